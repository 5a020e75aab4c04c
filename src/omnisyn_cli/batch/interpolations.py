"""The work function of ``omnisyn batch``: one line of a manifest becomes one interpolation.

A worker keeps from one job for the next a few of the panoramas it has decoded, of the depth it has found and of the
networks it has loaded, so its memory does not grow with the number of its jobs.
"""

import hashlib
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from omnisyn_cli.batch.folder import attempt_folder, output_stats, publish, read_outputs
from omnisyn_cli.batch.manifest import BatchJob
from omnisyn_cli.batch.provenance import digest_of_network, file_stamp, job_sources
from omnisyn_cli.interpolation.loading import CachedPanorama
from omnisyn_cli.interpolation.plan import InterpolationPlan, plan_interpolation
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.io import Panorama, read_panorama
from omnisyn_cli.pipeline.depth_sources import make_estimator
from omnisyn_cli.types import DepthEstimate, DepthEstimator, View

# Kept at a time by a worker: two panoramas for the pair at work, one shared with the next pair; the depth of pairs;
# estimators, as jobs that want depth found in more ways than that load networks again.
MAX_CACHED_PANORAMAS, MAX_CACHED_DEPTHS, MAX_CACHED_ESTIMATORS = 3, 4, 4
T = TypeVar("T")


class LRUCache(Generic[T]):
    """The values that were asked for last, at most so many."""

    def __init__(self, most: int) -> None:
        self.misses = 0  # how many were not known when they were asked for
        self._most = most
        self._known: OrderedDict[Hashable, T] = OrderedDict()

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """The value of a key; one that is not known is made, in memory that another has left before."""
        if key not in self._known:
            while len(self._known) >= self._most:
                self._known.popitem(last=False)
            self._known[key] = make()
            self.misses += 1
        self._known.move_to_end(key)
        return self._known[key]


class PanoramaCache(LRUCache[CachedPanorama]):
    """:func:`omnisyn_cli.io.read_panorama` that keeps the last unchanged files, as samples where these say all."""

    def __init__(self) -> None:
        super().__init__(MAX_CACHED_PANORAMAS)

    def __call__(self, path: Path, **options: Any) -> Panorama:
        """The panorama of a file."""

        def read() -> CachedPanorama:
            return CachedPanorama(read_panorama(path, **options))

        if not path.exists():
            read()  # which says what is wrong
        kept = self.get((*file_stamp(path), *sorted(options.items())), read)
        panorama = Panorama(kept.image(), kept.mask, kept.original, path)
        kept.release_floats()
        return panorama


class DepthCache(LRUCache[tuple[DepthEstimate, DepthEstimate]]):
    """A :class:`~omnisyn_cli.types.DepthEstimator` that keeps the last pairs, asked in one order, by positions."""

    def __init__(self, estimator: DepthEstimator) -> None:
        super().__init__(MAX_CACHED_DEPTHS)
        self._estimator = estimator

    def __call__(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        """Estimates for ``first`` and for ``second``."""
        if tuple(second.pose.position) < tuple(first.pose.position):
            depth_of_second, depth_of_first = self(second, first)
            return depth_of_first, depth_of_second
        return self.get((_digest(first), _digest(second)), lambda: self._estimator(first, second))


def _digest(view: View) -> bytes:
    """What tells a view from another without its picture: both may have been made of their files anew."""
    digest = hashlib.sha256(f"{view.image.shape} {view.image_uint8 is None} {view.is_clipped}".encode())
    pixels = view.image if view.image_uint8 is None else view.image_uint8
    for values in (pixels, view.mask, view.pose.position + 0.0, view.pose.rotation + 0.0):  # + 0.0: no minus zero
        if values is not None:
            digest.update(np.ascontiguousarray(values).reshape(-1).view(np.uint8).data)
    return digest.digest()


class Interpolator:
    """The work function for a worker.

    ``folder`` is that of the batch, absolute, ``staging`` the name of the hidden one in it, see
    :func:`~omnisyn_cli.batch.folder.open_staging_dir`; ``threads`` are those of each interpolation.
    """

    def __init__(self, folder: Path, staging: str, threads: int) -> None:
        self._folder, self._staging, self._threads = folder, staging, threads
        self._panoramas = PanoramaCache()
        self._estimators = LRUCache[DepthCache](MAX_CACHED_ESTIMATORS)

    def __call__(self, job: BatchJob) -> dict[str, Any]:
        """Make the outputs of a job; what there is to say about it, and the files if they could not be put in place."""
        begin, sources, folder = time.perf_counter(), job_sources(job), self._folder
        with attempt_folder(folder / self._staging) as (attempt, is_shared):
            for place in job.places:
                (attempt / place).parent.mkdir(parents=True, exist_ok=True)
            details = self._interpolate(job, attempt, sources)
            outputs = output_stats(attempt, job.places)
            files = None if is_shared else read_outputs(attempt, job.places)
            if is_shared:
                publish(attempt, folder, job.places)
        seconds = round(time.perf_counter() - begin, 3)
        return {"seconds": seconds, "outputs": outputs, **details, "sources": sources, "files": files}

    def _interpolate(self, job: BatchJob, attempt: Path, sources: Mapping[str, Any]) -> dict[str, Any]:
        plan = plan_interpolation(job.interpolation(attempt, self._threads))
        memory = self._memory(plan, sources, job) if plan.config.estimates_depth else None
        decoded, matched = self._panoramas.misses, memory.misses if memory else 0
        summary = run_interpolation(plan, read=self._panoramas, estimator=memory).describe()
        return {
            "panoramas_decoded": self._panoramas.misses - decoded,
            "pairs_matched": memory.misses - matched if memory else 0,
            "summary": {key: value for key, value in summary.items() if key not in ("inputs", "output")},
        }

    def _memory(self, plan: InterpolationPlan, sources: Mapping[str, Any], job: BatchJob) -> DepthCache:
        """The estimator that jobs with the same wishes for depth share; a network is loaded once, until it changes."""
        source, device = plan.config.depth, plan.config.device
        key = (source, device, *(digest_of_network(network, sources, job) for network in source.networks))
        return self._estimators.get(
            key, lambda: DepthCache(make_estimator(source, device=device, threads=plan.job.threads))
        )
