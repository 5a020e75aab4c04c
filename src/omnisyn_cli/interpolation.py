"""From files to a video: what ``omnisyn interpolate`` does, as a library.

:func:`plan_interpolation` (:mod:`omnisyn_cli.planning`) reads and checks what can be known without decoding a
picture; :func:`run_interpolation` does the work. Nothing appears under its final name unless all of it succeeded.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from omnisyn_cli.errors import InputError
from omnisyn_cli.fusion.kernels import quantize_rows
from omnisyn_cli.io import (
    FrameSink,
    Panorama,
    PosedPanorama,
    open_video,
    read_inverse_depth,
    read_mask,
    read_panorama,
    sample_type,
    write_depth,
)
from omnisyn_cli.io.background import BackgroundSink
from omnisyn_cli.io.staging import staged_folder
from omnisyn_cli.planning import DEPTH_METHODS, InterpolationJob, InterpolationPlan, depth_name, plan_interpolation
from omnisyn_cli.synthesis import Frame, Segment, Stopwatch, SynthesisOptions, synthesize
from omnisyn_cli.threads import run_bands
from omnisyn_cli.types import DepthEstimate, DepthEstimator, KnownDepth, View

__all__ = [
    "DEPTH_METHODS",
    "InterpolationJob",
    "InterpolationPlan",
    "Summary",
    "plan_interpolation",
    "run_interpolation",
]


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
    kinds = [sample_type(path, codec) for path, codec in _targets(plan.job)]
    with _depth_keeper(plan) as keep_depth, _sinks(plan) as sinks:
        for done, frame in enumerate(_frames(plan, loader, clock, keep_depth), start=1):
            samples = {kind: _as_samples(frame, kind, loader, plan.job.threads) for kind in kinds}
            with clock("encode"):
                for sink, kind in zip(sinks, kinds, strict=True):
                    sink.write(samples[kind])
            if on_frame:
                on_frame(done)
        with clock("encode"):
            for sink in sinks:
                sink.finish()
    return Summary(plan, {**clock.seconds, "total": time.perf_counter() - begin})


KeepDepth = Callable[[int, tuple[DepthEstimate, DepthEstimate]], None]
"""Called with the index of a pair and the depth of its two panoramas."""


def _frames(plan: InterpolationPlan, loader: _Loader, clock: Stopwatch, keep_depth: KeepDepth) -> Iterator[Frame]:
    """All frames; the depth of every pair is handed to ``keep_depth``."""
    options = SynthesisOptions(plan.size, plan.job.renderer, plan.job.cut, plan.job.threads)
    views, estimator, prepared = loader.views(), _estimator(plan), set()
    for made in synthesize(views, plan.path, estimator, options, clock=clock):
        if isinstance(made, Segment):
            prepared.add(made.index)
            keep_depth(made.index, made.depths)
        else:
            yield made
    if plan.job.save_depth is not None:
        for pair in sorted(set(range(len(views) - 1)) - prepared):  # no frame lay between these two
            keep_depth(pair, estimator(views[pair], views[pair + 1]))


def _estimator(plan: InterpolationPlan) -> DepthEstimator:
    if plan.depth == "file":
        return KnownDepth()
    if plan.depth == "network":
        return _network(plan.job)
    from omnisyn_cli.stereo.matching import MatchingDepthEstimator

    estimator: DepthEstimator = MatchingDepthEstimator(threads=plan.job.threads)
    return estimator


def _network(job: InterpolationJob) -> DepthEstimator:
    from omnisyn_cli.runtime.depth import LearnedDepthEstimator
    from omnisyn_cli.runtime.models import find_model
    from omnisyn_cli.runtime.session import open_session

    session = open_session(find_model(job.model or ""), device=job.device, threads=job.threads)
    estimator: DepthEstimator = LearnedDepthEstimator(session)
    return estimator


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
                mask = _combined(
                    mask,
                    read_mask(entry.mask, allow_aspect=self._plan.job.allow_aspect),
                    panorama.image.shape[:2],
                    entry.mask,
                )
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
        raise InputError(
            f"{path}: expected a mask of {size[1]}×{size[0]} pixels, got {second.shape[1]}×{second.shape[0]}; "
            "give it the size of its panorama"
        )
    return second if mask is None else mask & second


@contextmanager
def _depth_keeper(plan: InterpolationPlan) -> Iterator[KeepDepth]:
    """What writes the depth of pairs to ``job.save_depth``, which appears when everything has gone well."""
    folder = plan.job.save_depth
    with nullcontext() if folder is None else staged_folder(folder) as staged:

        def keep(pair: int, depths: tuple[DepthEstimate, DepthEstimate]) -> None:
            if staged is not None:
                for index, estimate in zip((pair, pair + 1), depths, strict=True):
                    write_depth(staged / depth_name(plan.job.images, pair, index), _depth_of(estimate))

        yield keep


def _depth_of(estimate: DepthEstimate) -> np.ndarray:
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / estimate.inverse_depth, np.float32)


PEAKS = {"uint8": 255, "uint16": 65535}


def _as_samples(frame: Frame, kind: str, loader: _Loader, threads: int | None) -> Shaped[np.ndarray, "height width 3"]:
    """The frame as samples of a type, in memory of its own; those of the file where it is a photograph unchanged."""
    if kind == "float32":
        return frame.image.astype(np.float32)
    if frame.panorama is not None:
        original = loader.panorama(frame.panorama).original
        if original is not None and str(original.dtype) == kind:
            return np.ascontiguousarray(original)
    samples, peak = np.empty(frame.image.shape, kind), np.float32(PEAKS[kind])
    run_bands(lambda begin, end: quantize_rows(frame.image, peak, samples, begin, end), len(samples), threads)
    return samples


def _targets(job: InterpolationJob) -> list[tuple[Path, str | None]]:
    """Path and codec of everything that takes frames.

    The video comes last, so that it is finished first: if that fails, no images are kept either.
    """
    images: list[tuple[Path, str | None]] = [] if job.save_frames is None else [(job.save_frames, None)]
    return [*images, (job.output, job.codec)]


@contextmanager
def _sinks(plan: InterpolationPlan) -> Iterator[list[BackgroundSink]]:
    """Where frames go, in the order of :func:`_targets`."""
    job = plan.job
    with ExitStack() as stack:
        sinks: list[FrameSink] = []
        for path, codec in _targets(job):
            is_output = path == job.output
            sinks.append(
                stack.enter_context(
                    open_video(
                        path, size=plan.size, fps=job.fps, codec=codec, threads=job.threads or 0,
                        crf=job.crf if is_output else None, preset=job.preset if is_output else None,
                        dtype=sample_type(path, codec), overwrite=job.overwrite,
                    )
                )
            )  # fmt: skip
        yield [stack.enter_context(BackgroundSink(sink)) for sink in sinks]
