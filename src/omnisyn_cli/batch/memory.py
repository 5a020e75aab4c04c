"""What a worker keeps from one job for the next: panoramas it has decoded, depth it has found.

Both keep a few only, so the memory of a worker does not grow with the number of its jobs.
"""

from __future__ import annotations

import weakref
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from omnisyn_cli.batch.provenance import stamp
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.io import MAX_PIXELS, Panorama, read_panorama
from omnisyn_cli.types import DepthEstimate, DepthEstimator, View

__all__ = ["MOST_PANORAMAS", "DepthMemory", "PanoramaMemory"]

MOST_PANORAMAS = 3
"""Two for the pair at work, one that it shares with the next pair."""

MOST_DEPTHS = 4


class PanoramaMemory:
    """:func:`omnisyn_cli.io.read_panorama` that remembers the last panoramas, as long as their files do not change.

    Attributes:
        decoded: how many were read from files so far.
    """

    def __init__(self, most: int = MOST_PANORAMAS) -> None:
        self.decoded = 0
        self._most = most
        self._known: OrderedDict[tuple[object, ...], Panorama] = OrderedDict()

    def __call__(self, path: Path, *, allow_aspect: bool = False, max_pixels: int = MAX_PIXELS) -> Panorama:
        """The panorama of a file; the same object as long as it is remembered."""
        if not path.exists():
            return read_panorama(path, allow_aspect=allow_aspect, max_pixels=max_pixels)  # which says what is wrong
        key = (*stamp(path), allow_aspect, max_pixels)
        if key in self._known:
            self._known.move_to_end(key)
            return self._known[key]
        while len(self._known) >= self._most:  # before the next one takes its memory
            self._known.popitem(last=False)
        self.decoded += 1
        panorama = self._known[key] = read_panorama(path, allow_aspect=allow_aspect, max_pixels=max_pixels)
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
        for pair in self._known:
            if pair.first.is_of(first) and pair.second.is_of(second):
                return pair.depths
        self.found += 1
        depths = self._estimator(first, second)
        self._known = [*self._known[1 - MOST_DEPTHS :], _Pair(_Trace.of(first), _Trace.of(second), depths)]
        return depths


@dataclass(frozen=True)
class _Trace:
    """What tells a view from another without keeping its picture alive."""

    image: weakref.ref[np.ndarray]
    pose: Pose
    mask: np.ndarray | None

    @staticmethod
    def of(view: View) -> _Trace:
        return _Trace(weakref.ref(view.image), view.pose, view.mask)

    def is_of(self, view: View) -> bool:
        """Whether it is the same picture in memory, with the same pose and mask."""
        has_same_pose = np.array_equal(self.pose.position, view.pose.position) and np.array_equal(
            self.pose.rotation, view.pose.rotation
        )
        return self.image() is view.image and has_same_pose and _are_equal(self.mask, view.mask)


@dataclass(frozen=True)
class _Pair:
    first: _Trace
    second: _Trace
    depths: tuple[DepthEstimate, DepthEstimate]


def _are_equal(first: np.ndarray | None, second: np.ndarray | None) -> bool:
    if first is None or second is None:
        return first is second
    return np.array_equal(first, second)
