"""Semi-global matching along meridians, of the disparities that are in question at each pixel.

Rows are polar angles of a frame whose zenith is the epipole, so a match lies in the same column, ``disparity`` rows
further down. Columns wrap, which makes every diagonal path as long as a meridian and all of them independent.

Each pixel has a band of disparities. Bands begin and end at different ones, so a path from pixel to pixel goes on at
the same disparity, not at the same place in the band. All numbers lie in one flat array, pixel after pixel. They are
whole, of 16 bits (:data:`PARTS`), of which a processor adds and compares sixteen at once.

Source: Hirschmüller, Stereo processing by semi-global matching and mutual information, 2008; bands: Rothermel et al.,
SURE: photogrammetric surface reconstruction from imagery, 2012 (tSGM).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float, Float32, Int32, Int64, UInt16

from omnisyn_cli.compute.jit import fast_kernel, inlined
from omnisyn_cli.compute.threads import run_bands

RUN_UP = 64
"""Columns that a horizontal path walks before the seam, so that the seam is no border."""

PARTS = 1024
"""Of 1 that costs are counted in."""

MOST_COST, MOST_JUMP = 4.0, 3.0
"""The largest cost and the largest penalty: the sum over eight paths of both, in parts, fits into 16 bits."""

FAR = np.uint16(60000)
"""Dearer than any path, and a penalty more is no overflow."""

ENDLESS = np.uint16(65535)

APART = 3
"""Rows: what lies closer to a disparity is no rival of it."""

SIDE_BY_SIDE = 32
"""Paths that walk together: what they read of a row lies side by side."""

AROUND, ONE = np.uint64(2), np.uint64(1)
"""Numbers around a path, beyond every band; and the next one."""


@dataclass(frozen=True)
class Bands:
    """The disparities that are tried for every pixel.

    Attributes:
        lowest: rows, >= 0: the first one.
        begin: index in the flat arrays of each pixel's first number, and the length of the arrays.
    """

    lowest: Int32[np.ndarray, "height width"]
    begin: Int64[np.ndarray, " pixels+1"]

    @staticmethod
    def between(lowest: Int32[np.ndarray, "height width"], highest: Int32[np.ndarray, "height width"] | int) -> Bands:
        """All whole rows from ``lowest`` to ``highest``, which is never the smaller one."""
        begin = np.zeros(lowest.size + 1, np.int64)
        np.cumsum((highest - lowest + 1).ravel(), out=begin[1:])
        return Bands(lowest, begin)


def counted(cost: Float[np.ndarray, "*numbers"]) -> UInt16[np.ndarray, "*numbers"]:
    """Costs >= 0 in parts; what is larger than :data:`MOST_COST` becomes that."""
    return np.asarray(np.rint(np.minimum(cost, MOST_COST) * PARTS), np.uint16)


def aggregate(
    cost: UInt16[np.ndarray, " numbers"],
    bands: Bands,
    luminance: Float[np.ndarray, "height width"],
    step: float,
    jump: float,
    contrast: float,
) -> UInt16[np.ndarray, " numbers"]:
    """The sum over eight path directions of the cheapest way to each pixel and disparity, in parts.

    Args:
        cost: matching cost in parts, at most :data:`MOST_COST`.
        bands: what the numbers belong to; or labels without an order, the same ones everywhere.
        luminance: a jump is cheaper by ``1 / (1 + |difference| / contrast)`` across an edge.
        step: penalty for neighbouring disparities; labels without an order have that of a jump.
        jump: penalty for any other change, at most :data:`MOST_JUMP`.
        contrast: grey difference at which a jump costs half.
    """
    height, width = luminance.shape
    small, large = (round(PARTS * min(penalty, jump, MOST_JUMP)) for penalty in (step, jump))
    penalties = np.uint16(small), np.float32(large), np.float32(1.0 / contrast)
    total, longest = np.zeros(len(cost), np.uint16), int(np.diff(bands.begin).max())
    room = (cost, bands.lowest, bands.begin, luminance, *penalties, longest, total)
    for lean in (-1, 0, 1):
        for is_down in (True, False):
            run_bands(partial(_aggregate_along, *room, lean, is_down), -(-width // SIDE_BY_SIDE))
    run_bands(partial(_aggregate_across, *room), height)
    return total


def choose(
    total: UInt16[np.ndarray, " numbers"], bands: Bands, *, is_all: bool
) -> tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]:
    """The cheapest disparity of every pixel to a fraction, and by how much its best rival is dearer (0 = a tie).

    Args:
        total: in parts, from :func:`aggregate`.
        bands: what the numbers belong to.
        is_all: whether nothing exists beyond the bands; else the margin is 0 where the cheapest one is at an end.
    """
    disparity, margin = np.empty(bands.lowest.shape, np.float32), np.zeros(bands.lowest.shape, np.float32)
    run_bands(partial(_choose, total, bands.lowest, bands.begin, is_all, disparity, margin), len(disparity))
    return disparity, margin


def lead(
    cost: UInt16[np.ndarray, " numbers"], bands: Bands, disparity: Float32[np.ndarray, "height width"]
) -> Float32[np.ndarray, "height width"]:
    """By how much a disparity is cheaper than all that are more than :data:`APART` from it, paths left aside.

    Near 0 where things repeat, however sure a path is of one of them; less than 0 where a path decided against costs.

    Args:
        cost: in parts, before aggregation.
        bands: what the numbers belong to.
        disparity: one of each pixel's.
    """
    out = np.empty(disparity.shape, np.float32)
    run_bands(partial(_lead, cost, bands.lowest, bands.begin, disparity, out), len(out))
    return out


@fast_kernel()
def _aggregate_along(  # type: ignore[no-untyped-def]
    cost, lowest, starts, luminance, small, large, scale, longest, total, lean, is_down, begin, end
):
    """Of paths along meridians, or ``lean`` columns aside with every row, those of some groups side by side."""
    height, width = lowest.shape
    paths, cheapest = np.empty((2 * SIDE_BY_SIDE, longest + 2 * AROUND), np.uint16), np.empty(SIDE_BY_SIDE, np.uint16)
    for group in range(begin, end):
        _begin_paths(paths)
        cheapest[:] = 0
        for k in range(height):
            row, before = (k, max(k - 1, 0)) if is_down else (height - 1 - k, height - 1 - max(k - 1, 0))
            for i in range(min(SIDE_BY_SIDE, width - group * SIDE_BY_SIDE)):
                origin = group * SIDE_BY_SIDE + i
                col, col_before = (origin + lean * k) % width, (origin + lean * max(k - 1, 0)) % width
                at, last = row * width + col, before * width + col_before
                leap = _leap(luminance[row, col] - luminance[before, col_before], large, scale)
                behind, ahead = paths[2 * i + (k + 1) % 2], paths[2 * i + k % 2]
                own, sums = cost[starts[at] : starts[at + 1]], total[starts[at] : starts[at + 1]]
                shift, reach = lowest[row, col] - lowest[before, col_before], starts[last + 1] - starts[last]
                cheapest[i] = _walk(own, behind, reach, ahead, shift, leap, cheapest[i], small, sums)


@fast_kernel()
def _aggregate_across(  # type: ignore[no-untyped-def]
    cost, lowest, starts, luminance, small, large, scale, longest, total, begin, end
):
    """Of paths along some rows, both ways."""
    width = lowest.shape[1]
    paths, nowhere = np.empty((2, longest + 2 * AROUND), np.uint16), np.zeros(longest, np.uint16)
    for row in range(begin, end):
        for side in range(2):
            cheap, before = np.uint16(0), (-RUN_UP if side == 0 else width - 1 + RUN_UP) % width
            _begin_paths(paths)
            for k in range(-RUN_UP, width):
                col = (k if side == 0 else width - 1 - k) % width
                at, last = row * width + col, row * width + before
                leap = _leap(luminance[row, col] - luminance[row, before], large, scale)
                behind, ahead = paths[(k + 1) % 2], paths[k % 2]
                own = cost[starts[at] : starts[at + 1]]
                sums = total[starts[at] : starts[at + 1]] if k >= 0 else nowhere[: len(own)]
                shift, reach = lowest[row, col] - lowest[row, before], starts[last + 1] - starts[last]
                cheap = _walk(own, behind, reach, ahead, shift, leap, cheap, small, sums)
                before = col


@inlined()
def _begin_paths(paths):  # type: ignore[no-untyped-def]
    """They have cost nothing so far; beyond both ends of the longest band there are none."""
    paths[:] = FAR
    paths[:, AROUND:-AROUND] = 0


@inlined()
def _leap(difference, large, scale):  # type: ignore[no-untyped-def]
    """What a jump costs between pixels of which one is so much brighter."""
    return np.uint16(large / (np.float32(1.0) + abs(difference) * scale) + np.float32(0.5))


@inlined()
def _walk(cost, behind, reach, ahead, shift, leap, cheapest, small, sums):  # type: ignore[no-untyped-def]
    """One step of a path into a band that begins ``shift`` disparities after the one that it leaves; its least cost.

    ``behind``, of ``reach`` numbers, and ``ahead`` have :data:`AROUND` more at both ends; what is ahead is added to
    ``sums``. All loops are of vectors: indices without a sign need no look at whether they count from the end, and what
    is found is brought back to 16 bits at once, so that it never needs more.
    """
    count, lowest, leaping = len(cost), FAR, np.uint16(cheapest + leap)
    first = min(max(0, -1 - shift), count)
    last = max(first, min(count, reach + 1 - shift))
    for k in range(np.uint64(first)):
        value = np.uint16(cost[k] + leap)
        ahead[k + AROUND], sums[k], lowest = value, np.uint16(sums[k] + value), _less(lowest, value)
    for k in range(np.uint64(last), np.uint64(count)):
        value = np.uint16(cost[k] + leap)
        ahead[k + AROUND], sums[k], lowest = value, np.uint16(sums[k] + value), _less(lowest, value)
    begin, source = np.uint64(first), np.uint64(first + shift + 1)
    for k in range(np.uint64(last - first)):  # the disparity itself is between its neighbours
        at, to = source + k, begin + k
        best = _less(_less(behind[at + ONE], leaping), np.uint16(_less(behind[at], behind[at + AROUND]) + small))
        value = np.uint16(np.uint16(cost[to] + best) - cheapest)
        ahead[to + AROUND], sums[to], lowest = value, np.uint16(sums[to] + value), _less(lowest, value)
    end = np.uint64(count) + AROUND
    ahead[end] = ahead[end + ONE] = FAR
    return lowest


@inlined()
def _less(one, other):  # type: ignore[no-untyped-def]
    """The lesser one; numba's ``min`` widens it."""
    return one if one < other else other


@fast_kernel()
def _choose(total, lowest, starts, is_all, disparity, margin, begin, end):  # type: ignore[no-untyped-def]
    width = lowest.shape[1]
    for row in range(begin, end):
        for col in range(width):
            at = row * width + col
            score = total[starts[at] : starts[at + 1]]
            nothing, count, best = np.uint64(0), np.uint64(len(score)), 0
            lowest_score = _least(score, nothing, count)
            while score[best] > lowest_score:
                best += 1
            disparity[row, col] = lowest[row, col] + best
            is_inside = 0 < best < len(score) - 1
            if is_inside:
                left, right = np.float32(score[best - 1] - lowest_score), np.float32(score[best + 1] - lowest_score)
                disparity[row, col] += np.float32(0.5) * (left - right) / (max(left, right) + np.float32(1e-6))
            if is_inside or is_all:
                before, after = np.uint64(max(best - 1, 0)), np.uint64(min(best + 2, len(score)))
                rival = _less(_least(score, nothing, before), _least(score, after, count))
                margin[row, col] = np.float32(rival - lowest_score) * np.float32(1.0 / PARTS)


@fast_kernel()
def _lead(cost, lowest, starts, disparity, out, begin, end):  # type: ignore[no-untyped-def]
    width = lowest.shape[1]
    for row in range(begin, end):
        for col in range(width):
            at = row * width + col
            own, nothing, count = cost[starts[at] : starts[at + 1]], np.uint64(0), starts[at + 1] - starts[at]
            best = min(max(int(np.rint(disparity[row, col])) - lowest[row, col], 0), count - 1)
            below, above = np.uint64(max(best - APART, 0)), np.uint64(min(best + APART + 1, count))
            cheapest = _least(own, np.uint64(max(best - 1, 0)), np.uint64(min(best + 2, count)))
            rival = _less(_least(own, nothing, below), _least(own, above, np.uint64(count)))
            out[row, col] = (np.float32(rival) - np.float32(cheapest)) * np.float32(1.0 / PARTS)


@inlined()
def _least(numbers, begin, end):  # type: ignore[no-untyped-def]
    """The smallest number from ``begin`` to ``end``; :data:`ENDLESS` if there is none."""
    lowest = ENDLESS
    for k in range(begin, end):
        lowest = _less(lowest, numbers[k])
    return lowest
