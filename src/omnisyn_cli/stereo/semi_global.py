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

import numba
import numpy as np
from jaxtyping import Float, Float32, Int32, Int64, UInt16

from omnisyn_cli.runtime.jit import parallel_kernel

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
    penalties = (float(round(PARTS * min(penalty, jump, MOST_JUMP))) for penalty in (step, jump))
    return np.asarray(_aggregate(cost, bands.lowest, bands.begin, luminance, *penalties, contrast))


def choose(
    total: UInt16[np.ndarray, " numbers"], bands: Bands, *, is_all: bool
) -> tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]:
    """The cheapest disparity of every pixel to a fraction, and by how much its best rival is dearer (0 = a tie).

    Args:
        total: in parts, from :func:`aggregate`.
        bands: what the numbers belong to.
        is_all: whether nothing exists beyond the bands; else the margin is 0 where the cheapest one is at an end.
    """
    disparity, margin = _choose(total, bands.lowest, bands.begin, is_all)
    return np.asarray(disparity), np.asarray(margin)


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
    return np.asarray(_lead(cost, bands.lowest, bands.begin, disparity))


@parallel_kernel(fastmath=True)
def _aggregate(cost, lowest, begin, luminance, step, jump, contrast):  # type: ignore[no-untyped-def]
    height, width = lowest.shape
    total = np.zeros(len(cost), np.uint16)
    small, large, scale = np.uint16(step), np.float32(jump), np.float32(1.0 / contrast)
    longest = 0
    for pixel in range(height * width):
        longest = max(longest, begin[pixel + 1] - begin[pixel])
    for way in range(6):
        lean, down = way // 2 - 1, way % 2 == 0
        for group in numba.prange((width + SIDE_BY_SIDE - 1) // SIDE_BY_SIDE):
            paths, cheapest = _no_paths(2 * SIDE_BY_SIDE, longest), np.zeros(SIDE_BY_SIDE, np.uint16)
            for k in range(height):
                row, before = (k, max(k - 1, 0)) if down else (height - 1 - k, height - 1 - max(k - 1, 0))
                for i in range(min(SIDE_BY_SIDE, width - group * SIDE_BY_SIDE)):
                    origin = group * SIDE_BY_SIDE + i
                    col, col_before = (origin + lean * k) % width, (origin + lean * max(k - 1, 0)) % width
                    at, last = row * width + col, before * width + col_before
                    leap = _leap(luminance[row, col] - luminance[before, col_before], large, scale)
                    behind, ahead = paths[2 * i + (k + 1) % 2], paths[2 * i + k % 2]
                    own, sums = cost[begin[at] : begin[at + 1]], total[begin[at] : begin[at + 1]]
                    shift, reach = lowest[row, col] - lowest[before, col_before], begin[last + 1] - begin[last]
                    cheapest[i] = _walk(own, behind, reach, ahead, shift, leap, cheapest[i], small, sums)
    for row in numba.prange(height):
        paths, nowhere = _no_paths(2, longest), np.zeros(longest, np.uint16)
        for side in range(2):
            cheap, before = np.uint16(0), (-RUN_UP if side == 0 else width - 1 + RUN_UP) % width
            paths[:, AROUND:-AROUND] = 0
            for k in range(-RUN_UP, width):
                col = (k if side == 0 else width - 1 - k) % width
                at, last = row * width + col, row * width + before
                leap = _leap(luminance[row, col] - luminance[row, before], large, scale)
                behind, ahead = paths[(k + 1) % 2], paths[k % 2]
                own = cost[begin[at] : begin[at + 1]]
                sums = total[begin[at] : begin[at + 1]] if k >= 0 else nowhere[: len(own)]
                shift, reach = lowest[row, col] - lowest[row, before], begin[last + 1] - begin[last]
                cheap = _walk(own, behind, reach, ahead, shift, leap, cheap, small, sums)
                before = col
    return total


@numba.njit(inline="always")
def _no_paths(count, longest):  # type: ignore[no-untyped-def]
    """Memory for costs of paths that begin: nothing so far, and beyond both ends of the longest band nothing at all."""
    paths = np.full((count, longest + 2 * AROUND), FAR, np.uint16)
    paths[:, AROUND:-AROUND] = 0
    return paths


@numba.njit(inline="always")
def _leap(difference, large, scale):  # type: ignore[no-untyped-def]
    """What a jump costs between pixels of which one is so much brighter."""
    return np.uint16(large / (np.float32(1.0) + abs(difference) * scale) + np.float32(0.5))


@numba.njit(inline="always")
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


@numba.njit(inline="always")
def _less(one, other):  # type: ignore[no-untyped-def]
    """The lesser one; numba's ``min`` widens it."""
    return one if one < other else other


@parallel_kernel(fastmath=True)
def _choose(total, lowest, begin, is_all):  # type: ignore[no-untyped-def]
    height, width = lowest.shape
    disparity, margin = np.empty((height, width), np.float32), np.zeros((height, width), np.float32)
    for row in numba.prange(height):
        for col in range(width):
            at = row * width + col
            score = total[begin[at] : begin[at + 1]]
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
    return disparity, margin


@parallel_kernel(fastmath=True)
def _lead(cost, lowest, begin, disparity):  # type: ignore[no-untyped-def]
    height, width = lowest.shape
    out = np.empty((height, width), np.float32)
    for row in numba.prange(height):
        for col in range(width):
            at = row * width + col
            own, nothing, count = cost[begin[at] : begin[at + 1]], np.uint64(0), begin[at + 1] - begin[at]
            best = min(max(int(np.rint(disparity[row, col])) - lowest[row, col], 0), count - 1)
            below, above = np.uint64(max(best - APART, 0)), np.uint64(min(best + APART + 1, count))
            cheapest = _least(own, np.uint64(max(best - 1, 0)), np.uint64(min(best + 2, count)))
            rival = _less(_least(own, nothing, below), _least(own, above, np.uint64(count)))
            out[row, col] = (np.float32(rival) - np.float32(cheapest)) * np.float32(1.0 / PARTS)
    return out


@numba.njit(inline="always")
def _least(numbers, begin, end):  # type: ignore[no-untyped-def]
    """The smallest number from ``begin`` to ``end``; :data:`ENDLESS` if there is none."""
    lowest = ENDLESS
    for k in range(begin, end):
        lowest = _less(lowest, numbers[k])
    return lowest
