"""The work itself: panoramas are decoded, frames are made of them and handed to where they go."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from omnisyn_cli.confidence import LEAST_SCORE, PairConfidence
from omnisyn_cli.errors import InputError
from omnisyn_cli.estimators import make_estimator as estimator_named
from omnisyn_cli.fusers import make_fuser
from omnisyn_cli.interpolation.loading import Loader, PanoramaReader
from omnisyn_cli.interpolation.saving import KeepDepth, confidence_sink, depth_keeper, frame_sinks, samples_of
from omnisyn_cli.interpolation.summary import Summary, warning_about
from omnisyn_cli.io import read_panorama
from omnisyn_cli.io.background import FrameRing, frames_in_queue
from omnisyn_cli.photometry import equalized
from omnisyn_cli.planning import InterpolationPlan, is_rounded, sample_types
from omnisyn_cli.presets import OMNISYN, PRESETS, SYNSIN_SOURCES
from omnisyn_cli.segments import Segment, Stopwatch, SynthesisOptions
from omnisyn_cli.synsin import SynSin, open_synsin
from omnisyn_cli.synthesis import Frame, synthesize
from omnisyn_cli.thread_limit import limited_threads
from omnisyn_cli.types import DepthEstimator

if TYPE_CHECKING:
    from omnisyn_cli.gpu.frames import GpuFrames

__all__ = ["make_estimator", "run_interpolation"]


def run_interpolation(
    plan: InterpolationPlan,
    on_frame: Callable[[int], None] | None = None,
    *,
    read: PanoramaReader = read_panorama,
    estimator: DepthEstimator | None = None,
) -> Summary:
    """Make the video.

    Args:
        plan: from :func:`omnisyn_cli.planning.plan_interpolation`.
        on_frame: called with the number of finished frames, after each.
        read: decodes a panorama; one that remembers what it has read serves several videos.
        estimator: finds depth for this program's own method; None makes the one that the plan asks for
            (:func:`make_estimator`).

    Raises:
        InputError: a picture, mask or depth file turns out to be damaged, or there is no GPU to make frames on.
        EncodingError, WriteError: see :func:`omnisyn_cli.io.open_video`.
    """
    begin, clock = time.perf_counter(), Stopwatch()
    device = _open_gpu(plan) if plan.is_on_gpu else None
    loader = Loader(plan, clock, read)
    with clock("decode"):
        loader.panorama(0), loader.panorama(1)  # damage is found before anything is begun
    kinds = sample_types(plan.job)
    pairs: dict[int, PairConfidence] = {}
    triangles: dict[int, tuple[int, int]] = {}
    own = plan.job.method == OMNISYN
    with (
        limited_threads(plan.job.threads),
        depth_keeper(plan) as keep_depth,
        confidence_sink(plan) as keep_confidence,
        frame_sinks(plan) as sinks,  # finished first: if that fails, nothing else is kept either
    ):
        ring = FrameRing(plan.size, frames_in_queue(plan.size)) if own and is_rounded(plan.job) else None
        frames = (
            _frames(plan, loader, estimator or make_estimator(plan), clock, keep_depth, pairs, triangles, ring, device)
            if own
            else _synsin_frames(plan, loader, clock)
        )
        for done, frame in enumerate(frames, start=1):
            samples = {kind: samples_of(frame, kind, loader, plan.job.threads) for kind in kinds}
            with clock("encode"):
                for sink, kind in zip(sinks, kinds, strict=True):
                    sink.write(samples[kind])
                keep_confidence(frame)
            if on_frame:
                on_frame(done)
        with clock("encode"):
            for sink in sinks:
                sink.finish()
    return Summary(plan, {**clock.seconds, "total": time.perf_counter() - begin}, pairs, triangles)


def _frames(
    plan: InterpolationPlan, loader: Loader, estimator: DepthEstimator, clock: Stopwatch, keep_depth: KeepDepth,
    pairs: dict[int, PairConfidence], triangles: dict[int, tuple[int, int]], ring: FrameRing | None,
    device: GpuFrames | None,
) -> Iterator[Frame]:  # fmt: skip
    """All frames; the depth of every pair is handed to ``keep_depth``, what to think of it is put into ``pairs``."""
    job = plan.job
    options = SynthesisOptions(
        plan.size, plan.renderer, plan.cut, job.threads,
        cross_fade=job.fallback == "crossfade", confidence=job.save_confidence is not None, adaptive=job.adaptive,
    )  # fmt: skip
    fuser = make_fuser(plan.fusion, plan.size, device=job.device, threads=job.threads)
    views, prepared = loader.views(), set()
    for made in synthesize(views, plan.path, estimator, options, fuser, clock, ring, device):
        if isinstance(made, Segment):
            prepared.add(made.index)
            pairs[made.index] = made.check.confidence
            if made.triangles is not None:
                triangles[made.index] = made.triangles
            _refuse_doubtful(plan, made.index, made.check.confidence)
            keep_depth(made.index, made.depths)
            for index in (made.index, made.index + 1):
                loader.forget_numbers(index)
        else:
            yield made
    if plan.job.save_depth is not None:
        for pair in sorted(set(range(len(views) - 1)) - prepared):  # no frame lay between these two
            keep_depth(pair, estimator(*equalized(views[pair], views[pair + 1], job.threads)))


def _open_gpu(plan: InterpolationPlan) -> GpuFrames:
    from omnisyn_cli.gpu.frames import GpuFrames  # torch takes seconds to import

    return GpuFrames(plan.size)


def _synsin_frames(plan: InterpolationPlan, loader: Loader, clock: Stopwatch) -> Iterator[Frame]:
    """All frames by what this program's are compared with."""
    networks = open_synsin(device=plan.job.device, threads=plan.job.threads)
    options = SynthesisOptions(plan.size, threads=plan.job.threads)
    return SynSin(networks, loader.views(), SYNSIN_SOURCES[plan.job.method], options, clock).frames(plan.path)


def _refuse_doubtful(plan: InterpolationPlan, index: int, pair: PairConfidence) -> None:
    if plan.job.fallback == "fail" and pair.score < LEAST_SCORE:
        raise InputError(warning_about(plan, index, pair))


def make_estimator(plan: InterpolationPlan) -> DepthEstimator:
    """What finds depth as a plan asks for; it may serve all plans with the same preset, depth, model, device, threads.

    Raises:
        InputError: the model cannot be loaded, or not on that device.
    """
    rows = PRESETS[plan.job.preset].depth_rows
    return estimator_named(plan.depth, rows=rows, model=plan.model, device=plan.job.device, threads=plan.job.threads)
