"""Semi-global matching along meridians, of the disparities that are in question at each pixel.

Rows are polar angles of a frame whose zenith is the epipole, so a match lies in the same column, ``disparity`` rows
further down. Columns wrap, which makes every diagonal path as long as a meridian and all of them independent.

Each pixel has a band of disparities. Bands begin and end at different ones, so a path from pixel to pixel goes on at
the same disparity, not at the same place in the band. All numbers lie in one flat array, pixel after pixel.

Source: Hirschmüller, Stereo processing by semi-global matching and mutual information, 2008; bands: Rothermel et al.,
SURE: photogrammetric surface reconstruction from imagery, 2012 (tSGM).
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from jaxtyping import Float, Float32, Int32, Int64

from omnisyn_cli.runtime.jit import parallel_kernel

RUN_UP = 64
"""Columns that a horizontal path walks before the seam, so that the seam is no border."""

FAR = np.float32(1e9)

SIDE_BY_SIDE = 32
"""Paths that walk together: what they read of a row lies side by side."""

AROUND, ONE, LANES = np.uint64(2), np.uint64(1), np.uint64(8)
"""Numbers around a path, beyond every band; the next one; and those that are worked on together."""


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


def aggregate(
    cost: Float32[np.ndarray, " numbers"],
    bands: Bands,
    luminance: Float[np.ndarray, "height width"],
    step: float,
    jump: float,
    contrast: float,
) -> Float32[np.ndarray, " numbers"]:
    """The sum over eight path directions of the cheapest way to each pixel and disparity.

    Args:
        cost: matching cost.
        bands: what the numbers belong to; or labels without an order, the same ones everywhere.
        luminance: a jump is cheaper by ``1 / (1 + |difference| / contrast)`` across an edge.
        step: penalty for neighbouring disparities (``inf``-like for labels without an order).
        jump: penalty for any other change.
        contrast: grey difference at which a jump costs half.
    """
    return np.asarray(_aggregate(cost, bands.lowest, bands.begin, luminance, step, jump, contrast))


def choose(
    total: Float32[np.ndarray, " numbers"], bands: Bands, *, is_all: bool
) -> tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]:
    """The cheapest disparity of every pixel to a fraction, and by how much its best rival is dearer (0 = a tie).

    Args:
        total: from :func:`aggregate`.
        bands: what the numbers belong to.
        is_all: whether nothing exists beyond the bands; else the margin is 0 where the cheapest one is at an end.
    """
    disparity, margin = _choose(total, bands.lowest, bands.begin, is_all)
    return np.asarray(disparity), np.asarray(margin)


@parallel_kernel(fastmath=True)
def _aggregate(cost, lowest, begin, luminance, step, jump, contrast):  # type: ignore[no-untyped-def]
    height, width = lowest.shape
    total = np.zeros(len(cost), np.float32)
    small, large, scale = np.float32(step), np.float32(jump), np.float32(1.0 / contrast)
    longest = 0
    for pixel in range(height * width):
        longest = max(longest, begin[pixel + 1] - begin[pixel])
    for way in range(6):
        lean, down = way // 2 - 1, way % 2 == 0
        for group in numba.prange((width + SIDE_BY_SIDE - 1) // SIDE_BY_SIDE):
            paths, least = _no_paths(2 * SIDE_BY_SIDE, longest), np.empty(LANES, np.float32)
            cheapest = np.zeros(SIDE_BY_SIDE, np.float32)
            for k in range(height):
                row, before = (k, max(k - 1, 0)) if down else (height - 1 - k, height - 1 - max(k - 1, 0))
                for i in range(min(SIDE_BY_SIDE, width - group * SIDE_BY_SIDE)):
                    origin = group * SIDE_BY_SIDE + i
                    col, col_before = (origin + lean * k) % width, (origin + lean * max(k - 1, 0)) % width
                    at, last = row * width + col, before * width + col_before
                    contrast_here = abs(luminance[row, col] - luminance[before, col_before])
                    leap = cheapest[i] + large / (1 + contrast_here * scale)
                    behind, ahead = paths[2 * i + (k + 1) % 2], paths[2 * i + k % 2]
                    own, shift = cost[begin[at] : begin[at + 1]], lowest[row, col] - lowest[before, col_before]
                    reach = begin[last + 1] - begin[last]
                    cheapest[i] = _walk(own, behind, reach, ahead, shift, leap, cheapest[i], small, least)
                    _add(ahead, total[begin[at] : begin[at + 1]])
    for row in numba.prange(height):
        paths, least = _no_paths(2, longest), np.empty(LANES, np.float32)
        for side in range(2):
            cheap, before = np.float32(0), (-RUN_UP if side == 0 else width - 1 + RUN_UP) % width
            paths[:, AROUND:-AROUND] = 0
            for k in range(-RUN_UP, width):
                col = (k if side == 0 else width - 1 - k) % width
                at, last = row * width + col, row * width + before
                leap = cheap + large / (1 + abs(luminance[row, col] - luminance[row, before]) * scale)
                behind, ahead = paths[(k + 1) % 2], paths[k % 2]
                own, shift = cost[begin[at] : begin[at + 1]], lowest[row, col] - lowest[row, before]
                reach = begin[last + 1] - begin[last]
                cheap = _walk(own, behind, reach, ahead, shift, leap, cheap, small, least)
                before = col
                if k >= 0:
                    _add(ahead, total[begin[at] : begin[at + 1]])
    return total


@numba.njit(inline="always")
def _no_paths(count, longest):  # type: ignore[no-untyped-def]
    """Memory for costs of paths that begin: nothing so far, and beyond both ends of the longest band nothing at all."""
    paths = np.full((count, longest + 2 * AROUND), FAR, np.float32)
    paths[:, AROUND:-AROUND] = 0
    return paths


@numba.njit(inline="always")
def _walk(cost, behind, reach, ahead, shift, leap, cheapest, small, least):  # type: ignore[no-untyped-def]
    """One step of a path into a band that begins ``shift`` disparities after the one that it leaves; its least cost.

    ``behind``, of ``reach`` numbers, and ``ahead`` have :data:`AROUND` more at both ends. All loops are of vectors:
    indices without a sign need no look at whether they count from the end, and minima are kept lane by lane.
    """
    count = len(cost)
    first = min(max(0, -1 - shift), count)
    last = max(first, min(count, reach + 1 - shift))
    for k in range(np.uint64(first)):
        ahead[k + AROUND] = cost[k] + (leap - cheapest)
    for k in range(np.uint64(last), np.uint64(count)):
        ahead[k + AROUND] = cost[k] + (leap - cheapest)
    begin, source = np.uint64(first), np.uint64(first + shift + 1)
    for k in range(np.uint64(last - first)):  # the disparity itself is between its neighbours
        at = source + k
        best = min(min(behind[at + ONE], leap), min(behind[at], behind[at + AROUND]) + small)
        ahead[begin + k + AROUND] = cost[begin + k] + best - cheapest
    end = np.uint64(count) + AROUND
    ahead[end] = ahead[end + ONE] = FAR
    return _least(ahead, AROUND, end, least)


@numba.njit(inline="always")
def _least(numbers, begin, end, least):  # type: ignore[no-untyped-def]
    """The smallest number from ``begin`` to ``end``; ``least`` is room for one in each lane."""
    lowest, whole = FAR, (end - begin) // LANES
    for lane in range(LANES):
        least[lane] = FAR
    for k in range(whole):
        for lane in range(LANES):
            least[lane] = min(least[lane], numbers[begin + k * LANES + lane])
    for k in range(begin + whole * LANES, end):
        lowest = min(lowest, numbers[k])
    for lane in range(LANES):
        lowest = min(lowest, least[lane])
    return lowest


@numba.njit(inline="always")
def _add(path, sums):  # type: ignore[no-untyped-def]
    for k in range(np.uint64(len(sums))):
        sums[k] += path[k + AROUND]


@parallel_kernel()
def _choose(total, lowest, begin, is_all):  # type: ignore[no-untyped-def]
    height, width = lowest.shape
    disparity, margin = np.empty((height, width), np.float32), np.zeros((height, width), np.float32)
    for row in numba.prange(height):
        least = np.empty(LANES, np.float32)
        for col in range(width):
            at = row * width + col
            score = total[begin[at] : begin[at + 1]]
            nothing, count, best = np.uint64(0), np.uint64(len(score)), 0
            lowest_score = _least(score, nothing, count, least)
            while score[best] > lowest_score:
                best += 1
            disparity[row, col] = lowest[row, col] + best
            is_inside = 0 < best < len(score) - 1
            if is_inside:
                left, right = score[best - 1] - score[best], score[best + 1] - score[best]
                disparity[row, col] += np.float32(0.5) * (left - right) / (max(left, right) + np.float32(1e-9))
            if is_inside or is_all:
                before, after = np.uint64(max(best - 1, 0)), np.uint64(min(best + 2, len(score)))
                rival = min(_least(score, nothing, before, least), _least(score, after, count, least))
                margin[row, col] = rival - score[best]
    return disparity, margin
