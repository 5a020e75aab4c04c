"""Which jobs have their frames made on a GPU, and what there is to say where one was asked for."""

from __future__ import annotations

from collections.abc import Sequence

from omnisyn_cli.planning.job import InterpolationJob
from omnisyn_cli.presets import OMNISYN
from omnisyn_cli.runtime.session import check_device_of_networks

__all__ = ["are_frames_on_gpu", "check_device", "notes_about_gpu"]


def are_frames_on_gpu(job: InterpolationJob, renderer: str, fusion: str) -> bool:
    """Whether frames between photographs are made by :mod:`omnisyn_cli.gpu`: where CUDA is asked for by name.

    Args:
        job: what is asked for.
        renderer: how surfaces are drawn, no longer ``auto``.
        fusion: how two renderings become one picture, likewise.
    """
    return job.device == "cuda" and job.method == OMNISYN and not _against(job, renderer, fusion)


def check_device(job: InterpolationJob, renderer: str, fusion: str, networks: Sequence[str]) -> None:
    """Refuse a device that this machine does not have; a plan alone may be for another one.

    Args:
        job: what is asked for.
        renderer: as of :func:`are_frames_on_gpu`.
        fusion: likewise.
        networks: that have a part in the frames.

    Raises:
        InputError: there is no such device here.
    """
    if job.device != "cuda":
        return
    if are_frames_on_gpu(job, renderer, fusion):
        from omnisyn_cli.gpu.device import open_device  # torch takes seconds to import

        open_device(job.device)
    if networks:
        check_device_of_networks(job.device)


def notes_about_gpu(job: InterpolationJob, renderer: str, fusion: str) -> tuple[str, ...]:
    """What a user who asked for CUDA should know; arguments as of :func:`are_frames_on_gpu`."""
    if job.device != "cuda" or job.method != OMNISYN:
        return ()
    against = _against(job, renderer, fusion)
    if against:
        return (
            "frames are made on the processor: the GPU makes them only with the renderer mesh and the fusion "
            f"geometric, without confidence maps and cross-fades; this job has {', '.join(against)}",
        )
    return ("on the GPU every triangle is drawn, --adaptive changes nothing",) if job.adaptive else ()


def _against(job: InterpolationJob, renderer: str, fusion: str) -> list[str]:
    """What the GPU does not do."""
    wanted = {
        f"the renderer {renderer}": renderer != "mesh",
        f"the fusion {fusion}": fusion != "geometric",
        "confidence maps (--save-confidence)": job.save_confidence is not None,
        "cross-fades (--fallback crossfade)": job.fallback == "crossfade",
    }
    return [what for what, is_wanted in wanted.items() if is_wanted]
