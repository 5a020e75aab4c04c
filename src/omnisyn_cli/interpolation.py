"""From files to a video: what ``omnisyn interpolate`` does, as a library.

:func:`plan_interpolation` reads and checks everything that can be known without decoding a picture;
:func:`run_interpolation` does the work. Nothing appears under its final name unless all of it succeeded.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from omnisyn_cli.errors import InputError, PoseError
from omnisyn_cli.fusion.kernels import quantize_rows
from omnisyn_cli.io import (
    FrameSink,
    Panorama,
    PosedPanorama,
    check_video,
    open_video,
    read_header,
    read_inverse_depth,
    read_mask,
    read_panorama,
    read_poses,
    write_depth,
)
from omnisyn_cli.io.background import BackgroundSink
from omnisyn_cli.io.paths import check_folder, check_output, write_errors
from omnisyn_cli.io.placement import placement_of
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.synthesis import Frame, Segment, Stopwatch, SynthesisOptions, synthesize
from omnisyn_cli.threads import run_bands
from omnisyn_cli.trajectory import STILL, Ease, Heading, Waypoint, path_length, plan_path
from omnisyn_cli.types import DepthEstimate, DepthEstimator, KnownDepth, View

__all__ = ["DEPTH_METHODS", "InterpolationJob", "InterpolationPlan", "Summary", "plan_interpolation", "run_interpolation"]

DEPTH_METHODS = ("auto", "matching", "file")

SECONDS_PER_PAIR = 3.0
"""Length of the video between two panoramas unless the user says otherwise."""


@dataclass(frozen=True)
class InterpolationJob:
    """What a user asks for.

    Attributes:
        images: two or more panoramas, in walking order.
        poses: pose file that names them all.
        output: video file, folder or file name pattern.
        frames: number of frames; None follows from ``duration`` and ``fps``.
        duration: seconds; None means three per pair.
        fps: frames per second.
        size: (height, width) of the video; None means that of the largest panorama.
        depth: ``matching``, ``file`` (named in the pose file), or ``auto``: file where every panorama has one.
        renderer: ``mesh``, ``points`` or ``two-pass``.
        cut: where meshes are cut.
        ease, heading: see :func:`omnisyn_cli.trajectory.plan_path`.
        codec, crf, preset: see :func:`omnisyn_cli.io.open_video`.
        save_depth: folder for the depth of every panorama, as EXR; None saves none.
        save_frames: folder or pattern for the frames as images besides the video; None saves none.
        threads: at most this many; None is one per core.
        overwrite: replace what exists.
        allow_aspect: resample panoramas that are not 2:1.
    """

    images: tuple[Path, ...]
    poses: Path
    output: Path
    frames: int | None = None
    duration: float | None = None
    fps: float = 30.0
    size: tuple[int, int] | None = None
    depth: str = "auto"
    renderer: str = "mesh"
    cut: Cut = field(default_factory=Cut)
    ease: Ease = "linear"
    heading: Heading = "panoramas"
    codec: str | None = None
    crf: float | None = None
    preset: str | None = None
    save_depth: Path | None = None
    save_frames: Path | None = None
    threads: int | None = None
    overwrite: bool = False
    allow_aspect: bool = False


@dataclass(frozen=True)
class InterpolationPlan:
    """A job that has been checked.

    Attributes:
        job: what was asked for.
        entries: the pose file's entry of every panorama.
        source_sizes: (height, width) of every panorama.
        size: (height, width) of the video.
        path: a waypoint for every frame.
        depth: the depth method.
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
            "codec": self.job.codec or "by file name",
            "depth": self.depth,
            "renderer": self.job.renderer,
            "path_metres": round(self.length, 4),
            "memory_mib": round(self.memory / 2**20),
            "notes": list(self.notes),
        }


@dataclass(frozen=True)
class Summary:
    """What was done.

    Attributes:
        plan: what was planned.
        seconds: wall time by stage; ``total`` is all of it. Encoding runs beside the other stages: ``encode`` is the
            time that they waited for it.
    """

    plan: InterpolationPlan
    seconds: dict[str, float]

    def describe(self) -> dict[str, Any]:
        """The summary as plain values, for people and for JSON."""
        return {**self.plan.describe(), "stages": {stage: round(value, 3) for stage, value in self.seconds.items()}}


def plan_interpolation(job: InterpolationJob) -> InterpolationPlan:
    """Check a job without decoding or writing anything.

    Raises:
        InputError: a file is missing, poses do not fit, the output exists, a size or count makes no sense.
    """
    if len(job.images) < 2:
        raise InputError(f"expected two or more panoramas, got {len(job.images)}; name at least a first and a last one")
    pose_file = read_poses(job.poses)
    entries = tuple(pose_file.of(image) for image in job.images)
    source_sizes = tuple(_size_of(image) for image in job.images)
    size = job.size or _even(max(source_sizes))
    poses = [entry.pose for entry in entries]
    frame_count = _frame_count(job)
    path = tuple(plan_path(poses, frame_count, ease=job.ease, heading=job.heading))
    _check_outputs(job, size)
    depth = _depth_method(job, entries)
    memory = _memory(size, source_sizes, job)
    return InterpolationPlan(
        job, entries, source_sizes, size, path, depth, path_length(poses), memory, tuple(_notes(job, entries))
    )


def run_interpolation(plan: InterpolationPlan, on_frame: Callable[[int], None] | None = None) -> Summary:
    """Make the video.

    Args:
        plan: from :func:`plan_interpolation`.
        on_frame: called with the number of finished frames, after each.

    Raises:
        InputError: a picture, mask or depth file turns out to be damaged.
        EncodingError, WriteError: see :func:`omnisyn_cli.io.open_video`.
    """
    begin, clock = time.perf_counter(), Stopwatch()
    loader = _Loader(plan, clock)
    with clock("decode"):
        loader.panorama(0), loader.panorama(1)  # damage is found before anything is begun
    options = SynthesisOptions(plan.size, plan.job.renderer, plan.job.cut, plan.job.threads)
    estimator = _estimator(plan)
    with _sinks(plan) as sinks:
        done = 0
        for made in synthesize(loader.views(), plan.path, estimator, options, clock=clock):
            if isinstance(made, Segment):
                _save_depths(plan, made)
                continue
            frame = _as_bytes(made, loader, plan.job.threads)
            with clock("encode"):
                for sink in sinks:
                    sink.write(frame)
            done += 1
            if on_frame:
                on_frame(done)
        with clock("encode"):
            for sink in sinks:
                sink.finish()
    return Summary(plan, {**clock.seconds, "total": time.perf_counter() - begin})


def _estimator(plan: InterpolationPlan) -> DepthEstimator:
    if plan.depth == "file":
        return KnownDepth()
    from omnisyn_cli.stereo import MatchingDepthEstimator

    return MatchingDepthEstimator()


class _Loader:
    """Panoramas from their files when they are needed; the last two are kept."""

    def __init__(self, plan: InterpolationPlan, clock: Stopwatch) -> None:
        self._plan, self._clock = plan, clock
        self.panorama = lru_cache(maxsize=2)(self._read_panorama)
        self.view = lru_cache(maxsize=2)(self._read_view)

    def views(self) -> Sequence[View]:
        """All views, read on demand."""
        return _LazySequence(len(self._plan.entries), self.view)

    def _read_panorama(self, index: int) -> Panorama:
        return read_panorama(self._plan.job.images[index], allow_aspect=self._plan.job.allow_aspect)

    def _read_view(self, index: int) -> View:
        with self._clock("decode"):
            entry, panorama = self._plan.entries[index], self.panorama(index)
            mask = panorama.mask
            if entry.mask is not None:
                mask = _combined(mask, read_mask(entry.mask), panorama.image.shape[:2], entry.mask)
            return View(panorama.image, entry.pose, mask, self._known_depth(entry))

    def _known_depth(self, entry: PosedPanorama) -> DepthEstimate | None:
        if self._plan.depth != "file" or entry.depth is None:
            return None
        inverse_depth = read_inverse_depth(entry.depth)
        return DepthEstimate(inverse_depth, np.ones_like(inverse_depth))


class _LazySequence(Sequence[View]):
    def __init__(self, count: int, item: Callable[[int], View]) -> None:
        self._count, self._item = count, item

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> View:  # type: ignore[override]
        return self._item(index)


def _combined(mask: np.ndarray | None, second: np.ndarray, size: tuple[int, ...], path: Path) -> np.ndarray:
    if second.shape != size:
        raise InputError(f"{path}: expected a mask of {size[1]}×{size[0]} pixels, got {second.shape[1]}×{second.shape[0]}")
    return second if mask is None else mask & second


def _size_of(image: Path) -> tuple[int, int]:
    """Height and width of the whole sphere that the file will be read as."""
    placement = placement_of(read_header(image))
    return placement.full_height, placement.full_width


def _even(size: tuple[int, int]) -> tuple[int, int]:
    """The 2:1 size with an even height that is closest to an image of this height."""
    height = size[0] + size[0] % 2
    return height, 2 * height


def _frame_count(job: InterpolationJob) -> int:
    seconds = job.duration if job.duration is not None else SECONDS_PER_PAIR * (len(job.images) - 1)
    count = job.frames if job.frames is not None else round(seconds * job.fps)
    if count < len(job.images):
        raise InputError(
            f"expected at least {len(job.images)} frames, one for each panorama, got {count}; ask for more frames"
        )
    return count


def _check_outputs(job: InterpolationJob, size: tuple[int, int]) -> None:
    if size[1] != 2 * size[0]:
        raise InputError(f"expected a size twice as wide as high, got {size[1]}x{size[0]}; try {2 * size[0]}x{size[0]}")
    check_video(
        job.output, size=size, fps=job.fps, codec=job.codec, crf=job.crf, preset=job.preset, overwrite=job.overwrite
    )
    if job.save_frames is not None:
        check_video(job.save_frames, size=size, fps=job.fps, overwrite=job.overwrite)
    if job.save_depth is not None:
        check_folder(job.save_depth if job.save_depth.exists() else job.save_depth.parent)
        for pair in range(len(job.images) - 1):
            for index in (pair, pair + 1):
                check_depth = _depth_path(job, job.save_depth, pair, index)
                if check_depth.exists():
                    check_output(check_depth, job.overwrite)


def _depth_method(job: InterpolationJob, entries: Sequence[PosedPanorama]) -> str:
    without = [image.name for image, entry in zip(job.images, entries, strict=True) if entry.depth is None]
    if job.depth == "auto":
        return "matching" if without else "file"
    if job.depth == "file" and without:
        raise PoseError(
            f"{job.poses}: expected a 'depth' file for every panorama, got none for {', '.join(without)}; "
            "name one or choose another depth method"
        )
    return job.depth


def _notes(job: InterpolationJob, entries: Sequence[PosedPanorama]) -> Iterator[str]:
    for a, b, first, second in zip(job.images, job.images[1:], entries, entries[1:], strict=False):
        if np.linalg.norm(second.pose.position - first.pose.position) <= STILL:
            same = second.pose.almost_equals(first.pose)
            how = "cross-fades" if same else "turns in place and cross-fades"
            yield f"{a.name} and {b.name} have the same position: there is no parallax to follow, the video {how}"


def _memory(size: tuple[int, int], sources: Sequence[tuple[int, int]], job: InterpolationJob) -> int:
    """Bytes, estimated: two panoramas with textures, two renderings, the fused picture, frames on their way out."""
    del job
    largest = max(height * width for height, width in sources)
    pixels = size[0] * size[1]
    per_source_pixel = 3 + 12 + 16 * 4 / 3 + 24  # samples, floats, mip levels, mesh
    per_pixel = 2 * (8 + 16) + 16 + 16 / 3 + 5 * 3  # two renderings, picture, pyramid, frames in the queue
    return int(250e6 + 2 * per_source_pixel * largest + per_pixel * pixels)


def _save_depths(plan: InterpolationPlan, segment: Segment) -> None:
    """Depth of both panoramas of a pair; inside a chain a panorama has one file for each of its pairs."""
    folder = plan.job.save_depth
    if folder is None:
        return
    with write_errors(folder):
        folder.mkdir(exist_ok=True)
    for index, estimate in zip((segment.index, segment.index + 1), segment.depths, strict=True):
        write_depth(_depth_path(plan.job, folder, segment.index, index), _depth_of(estimate))


def _depth_path(job: InterpolationJob, folder: Path, pair: int, index: int) -> Path:
    return folder / f"{pair:04d}_{job.images[index].stem}_depth.exr"


def _depth_of(estimate: DepthEstimate) -> np.ndarray:
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / estimate.inverse_depth, np.float32)


def _as_bytes(frame: Frame, loader: _Loader, threads: int | None) -> UInt8[np.ndarray, "height width 3"]:
    """The frame as 8-bit samples: those of the file itself where it is a photograph unchanged."""
    if frame.panorama is not None:
        original = loader.panorama(frame.panorama).original
        if original is not None and original.dtype == np.uint8:
            return np.ascontiguousarray(original)
    samples = np.empty(frame.image.shape, np.uint8)
    run_bands(
        lambda begin, end: quantize_rows(frame.image, np.float32(255), samples, begin, end), len(samples), threads
    )
    return samples


@contextmanager
def _sinks(plan: InterpolationPlan) -> Iterator[list[BackgroundSink]]:
    job = plan.job
    with ExitStack() as stack:
        sinks: list[FrameSink] = [
            stack.enter_context(
                open_video(
                    job.output, size=plan.size, fps=job.fps, codec=job.codec, crf=job.crf, preset=job.preset,
                    threads=job.threads or 0, overwrite=job.overwrite,
                )
            )
        ]  # fmt: skip
        if job.save_frames is not None:
            sinks.append(
                stack.enter_context(open_video(job.save_frames, size=plan.size, fps=job.fps, overwrite=job.overwrite))
            )
        yield [stack.enter_context(BackgroundSink(sink)) for sink in sinks]
