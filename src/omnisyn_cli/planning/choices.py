"""What frames are made with: where a job leaves it open, its preset and the pose file decide."""

from __future__ import annotations

from collections.abc import Sequence

from omnisyn_cli.errors import InputError, PoseError
from omnisyn_cli.io import PosedPanorama
from omnisyn_cli.planning.job import InterpolationJob
from omnisyn_cli.presets import FUSION_MODELS, OMNISYN, PRESETS, SYNSIN_MODELS
from omnisyn_cli.render.mesh import Cut

__all__ = ["depth_method", "made_with", "networks_of"]

MODELLED = ("refined", "network", "monocular")
"""Sources of depth that a network has a part in."""


def depth_method(job: InterpolationJob, entries: Sequence[PosedPanorama]) -> str:
    """Where depth comes from, one of :data:`omnisyn_cli.estimators.DEPTH_SOURCES`.

    Raises:
        PoseError: it is to come from files, and the pose file does not name one for every panorama.
    """
    if job.method != OMNISYN:
        return "monocular"
    without = [image.name for image, entry in zip(job.images, entries, strict=True) if entry.depth is None]
    if job.depth == "auto":
        return PRESETS[job.preset].depth if without or job.model is not None else "file"
    if job.depth == "file" and without:
        raise PoseError(
            f"{job.poses}: expected a 'depth' file for every panorama, got none for {', '.join(without)}; "
            "name one or choose another depth method"
        )
    return job.depth


def made_with(job: InterpolationJob, depth: str) -> tuple[str | None, str, str, Cut]:
    """Network of the depth, fusion, renderer and cut: what the job says, else its preset.

    Raises:
        InputError: a network where none has a part, or none where one has.
    """
    preset = PRESETS[job.preset]
    renderer = preset.renderer if job.renderer == "auto" else job.renderer
    cut = Cut() if preset.cut_metres is None else Cut(relative=None, metres=preset.cut_metres)
    return _model(job, depth), _fusion(job, depth), renderer, cut if job.cut is None else job.cut


def networks_of(job: InterpolationJob, entries: Sequence[PosedPanorama]) -> tuple[str, ...]:
    """Networks that have a part in a job's frames, by name in the manifest or as paths: of depth, then of fusion.

    Raises:
        InputError, PoseError: depth cannot be had as the job asks for it.
    """
    if job.method != OMNISYN:
        return SYNSIN_MODELS
    depth = depth_method(job, entries)
    fusing = FUSION_MODELS.get(_fusion(job, depth))
    return tuple(network for network in (_model(job, depth), fusing) if network is not None)


def _model(job: InterpolationJob, depth: str) -> str | None:
    """The network that finds or refines depth, if one does."""
    preset = PRESETS[job.preset]
    usual = {preset.depth: preset.model, "monocular": SYNSIN_MODELS[0]}
    model = job.model or usual.get(depth)
    if depth not in MODELLED:
        if job.model is not None:
            raise InputError(
                f"expected a model only for depth {' or '.join(MODELLED)}, got depth {depth!r} and model "
                f"{job.model!r}; leave one of them out"
            )
        return None
    if model is None:
        raise InputError(f"expected a model for depth {depth!r}, got none; name one (--model)")
    return model


def _fusion(job: InterpolationJob, depth: str) -> str:
    """How renderings are fused; the network never saw those of known depth and makes them worse."""
    if job.fusion != "auto":
        return job.fusion
    return "geometric" if depth == "file" else PRESETS[job.preset].fusion
