"""What is going to be done: a user's wishes, checked against the files, before any picture is decoded.

Whatever can be refused is refused here, so that nothing fails after minutes of work that could have been known before.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from omnisyn_cli.errors import ImageError, InputError, OutputPathError, PoseError
from omnisyn_cli.estimators import DEPTH_SOURCES
from omnisyn_cli.io import (
    MAX_PIXELS,
    PosedPanorama,
    PoseFile,
    check_output,
    check_video,
    read_header,
    read_poses,
    sample_type,
)
from omnisyn_cli.io.background import frames_in_queue
from omnisyn_cli.io.decode import check_pixel_count
from omnisyn_cli.io.depth import check_depth_header
from omnisyn_cli.io.encoders import CODECS
from omnisyn_cli.io.paths import check_name
from omnisyn_cli.io.placement import placement_of
from omnisyn_cli.io.sequence import image_sequence, is_sequence
from omnisyn_cli.io.staging import check_staged_folder
from omnisyn_cli.presets import DEFAULT_FUSION, DEFAULT_PRESET, FUSION_MODEL, FUSIONS, PRESETS
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.runtime.models import find_model
from omnisyn_cli.runtime.session import DEVICES
from omnisyn_cli.trajectory import EASES, HEADINGS, STILL, Ease, Heading, Waypoint, path_length, plan_path

__all__ = [
    "DEPTH_METHODS",
    "FALLBACKS",
    "POSES_FROM_PICTURES",
    "RENDERERS",
    "SECONDS_PER_PAIR",
    "InterpolationJob",
    "InterpolationPlan",
    "depth_name",
    "networks_of",
    "plan_interpolation",
    "targets",
    "with_preset",
]

DEPTH_METHODS = ("auto", *DEPTH_SOURCES)

RENDERERS = ("mesh", "points", "two-pass")
"""Those of :mod:`omnisyn_cli.render.renderer`, by name: importing it takes longer than planning."""

POSES_FROM_PICTURES = Path("auto")
"""Stands for a pose file where there is none."""

MODELLED = ("refined", "network")
"""Sources of depth that a network has a part in."""

FALLBACKS = ("none", "crossfade", "fail")

SECONDS_PER_PAIR = 3.0
"""Length of the video between two panoramas unless the user says otherwise."""

MOST_NADIR = math.radians(90.0)
"""A cap that is no hemisphere yet."""

LEAST_HEIGHT = 2
"""Rows of the smallest panorama that a surface can be made of."""

MOST_FRAMES = 1_000_000
"""Nine hours; more is taken for a mistake."""


@dataclass(frozen=True)
class InterpolationJob:
    """What a user asks for.

    Attributes:
        images: two or more panoramas, in walking order.
        poses: pose file that names them all, or :data:`POSES_FROM_PICTURES` to find them in the pictures.
        output: video file, folder or file name pattern.
        frames: number of frames; None follows from ``duration`` and ``fps``.
        duration: seconds; None means three per pair.
        fps: frames per second.
        size: (height, width) of the video; None means that of the largest panorama.
        preset: how much time accuracy is worth, one of :data:`omnisyn_cli.presets.PRESETS`.
        depth: ``matching``, ``refined`` (matching made better by a network), ``file`` (named in the pose file),
            ``network``, or ``auto``: files where every panorama has one, else what the preset says.
        model: for ``network`` and ``refined``: an ONNX file, or a name in the manifest of installed models; None is the
            preset's.
        device: where the network runs: ``auto``, ``cpu`` or ``cuda``. All else runs on the processor.
        renderer: ``mesh``, ``points`` or ``two-pass``.
        cut: where meshes are cut.
        fusion: ``geometric``, or ``network``, which corrects it where the views contradict each other.
        ease, heading: see :func:`omnisyn_cli.trajectory.plan_path`.
        codec, crf, encoder_preset: see :func:`omnisyn_cli.io.open_video`.
        save_depth: folder for the depth of every panorama, as EXR; None saves none.
        masks: an image for every panorama, black where it must not be used, besides those of the pose file; or none.
        nadir: radians around every panorama's own straight down (its last row) that are not used: tripod, car roof.
        fallback: what is done about pairs of low confidence: ``none`` warns, ``crossfade`` shows the photographs,
            cross-faded, in doubtful regions, ``fail`` gives up.
        save_confidence: video or folder for the confidence of every pixel, in grey; None saves none.
        save_frames: folder or pattern for the frames as images besides the video; None saves none.
        threads: at most this many; None is one per core.
        overwrite: replace what exists.
        allow_aspect: resample panoramas that are not 2:1.
        max_pixels: refuse panoramas, masks and depth files with more pixels, before they are decoded.
        allow_outside: accept depth and masks that the pose file names outside of its folder.
        baseline: metres between neighbours whose poses are found in the pictures; None takes 1 and says so.
        refine: correct rotations and directions of the given poses where the pictures fit better then.
        adaptive: draw flat surfaces with fewer triangles, see :class:`omnisyn_cli.synthesis.SynthesisOptions`.
    """

    images: tuple[Path, ...]
    poses: Path
    output: Path
    frames: int | None = None
    duration: float | None = None
    fps: float = 30.0
    size: tuple[int, int] | None = None
    preset: str = DEFAULT_PRESET
    depth: str = "auto"
    model: str | None = None
    device: str = "auto"
    renderer: str = "mesh"
    cut: Cut = field(default_factory=Cut)
    fusion: str = DEFAULT_FUSION
    ease: Ease = "linear"
    heading: Heading = "panoramas"
    codec: str | None = None
    crf: float | None = None
    encoder_preset: str | None = None
    save_depth: Path | None = None
    masks: tuple[Path, ...] = ()
    nadir: float = 0.0
    fallback: str = "none"
    save_confidence: Path | None = None
    save_frames: Path | None = None
    threads: int | None = None
    overwrite: bool = False
    allow_aspect: bool = False
    max_pixels: int = MAX_PIXELS
    allow_outside: bool = False
    baseline: float | None = None
    refine: bool = False
    adaptive: bool = False


@dataclass(frozen=True)
class InterpolationPlan:
    """A job that has been checked.

    Attributes:
        job: what was asked for.
        entries: the pose file's entry of every panorama.
        source_sizes: (height, width) of every panorama.
        size: (height, width) of the video.
        path: a waypoint for every frame.
        depth: where depth comes from, one of :data:`omnisyn_cli.estimators.DEPTH_SOURCES`.
        model: the network that has a part in it; None if none has.
        length: metres from the first panorama to the last.
        memory: bytes that the pictures and buffers will take, estimated.
        notes: what the user should know.
    """

    job: InterpolationJob
    entries: tuple[PosedPanorama, ...]
    source_sizes: tuple[tuple[int, int], ...]
    size: tuple[int, int]
    path: tuple[Waypoint, ...]
    depth: str
    model: str | None
    length: float
    memory: int
    notes: tuple[str, ...]

    def describe(self) -> dict[str, Any]:
        """The plan as plain values, for people and for JSON."""
        height, width = self.size
        return {
            "inputs": [str(image) for image in self.job.images],
            "output": str(self.job.output),
            "frames": len(self.path),
            "fps": self.job.fps,
            "seconds_of_video": round(len(self.path) / self.job.fps, 3),
            "size": f"{width}x{height}",
            "encoder": _encoder(self.job),
            "preset": self.job.preset,
            "depth": self.depth,
            "model": self.model or "",
            "renderer": self.job.renderer,
            "fusion": self.job.fusion,
            "path_metres": round(self.length, 4),
            "memory_mib": round(self.memory / 2**20),
            "notes": list(self.notes),
        }


def plan_interpolation(job: InterpolationJob) -> InterpolationPlan:
    """Check a job without writing anything; pictures are decoded only to find or to refine poses.

    Raises:
        InputError: a file is missing, poses do not fit, the output exists, a size or count makes no sense.
    """
    if len(job.images) < 2:
        raise InputError(f"expected two or more panoramas, got {len(job.images)}; name at least a first and a last one")
    _check_names(job)
    _check_choices(job)
    pose_file, remarks = _poses(job)
    entries = tuple(pose_file.of(image) for image in job.images)
    source_sizes = tuple(_size_of(image, job) for image in job.images)
    depth = _depth_method(job, entries)
    model = _model(job, depth)
    for network in networks_of(job, entries):
        find_model(network)
    _check_companions(entries, depth)
    for mask in job.masks:
        read_header(mask)
    size = job.size or _even(max(source_sizes))
    _check_outputs(job, size)
    _check_inputs_survive(job, entries)
    poses = [entry.pose for entry in entries]
    path = tuple(plan_path(poses, _frame_count(job), ease=job.ease, heading=job.heading))
    memory = _memory(job, size, source_sizes, _depth_sizes(entries, depth, PRESETS[job.preset].depth_rows))
    return InterpolationPlan(
        job, entries, source_sizes, size, path, depth, model, path_length(poses), memory,
        (*remarks, *_notes(job, entries, depth)),
    )  # fmt: skip


def with_preset(plan: InterpolationPlan, preset: str) -> InterpolationPlan:
    """The plan with another preset; its poses are not looked for again.

    Raises:
        InputError: the preset's network is not installed.
    """
    job = replace(plan.job, preset=preset)
    depth = _depth_method(job, plan.entries)
    for network in networks_of(job, plan.entries):
        find_model(network)
    sizes = _depth_sizes(plan.entries, depth, PRESETS[preset].depth_rows)
    memory = _memory(job, plan.size, plan.source_sizes, sizes)
    return replace(plan, job=job, depth=depth, model=_model(job, depth), memory=memory)


def networks_of(job: InterpolationJob, entries: Sequence[PosedPanorama]) -> tuple[str, ...]:
    """Networks that have a part in a job's frames, by name in the manifest or as paths: of depth, then of fusion.

    Raises:
        InputError, PoseError: depth cannot be had as the job asks for it.
    """
    model = _model(job, _depth_method(job, entries))
    return (*(() if model is None else (model,)), *((FUSION_MODEL,) if job.fusion == "network" else ()))


def depth_name(images: Sequence[Path], pair: int, index: int) -> str:
    """File name of the depth of panorama ``index`` as one of a pair; inside a chain it has one for each pair."""
    return f"{pair:04d}_{images[index].stem}_depth.exr"


def _poses(job: InterpolationJob) -> tuple[PoseFile, tuple[str, ...]]:
    """The poses, read, refined or found, and what there is to say about them."""
    is_found = job.poses == POSES_FROM_PICTURES
    if job.baseline is not None and not is_found:
        raise InputError(
            f"expected a baseline only where poses are found in the pictures (--poses auto), got {job.baseline:g} m "
            f"and {job.poses}; leave out one of them"
        )
    if not (is_found or job.refine):
        return read_poses(job.poses, allow_outside=job.allow_outside), ()
    # OpenCV takes a while to import and is needed for poses from pictures only.
    from omnisyn_cli.posing import PictureOptions, estimate_poses, refine_poses

    options = PictureOptions(job.allow_aspect, job.threads, job.max_pixels)
    if is_found:
        found = estimate_poses(job.images, () if job.baseline is None else (job.baseline,), options)
    else:
        found = refine_poses(job.images, read_poses(job.poses, allow_outside=job.allow_outside), options)
    return PoseFile(job.poses, found.panoramas), found.notes


def _check_names(job: InterpolationJob) -> None:
    """File names that are not text (bytes from another encoding) cannot be handed to the image libraries."""
    for path in (*job.images, *job.masks, job.poses, job.output, job.save_depth, job.save_frames, job.save_confidence):
        name = str(path)
        if name.encode("utf-8", "replace") != name.encode("utf-8", "surrogateescape"):
            raise InputError(f"{name!r}: expected a file name in UTF-8, got other bytes; rename the file or its folder")
    for target in (job.output, job.save_depth, job.save_frames, job.save_confidence):
        if target is not None:
            check_name(target)


def _size_of(image: Path, job: InterpolationJob) -> tuple[int, int]:
    """Height and width of the panorama that :func:`omnisyn_cli.io.read_panorama` will make of a file."""
    placement = placement_of(read_header(image))
    height, width = placement.full_height, placement.full_width
    check_pixel_count(image, height, width, job.max_pixels)
    if min(height, width // 2) < LEAST_HEIGHT:
        raise ImageError(
            f"{image}: expected a panorama of at least {2 * LEAST_HEIGHT}×{LEAST_HEIGHT} pixels, got {width}×{height}; "
            "choose a larger image"
        )
    if width == 2 * height:
        return height, width
    if not job.allow_aspect:
        raise ImageError(
            f"{image}: expected an equirectangular panorama twice as wide as high, got {width}×{height}; "
            "stitch it to 2:1, or allow other aspect ratios (--allow-aspect) if the image does cover the whole sphere"
        )
    return width // 2, width // 2 * 2


def _even(size: tuple[int, int]) -> tuple[int, int]:
    """The 2:1 size with an even height that is closest to an image of this height."""
    height = size[0] + size[0] % 2
    return height, 2 * height


def _frame_count(job: InterpolationJob) -> int:
    if job.frames is not None and job.duration is not None:
        raise InputError(
            f"expected either frames or a duration, got {job.frames} frames and {job.duration:g} s; name one, and the "
            "frames per second"
        )
    seconds = job.duration if job.duration is not None else SECONDS_PER_PAIR * (len(job.images) - 1)
    count = job.frames if job.frames is not None else seconds * job.fps
    if not math.isfinite(count) or count > MOST_FRAMES:
        raise InputError(f"expected at most {MOST_FRAMES:,} frames, got {count:g}; ask for fewer")
    if round(count) < len(job.images):
        raise InputError(
            f"expected at least {len(job.images)} frames, one for each panorama, got {round(count)}; "
            "ask for more frames or a longer duration"
        )
    return round(count)


def _depth_method(job: InterpolationJob, entries: Sequence[PosedPanorama]) -> str:
    without = [image.name for image, entry in zip(job.images, entries, strict=True) if entry.depth is None]
    if job.depth == "auto":
        return PRESETS[job.preset].depth if without or job.model is not None else "file"
    if job.depth == "file" and without:
        raise PoseError(
            f"{job.poses}: expected a 'depth' file for every panorama, got none for {', '.join(without)}; "
            "name one or choose another depth method"
        )
    return job.depth


def _model(job: InterpolationJob, depth: str) -> str | None:
    """The network that finds or refines depth, if one does."""
    preset = PRESETS[job.preset]
    model = job.model or (preset.model if depth == preset.depth else None)
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


def _check_choices(job: InterpolationJob) -> None:
    """What the command line offers as choices, for those who call the library."""
    choices = {
        "preset": (job.preset, PRESETS),
        "depth": (job.depth, DEPTH_METHODS),
        "renderer": (job.renderer, RENDERERS),
        "fusion": (job.fusion, FUSIONS),
        "ease": (job.ease, EASES),
        "heading": (job.heading, HEADINGS),
        "device": (job.device, DEVICES),
        "fallback": (job.fallback, FALLBACKS),
    }
    for name, (value, known) in choices.items():
        if value not in known:
            raise InputError(f"expected one of {', '.join(known)} as {name}, got {value!r}; choose one of these")
    if job.masks and len(job.masks) != len(job.images):
        raise InputError(
            f"expected one mask for each of {len(job.images)} panoramas, got {len(job.masks)}; name them in the order "
            "of the panoramas, or in the pose file"
        )
    if not 0.0 <= job.nadir < MOST_NADIR:
        raise InputError(
            f"expected a cap around the nadir of at least 0 and less than {math.degrees(MOST_NADIR):g} degrees, got "
            f"{math.degrees(job.nadir):g}; give the angle from straight down to its edge"
        )


def _check_companions(entries: Sequence[PosedPanorama], depth: str) -> None:
    """Masks, and depth files if they are used, have to be there."""
    for entry in entries:
        if entry.mask is not None:
            read_header(entry.mask)
        if entry.depth is not None and depth == "file":
            check_depth_header(read_header(entry.depth))


def _check_outputs(job: InterpolationJob, size: tuple[int, int]) -> None:
    if size[1] != 2 * size[0]:
        raise InputError(f"expected a size twice as wide as high, got {size[1]}x{size[0]}; try {2 * size[0]}x{size[0]}")
    if size[0] * size[1] > MAX_PIXELS:
        raise InputError(f"expected a size of at most {MAX_PIXELS:,} pixels, got {size[1]}x{size[0]}; ask for less")
    check_video(
        job.output,
        size=size,
        fps=job.fps,
        codec=job.codec,
        crf=job.crf,
        preset=job.encoder_preset,
        dtype=sample_type(job.output, job.codec),
        overwrite=job.overwrite,
    )
    if job.save_frames is not None:
        _check_saved_frames(job, job.save_frames, size)
    if job.save_confidence is not None:
        check_video(job.save_confidence, size=size, fps=job.fps, overwrite=job.overwrite)
        if job.save_confidence.resolve() == job.output.resolve():
            raise OutputPathError(f"{job.output}: expected another place for the confidence; name another file")
    if job.save_depth is not None:
        check_staged_folder(job.save_depth)
        for file in _depth_files(job):
            if file.exists():
                check_output(file, job.overwrite)


def _check_saved_frames(job: InterpolationJob, frames: Path, size: tuple[int, int]) -> None:
    if not is_sequence(frames):
        raise OutputPathError(f"{frames}: expected a folder or a pattern such as frames/%05d.png, got a file name")
    if is_sequence(job.output) and image_sequence(frames) == image_sequence(job.output):
        raise OutputPathError(f"{frames}: expected another place than the output's, got the same; name another folder")
    check_video(frames, size=size, fps=job.fps, overwrite=job.overwrite)


def _depth_files(job: InterpolationJob) -> Iterator[Path]:
    if job.save_depth is not None:
        for pair in range(len(job.images) - 1):
            for index in (pair, pair + 1):
                yield job.save_depth / depth_name(job.images, pair, index)


def _check_inputs_survive(job: InterpolationJob, entries: Sequence[PosedPanorama]) -> None:
    """Overwriting must not reach what the video is made of."""
    replaced = {job.output.resolve(), *(file.resolve() for file in _depth_files(job))}
    if job.save_confidence is not None:
        replaced.add(job.save_confidence.resolve())
    for place in (job.output, job.save_frames, job.save_confidence):
        if place is not None and is_sequence(place):
            replaced.update(file.resolve() for file in image_sequence(place).existing())
    companions = (file for entry in entries for file in (entry.depth, entry.mask) if file is not None)
    for file in (*job.images, *job.masks, job.poses, *companions):
        if file.resolve() in replaced:
            raise OutputPathError(f"{file}: expected inputs that are not overwritten, got this one; write elsewhere")


def _encoder(job: InterpolationJob) -> str:
    """The codec and its settings in a few words."""
    if is_sequence(job.output):
        sequence = image_sequence(job.output, f".{job.codec or 'png'}")
        return f"{Path(sequence.after).suffix.lstrip('.') or sequence.after.lstrip('.')} images"
    codec = CODECS[job.codec or "h264"]
    crf = codec.crf if job.crf is None else job.crf
    quality = "" if crf is None else f" crf {crf:g}"
    return f"{job.codec or 'h264'}{quality} preset {job.encoder_preset or codec.preset}"


def _notes(job: InterpolationJob, entries: Sequence[PosedPanorama], depth: str) -> Iterator[str]:
    named = [image.name for image, entry in zip(job.images, entries, strict=True) if entry.depth is not None]
    if job.depth == "auto" and depth != "file" and named:
        yield f"{job.poses.name} names depth for {', '.join(named)} only: depth of all comes from matching"
    for (a, first), (b, second) in pairwise(zip(job.images, entries, strict=True)):
        if np.linalg.norm(second.pose.position - first.pose.position) <= STILL:
            same = second.pose.almost_equals(first.pose)
            how = "cross-fades" if same else "turns in place and cross-fades"
            yield f"{a.name} and {b.name} have the same position: there is no parallax to follow, the video {how}"


PROGRAM = 450e6
"""Bytes of the interpreter, its libraries, compiled kernels and matching."""

BYTES_PER_VERTEX = {"mesh": 45, "points": 400, "two-pass": 950}
"""Measured at their peaks and rounded up: mesh with buffers; splats; explicit triangles."""

MIP_LEVELS = 4 / 3
"""Pixels of a texture with its mip levels, in those of the picture."""

LEAST_ROWS_BY_ROWS = 897
"""Rows from which on frames are coloured some rows at a time (:meth:`omnisyn_cli.fusion.GeometricFuser.takes_rows`)."""


def _memory(
    job: InterpolationJob, size: tuple[int, int], sources: Sequence[tuple[int, int]], depths: Sequence[tuple[int, int]]
) -> int:
    """Bytes, estimated: the most of what is held while a pair is prepared and while frames are made of it."""
    largest, vertices = (max(height * width for height, width in group) for group in (sources, depths))
    has_samples = all(read_header(image).dtype == "uint8" for image in job.images)
    is_kept_as_samples = has_samples and job.renderer == "mesh"
    kept = (3 if has_samples else 12) + MIP_LEVELS * 4 * (1 if is_kept_as_samples else 4)
    numbers, texturing = 12, 4  # of both for depth; of the last one again, when it is shown
    surfaces = 2 * BYTES_PER_VERTEX[job.renderer] * vertices
    held = max(2 * (numbers + texturing) * largest, _bytes_of_frames(job, size) + numbers * largest)
    return int(PROGRAM + surfaces + 2 * kept * largest + held)


def _bytes_of_frames(job: InterpolationJob, size: tuple[int, int]) -> float:
    """What making frames takes: two renderings, the pyramid that fills holes, frames on their way to the encoder."""
    pixels = size[0] * size[1]
    kinds = {sample_type(path, codec) for path, codec in targets(job)}
    is_by_rows = (
        kinds == {"uint8"} and job.renderer == "mesh" and size[0] % 2 == 0 and size[0] >= LEAST_ROWS_BY_ROWS
        and job.fusion == "geometric" and job.fallback != "crossfade" and job.save_confidence is None
    )  # fmt: skip
    pyramid, planes = 16 / 3, 1.5
    waiting = frames_in_queue(size) + 2
    if is_by_rows:
        return pixels * (2 * 8 + 1 + pyramid + 3 * waiting + planes)
    largest_sample = max(np.dtype(kind).itemsize for kind in kinds)
    return pixels * (2 * (8 + 16) + 16 + pyramid + 3 * largest_sample * waiting + planes)


def targets(job: InterpolationJob) -> list[tuple[Path, str | None]]:
    """Path and codec of everything that takes frames.

    The video comes last, so that it is finished first: if that fails, no images are kept either.
    """
    images: list[tuple[Path, str | None]] = [] if job.save_frames is None else [(job.save_frames, None)]
    return [*images, (job.output, job.codec)]


def _depth_sizes(entries: Sequence[PosedPanorama], depth: str, rows: int) -> list[tuple[int, int]]:
    """Rows and columns of the surfaces; estimated depth has at most ``rows``."""
    headers = [read_header(entry.depth) for entry in entries if entry.depth is not None] if depth == "file" else []
    return [(header.height, header.width) for header in headers] or [(rows, 2 * rows)]
