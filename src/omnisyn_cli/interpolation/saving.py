"""Where frames, their confidence and the depth of panoramas go; all of it appears when everything has gone well."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext

import numpy as np
from jaxtyping import Shaped

from omnisyn_cli.fusion.kernels import quantize_rows
from omnisyn_cli.interpolation.job import depth_name, targets
from omnisyn_cli.interpolation.loading import Loader
from omnisyn_cli.interpolation.plan import InterpolationPlan
from omnisyn_cli.io import open_video, write_depth
from omnisyn_cli.io.background import BackgroundSink, frames_in_queue
from omnisyn_cli.io.images import INTEGER_PEAKS
from omnisyn_cli.io.outputs import staged_folder
from omnisyn_cli.runtime.threads import run_bands
from omnisyn_cli.synthesis.frames import Frame
from omnisyn_cli.types import DepthEstimate

KeepDepth = Callable[[int, tuple[DepthEstimate, DepthEstimate]], None]
"""Called with the index of a pair and the depth of its two panoramas."""


@contextmanager
def depth_keeper(plan: InterpolationPlan) -> Iterator[KeepDepth]:
    """What writes the depth of pairs to ``job.save_depth``, which appears when everything has gone well."""
    folder = plan.job.save_depth
    with nullcontext() if folder is None else staged_folder(folder, overwrite=plan.job.overwrite) as staged:

        def keep(pair: int, depths: tuple[DepthEstimate, DepthEstimate]) -> None:
            if staged is not None:
                for index, estimate in zip((pair, pair + 1), depths, strict=True):
                    write_depth(staged / depth_name(plan.job.images, pair, index), _depth_of(estimate))

        yield keep


def _depth_of(estimate: DepthEstimate) -> np.ndarray:
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / estimate.inverse_depth, np.float32)


def samples_of(frame: Frame, kind: str, loader: Loader, threads: int | None) -> Shaped[np.ndarray, "height width 3"]:
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
    run_bands(lambda begin, end: quantize_rows(frame.image, peak, samples, begin, end), len(samples), threads)
    return samples


@contextmanager
def confidence_sink(plan: InterpolationPlan) -> Iterator[Callable[[Frame], None]]:
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
def frame_sinks(plan: InterpolationPlan) -> Iterator[list[BackgroundSink]]:
    """Where frames go, in the order of :func:`omnisyn_cli.interpolation.job.targets`."""
    job = plan.job
    with ExitStack() as stack:
        opened = [
            open_video(place, size=plan.size, threads=job.threads or 0, overwrite=job.overwrite, **encoding)
            for place, encoding in targets(job).items()
        ]
        sinks = [stack.enter_context(sink) for sink in opened]
        yield [stack.enter_context(BackgroundSink(sink, frames_in_queue(plan.size))) for sink in sinks]
