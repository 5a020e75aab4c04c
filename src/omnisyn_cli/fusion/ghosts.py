"""Things that moved: where two views show different things in one place, the picture comes from one of them.

Two renderings of a place that stayed the same differ by a pixel or so of displacement, which vanishes in the mean over
a few pixels. A person who is there in only one of them does not. So means over cells of about 1.4° are compared, after
taking away what differs over a wide neighbourhood (light, vignetting). Islands of cells that differ, but for thin ones,
which are edges of wrong depth, are regions. In each region the view that counts more there, taken as a whole, wins: a
thing is there or it is not, but never half transparent, and it changes once along the way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Integer

from omnisyn_cli.fusion.ghost_kernels import gather_cells, silence_rows
from omnisyn_cli.fusion.options import BlendOptions
from omnisyn_cli.geometry.border import filter_across_seam
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.threads import run_bands
from omnisyn_cli.types import BELIEF, Rendering, RowRendering

__all__ = [
    "ENDLESS", "LEAST_CELL", "NEARBY", "ROWS_OF_CELLS", "SAMPLES_ALONG_CELL", "GhostOptions", "GhostRemover",
    "samples_of_cells",
]  # fmt: skip

ROWS_OF_CELLS = 128
LEAST_CELL = 4
"""Pixels along the side of a cell at least, because views are displaced by pixels, not by angles."""

SAMPLES_ALONG_CELL = 4

NEARBY = 3
"""Cells by which wrong depth may displace things."""

ENDLESS = 1e3


@dataclass(frozen=True)
class GhostOptions:
    """When two colours of one place are different things.

    Attributes:
        difference: least difference of the mean colours in any channel, stored values.
        beyond: how far one colour has to lie outside of the range of the other view around that place: what is there
            a little aside is displaced by wrong depth, and nothing that moved.
        neighbourhood: cells to every side over which a common difference is no thing of its own.
    """

    difference: float = 0.12
    beyond: float = 0.08
    neighbourhood: int = 12


class GhostRemover:
    """Takes the worth of one of two renderings away where blending them would show a ghost. Reused between frames.

    Args:
        size: height and width of the renderings.
        blend: how they will be blended.
        options: what a ghost is.
        threads: at most this many; None is one per core.
    """

    def __init__(
        self,
        size: tuple[int, int],
        blend: BlendOptions | None = None,
        options: GhostOptions | None = None,
        threads: int | None = None,
    ) -> None:
        self.size, self.threads = size, threads
        self.blend, self.options = blend or BlendOptions(), options or GhostOptions()
        self.cell = max(LEAST_CELL, -(-size[0] // ROWS_OF_CELLS))
        self._step = max(1, self.cell // SAMPLES_ALONG_CELL)
        self._grid = (-(-size[0] // self.cell), -(-size[1] // self.cell))
        self._sums = np.zeros((*self._grid, 11), np.float32)
        self._directions = pixel_directions(*self._grid).astype(np.float32)

    def __call__(self, first: Rendering, second: Rendering, t: float, strictness: float = 1.0) -> None:
        """Change the worths in place for a frame at a share ``t`` of the way.

        Args:
            first: of the first view.
            second: of the second view.
            t: share of the way.
            strictness: how strictly the nearer surface hides the farther one in the blend, from 0 to 1.
        """
        seen = (first.colour, first.inverse_depth, second.colour, second.inverse_depth)
        loser = self._losers(seen, self.cell, self._step, first, second, t, strictness)
        if loser is not None:
            run_bands(
                lambda begin, end: silence_rows(first.colour, second.colour, loser, self.cell, 0, begin, end),
                self.size[0],
                self.threads,
            )

    def by_rows(
        self, first: RowRendering, second: RowRendering, t: float, strictness: float = 1.0
    ) -> Callable[[np.ndarray, np.ndarray, int], None] | None:
        """The same for renderings that are coloured row by row.

        Returns:
            What changes the worths of some rows of colours of both, given the first of them; None where nothing is to
            be changed.
        """
        rows, cols = (samples_of_cells(count, self.cell, self._step) for count in self.size)
        seen = (
            first.colour_at(rows, cols), first.inverse_depth[rows].take(cols, axis=1),
            second.colour_at(rows, cols), second.inverse_depth[rows].take(cols, axis=1),
        )  # fmt: skip
        loser = self._losers(seen, -(-self.cell // self._step), 1, first, second, t, strictness)
        if loser is None:
            return None
        return lambda a, b, top: silence_rows(a, b, loser, self.cell, top, 0, len(a))

    @property
    def sampled(self) -> float:
        """Share of the pixels that are looked at."""
        return 1.0 / self._step**2

    def _losers(
        self, seen: tuple[np.ndarray, ...], cell: int, step: int, first: Rendering | RowRendering,
        second: Rendering | RowRendering, t: float, strictness: float,
    ) -> Float32[np.ndarray, "rows cols"] | None:  # fmt: skip
        """Which view loses in which cell, see :func:`_losers_of_regions`; None where there is no ghost."""
        run_bands(
            lambda begin, end: gather_cells(*seen, cell, step, self._sums, begin, end), self._grid[0], self.threads
        )
        differs = self._differing()
        if not differs.any():
            return None
        offsets = (first.target_from_source.position, second.target_from_source.position)
        return _losers_of_regions(differs, self._preference(offsets, t, strictness))

    def _differing(self) -> Bool[np.ndarray, "rows cols"]:
        """Cells of different things: not thin, and grown by what an opening took from their edges."""
        count, reach = self._sums[..., 0], min(self.options.neighbourhood, *(n // 2 - 1 for n in self._grid))
        if reach < NEARBY:
            return np.zeros(self._grid, bool)
        first, second = (self._sums[..., k : k + 3] / np.maximum(count, 1.0)[..., None] for k in (1, 4))
        plain = first - second
        second = second + _box_mean(plain, count, reach)
        least, seen = self.options.difference, count > 0.0
        differs = seen & (_greatest(np.abs(plain)) > least) & (_greatest(np.abs(first - second)) > least)
        differs &= np.maximum(_beyond(first, second, seen), _beyond(second, first, seen)) > self.options.beyond
        return filter_across_seam(_grown_core, differs.astype(np.uint8), 4) > 0

    def _preference(
        self, offsets: tuple[np.ndarray, np.ndarray], t: float, strictness: float
    ) -> Float32[np.ndarray, "rows cols"]:
        """log(weight of the first / weight of the second) in the blend, by cell; 0 where only one sees anything."""
        count = np.maximum(self._sums[..., 0], 1.0)
        worths = [np.maximum(self._sums[..., k] / count, 1e-6) for k in (7, 8)]
        rhos = [self._sums[..., k] / count for k in (9, 10)]
        near = [
            -1.5 * np.log(((self._directions - rho[..., None] * offset) ** 2).sum(axis=-1) + 1e-8)
            for rho, offset in zip(rhos, offsets, strict=True)
        ]
        gap = (rhos[0] - rhos[1]) / (np.maximum(*rhos) * self.blend.disagreement + 1e-9)
        believed = np.minimum(1.0, BELIEF * np.where(gap > 0.0, *worths))
        rest = 1.0 - believed * (1.0 - np.exp(np.maximum(-gap * gap, strictness * np.log(self.blend.hidden))))
        hides = -np.sign(gap) * np.log(rest)
        share = np.log(max(1.0 - t, 1e-9) / max(t, 1e-9))
        found = share + np.log(worths[0] / worths[1]) + near[0] - near[1] + hides
        return np.asarray(np.where(self._sums[..., 0] > 0.0, found, 0.0), np.float32)


def samples_of_cells(count: int, cell: int, step: int) -> Integer[np.ndarray, " samples"]:
    """Every ``step``-th pixel of each cell along a side of ``count`` pixels."""
    return np.flatnonzero(np.arange(count) % cell % step == 0)


def _grown_core(wide: Integer[np.ndarray, "rows cols"]) -> Integer[np.ndarray, "rows cols"]:
    """A mask opened, and grown by one more cell."""
    return np.asarray(cv2.dilate(cv2.erode(wide, np.ones((3, 3), np.uint8)), np.ones((5, 5), np.uint8)))


def _beyond(one: np.ndarray, other: np.ndarray, seen: np.ndarray) -> Float32[np.ndarray, "rows cols"]:
    """How far the colours of one lie outside of the range that the other has around the same place."""
    window = np.ones((2 * NEARBY + 1, 2 * NEARBY + 1), np.uint8)
    ranges = []
    for extreme, nothing in ((cv2.dilate, -ENDLESS), (cv2.erode, ENDLESS)):
        known = np.where(seen[..., None], other, nothing).astype(np.float32)
        ranges.append(filter_across_seam(partial(extreme, kernel=window), known, NEARBY))
    return _greatest(np.maximum(one - ranges[0], ranges[1] - one))


def _greatest(values: Float32[np.ndarray, "rows cols 3"]) -> Float32[np.ndarray, "rows cols"]:
    """Of three channels; numpy's own maximum over so short an axis takes ten times as long."""
    return np.asarray(np.maximum(np.maximum(values[..., 0], values[..., 1]), values[..., 2]))


def _box_mean(values: np.ndarray, weight: np.ndarray, reach: int) -> Float32[np.ndarray, "rows cols 3"]:
    """Weighted means over squares that wrap at the seam and end at the poles."""
    stacked = np.dstack([values * weight[..., None], weight])
    mean = partial(cv2.boxFilter, ddepth=-1, ksize=(2 * reach + 1, 2 * reach + 1), borderType=cv2.BORDER_REFLECT)
    sums = filter_across_seam(mean, stacked, reach)
    return np.asarray(sums[..., :3] / np.maximum(sums[..., 3:], 1e-6))


def _losers_of_regions(
    differs: Bool[np.ndarray, "rows cols"], preference: np.ndarray
) -> Float32[np.ndarray, "rows cols"]:
    """1 in regions where the first view wins (the second loses), −1 where the second does, 0 elsewhere."""
    count, labels = cv2.connectedComponents(differs.astype(np.uint8), connectivity=8)
    labels = _joined_at_the_seam(labels, count)
    sums = np.bincount(labels.ravel(), preference.ravel(), count)
    winners = np.where(sums >= 0.0, np.float32(1.0), np.float32(-1.0))
    winners[0] = 0.0
    return np.asarray(winners[labels])


def _joined_at_the_seam(labels: np.ndarray, count: int) -> np.ndarray:
    """Labels of regions that touch across the seam made equal."""
    names = np.arange(count)
    padded = np.pad(labels[:, -1], 1)
    for shift in range(3):
        for left, right in zip(labels[:, 0], padded[shift : shift + len(labels)], strict=True):
            if left and right and names[left] != names[right]:
                names[names == names[right]] = names[left]
    return np.asarray(names[labels])
