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
        for origin in numba.prange(width):
            behind, ahead = np.zeros(longest, np.float32), np.empty(longest, np.float32)
            start = 0 if down else height - 1
            at, low, grey, cheapest = (
                start * width + origin,
                lowest[start, origin],
                luminance[start, origin],
                np.float32(0),
            )
            count = begin[at + 1] - begin[at]
            for k in range(height):
                row, col = k if down else height - 1 - k, (origin + lean * k) % width
                at, here = row * width + col, luminance[row, col]
                own, leap = cost[begin[at] : begin[at + 1]], cheapest + large / (1 + abs(here - grey) * scale)
                cheapest = _walk(own, behind[:count], ahead, lowest[row, col] - low, leap, cheapest, small)
                low, grey, count = lowest[row, col], here, len(own)
                for level in range(count):
                    total[begin[at] + level] += ahead[level]
                ahead, behind = behind, ahead
    for row in numba.prange(height):
        for side in range(2):
            behind, ahead = np.zeros(longest, np.float32), np.empty(longest, np.float32)
            start = -RUN_UP % width if side == 0 else (width - 1 + RUN_UP) % width
            at, low, grey, cheapest = row * width + start, lowest[row, start], luminance[row, start], np.float32(0)
            count = begin[at + 1] - begin[at]
            for k in range(-RUN_UP, width):
                col = (k if side == 0 else width - 1 - k) % width
                at, here = row * width + col, luminance[row, col]
                own, leap = cost[begin[at] : begin[at + 1]], cheapest + large / (1 + abs(here - grey) * scale)
                cheapest = _walk(own, behind[:count], ahead, lowest[row, col] - low, leap, cheapest, small)
                low, grey, count = lowest[row, col], here, len(own)
                if k >= 0:
                    for level in range(count):
                        total[begin[at] + level] += ahead[level]
                ahead, behind = behind, ahead
    return total


@numba.njit(inline="always")
def _walk(cost, behind, ahead, shift, leap, cheapest, small):  # type: ignore[no-untyped-def]
    """One step of a path into a band that begins ``shift`` disparities after the one that it leaves."""
    count = len(cost)
    inner = min(max(0, 1 - shift), count)
    outer = max(inner, min(count, len(behind) - 1 - shift))
    lowest = FAR
    for level in range(inner):
        value = cost[level] + _cheapest_way(behind, level + shift, leap, small) - cheapest
        ahead[level] = value
        lowest = min(lowest, value)
    for level in range(inner, outer):  # all neighbours exist: a loop of vectors
        at = level + shift
        best = min(min(behind[at], leap), min(behind[at - 1], behind[at + 1]) + small)
        value = cost[level] + best - cheapest
        ahead[level] = value
        lowest = min(lowest, value)
    for level in range(outer, count):
        value = cost[level] + _cheapest_way(behind, level + shift, leap, small) - cheapest
        ahead[level] = value
        lowest = min(lowest, value)
    return lowest


@numba.njit(inline="always")
def _cheapest_way(behind, at, leap, small):  # type: ignore[no-untyped-def]
    """To the disparity at a place that need not be in the band behind."""
    count, best = len(behind), leap
    if 0 <= at < count:
        best = min(best, behind[at])
    if 0 <= at - 1 < count:
        best = min(best, behind[at - 1] + small)
    if 0 <= at + 1 < count:
        best = min(best, behind[at + 1] + small)
    return best


@parallel_kernel()
def _choose(total, lowest, begin, is_all):  # type: ignore[no-untyped-def]
    height, width = lowest.shape
    disparity, margin = np.empty((height, width), np.float32), np.zeros((height, width), np.float32)
    for row in numba.prange(height):
        for col in range(width):
            at = row * width + col
            score = total[begin[at] : begin[at + 1]]
            best = int(np.argmin(score))
            disparity[row, col] = lowest[row, col] + best
            is_inside = 0 < best < len(score) - 1
            if is_inside:
                left, right = score[best - 1] - score[best], score[best + 1] - score[best]
                disparity[row, col] += np.float32(0.5) * (left - right) / (max(left, right) + np.float32(1e-9))
            if is_inside or is_all:
                rival = FAR
                for k in range(len(score)):
                    if abs(k - best) > 1:
                        rival = min(rival, score[k])
                margin[row, col] = rival - score[best]
    return disparity, margin
