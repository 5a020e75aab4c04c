"""Which jobs have their frames made on a GPU, and what there is to say where one was asked for."""

from __future__ import annotations

from omnisyn_cli.planning.job import InterpolationJob
from omnisyn_cli.presets import OMNISYN

__all__ = ["are_frames_on_gpu", "notes_about_gpu"]


def are_frames_on_gpu(job: InterpolationJob, renderer: str, fusion: str) -> bool:
    """Whether frames between photographs are made by :mod:`omnisyn_cli.gpu`: where CUDA is asked for by name.

    Args:
        job: what is asked for.
        renderer: how surfaces are drawn, no longer ``auto``.
        fusion: how two renderings become one picture, likewise.
    """
    return job.device == "cuda" and job.method == OMNISYN and not _against(job, renderer, fusion)


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
