"""What a worker keeps from one job for the next: panoramas it has decoded, depth it has found, networks it has loaded.

Only a few of each are kept, so the memory of a worker does not grow with the number of its jobs.
"""

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from omnisyn_cli.batch.provenance import stamp
from omnisyn_cli.interpolation.loading import KeptPanorama
from omnisyn_cli.io import MAX_PIXELS, Panorama, read_panorama
from omnisyn_cli.types import DepthEstimate, DepthEstimator, View

MOST_PANORAMAS = 3
"""Two for the pair at work, one that it shares with the next pair."""

MOST_DEPTHS = 4

T = TypeVar("T")


class Recent(Generic[T]):
    """The values that were asked for last.

    Args:
        most: how many are kept.

    Attributes:
        made: how many were not known when they were asked for.
    """

    def __init__(self, most: int) -> None:
        self.made = 0
        self._most = most
        self._known: OrderedDict[Hashable, T] = OrderedDict()

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """The value of a key; one that is not known is made, in memory that another has left before."""
        if key not in self._known:
            while len(self._known) >= self._most:
                self._known.popitem(last=False)
            self._known[key] = make()
            self.made += 1
        self._known.move_to_end(key)
        return self._known[key]


class PanoramaMemory:
    """:func:`omnisyn_cli.io.read_panorama` that remembers the last panoramas, as long as their files do not change.

    What is remembered is held as the samples of its file where these say everything: a quarter of the numbers.
    """

    def __init__(self) -> None:
        self._known = Recent[KeptPanorama](MOST_PANORAMAS)

    @property
    def decoded(self) -> int:
        """How many were read from files so far."""
        return self._known.made

    def __call__(self, path: Path, *, allow_aspect: bool = False, max_pixels: int = MAX_PIXELS) -> Panorama:
        """The panorama of a file."""

        def read() -> KeptPanorama:
            return KeptPanorama(read_panorama(path, allow_aspect=allow_aspect, max_pixels=max_pixels))

        if not path.exists():
            read()  # which says what is wrong
        kept = self._known.get((*stamp(path), allow_aspect, max_pixels), read)
        panorama = Panorama(kept.image(), kept.mask, kept.original, path)
        kept.forget_numbers()
        return panorama


class DepthMemory:
    """A :class:`~omnisyn_cli.types.DepthEstimator` that remembers the last pairs, whichever way round they are asked.

    A pair is always handed to the estimator in one order, given by its positions: so the way there and the way back
    have the same depth, and no result depends on what was asked before.

    Args:
        estimator: what finds depth.
    """

    def __init__(self, estimator: DepthEstimator) -> None:
        self._estimator = estimator
        self._known = Recent[tuple[DepthEstimate, DepthEstimate]](MOST_DEPTHS)

    @property
    def found(self) -> int:
        """How many pairs it was asked for so far."""
        return self._known.made

    def __call__(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        """Estimates for ``first`` and for ``second``."""
        if tuple(second.pose.position) < tuple(first.pose.position):
            there, back = self(second, first)
            return back, there
        return self._known.get((_digest(first), _digest(second)), lambda: self._estimator(first, second))


def _digest(view: View) -> bytes:
    """What tells a view from another without its picture: both may have been made of their files anew."""
    digest = hashlib.sha256(f"{view.image.shape} {view.samples is None} {view.is_cut_off}".encode())
    pixels = view.image if view.samples is None else view.samples
    for values in (pixels, view.mask, view.pose.position + 0.0, view.pose.rotation + 0.0):  # + 0.0: no minus zero
        if values is not None:
            digest.update(np.ascontiguousarray(values).reshape(-1).view(np.uint8).data)
    return digest.digest()
