"""Ghost removal: where two layers show different things in one place, the frame takes the place from one of them.

Two layers of a static place differ by a pixel or so of displacement, which vanishes in the mean over a few pixels. A
person who is in only one of the photographs does not. The detector therefore compares means over cells of 1.4°:

1. The colour difference of a cell is taken as it is, and after subtracting what differs over a wide neighbourhood
   (light, vignetting). Both have to be large.
2. The colour of one layer has to lie outside the range of the other layer in the cells around it. Otherwise it is the
   same thing, displaced by wrong depth.
3. A morphological opening drops thin structures, which are edges of wrong depth.
4. Connected cells are a region. In each region the layer with the larger total weight wins; a layer with holes counts
   for less. A moving thing is thus visible or not, never half transparent, and it changes once along the way.

Colours are numpy arrays, or torch tensors on any device. Only loops over all pixels have two forms: arrays here, numba
kernels in :mod:`omnisyn_cli.fusion.ghost_kernels`.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from array_api_compat import array_namespace, device, is_numpy_array
from jaxtyping import Bool, Float32, Integer

from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.fusion.blend_rule import BlendRule, LayerArrays, view_weights
from omnisyn_cli.fusion.ghost_grid import ghost_cell_size, ghost_sample_step
from omnisyn_cli.fusion.ghost_kernels import accumulate_cells, suppress_edge_samples, suppress_rows
from omnisyn_cli.fusion.window_filters import box_filter, dilate
from omnisyn_cli.geometry.perspective import cell_directions
from omnisyn_cli.geometry.pose import at_same_position
from omnisyn_cli.geometry.regions import connected_regions
from omnisyn_cli.geometry.sampling import grid_subsample
from omnisyn_cli.types import MIN_VISIBLE_WEIGHT, EdgePixels, Layer

Array = Any  # numpy.ndarray or torch.Tensor

MAX_DISPLACEMENT_CELLS = 3  # cells by which wrong depth may displace things. Set by hand.
UNSEEN_COLOUR = 1e3  # stands for the colour of cells that are not seen, so that they never widen a range
# Distance from an end of the way at which the weights of both layers are still compared; at the end one is 0.
MIN_PATH_POSITION = 1e-9
# Label spreading steps between two tests for convergence on a device, where a test waits for it. Set by hand.
LABEL_STEPS_PER_CHECK = 4

# Logarithm of weights that a layer gains over one that sees nothing of a cell: the other would show through the holes.
# Measured on generated walks and pairs with estimated depth: 0.04 dB, of which one home has 0.5; at 50 nothing is left.
COVERAGE_LOG_WEIGHT = 4.0
VOTE_STEPS = 2.0**20  # parts of 1 in which votes are rounded: sums of whole numbers do not depend on their order
# Least difference of the mean colours of two things in any channel, sRGB values. Set by hand.
MIN_GHOST_DIFFERENCE = 0.12
# sRGB values that one colour has to lie outside of the range of the other layer in nearby cells: a thing that is merely
# displaced by wrong depth lies inside. Set by hand.
MIN_OUTSIDE_RANGE = 0.08
ILLUMINATION_RADIUS = 12  # cells over which a common difference counts as light, not as a thing. Set by hand.


@dataclass(frozen=True)
class GhostSuppression:
    """Takes blend weight away from the layer that is not shown; a :data:`omnisyn_cli.types.ColourStep`."""

    # by cell, in [−1, 1]: at −1 the first layer loses all of its weight, at 1 the second does
    signed_strength: Float32[Array, "rows cols"]
    cell_size: int  # pixels along the side of a cell

    def __call__(self, first: Array, second: Array, top: int) -> None:
        """In some rows of both layers, in place, where both see something; bilinear between cells.

        Layers are ``(rows, width, 4)`` RGB and weight; ``top`` is the row of the frame that the first of them is.
        """
        if is_numpy_array(first):
            suppress_rows(first, second, self.signed_strength, self.cell_size, top)
            return
        xp, strength, (rows, cols) = array_namespace(first), self.signed_strength, self.signed_strength.shape
        upper, lower, down = _neighbour_cells(xp.arange(first.shape[0], device=device(first)) + top, self.cell_size)
        left, right, across = _neighbour_cells(xp.arange(first.shape[1], device=device(first)), self.cell_size)
        above, below = strength[xp.clip(upper, min=0)], strength[xp.clip(lower, max=rows - 1)]
        line = above + down[:, None] * (below - above)
        value = line[:, left % cols] + across * (line[:, right % cols] - line[:, left % cols])
        value = value * ((first[..., 3] > float(MIN_VISIBLE_WEIGHT)) & (second[..., 3] > float(MIN_VISIBLE_WEIGHT)))
        first[..., 3] *= 1.0 + xp.clip(value, max=0.0)
        second[..., 3] *= 1.0 - xp.clip(value, min=0.0)

    def apply_to_edges(self, first: Array, second: Array, edge_pixels: EdgePixels) -> None:
        """In the samples of edge pixels, ``(2, samples, 4)`` of either layer."""
        suppress_edge_samples(first, second, self.signed_strength, self.cell_size, edge_pixels)


class GhostRemover:
    """Detects where blending two layers of one size would show a ghost, and which layer is suppressed there.

    It reads ``samples_per_side`` pixels along a cell, ``downsampled_size`` of all: every one if ``is_full_resolution``.
    """

    def __init__(self, size: tuple[int, int], threads: int | None = None) -> None:
        self.size, self.threads = size, threads
        self.cell_size, step = ghost_cell_size(size), ghost_sample_step(size)
        self.is_full_resolution = step == 1
        self.samples_per_side = -(-self.cell_size // step)
        self.rows, self.cols = (np.flatnonzero(np.arange(count) % self.cell_size % step == 0) for count in size)
        self.downsampled_size = len(self.rows), len(self.cols)
        self.grid = (-(-size[0] // self.cell_size), -(-size[1] // self.cell_size))
        self._directions = cell_directions(size, self.grid).astype(np.float32)

    def __call__(self, first: Layer, second: Layer, rule: BlendRule) -> GhostSuppression | None:
        """The suppression for two layers at full size that a rule blends; None without ghosts."""
        return self.detect(self.downsample(first), self.downsample(second), rule)

    def downsample(self, layer: Layer) -> Layer:
        """The pixels of a layer that the detector reads, as a smaller layer; the same layer if it reads all."""
        if self.is_full_resolution and layer.cached_colour is not None:
            return layer
        xp, rho = array_namespace(layer.inverse_depth), layer.inverse_depth
        if is_numpy_array(rho):
            sampled = grid_subsample(rho, self.rows, self.cols)
        else:
            rows, cols = (xp.asarray(index, device=device(rho)) for index in (self.rows, self.cols))
            sampled = xp.take(xp.take(rho, rows, axis=0), cols, axis=1)
        return Layer.from_arrays(sampled, layer.subsampled_colours(self.rows, self.cols), layer.target_from_source)

    def detect(self, first: Layer, second: Layer, rule: BlendRule) -> GhostSuppression | None:
        """The suppression, given both layers as :meth:`downsample` returns them; None without ghosts."""
        if self._light_radius < MAX_DISPLACEMENT_CELLS:
            return None
        cells_a, cells_b, count, coverage = self._cell_means(first, second)
        differs = self._different_cells(cells_a, cells_b, count)
        if not is_any(differs):
            return None
        preference = self._log_weight_ratio(cells_a, cells_b, rule, differs) + COVERAGE_LOG_WEIGHT * coverage
        return GhostSuppression(region_winners(differs, preference), self.cell_size)

    @property
    def _light_radius(self) -> int:
        """Of the box filter that estimates the common difference; it has to fit into the grid."""
        return min(ILLUMINATION_RADIUS, *(count // 2 - 1 for count in self.grid))

    def _cell_means(self, first: Layer, second: Layer) -> tuple[LayerArrays, LayerArrays, Array, Array]:
        """Means by cell of both layers, of what both see; how many pixels; what share the first sees more."""
        (a, a_rho), (b, b_rho) = ((layer.colour, layer.inverse_depth) for layer in (first, second))
        if is_numpy_array(a):
            sums = np.empty((*self.grid, 13), np.float32)
            accumulate = partial(accumulate_cells, a, a_rho, b, b_rho, self.samples_per_side, sums)
            run_ranges(accumulate, self.grid[0], self.threads)
        else:
            sums = self._accumulate_arrays(a, a_rho, b, b_rho)
        xp, count = array_namespace(sums), sums[..., 0]
        share = 1.0 / xp.clip(count, min=1.0)
        offsets = (xp.asarray(layer.target_from_source.position, dtype=sums.dtype, device=device(sums))
                   for layer in (first, second))  # fmt: skip
        means = [
            LayerArrays(
                sums[..., k : k + 3] * share[..., None], sums[..., k + 3] * share, sums[..., rho] * share, offset
            )
            for k, rho, offset in zip((1, 5), (9, 10), offsets, strict=True)
        ]
        only_first, only_second = sums[..., 11], sums[..., 12]
        return *means, count, (only_first - only_second) / xp.clip(count + only_first + only_second, min=1.0)

    def _accumulate_arrays(self, first: Array, first_rho: Array, second: Array, second_rho: Array) -> Array:
        """:func:`omnisyn_cli.fusion.ghost_kernels.accumulate_cells` by arrays."""
        xp, (rows, cols) = array_namespace(first), (count * self.samples_per_side for count in self.grid)
        seen_a, seen_b = (colour[..., 3:] > float(MIN_VISIBLE_WEIGHT) for colour in (first, second))
        rhos = xp.clip(xp.stack([first_rho, second_rho], axis=-1), min=0.0)
        values = xp.concat([xp.ones_like(rhos[..., :1]), first, second, rhos], axis=-1)
        values = xp.where(seen_a & seen_b, values, xp.zeros_like(values))
        alone = (xp.astype(one & ~other, values.dtype) for one, other in ((seen_a, seen_b), (seen_b, seen_a)))
        values = xp.concat([values, *alone], axis=-1)
        padded = xp.zeros((rows, cols, values.shape[-1]), dtype=values.dtype, device=device(values))
        padded[: values.shape[0], : values.shape[1]] = values
        side = self.samples_per_side
        return xp.sum(padded.reshape(self.grid[0], side, self.grid[1], side, -1), axis=(1, 3))

    def _different_cells(self, first: LayerArrays, second: LayerArrays, count: Array) -> Bool[Array, "rows cols"]:
        """Cells that show different things: steps 1 to 3 of the module's list."""
        xp = array_namespace(count)
        difference = first.colour - second.colour
        # The common difference, weighted by how many pixels of each cell both layers see.
        weighted = xp.concat([difference * count[..., None], count[..., None]], axis=-1)
        means = box_filter(weighted, self._light_radius, mirror_poles=True)
        relit = second.colour + means[..., :3] / xp.clip(means[..., 3:], min=1e-6)
        threshold, seen = MIN_GHOST_DIFFERENCE, count > 0.0
        # The plain test as well: beside a large moving thing, relighting alone makes unchanged cells differ.
        differs = seen & (_channel_max(xp.abs(difference)) > threshold)
        differs &= _channel_max(xp.abs(first.colour - relit)) > threshold
        outside = xp.maximum(
            _colour_range_excess(first.colour, relit, seen), _colour_range_excess(relit, first.colour, seen)
        )
        differs &= outside > MIN_OUTSIDE_RANGE
        # Opening: erosion by 1 cell drops thin structures. Dilation by 2 gives back that cell, and one cell of margin.
        rest = dilate(xp.astype(~differs, xp.int32), 1)
        return dilate(1 - rest, 2) > 0

    def _log_weight_ratio(
        self, first: LayerArrays, second: LayerArrays, rule: BlendRule, wanted: Bool[Array, "rows cols"]
    ) -> Float32[Array, "rows cols"]:
        """log(weight of the first / of the second) in the blend of the wanted cells, which are few; else 0."""
        xp, cells = array_namespace(wanted), array_namespace(wanted).nonzero(wanted)
        directions = xp.asarray(self._directions, device=device(wanted))[cells]
        inside = replace(rule, t=min(max(rule.t, MIN_PATH_POSITION), 1.0 - MIN_PATH_POSITION))
        a, b = view_weights(_take_cells(first, cells), _take_cells(second, cells), directions, inside)
        is_known, one = (a > 0.0) & (b > 0.0), xp.ones_like(a)
        preference = xp.zeros_like(first.weight)
        preference[cells] = xp.log(xp.where(is_known, a, one)) - xp.log(xp.where(is_known, b, one))
        return preference


def _take_cells(layer: LayerArrays, cells: tuple[Array, ...]) -> LayerArrays:
    return LayerArrays(layer.colour[cells], layer.weight[cells], layer.inverse_depth[cells], layer.offset)


def is_any(mask: Bool[Array, "rows cols"]) -> bool:
    """Whether any element is set; on a device this waits for the result."""
    return bool(mask.any())


def have_same_position(first: Layer, second: Layer) -> bool:
    """Whether both views were taken from one place. Then the frame is a cross-fade, and nothing is a ghost."""
    return at_same_position(first.target_from_source, second.target_from_source)


def _neighbour_cells(pixel: Integer[Array, " pixels"], cell_size: int) -> tuple[Array, Array, Array]:
    """The two cells between whose centres a pixel centre lies, and its fraction of the way between them."""
    xp = array_namespace(pixel)
    position = (xp.astype(pixel, xp.float32) + 0.5) / cell_size - 0.5
    floor = xp.floor(position)
    index = xp.astype(floor, xp.int64)
    return index, index + 1, position - floor


def _colour_range_excess(one: Array, other: Array, seen: Bool[Array, "rows cols"]) -> Float32[Array, "rows cols"]:
    """How far the colours of one layer lie outside of the other layer's range in the cells around."""
    xp = array_namespace(one)
    unseen, known = xp.full_like(other, -UNSEEN_COLOUR), seen[..., None]
    highest = dilate(xp.where(known, other, unseen), MAX_DISPLACEMENT_CELLS)
    lowest = -dilate(xp.where(known, -other, unseen), MAX_DISPLACEMENT_CELLS)
    return _channel_max(xp.maximum(one - highest, lowest - one))


def _channel_max(values: Float32[Array, "rows cols 3"]) -> Float32[Array, "rows cols"]:
    """Maximum of three channels; numpy's own maximum over so short an axis takes ten times as long."""
    xp = array_namespace(values)
    return xp.maximum(xp.maximum(values[..., 0], values[..., 1]), values[..., 2])


def region_winners(
    differs: Bool[Array, "rows cols"], preference: Float32[Array, "rows cols"]
) -> Float32[Array, "rows cols"]:
    """By cell: 1 in regions where the first layer wins by the cells' votes, −1 where the second does, 0 elsewhere."""
    xp, labels = array_namespace(preference), label_regions(differs).reshape(-1)
    votes = xp.astype(xp.round(preference * VOTE_STEPS), xp.float64)
    sums = xp.bincount(labels, votes.reshape(-1))
    wins = xp.take(sums, labels, axis=0).reshape(differs.shape) >= 0.0
    return xp.astype(differs, preference.dtype) * (2.0 * xp.astype(wins, preference.dtype) - 1.0)


def label_regions(differs: Bool[Array, "rows cols"]) -> Integer[Array, "rows cols"]:
    """A label > 0 per 8-connected region, over the seam; on devices spread by pointer jumping, in few steps."""
    if is_numpy_array(differs):
        return connected_regions(differs, is_diagonal=True)
    xp = array_namespace(differs)
    inside = xp.astype(differs, xp.int64)
    count = inside.shape[0] * inside.shape[1]
    labels = inside * xp.arange(1, count + 1, device=device(differs)).reshape(inside.shape)
    while True:
        before = labels
        for _ in range(LABEL_STEPS_PER_CHECK):
            labels = dilate(labels, 1) * inside
            named = xp.take(labels.reshape(-1), xp.clip(labels - 1, min=0).reshape(-1), axis=0)
            labels = named.reshape(inside.shape) * inside
        if not is_any(before != labels):
            return labels
