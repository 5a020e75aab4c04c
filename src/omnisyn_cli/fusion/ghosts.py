"""Things that moved: where two views show different things in one place, the picture comes from one of them.

Two renderings of a place that stayed the same differ by a pixel or so of displacement, which vanishes in the mean over
a few pixels. A person who is there in only one of them does not. So means over cells of about 1.4° are compared, after
taking away what differs over a wide neighbourhood (light, vignetting). Islands of cells that differ, but for thin ones,
which are edges of wrong depth, are regions. In each region the view that counts more there, taken as a whole, wins;
one that has holes counts for less. So a thing is there or it is not, but never half transparent, and it changes once
along the way.

Colours may be numpy arrays or torch tensors on any device. Only what is done for every pixel has two forms: arrays
here, and kernels for the processor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from array_api_compat import array_namespace, device, is_numpy_array
from jaxtyping import Bool, Float32, Integer

from omnisyn_cli.compute.threads import run_bands
from omnisyn_cli.fusion.blend_rule import BlendRule, LayerArrays, view_weights
from omnisyn_cli.fusion.ghost_grid import ghost_cell_size, ghost_sample_step, greatest_near, mean_near
from omnisyn_cli.fusion.ghost_kernels import accumulate_cells, suppress_edge_samples, suppress_rows
from omnisyn_cli.geometry.pose import STILL
from omnisyn_cli.geometry.regions import connected_regions
from omnisyn_cli.geometry.sampling import grid_subsample
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.types import MIN_VISIBLE_WEIGHT, EdgePixels, Layer

__all__ = ["GhostRemover", "GhostSuppression", "have_same_position"]

Array = Any  # numpy.ndarray or torch.Tensor

NEARBY = 3
"""Cells by which wrong depth may displace things."""

ENDLESS = 1e3

LEAST_T = 1e-9
"""How close to an end of the way the weights of both views are still compared."""

SPREADINGS = 4
"""Steps of spreading after which it is asked whether anything has changed."""

WHOLENESS = 4.0
"""Logarithm of weights that a view gains over one that sees nothing of a cell: the other would show through the holes.

Measured on generated walks and pairs with estimated depth: 0.04 dB, of which one home has 0.5; at 50 nothing is left.
"""

PREFERENCE_STEPS = 2.0**20
"""Parts of 1 in which preferences are added: sums of whole numbers do not depend on their order."""


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


@dataclass(frozen=True)
class GhostSuppression:
    """What takes weight away from the view that is not shown; a :data:`omnisyn_cli.types.ColourStep`.

    Attributes:
        suppressed: by cell: from −1 (the first loses all of its weight) to 1 (the second does).
        cell: pixels along the side of a cell.
    """

    suppressed: Float32[Array, "rows cols"]
    cell: int

    def __call__(self, first: Array, second: Array, top: int) -> None:
        """In some rows of both views, see :func:`suppress`."""
        suppress(first, second, top, self.suppressed, self.cell)

    def of_samples(self, first: Array, second: Array, edge_pixels: EdgePixels) -> None:
        """In the samples of spots, ``(2, samples, 4)`` of either view."""
        suppress_edge_samples(first, second, self.suppressed, self.cell, edge_pixels)


class GhostRemover:
    """Finds where blending two renderings would show a ghost, and which of them is not to be shown there.

    Args:
        size: height and width of the renderings.
        options: what a ghost is.
        threads: at most this many; None is one per core.

    Attributes:
        is_full_resolution: whether every pixel is looked at, and not only some of each cell.
        downsampled_size: how many rows and columns are looked at.
        along: pixels that are looked at along the side of a cell.
    """

    def __init__(self, size: tuple[int, int], options: GhostOptions | None = None, threads: int | None = None) -> None:
        self.size, self.threads, self.options = size, threads, options or GhostOptions()
        self.cell, step = ghost_cell_size(size), ghost_sample_step(size)
        self.is_full_resolution = step == 1
        self.along = -(-self.cell // step)
        self._rows, self._cols = (np.flatnonzero(np.arange(count) % self.cell % step == 0) for count in size)
        self.downsampled_size = len(self._rows), len(self._cols)
        self._grid = (-(-size[0] // self.cell), -(-size[1] // self.cell))
        self._directions = pixel_directions(*self._grid).astype(np.float32)

    def __call__(self, first: Layer, second: Layer, rule: BlendRule) -> GhostSuppression | None:
        """What suppresses ghosts in colours of both views; None where there are none.

        Args:
            first: of the first view.
            second: of the second view.
            rule: how they are blended.
        """
        return self.among(self.downsample(first), self.downsample(second), rule)

    def downsample(self, view: Layer) -> Layer:
        """The pixels of a rendering that are looked at, as a smaller one; the very same one where these are all."""
        if self.is_full_resolution and view.held is not None:
            return view
        xp, rho = array_namespace(view.inverse_depth), view.inverse_depth
        if is_numpy_array(rho):
            near = grid_subsample(rho, self._rows, self._cols)
        else:
            rows, cols = (xp.asarray(index, device=device(rho)) for index in (self._rows, self._cols))
            near = xp.take(xp.take(rho, rows, axis=0), cols, axis=1)
        return Layer.from_arrays(near, view.colour_grid(self._rows, self._cols), view.target_from_source)

    def among(self, first: Layer, second: Layer, rule: BlendRule) -> GhostSuppression | None:
        """The same, given the pixels of both that are looked at (:meth:`downsample`)."""
        if self._reach < NEARBY:
            return None
        one, other, count, more = self._cells(first, second)
        differs = self._differing(one, other, count)
        if not is_any(differs):
            return None
        preference = self._preference(one, other, rule, differs) + WHOLENESS * more
        return GhostSuppression(suppressed_cells(differs, preference), self.cell)

    @property
    def _reach(self) -> int:
        return min(self.options.neighbourhood, *(count // 2 - 1 for count in self._grid))

    def _cells(self, first: Layer, second: Layer) -> tuple[LayerArrays, LayerArrays, Array, Array]:
        """Means over what both views see of each cell; how many pixels these are; what share more the first sees."""
        (a, a_rho), (b, b_rho) = ((view.colour, view.inverse_depth) for view in (first, second))
        if is_numpy_array(a):
            sums = np.empty((*self._grid, 13), np.float32)
            gather = partial(accumulate_cells, a, a_rho, b, b_rho, self.along, sums)
            run_bands(gather, self._grid[0], self.threads)
        else:
            sums = self._gathered(a, a_rho, b, b_rho)
        xp, count = array_namespace(sums), sums[..., 0]
        share = 1.0 / xp.clip(count, min=1.0)
        offsets = (xp.asarray(view.target_from_source.position, dtype=sums.dtype, device=device(sums))
                   for view in (first, second))  # fmt: skip
        shown = [
            LayerArrays(sums[..., k : k + 3] * share[..., None], sums[..., k + 3] * share, sums[..., rho] * share, offset)
            for k, rho, offset in zip((1, 5), (9, 10), offsets, strict=True)
        ]
        only_first, only_second = sums[..., 11], sums[..., 12]
        return *shown, count, (only_first - only_second) / xp.clip(count + only_first + only_second, min=1.0)

    def _gathered(self, first: Array, first_rho: Array, second: Array, second_rho: Array) -> Array:
        """:func:`omnisyn_cli.fusion.ghost_kernels.accumulate_cells` by arrays."""
        xp, (rows, cols) = array_namespace(first), (count * self.along for count in self._grid)
        is_first, is_second = (colour[..., 3:] > float(MIN_VISIBLE_WEIGHT) for colour in (first, second))
        near = xp.clip(xp.stack([first_rho, second_rho], axis=-1), min=0.0)
        values = xp.concat([xp.ones_like(near[..., :1]), first, second, near], axis=-1)
        values = xp.where(is_first & is_second, values, xp.zeros_like(values))
        alone = (xp.astype(one & ~other, values.dtype) for one, other in ((is_first, is_second), (is_second, is_first)))
        values = xp.concat([values, *alone], axis=-1)
        whole = xp.zeros((rows, cols, values.shape[-1]), dtype=values.dtype, device=device(values))
        whole[: values.shape[0], : values.shape[1]] = values
        return xp.sum(whole.reshape(self._grid[0], self.along, self._grid[1], self.along, -1), axis=(1, 3))

    def _differing(self, first: LayerArrays, second: LayerArrays, count: Array) -> Bool[Array, "rows cols"]:
        """Cells of different things: not thin, and grown by what an opening took from their edges."""
        xp = array_namespace(count)
        one, plain = first.colour, first.colour - second.colour
        weighted = xp.concat([plain * count[..., None], count[..., None]], axis=-1)
        means = mean_near(weighted, self._reach, is_mirrored=True)
        other = second.colour + means[..., :3] / xp.clip(means[..., 3:], min=1e-6)
        least, seen = self.options.difference, count > 0.0
        differs = seen & (_greatest(xp.abs(plain)) > least) & (_greatest(xp.abs(one - other)) > least)
        differs &= xp.maximum(_beyond(one, other, seen), _beyond(other, one, seen)) > self.options.beyond
        rest = greatest_near(xp.astype(~differs, xp.int32), 1)
        return greatest_near(1 - rest, 2) > 0

    def _preference(
        self, first: LayerArrays, second: LayerArrays, rule: BlendRule, wanted: Bool[Array, "rows cols"]
    ) -> Float32[Array, "rows cols"]:
        """log(weight of the first / weight of the second) in the blend of the wanted cells, which are few; else 0."""
        xp, cells = array_namespace(wanted), array_namespace(wanted).nonzero(wanted)
        directions = xp.asarray(self._directions, device=device(wanted))[cells]
        inside = replace(rule, t=min(max(rule.t, LEAST_T), 1.0 - LEAST_T))
        a, b = view_weights(_of_cells(first, cells), _of_cells(second, cells), directions, inside)
        is_known, one = (a > 0.0) & (b > 0.0), xp.ones_like(a)
        preference = xp.zeros_like(first.weight)
        preference[cells] = xp.log(xp.where(is_known, a, one)) - xp.log(xp.where(is_known, b, one))
        return preference


def _of_cells(shown: LayerArrays, cells: tuple[Array, ...]) -> LayerArrays:
    return LayerArrays(shown.colour[cells], shown.weight[cells], shown.inverse_depth[cells], shown.offset)


def is_any(mask: Bool[Array, "rows cols"]) -> bool:
    """Whether it is set anywhere: what has to be known before it goes on."""
    return bool(mask.any())


def have_same_position(first: Layer, second: Layer) -> bool:
    """Whether both views were taken from one place: then one picture turns into the other, and nothing is a ghost."""
    positions = (first.target_from_source.position, second.target_from_source.position)
    return np.allclose(*positions, rtol=0.0, atol=STILL)


def suppress(first: Array, second: Array, top: int, suppressed: Float32[Array, "rows cols"], cell: int) -> None:
    """Take weight away from the suppressed view where both see something, in place, gradually at borders of regions.

    Args:
        first: ``(rows, width, 4)`` RGB and weight of some rows.
        second: likewise.
        top: row of the picture that the first of them is.
        suppressed: by cell: from −1 (the first loses all of its weight) to 1 (the second does).
        cell: pixels along the side of a cell.
    """
    if is_numpy_array(first):
        suppress_rows(first, second, suppressed, cell, top)
        return
    xp, (rows, cols) = array_namespace(first), suppressed.shape
    upper, lower, down = _neighbours(xp.arange(first.shape[0], device=device(first)) + top, cell)
    left, right, across = _neighbours(xp.arange(first.shape[1], device=device(first)), cell)
    above, below = suppressed[xp.clip(upper, min=0)], suppressed[xp.clip(lower, max=rows - 1)]
    line = above + down[:, None] * (below - above)
    value = line[:, left % cols] + across * (line[:, right % cols] - line[:, left % cols])
    value = value * ((first[..., 3] > float(MIN_VISIBLE_WEIGHT)) & (second[..., 3] > float(MIN_VISIBLE_WEIGHT)))
    first[..., 3] *= 1.0 + xp.clip(value, max=0.0)
    second[..., 3] *= 1.0 - xp.clip(value, min=0.0)


def _neighbours(pixel: Integer[Array, " pixels"], cell: int) -> tuple[Array, Array, Array]:
    """Cells whose centres a pixel's lies between, and how far it is from the first of them."""
    xp = array_namespace(pixel)
    place = (xp.astype(pixel, xp.float32) + 0.5) / cell - 0.5
    before = xp.floor(place)
    index = xp.astype(before, xp.int64)
    return index, index + 1, place - before


def _beyond(one: Array, other: Array, seen: Bool[Array, "rows cols"]) -> Float32[Array, "rows cols"]:
    """How far the colours of one lie outside of the range that the other has around the same place."""
    xp = array_namespace(one)
    nothing, known = xp.full_like(other, -ENDLESS), seen[..., None]
    highest = greatest_near(xp.where(known, other, nothing), NEARBY)
    lowest = -greatest_near(xp.where(known, -other, nothing), NEARBY)
    return _greatest(xp.maximum(one - highest, lowest - one))


def _greatest(values: Float32[Array, "rows cols 3"]) -> Float32[Array, "rows cols"]:
    """Of three channels; numpy's own maximum over so short an axis takes ten times as long."""
    xp = array_namespace(values)
    return xp.maximum(xp.maximum(values[..., 0], values[..., 1]), values[..., 2])


def suppressed_cells(
    differs: Bool[Array, "rows cols"], preference: Float32[Array, "rows cols"]
) -> Float32[Array, "rows cols"]:
    """By cell: 1 in regions where the first view wins, −1 where the second does, 0 elsewhere.

    Args:
        differs: the cells of regions.
        preference: by how much each counts for the first view.
    """
    xp, labels = array_namespace(preference), regions(differs).reshape(-1)
    votes = xp.astype(xp.round(preference * PREFERENCE_STEPS), xp.float64)
    sums = xp.bincount(labels, votes.reshape(-1))
    wins = xp.take(sums, labels, axis=0).reshape(differs.shape) >= 0.0
    return xp.astype(differs, preference.dtype) * (2.0 * xp.astype(wins, preference.dtype) - 1.0)


def regions(differs: Bool[Array, "rows cols"]) -> Integer[Array, "rows cols"]:
    """A number > 0 for every region of neighbouring cells, diagonal ones and those across the seam included; else 0.

    On a device the greatest number spreads over neighbours, and from every cell on to the cells that name it: regions
    that wind take hardly longer than others.
    """
    if is_numpy_array(differs):
        return connected_regions(differs, is_diagonal=True)
    xp = array_namespace(differs)
    inside = xp.astype(differs, xp.int64)
    count = inside.shape[0] * inside.shape[1]
    labels = inside * xp.arange(1, count + 1, device=device(differs)).reshape(inside.shape)
    while True:
        before = labels
        for _ in range(SPREADINGS):
            labels = greatest_near(labels, 1) * inside
            named = xp.take(labels.reshape(-1), xp.clip(labels - 1, min=0).reshape(-1), axis=0)
            labels = named.reshape(inside.shape) * inside
        if not is_any(before != labels):
            return labels
