"""From files to a video: what ``omnisyn interpolate`` does, as a library.

:func:`plan_interpolation` (:mod:`omnisyn_cli.planning`) reads and checks what can be known without decoding a
picture; :func:`run_interpolation` does the work. Nothing appears under its final name unless all of it succeeded.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from statistics import fmean
from typing import Any
from weakref import ref

import numpy as np
from jaxtyping import Float, Shaped

from omnisyn_cli.confidence import LEAST_SCORE, PairConfidence
from omnisyn_cli.errors import InputError
from omnisyn_cli.estimators import make_estimator as estimator_named
from omnisyn_cli.fusers import make_fuser
from omnisyn_cli.fusion.kernels import quantize_rows
from omnisyn_cli.geometry.cap import outside_nadir
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
from omnisyn_cli.io.background import BackgroundSink, FrameRing, frames_in_queue
from omnisyn_cli.io.staging import staged_folder
from omnisyn_cli.photometry import equalized
from omnisyn_cli.planning import (
    DEPTH_METHODS,
    InterpolationJob,
    InterpolationPlan,
    depth_name,
    plan_interpolation,
    targets,
)
from omnisyn_cli.presets import PRESETS
from omnisyn_cli.synthesis import Frame, Segment, Stopwatch, SynthesisOptions, synthesize
from omnisyn_cli.threads import run_bands
from omnisyn_cli.types import DepthEstimate, DepthEstimator, View

__all__ = [
    "DEPTH_METHODS",
    "InterpolationJob",
    "InterpolationPlan",
    "PanoramaReader",
    "Summary",
    "make_estimator",
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
        pairs: how far the frames between two panoramas can be relied on, by the index of the first; pairs without a
            frame of their own are left out.
        triangles: how many are drawn for each frame of a pair, and how many its two meshes have, by the same index.
    """

    plan: InterpolationPlan
    seconds: dict[str, float]
    pairs: Mapping[int, PairConfidence] = field(default_factory=dict)
    triangles: Mapping[int, tuple[int, int]] = field(default_factory=dict)

    def describe(self) -> dict[str, Any]:
        """The summary as plain values, for people and for JSON."""
        stages = {stage: round(value, 3) for stage, value in self.seconds.items()}
        triangles = [{"first": index, "drawn": drawn, "of": every} for index, (drawn, every) in self.triangles.items()]
        return {**self.plan.describe(), "stages": stages, "confidence": self._confidence(), "triangles": triangles}

    def warnings(self) -> list[str]:
        """A line for every pair that scores too low to be relied on."""
        return [_warning(self.plan, index, pair) for index, pair in self.pairs.items() if pair.score < LEAST_SCORE]

    def _confidence(self) -> dict[str, Any]:
        """The clip's score is that of its worst pair; its shares are the means."""
        if not self.pairs:
            return {"score": 1.0, "pairs": []}
        described = [pair.describe() for pair in self.pairs.values()]
        shares = {key: round(fmean(pair[key] for pair in described), 4) for key in described[0] if key != "score"}
        return {
            "score": min(pair["score"] for pair in described),
            **shares,
            "pairs": [{"first": index, **pair} for index, pair in zip(self.pairs, described, strict=True)],
        }


PanoramaReader = Callable[..., Panorama]
"""Called as :func:`omnisyn_cli.io.read_panorama` is: with a path, ``allow_aspect`` and ``max_pixels``."""


def run_interpolation(
    plan: InterpolationPlan,
    on_frame: Callable[[int], None] | None = None,
    *,
    read: PanoramaReader = read_panorama,
    estimator: DepthEstimator | None = None,
) -> Summary:
    """Make the video.

    Args:
        plan: from :func:`plan_interpolation`.
        on_frame: called with the number of finished frames, after each.
        read: decodes a panorama; one that remembers what it has read serves several videos.
        estimator: finds depth; None makes the one that the plan asks for (:func:`make_estimator`).

    Raises:
        InputError: a picture, mask or depth file turns out to be damaged.
        EncodingError, WriteError: see :func:`omnisyn_cli.io.open_video`.
    """
    begin, clock = time.perf_counter(), Stopwatch()
    loader = _Loader(plan, clock, read)
    with clock("decode"):
        loader.panorama(0), loader.panorama(1)  # damage is found before anything is begun
    kinds = [sample_type(path, codec) for path, codec in targets(plan.job)]
    pairs: dict[int, PairConfidence] = {}
    triangles: dict[int, tuple[int, int]] = {}
    with _depth_keeper(plan) as keep_depth, _sinks(plan) as sinks, _confidence_sink(plan) as keep_confidence:
        ring = FrameRing(plan.size, frames_in_queue(plan.size)) if set(kinds) == {"uint8"} else None
        frames = _frames(plan, loader, estimator or make_estimator(plan), clock, keep_depth, pairs, triangles, ring)
        for done, frame in enumerate(frames, start=1):
            samples = {kind: _as_samples(frame, kind, loader, plan.job.threads) for kind in kinds}
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


def _warning(plan: InterpolationPlan, index: int, pair: PairConfidence) -> str:
    """What is wrong with a pair and what to do about it, in one line."""
    first, second = plan.job.images[index : index + 2]
    return (
        f"{first.name} and {second.name}: expected a confidence of at least {LEAST_SCORE:g}, got {pair.score:.2f} "
        f"({pair.unseen:.0%} unseen, {pair.disagreement:.0%} in disagreement); check the poses, take panoramas that "
        "are closer together, or show a cross-fade there (--fallback crossfade)"
    )


def _refuse_doubtful(plan: InterpolationPlan, index: int, pair: PairConfidence) -> None:
    if plan.job.fallback == "fail" and pair.score < LEAST_SCORE:
        raise InputError(_warning(plan, index, pair))


KeepDepth = Callable[[int, tuple[DepthEstimate, DepthEstimate]], None]
"""Called with the index of a pair and the depth of its two panoramas."""


def _frames(
    plan: InterpolationPlan, loader: _Loader, estimator: DepthEstimator, clock: Stopwatch, keep_depth: KeepDepth,
    pairs: dict[int, PairConfidence], triangles: dict[int, tuple[int, int]], ring: FrameRing | None,
) -> Iterator[Frame]:  # fmt: skip
    """All frames; the depth of every pair is handed to ``keep_depth``, what to think of it is put into ``pairs``."""
    job = plan.job
    options = SynthesisOptions(
        plan.size, job.renderer, job.cut, job.threads,
        cross_fade=job.fallback == "crossfade", confidence=job.save_confidence is not None, adaptive=job.adaptive,
    )  # fmt: skip
    fuser = make_fuser(job.fusion, plan.size, device=job.device, threads=job.threads)
    views, prepared = loader.views(), set()
    for made in synthesize(views, plan.path, estimator, options, fuser, clock, ring):
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


def make_estimator(plan: InterpolationPlan) -> DepthEstimator:
    """What finds depth as a plan asks for; it may serve all plans with the same preset, depth, model, device, threads.

    Raises:
        InputError: the model cannot be loaded, or not on that device.
    """
    rows = PRESETS[plan.job.preset].depth_rows
    return estimator_named(plan.depth, rows=rows, model=plan.model, device=plan.job.device, threads=plan.job.threads)


class _Kept:
    """A panorama that can be held as the samples of its file; numbers are made of them again where they are needed."""

    def __init__(self, panorama: Panorama) -> None:
        self.original, self.mask, self.size = panorama.original, panorama.mask, panorama.image.shape[:2]
        self.samples = panorama.original if str(getattr(panorama.original, "dtype", "")) == "uint8" else None
        self._image: np.ndarray | None = panorama.image
        self._known = ref(panorama.image)

    def image(self) -> Float[np.ndarray, "height width 3"]:
        """RGB in [0, 1]."""
        image = self._known() if self._image is None else self._image
        if image is None:  # forgotten, which it is only where there are samples
            image = np.divide(np.asarray(self.samples), np.float32(PEAKS["uint8"]), dtype=np.float32)
            self._known = ref(image)
        return image

    def forget_numbers(self) -> None:
        """Hold samples only, if they say everything."""
        if self.samples is not None:
            self._image = None


class _Loader:
    """Panoramas from their files when they are needed; the last two are kept."""

    def __init__(self, plan: InterpolationPlan, clock: Stopwatch, read: PanoramaReader) -> None:
        self._plan, self._clock, self._read = plan, clock, read
        self.panorama = lru_cache(maxsize=2)(self._read_panorama)
        self._companions = lru_cache(maxsize=2)(self._read_companions)

    def views(self) -> Sequence[View]:
        """All views, read on demand."""
        return _LazySequence(len(self._plan.entries), self._view)

    def forget_numbers(self, index: int) -> None:
        """What a surface has been made of is not needed as numbers any more."""
        self.panorama(index).forget_numbers()

    def _read_panorama(self, index: int) -> _Kept:
        job = self._plan.job
        return _Kept(self._read(job.images[index], allow_aspect=job.allow_aspect, max_pixels=job.max_pixels))

    def _view(self, index: int) -> View:
        with self._clock("decode"):
            panorama, (mask, known_depth) = self.panorama(index), self._companions(index)
            return View(panorama.image(), self._plan.entries[index].pose, mask, known_depth, samples=panorama.samples)

    def _read_companions(self, index: int) -> tuple[np.ndarray | None, DepthEstimate | None]:
        """What of a panorama may be used, and its depth if that is known."""
        entry, panorama = self._plan.entries[index], self.panorama(index)
        mask = panorama.mask
        if entry.mask is not None:
            mask = _combined(mask, self._mask(entry.mask), panorama.size, entry.mask)
        return self._usable(index, mask), self._known_depth(entry)

    def _usable(self, index: int, mask: np.ndarray | None) -> np.ndarray | None:
        """A panorama's mask with what the job forbids besides."""
        job, size = self._plan.job, self.panorama(index).size
        if job.masks:
            path = job.masks[index]
            mask = _combined(mask, self._mask(path), size, path)
        if job.nadir > 0.0:
            cap = outside_nadir((size[0], size[1]), job.nadir)
            mask = cap if mask is None else mask & cap
        return mask

    def _mask(self, path: Path) -> np.ndarray:
        job = self._plan.job
        return read_mask(path, allow_aspect=job.allow_aspect, max_pixels=job.max_pixels)

    def _known_depth(self, entry: PosedPanorama) -> DepthEstimate | None:
        if self._plan.depth != "file" or entry.depth is None:
            return None
        inverse_depth = read_inverse_depth(entry.depth, max_pixels=self._plan.job.max_pixels)
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
    if frame.image.dtype == np.uint8 and kind == "uint8":
        return frame.image
    if kind == "float32":
        return frame.image.astype(np.float32)
    if frame.panorama is not None:
        original = loader.panorama(frame.panorama).original
        if original is not None and str(original.dtype) == kind:
            return np.ascontiguousarray(original)
    samples, peak = np.empty(frame.image.shape, kind), np.float32(PEAKS[kind])
    run_bands(lambda begin, end: quantize_rows(frame.image, peak, samples, begin, end), len(samples), threads)
    return samples


@contextmanager
def _confidence_sink(plan: InterpolationPlan) -> Iterator[Callable[[Frame], None]]:
    """What writes the confidence of frames to ``job.save_confidence``, in grey: white is sure."""
    job = plan.job
    if job.save_confidence is None:
        yield lambda frame: None
        return
    with open_video(
        job.save_confidence, size=plan.size, fps=job.fps, threads=job.threads or 0, overwrite=job.overwrite
    ) as sink:

        def keep(frame: Frame) -> None:
            if frame.confidence is not None:
                grey = np.rint(255.0 * frame.confidence).astype(np.uint8)
                sink.write(np.ascontiguousarray(np.repeat(grey[..., None], 3, axis=2)))

        yield keep


@contextmanager
def _sinks(plan: InterpolationPlan) -> Iterator[list[BackgroundSink]]:
    """Where frames go, in the order of :func:`omnisyn_cli.planning.targets`."""
    job = plan.job
    with ExitStack() as stack:
        sinks: list[FrameSink] = []
        for path, codec in targets(job):
            is_output = path == job.output
            sinks.append(
                stack.enter_context(
                    open_video(
                        path, size=plan.size, fps=job.fps, codec=codec, threads=job.threads or 0,
                        crf=job.crf if is_output else None, preset=job.encoder_preset if is_output else None,
                        dtype=sample_type(path, codec), overwrite=job.overwrite,
                    )
                )
            )  # fmt: skip
        yield [stack.enter_context(BackgroundSink(sink, frames_in_queue(plan.size))) for sink in sinks]
