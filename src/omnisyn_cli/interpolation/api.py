"""The library in a few verbs, for notebooks and scripts: what ``import omnisyn_cli`` offers.

Read panoramas and poses, estimate depth, make frames, write a video; :mod:`omnisyn_cli.evaluation.public_api`
evaluates. An estimator of depth or a fuser of your own is any callable with the signature of
:class:`~omnisyn_cli.types.DepthEstimator` or :class:`~omnisyn_cli.types.Fuser`.
"""

import inspect
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields
from itertools import chain
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
from jaxtyping import Float, Float32

from omnisyn_cli.errors import ImageError, InputError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.interpolation.job import INPUT_FILES, INPUT_LISTS, OUTPUTS, InterpolationJob, TourJob
from omnisyn_cli.interpolation.loading import known_depth
from omnisyn_cli.interpolation.plan import plan_interpolation
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.interpolation.summary import Summary
from omnisyn_cli.io import open_video, read_panorama, sample_type
from omnisyn_cli.io.images import INTEGER_PEAKS, usable_part
from omnisyn_cli.pipeline.config import DepthSource, RunConfig, frame_size, make_method
from omnisyn_cli.pipeline.depth_sources import make_estimator
from omnisyn_cli.pipeline.presets import DEFAULT_PRESET, PRESETS
from omnisyn_cli.poses.file import read_poses
from omnisyn_cli.synthesis.consistency import equalize_exposure
from omnisyn_cli.synthesis.synthesize import synthesize
from omnisyn_cli.synthesis.trajectory import Ease, Heading, plan_path
from omnisyn_cli.types import DepthEstimate, DepthEstimator, Fuser, Layer, View

__all__ = [
    "PRESETS", "DepthEstimate", "DepthEstimator", "DepthSource", "Fuser", "Layer", "Pose", "RunConfig", "View",
    "estimate_depth", "interpolate", "make_frames", "read_views", "write_video",
]  # fmt: skip


def read_views(images: Sequence[Path | str], poses: Path | str, *, nadir_deg: float = 0.0) -> list[View]:
    """Panoramas, two or more in walking order, with their poses, masks and, where the pose file names it, their depth.

    ``nadir_deg`` are degrees around straight down that are not used: tripod, roof of a car. InputError: a file is
    missing or damaged, or the pose file does not name a panorama.
    """
    paths, views = _paths(images), []
    file = read_poses(poses)
    for path in paths:
        panorama, entry = read_panorama(path), file.of(path)
        mask = usable_part(panorama.mask, panorama.image.shape[:2], (entry.mask,), math.radians(nadir_deg))
        views.append(View(panorama.image, entry.pose, mask, known_depth(entry)))
    return views


def estimate_depth(
    first: View, second: View, config: RunConfig | str = DEFAULT_PRESET, *, threads: int | None = None
) -> tuple[DepthEstimate, DepthEstimate]:
    """Inverse depth (1/metre) and confidence of both panoramas of a pair, each in its own frame.

    Of a config, or the preset of that name, only depth and device matter; ``threads`` None is one per core.
    InputError: a network is missing, or there is no such device.
    """
    config = _resolved(config)
    return make_estimator(config.depth, device=config.device, threads=threads)(
        *equalize_exposure(first, second, threads)
    )


def make_frames(
    views: Sequence[View], frames: int, config: RunConfig | str = DEFAULT_PRESET, *,
    size: str | tuple[int, int] | None = None, ease: Ease = "linear", heading: Heading = "panoramas",
    estimator: DepthEstimator | None = None, fuser: Fuser | None = None, threads: int | None = None,
) -> Iterator[Float32[np.ndarray, "height width 3"]]:  # fmt: skip
    """Frames from the first to the last of two panoramas or more: RGB in [0, 1], one at a time, in memory of their own.

    ``config`` is a config or the name of a preset, which takes the depth of the views where all of them have some.
    ``size`` is such as ``"2048x1024"``, or (width, height); None is that of the first panorama. For ``ease`` and
    ``heading`` see :func:`omnisyn_cli.synthesis.trajectory.plan_path`. ``estimator`` and ``fuser`` (for frames of this
    size) find depth, and join both renderings, in place of the config's. ``threads`` None is one per core.

    Raises InputError: a network is missing, or there is no such device; ValueError: fewer than two views, or fewer
    frames than views.
    """
    path = plan_path([view.pose for view in views], frames, ease=ease, heading=heading)
    chosen = _resolved(config)
    if isinstance(config, str) and estimator is None and all(view.known_depth is not None for view in views):
        chosen = chosen.of_known_depth()
    height, width = views[0].image.shape[:2] if size is None else frame_size(size)
    method = make_method(chosen, (height, width), threads=threads, estimator=estimator, fuser=fuser)
    for frame in synthesize(views, path, method):
        yield np.array(np.clip(frame.image, 0.0, 1.0), np.float32)


def write_video(
    path: Path | str, frames: Iterable[Float[np.ndarray, "height width 3"]], *, fps: float = 30.0, **options: Any
) -> None:
    """Write frames as a 360° video, or as numbered images into a folder.

    Frames are RGB in [0, 1], all of one size. ``path`` and the options ``codec``, ``crf``, ``preset`` and
    ``overwrite`` are those of :func:`omnisyn_cli.io.open_video`.

    Raises ImageError: there are no frames; InputError, OutputPathError: the size, the place or an option cannot be
    used; EncodingError, WriteError: the encoder stopped, or the disk is full.
    """
    waiting = iter(frames)
    if (first := next(waiting, None)) is None:
        raise ImageError(f"{path}: expected one frame or more, got none")
    kind = sample_type(Path(path), options.get("codec"))
    with open_video(path, size=first.shape[:2], fps=fps, dtype=kind, **options) as sink:
        for frame in chain([first], waiting):
            whole = np.rint(np.clip(frame, 0.0, 1.0) * INTEGER_PEAKS[kind]) if kind in INTEGER_PEAKS else frame
            sink.write(whole.astype(kind))


def interpolate(images: Sequence[Path | str], poses: Path | str, output: Path | str, **options: Any) -> Summary:
    """From files to a video, as ``omnisyn interpolate`` does it.

    Args:
        images: two or more panoramas, in walking order.
        poses: pose file that names them all, or ``auto`` to find them in the pictures.
        output: video file, folder or file name pattern.
        options: those below; angles are in radians, and a size may be ``"2048x1024"`` or (width, height) too.

    Raises OmnisynError: something that was given cannot be used, or writing failed.
    """
    if options.get("size") is not None and options.get("projection") != "flat":
        options["size"] = frame_size(options["size"])
    options |= {name: Path(options[name]) for name in (*OUTPUTS, *INPUT_FILES) if options.get(name) is not None}
    options |= {name: tuple(map(Path, options[name])) for name in INPUT_LISTS if name in options}
    job = InterpolationJob(_paths(images), Path(poses), Path(output), **options)
    return run_interpolation(plan_interpolation(job))


def _with_options(verb: inspect.Signature) -> inspect.Signature:
    """The signature with every option in place of ``**options``, for ``help`` and for editors."""
    types = get_type_hints(InterpolationJob)  # without their ranges
    named = [parameter for parameter in verb.parameters.values() if parameter.kind is not parameter.VAR_KEYWORD]
    options = [
        inspect.Parameter(each.name, inspect.Parameter.KEYWORD_ONLY, default=each.default, annotation=types[each.name])
        for each in fields(InterpolationJob)
        if each.name not in verb.parameters
    ]
    return verb.replace(parameters=[*named, *options])


interpolate.__signature__ = _with_options(inspect.signature(interpolate))  # type: ignore[attr-defined]
interpolate.__doc__ = "\n\n".join(inspect.getdoc(each) or "" for each in (interpolate, TourJob, InterpolationJob))


def _paths(images: Sequence[Path | str]) -> tuple[Path, ...]:
    """Names as paths; InputError: there is one name instead of several."""
    if isinstance(images, str | Path):
        raise InputError(f"expected a list of two or more panoramas, got the single name {str(images)!r}; write [a, b]")
    return tuple(map(Path, images))


def _resolved(config: RunConfig | str) -> RunConfig:
    if isinstance(config, RunConfig):
        return config
    if config not in PRESETS:
        raise ValueError(f"expected a config or a preset of {', '.join(PRESETS)}, got {config!r}")
    return PRESETS[config].config
