"""The work itself: panoramas are decoded, frames are made of them and handed to where they go.

Frames, their confidence and the depth of panoramas appear when everything has gone well.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from statistics import fmean

import numpy as np
from jaxtyping import Shaped

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.compute.threads import limited_threads, run_ranges
from omnisyn_cli.fusion.blend_kernels import quantize_rows
from omnisyn_cli.geometry.sphere import solid_angles
from omnisyn_cli.interpolation.job import depth_name, is_rounded, sample_types, stereo_mode, targets
from omnisyn_cli.interpolation.loading import Loader, PanoramaReader, pair_surfaces
from omnisyn_cli.interpolation.plan import InterpolationPlan
from omnisyn_cli.interpolation.summary import Summary, refuse_doubtful
from omnisyn_cli.interpolation.viewer.contents import TourPacker
from omnisyn_cli.interpolation.viewer.page import write_page
from omnisyn_cli.io import FrameSink, open_video, read_panorama, write_depth
from omnisyn_cli.io.images import INTEGER_PEAKS
from omnisyn_cli.io.outputs import staged_folder
from omnisyn_cli.io.video import BackgroundSink, FrameRing, frames_in_queue
from omnisyn_cli.pipeline.config import make_method
from omnisyn_cli.poses.floor import height_in_depth, wall_distance
from omnisyn_cli.render.eyes import top_bottom
from omnisyn_cli.synthesis.consistency import CrossCheck
from omnisyn_cli.synthesis.methods import Pair, SurfaceMethod, SurfacePair
from omnisyn_cli.synthesis.prepared_pair import measure_pair
from omnisyn_cli.synthesis.synthesize import Frame, synthesize
from omnisyn_cli.types import DepthEstimate, DepthEstimator

Depths = tuple[DepthEstimate, DepthEstimate]


def _samples_of(frame: Frame, kind: str, loader: Loader, threads: int | None) -> Shaped[np.ndarray, "height width 3"]:
    """The frame as samples of a type, in memory of its own; those of the file where it is a photograph unchanged."""
    if frame.image.dtype == np.uint8 and kind == "uint8":
        return frame.image
    if kind == "float32":
        return frame.image.astype(np.float32)
    if frame.panorama is not None:
        original = loader.panorama(frame.panorama).original
        if original is not None and str(original.dtype) == kind:
            return np.ascontiguousarray(original)
    samples, peak = np.empty(frame.image.shape, kind), np.float32(INTEGER_PEAKS[kind])
    run_ranges(lambda begin, end: quantize_rows(frame.image, peak, samples, begin, end), len(samples), threads)
    return samples


def _confidence_sink(plan: InterpolationPlan) -> AbstractContextManager[FrameSink | None]:
    """What writes the confidence of frames to ``job.save_confidence``, if anything does."""
    job = plan.job
    if job.save_confidence is None:
        return nullcontext()
    return open_video(
        job.save_confidence, size=plan.size, fps=job.fps, threads=job.threads or 0, overwrite=job.overwrite,
        stereo_mode=stereo_mode(job),
    )  # fmt: skip


@contextmanager
def _frame_sinks(plan: InterpolationPlan) -> Iterator[list[BackgroundSink]]:
    """Where frames go, in the order of :func:`omnisyn_cli.interpolation.job.targets`."""
    job, places = plan.job, targets(plan.job)
    places[job.output]["soundtrack"] = plan.soundtrack
    with ExitStack() as stack:
        opened = [
            open_video(place, size=plan.frame_size, threads=job.threads or 0, overwrite=job.overwrite, **encoding)
            for place, encoding in places.items()
        ]
        sinks = [stack.enter_context(sink) for sink in opened]
        yield [stack.enter_context(BackgroundSink(sink, frames_in_queue(plan.frame_size))) for sink in sinks]


def run_interpolation(
    plan: InterpolationPlan, on_frame: Callable[[int], None] | None = None, *, read: PanoramaReader = read_panorama,
    estimator: DepthEstimator | None = None, now: Callable[[], float] = time.perf_counter,
) -> Summary:  # fmt: skip
    """Make the video.

    ``on_frame`` is called with the number of finished frames after each. ``read`` decodes a panorama; one that
    remembers what it has read serves several videos. An estimator finds depth for this program's own method in place of
    the plan's; ``now`` is the clock of the summary's seconds.

    Raises InputError: a picture, mask or depth file turns out to be damaged, or there is no GPU for networks;
    EncodingError, WriteError: see :func:`omnisyn_cli.io.open_video`.
    """
    job, clock = plan.job, Stopwatch(now)
    loader = Loader(plan, clock, read)
    summary = Summary(plan, left_out=loader.left_out)
    kinds, threads, depth = sample_types(job), job.threads, job.save_depth
    with limited_threads(threads):
        with clock("decode"):
            loader.panorama(0), loader.panorama(1)  # damage is found before anything is begun
        method = make_method(plan.config, plan.size, threads=threads, clock=clock, estimator=estimator)
        with (
            nullcontext() if depth is None else staged_folder(depth, overwrite=job.overwrite) as depth_folder,
            _confidence_sink(plan) as confidence_sink,
            _frame_sinks(plan) as sinks,  # finished first: if that fails, nothing else is kept either
        ):
            keeper = _PairKeeper(summary, loader, depth_folder, clock)
            is_stereo = job.stereo != "mono"
            rounds_early = is_rounded(job) and isinstance(method, SurfaceMethod) and not is_stereo
            made = method.frames_at_once if isinstance(method, SurfaceMethod) else 1
            ring = FrameRing(plan.size, frames_in_queue(plan.size), made) if rounds_early else None
            frames = synthesize(loader, plan.path, method, ring, keeper, photographs=not is_stereo)
            frames = keeper.both_eyes(frames) if is_stereo else frames
            for done, frame in enumerate(frames, start=1):
                keeper.count(frame)
                samples = {kind: _samples_of(frame, kind, loader, threads) for kind in kinds}
                with clock("encode"):
                    for sink, kind in zip(sinks, kinds, strict=True):
                        sink.write(samples[kind])
                    if confidence_sink is not None and frame.confidence is not None:
                        grey = np.rint(255.0 * frame.confidence).astype(np.uint8)  # white is sure
                        confidence_sink.write(np.repeat(grey[..., None], 3, axis=2))
                if on_frame:
                    on_frame(done)
            if isinstance(method, SurfaceMethod):
                keeper.add_pairs_without_frames(method)
                if method.device is not None and method.device.failure:
                    summary.remarks.append(
                        f"frames were made on the processor: the GPU failed ({method.device.failure})"
                    )
            with clock("encode"):
                for sink in sinks:
                    sink.finish()
    if keeper.packer is not None and job.view is not None:
        with clock("walk"):
            write_page(job.view, keeper.packer.manifest(), keeper.packer.blocks.contents)
    return replace(summary, seconds=clock.with_total(), results=summary.modelled())


class _PairKeeper:
    """Keeps what there is to know about each pair: its depth as files, a walk, figures for the summary."""

    def __init__(self, summary: Summary, loader: Loader, depth_folder: Path | None, clock: Stopwatch) -> None:
        self._plan, self._summary, self._clock = summary.plan, summary, clock
        self._loader, self._depth_folder = loader, depth_folder
        self.packer = None if self._plan.job.view is None else TourPacker(self._plan)
        self._current: SurfacePair | None = None

    def __call__(self, index: int, pair: Pair) -> None:
        """Look at a pair before its frames are made; give up on a doubtful one if that is asked for."""
        if not isinstance(pair, SurfacePair):
            return
        self._current = pair
        self._summary.pairs[index] = confidence = pair.prepared.cross_check.confidence
        if pair.prepared.triangles is not None:
            self._summary.triangles[index] = pair.prepared.triangles
        # without parallax: however the camera moves, it only turns there
        areas = [(depth.inverse_depth == 0.0, solid_angles(*depth.inverse_depth.shape)) for depth in pair.depths]
        self._summary.infinitely_far[index] = fmean(float(area[is_far].sum() / area.sum()) for is_far, area in areas)
        first, second = (entry.pose for entry in self._plan.entries[index : index + 2])
        if (height := height_in_depth((first, second), pair.depths)) is not None:
            self._summary.camera_heights[index] = height
        self._summary.walls[index] = wall_distance((first, second), pair.depths)
        refuse_doubtful(self._plan, index, confidence)
        self._keep(index, pair.depths, pair.prepared.cross_check)
        self._loader.release_floats(index)

    def both_eyes(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """What the left eye sees of each frame above what the right eye sees."""
        for frame in frames:
            if self._current is not None:
                with self._clock("eyes"):
                    inverse_depth = self._current.inverse_depth(frame.waypoint)
                    image = top_bottom(frame.image, inverse_depth, self._plan.job.threads)
                yield replace(frame, image=image, panorama=None)

    def count(self, frame: Frame) -> None:
        """Look at a frame."""
        is_photograph = frame.waypoint.t in (0.0, 1.0)
        self._summary.frames[
            "photographs" if is_photograph else "shown_again" if frame.is_shown_again else "rendered"
        ] += 1

    def add_pairs_without_frames(self, method: SurfaceMethod) -> None:
        """Keep the depth of neighbours that no frame lay between, if depth is kept."""
        if self._depth_folder is None and self.packer is None:
            return
        for index in sorted(set(range(len(self._loader) - 1)) - self._summary.pairs.keys()):
            self._keep(index, *measure_pair(index, method.depths_of(self._loader), method.options, self._clock))

    def _keep(self, index: int, depths: Depths, check: CrossCheck) -> None:
        if self._depth_folder is not None:
            for k, estimate in zip((index, index + 1), depths, strict=True):
                with np.errstate(divide="ignore"):
                    depth = np.asarray(1.0 / estimate.inverse_depth, np.float32)
                write_depth(self._depth_folder / depth_name(self._plan.job.images, index, k), depth)
        if self.packer is not None:
            with self._clock("walk"):
                views = self._loader[index], self._loader[index + 1]
                self.packer.add(pair_surfaces(self._plan, index, views, depths, check))
