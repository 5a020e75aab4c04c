"""Semi-global matching along meridians, over a range of disparities of its own at each pixel.

Rows are polar angles of a frame whose zenith is the epipole, so a match lies in the same column, ``disparity`` rows
further down. Columns wrap, which makes every diagonal path as long as a meridian and all paths independent.

Ranges of neighbouring pixels begin and end at different disparities. A path therefore goes on at the same disparity,
not at the same index of the range. All costs lie in one flat array, pixel after pixel. They are fixed-point numbers of
16 bits (:data:`FIXED_POINT_SCALE`), because a processor adds and compares sixteen of these at once.

Source: Hirschmüller, Stereo processing by semi-global matching and mutual information, 2008; ranges per pixel:
Rothermel et al., SURE: photogrammetric surface reconstruction from imagery, 2012 (tSGM).
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int32, Int64, UInt16

from omnisyn_cli.compute.arrays import empty, zeros
from omnisyn_cli.compute.jit import fast_kernel, inlined
from omnisyn_cli.compute.threads import run_ranges

# Columns that a horizontal path walks before it counts, so that the seam is no border; chosen by eye.
SEAM_WARM_UP_COLUMNS = 64
# Fixed-point steps per unit of cost. The sum of eight paths of the largest cost and penalty still fits 16 bits.
FIXED_POINT_SCALE = 1024
# The largest cost and the largest penalty: 8 · (4 + 3) · 1024 = 57,344 is below :data:`UNREACHABLE_COST`.
MAX_COST, MAX_P2 = 4.0, 3.0
# Path cost outside of a range: above every real path, and adding P2 does not overflow 16 bits.
UNREACHABLE_COST = np.uint16(60000)
IMPOSSIBLE_COST = np.uint16(65535)  # the greatest number of 16 bits: what must never be selected
RIVAL_MIN_ROWS = 3  # disparities at most this many rows away are the same match, not rivals of it; chosen by eye

# Paths that walk together: what they read of a row lies side by side in memory. (Measured: 2.4 to 3.5 times as fast,
# together with vectorised loops.)
PATHS_PER_GROUP = 32
# Entries of :data:`UNREACHABLE_COST` before and after a path's costs, so that neighbours need no bounds check.
PATH_PADDING = np.uint64(2)
# Typed, because an index without a sign is not tested for counting from the end, so its loop vectorises.
INDEX_ONE, INDEX_TWO = np.uint64(1), np.uint64(2)


@dataclass(frozen=True)
class DisparityRange:
    """The disparities that are tried at every pixel."""

    lowest: Int32[np.ndarray, "height width"]  # rows, >= 0: the first disparity of each pixel
    # index of each pixel's first cost in the flat arrays, row after row; last, the length of the arrays
    offsets: Int64[np.ndarray, " pixels+1"]

    @staticmethod
    def from_bounds(
        lowest: Int32[np.ndarray, "height width"], highest: Int32[np.ndarray, "height width"] | int
    ) -> "DisparityRange":
        """All whole rows from ``lowest`` to ``highest`` (included), which is never the smaller one."""
        offsets = np.zeros(lowest.size + 1, np.int64)
        np.cumsum((highest - lowest + 1).ravel(), out=offsets[1:])
        return DisparityRange(lowest, offsets)


class PathInputs(NamedTuple):
    """What all paths read."""

    # matching costs, flat, fixed-point; see :class:`DisparityRange`
    cost: UInt16[np.ndarray, " costs"]
    lowest: Int32[np.ndarray, "height width"]
    offsets: Int64[np.ndarray, " pixels+1"]
    luminance: Float[np.ndarray, "height width"]  # weakens P2 at edges
    # penalties for a change of disparity by one and for any other change, fixed-point
    p1: np.uint16
    p2: np.float32
    inverse_contrast: np.float32  # 1 / the grey difference that halves P2
    longest_range: int  # disparities of the longest range


def to_fixed_point(cost: Float[np.ndarray, "*costs"]) -> UInt16[np.ndarray, "*costs"]:
    """Costs >= 0 in steps of 1 / :data:`FIXED_POINT_SCALE`, clipped to :data:`MAX_COST`."""
    return np.asarray(np.rint(np.minimum(cost, MAX_COST) * FIXED_POINT_SCALE), np.uint16)


def aggregate_costs(
    cost: UInt16[np.ndarray, " costs"], disparities: DisparityRange, luminance: Float[np.ndarray, "height width"],
    p1: float, p2: float, p2_contrast: float,
) -> UInt16[np.ndarray, " costs"]:  # fmt: skip
    """The sum over eight path directions of the cheapest way to each pixel and disparity, fixed-point as the costs.

    A change to a neighbouring disparity costs ``p1``, any other one ``p2``, at most :data:`MAX_P2` and divided by
    ``1 + |difference of luminance| / p2_contrast``. Labels without an order, the same ones everywhere, have equal ones.
    """
    height, width = luminance.shape
    fixed_p1, fixed_p2 = (round(FIXED_POINT_SCALE * min(penalty, p2, MAX_P2)) for penalty in (p1, p2))
    inputs = PathInputs(
        cost, disparities.lowest, disparities.offsets, luminance, np.uint16(fixed_p1), np.float32(fixed_p2),
        np.float32(1.0 / p2_contrast), int(np.diff(disparities.offsets).max()),
    )  # fmt: skip
    total = np.zeros(len(cost), np.uint16)
    for slope in (-1, 0, 1):
        for is_down in (True, False):
            run_ranges(partial(_aggregate_columns, inputs, total, slope, is_down), -(-width // PATHS_PER_GROUP))
    run_ranges(partial(_aggregate_rows, inputs, total), height)
    return total


def winner_takes_all(
    total: UInt16[np.ndarray, " costs"], disparities: DisparityRange, *, is_complete_range: bool
) -> tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]:
    """The cheapest disparity of every pixel to a fraction of a row, and its margin over the best rival (0 = a tie).

    ``total`` are aggregated costs, fixed-point. Unless nothing exists outside of the ranges (``is_complete_range``), a
    winner at the end of its range has margin 0, because the true one may lie beyond.
    """
    shape = disparities.lowest.shape
    disparity, margin = np.empty(shape, np.float32), np.zeros(shape, np.float32)
    inputs = (total, disparities.lowest, disparities.offsets, is_complete_range)
    run_ranges(partial(_select_winners, *inputs, disparity, margin), len(disparity))
    return disparity, margin


def uniqueness_margin(
    cost: UInt16[np.ndarray, " costs"], disparities: DisparityRange, disparity: Float32[np.ndarray, "height width"]
) -> Float32[np.ndarray, "height width"]:
    """By how much a disparity is cheaper than all that are more than :data:`RIVAL_MIN_ROWS` away, before aggregation.

    Near 0 on repeating patterns, however clearly the paths prefer one repetition. Below 0 where the paths overruled the
    pixel's own cost. Costs are fixed-point; ``disparity`` is one of each pixel's.
    """
    out = np.empty(disparity.shape, np.float32)
    run_ranges(partial(_measure_uniqueness, cost, disparities.lowest, disparities.offsets, disparity, out), len(out))
    return out


@fast_kernel()
def _aggregate_columns(inputs, total, slope, is_down, begin, end):  # type: ignore[no-untyped-def]
    """Adds up paths along meridians (``slope`` 0) or diagonals (``slope`` columns per row), some groups of columns."""
    height, width = inputs.lowest.shape
    offsets, lowest, luminance = inputs.offsets, inputs.lowest, inputs.luminance
    paths = empty((2 * PATHS_PER_GROUP, inputs.longest_range + 2 * PATH_PADDING), np.uint16)
    cheapest = empty(PATHS_PER_GROUP, np.uint16)
    for group in range(begin, end):
        _reset_paths(paths)
        cheapest[:] = 0
        for k in range(height):
            row, row_before = (k, max(k - 1, 0)) if is_down else (height - 1 - k, height - 1 - max(k - 1, 0))
            for i in range(min(PATHS_PER_GROUP, width - group * PATHS_PER_GROUP)):
                origin = group * PATHS_PER_GROUP + i
                col, col_before = (origin + slope * k) % width, (origin + slope * max(k - 1, 0)) % width
                here, before = row * width + col, row_before * width + col_before
                edge = luminance[row, col] - luminance[row_before, col_before]
                p2 = _adaptive_p2(edge, inputs.p2, inputs.inverse_contrast)
                previous, current = paths[2 * i + (k + 1) % 2], paths[2 * i + k % 2]  # each path has two buffers
                cost = inputs.cost[offsets[here] : offsets[here + 1]]
                sums = total[offsets[here] : offsets[here + 1]]
                shift, length = lowest[row, col] - lowest[row_before, col_before], offsets[before + 1] - offsets[before]
                cheapest[i] = _extend_path(cost, previous, length, current, shift, inputs.p1, p2, cheapest[i], sums)


@fast_kernel()
def _aggregate_rows(inputs, total, begin, end):  # type: ignore[no-untyped-def]
    """Adds up paths along some rows, both ways."""
    width = inputs.lowest.shape[1]
    offsets, lowest, luminance = inputs.offsets, inputs.lowest, inputs.luminance
    paths = empty((2, inputs.longest_range + 2 * PATH_PADDING), np.uint16)
    unused_sums = zeros(inputs.longest_range, np.uint16)
    for row in range(begin, end):
        for side in range(2):
            warm_up = SEAM_WARM_UP_COLUMNS
            cheapest, col_before = np.uint16(0), (-warm_up if side == 0 else width - 1 + warm_up) % width
            _reset_paths(paths)
            for k in range(-warm_up, width):
                col = (k if side == 0 else width - 1 - k) % width
                here, before = row * width + col, row * width + col_before
                edge = luminance[row, col] - luminance[row, col_before]
                p2 = _adaptive_p2(edge, inputs.p2, inputs.inverse_contrast)
                previous, current = paths[(k + 1) % 2], paths[k % 2]
                cost = inputs.cost[offsets[here] : offsets[here + 1]]
                sums = total[offsets[here] : offsets[here + 1]] if k >= 0 else unused_sums[: len(cost)]
                shift, length = lowest[row, col] - lowest[row, col_before], offsets[before + 1] - offsets[before]
                cheapest = _extend_path(cost, previous, length, current, shift, inputs.p1, p2, cheapest, sums)
                col_before = col


@inlined()
def _reset_paths(paths):  # type: ignore[no-untyped-def]
    """Paths begin with cost 0; the padding on both sides stays unreachable."""
    paths[:] = UNREACHABLE_COST
    paths[:, PATH_PADDING:-PATH_PADDING] = 0


@inlined()
def _adaptive_p2(edge, p2, inverse_contrast):  # type: ignore[no-untyped-def]
    """P2 across a luminance difference, rounded to fixed-point: depth jumps are likelier at edges of the image."""
    return np.uint16(p2 / (np.float32(1.0) + abs(edge) * inverse_contrast) + np.float32(0.5))


@inlined()
def _extend_path(cost, previous, length, current, shift, p1, p2, cheapest, sums):  # type: ignore[no-untyped-def]
    """One step of a path to the next pixel, whose first disparity is ``shift`` more; returns the least path cost there.

    ``previous`` has the ``length`` path costs at the pixel before, between two paddings; ``current`` gets those at this
    one, and ``sums`` has them added. A change by one costs ``p1``, any other one ``p2``. The least path cost before,
    ``cheapest``, is subtracted, so that costs stay bounded.

    All loops vectorise: indices are unsigned, and results are cut back to 16 bits at once, so that none needs more.
    """
    count, least, large_step = len(cost), UNREACHABLE_COST, np.uint16(cheapest + p2)
    # Disparities from `first` to `last` have a neighbour in the range before; others are only reached by a large step.
    first = min(max(0, -1 - shift), count)
    last = max(first, min(count, length + 1 - shift))
    for k in range(np.uint64(first)):
        value = np.uint16(cost[k] + p2)  # a large step costs `cheapest + p2`, less the `cheapest` that is subtracted
        current[k + INDEX_TWO], sums[k], least = value, np.uint16(sums[k] + value), _smaller(least, value)
    for k in range(np.uint64(last), np.uint64(count)):
        value = np.uint16(cost[k] + p2)
        current[k + INDEX_TWO], sums[k], least = value, np.uint16(sums[k] + value), _smaller(least, value)
    begin, source = np.uint64(first), np.uint64(first + shift + 1)
    for k in range(np.uint64(last - first)):
        below, to = source + k, begin + k  # in `previous`, `below` is one row less, `below + ONE` the same disparity
        step = np.uint16(_smaller(previous[below], previous[below + INDEX_TWO]) + p1)
        best = _smaller(_smaller(previous[below + INDEX_ONE], large_step), step)
        value = np.uint16(np.uint16(cost[to] + best) - cheapest)
        current[to + INDEX_TWO], sums[to], least = value, np.uint16(sums[to] + value), _smaller(least, value)
    end = np.uint64(count) + PATH_PADDING
    current[end] = current[end + INDEX_ONE] = UNREACHABLE_COST  # the buffer may hold a longer range from before
    return least


@inlined()
def _smaller(one, other):  # type: ignore[no-untyped-def]
    """The smaller of two; numba's ``min`` would widen it."""
    return one if one < other else other


@fast_kernel()
def _select_winners(total, lowest, offsets, is_complete_range, disparity, margin, begin, end):  # type: ignore[no-untyped-def]
    width = lowest.shape[1]
    for row in range(begin, end):
        for col in range(width):
            at = row * width + col
            costs = total[offsets[at] : offsets[at + 1]]
            zero, count, best = np.uint64(0), np.uint64(len(costs)), 0
            least = _range_min(costs, zero, count)
            while costs[best] > least:
                best += 1
            disparity[row, col] = lowest[row, col] + best
            is_inside = 0 < best < len(costs) - 1
            if is_inside:  # equiangular fit: the tip of a V with equal slopes through three costs
                left, right = np.float32(costs[best - 1] - least), np.float32(costs[best + 1] - least)
                disparity[row, col] += np.float32(0.5) * (left - right) / (max(left, right) + np.float32(1e-6))
            if is_inside or is_complete_range:
                before, after = np.uint64(max(best - 1, 0)), np.uint64(min(best + 2, len(costs)))
                rival = _smaller(_range_min(costs, zero, before), _range_min(costs, after, count))
                margin[row, col] = np.float32(rival - least) * np.float32(1.0 / FIXED_POINT_SCALE)


@fast_kernel()
def _measure_uniqueness(cost, lowest, offsets, disparity, out, begin, end):  # type: ignore[no-untyped-def]
    width = lowest.shape[1]
    for row in range(begin, end):
        for col in range(width):
            at = row * width + col
            costs, zero, count = cost[offsets[at] : offsets[at + 1]], np.uint64(0), offsets[at + 1] - offsets[at]
            best = min(max(int(np.rint(disparity[row, col])) - lowest[row, col], 0), count - 1)
            before = np.uint64(max(best - RIVAL_MIN_ROWS, 0))
            after = np.uint64(min(best + RIVAL_MIN_ROWS + 1, count))
            own = _range_min(costs, np.uint64(max(best - 1, 0)), np.uint64(min(best + 2, count)))
            rival = _smaller(_range_min(costs, zero, before), _range_min(costs, after, np.uint64(count)))
            out[row, col] = (np.float32(rival) - np.float32(own)) * np.float32(1.0 / FIXED_POINT_SCALE)


@inlined()
def _range_min(costs, begin, end):  # type: ignore[no-untyped-def]
    """The smallest of the costs from ``begin`` to ``end``; :data:`IMPOSSIBLE_COST` if there are none."""
    least = IMPOSSIBLE_COST
    for k in range(begin, end):
        least = _smaller(least, costs[k])
    return least
