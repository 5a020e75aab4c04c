"""What a worker keeps from one job for the next: panoramas it has decoded, depth it has found.

Both keep a few only, so the memory of a worker does not grow with the number of its jobs.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from omnisyn_cli.batch.provenance import stamp
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.interpolation.loading import KeptPanorama
from omnisyn_cli.io import MAX_PIXELS, Panorama, read_panorama
from omnisyn_cli.types import DepthEstimate, DepthEstimator, View

__all__ = ["MOST_PANORAMAS", "DepthMemory", "PanoramaMemory"]

MOST_PANORAMAS = 3
"""Two for the pair at work, one that it shares with the next pair."""

MOST_DEPTHS = 4


class PanoramaMemory:
    """:func:`omnisyn_cli.io.read_panorama` that remembers the last panoramas, as long as their files do not change.

    What is remembered is held as the samples of its file where these say everything: a quarter of the numbers.

    Attributes:
        decoded: how many were read from files so far.
    """

    def __init__(self) -> None:
        self.decoded = 0
        self._known: OrderedDict[tuple[object, ...], KeptPanorama] = OrderedDict()

    def __call__(self, path: Path, *, allow_aspect: bool = False, max_pixels: int = MAX_PIXELS) -> Panorama:
        """The panorama of a file."""
        if not path.exists():
            return read_panorama(path, allow_aspect=allow_aspect, max_pixels=max_pixels)  # which says what is wrong
        key = (*stamp(path), allow_aspect, max_pixels)
        if key in self._known:
            self._known.move_to_end(key)
            kept = self._known[key]
            return Panorama(kept.image(), kept.mask, kept.original, path)
        while len(self._known) >= MOST_PANORAMAS:  # before the next one takes its memory
            self._known.popitem(last=False)
        self.decoded += 1
        panorama = read_panorama(path, allow_aspect=allow_aspect, max_pixels=max_pixels)
        self._known[key] = KeptPanorama(panorama)
        self._known[key].forget_numbers()
        return panorama


class DepthMemory:
    """A :class:`~omnisyn_cli.types.DepthEstimator` that remembers the last pairs, whichever way round they are asked.

    A pair is always handed to the estimator in one order, given by its positions: so the way there and the way back
    have the same depth, and no result depends on what was asked before.

    Args:
        estimator: what finds depth.

    Attributes:
        found: how many pairs it was asked for so far.
    """

    def __init__(self, estimator: DepthEstimator) -> None:
        self.found = 0
        self._estimator = estimator
        self._known: list[_Pair] = []

    def __call__(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        """Estimates for ``first`` and for ``second``."""
        if tuple(second.pose.position) < tuple(first.pose.position):
            there, back = self._of(second, first)
            return back, there
        return self._of(first, second)

    def _of(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        traces = (_Trace.of(first), _Trace.of(second))
        for pair in self._known:
            if all(known.is_of(trace) for known, trace in zip(pair.traces, traces, strict=True)):
                return pair.depths
        self.found += 1
        depths = self._estimator(first, second)
        self._known = [*self._known[1 - MOST_DEPTHS :], _Pair(traces, depths)]
        return depths


@dataclass(frozen=True)
class _Trace:
    """What tells a view from another without its picture: both may have been made of their files anew.

    Attributes:
        digest: of the picture and of what is known about its pixels.
        pose: of the view.
    """

    digest: bytes
    pose: Pose

    @staticmethod
    def of(view: View) -> _Trace:
        digest = hashlib.sha256(f"{view.image.shape} {view.samples is None} {view.is_cut_off}".encode())
        for pixels in (view.image if view.samples is None else view.samples, view.mask):
            if pixels is not None:
                digest.update(np.ascontiguousarray(pixels).reshape(-1).view(np.uint8).data)
        return _Trace(digest.digest(), view.pose)

    def is_of(self, other: _Trace) -> bool:
        """Whether it is the same picture, with the same pose and mask."""
        has_same_pose = np.array_equal(self.pose.position, other.pose.position) and np.array_equal(
            self.pose.rotation, other.pose.rotation
        )
        return self.digest == other.digest and has_same_pose


@dataclass(frozen=True)
class _Pair:
    traces: tuple[_Trace, _Trace]
    depths: tuple[DepthEstimate, DepthEstimate]
