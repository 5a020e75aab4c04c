"""Semi-global matching of a few disparities per pixel, those around what is known already.

The bands begin and end at different disparities, so a path from pixel to pixel goes on at the same disparity, not at
the same place in the band. All numbers lie in one flat array, pixel after pixel.

Source: Rothermel et al., SURE: photogrammetric surface reconstruction from imagery, 2012 (tSGM); the rest as in
:mod:`omnisyn_cli.stereo.semi_global`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from jaxtyping import Bool, Float, Float32, Int32, Int64

from omnisyn_cli.jit import parallel_kernel
from omnisyn_cli.stereo.semi_global import FAR, RUN_UP, UNSEEN, census_kernel, difference_of_pixels, mixed_cost

__all__ = ["Bands", "aggregate_bands", "band_cost", "choose_in_bands"]


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
    def between(lowest: Int32[np.ndarray, "height width"], highest: Int32[np.ndarray, "height width"]) -> Bands:
        """All whole rows from ``lowest`` to ``highest``, which is never the smaller one."""
        begin = np.zeros(lowest.size + 1, np.int64)
        np.cumsum((highest - lowest + 1).ravel(), out=begin[1:])
        return Bands(lowest, begin)


def band_cost(
    first: Float[np.ndarray, "height width 3"],
    second: Float[np.ndarray, "height width 3"],
    usable: Bool[np.ndarray, "height width"],
    bands: Bands,
    colour_share: float,
    truncation: float,
) -> Float32[np.ndarray, " numbers"]:
    """Cost in [0, 1] of every disparity of the bands, see :func:`omnisyn_cli.stereo.semi_global.sweep_cost`."""
    return np.asarray(_cost(first, second, usable, bands.lowest, bands.begin, colour_share, truncation))


def aggregate_bands(
    cost: Float32[np.ndarray, " numbers"],
    bands: Bands,
    luminance: Float[np.ndarray, "height width"],
    step: float,
    jump: float,
    contrast: float,
) -> Float32[np.ndarray, " numbers"]:
    """As :func:`omnisyn_cli.stereo.semi_global.aggregate`."""
    return np.asarray(_aggregate(cost, bands.lowest, bands.begin, luminance, step, jump, contrast))


def choose_in_bands(
    total: Float32[np.ndarray, " numbers"], bands: Bands
) -> tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]:
    """The cheapest disparity of every pixel to a fraction, and by how much its best rival is dearer.

    Where the cheapest is the first or the last of a band the margin is 0: beyond nothing was tried.
    """
    disparity, margin = _choose(total, bands.lowest, bands.begin)
    return np.asarray(disparity), np.asarray(margin)


@parallel_kernel()
def _cost(first, second, usable, lowest, begin, colour_share, truncation):  # type: ignore[no-untyped-def]
    height, width, _ = first.shape
    grey_a = (first[..., 0] + first[..., 1] + first[..., 2]) / np.float32(3.0)
    grey_b = (second[..., 0] + second[..., 1] + second[..., 2]) / np.float32(3.0)
    bits_a, bits_b = census_kernel(grey_a), census_kernel(grey_b)
    colour = np.float32(colour_share)
    scale = np.float32(1.0 / (3.0 * truncation))
    cost = np.empty(begin[-1], np.float32)
    for row in numba.prange(height):
        for col in range(width):
            at, r = begin[row * width + col], row + lowest[row, col]
            for k in range(begin[row * width + col + 1] - at):
                value = UNSEEN
                if r + k < height and usable[r + k, col]:
                    difference = difference_of_pixels(first, second, row, r + k, col) * scale
                    value = mixed_cost(bits_a[row, col] ^ bits_b[r + k, col], difference, colour)
                cost[at + k] = value
    return cost


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
        ahead[level] = cost[level] + _cheapest_way(behind, level + shift, leap, small) - cheapest
        lowest = min(lowest, ahead[level])
    for level in range(inner, outer):  # all neighbours exist: a loop of vectors
        at = level + shift
        best = min(min(behind[at], leap), min(behind[at - 1], behind[at + 1]) + small)
        ahead[level] = cost[level] + best - cheapest
        lowest = min(lowest, ahead[level])
    for level in range(outer, count):
        ahead[level] = cost[level] + _cheapest_way(behind, level + shift, leap, small) - cheapest
        lowest = min(lowest, ahead[level])
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
def _choose(total, lowest, begin):  # type: ignore[no-untyped-def]
    height, width = lowest.shape
    disparity, margin = np.empty((height, width), np.float32), np.zeros((height, width), np.float32)
    for row in numba.prange(height):
        for col in range(width):
            at = row * width + col
            score = total[begin[at] : begin[at + 1]]
            best = int(np.argmin(score))
            disparity[row, col] = lowest[row, col] + best
            if 0 < best < len(score) - 1:
                left, right = score[best - 1] - score[best], score[best + 1] - score[best]
                disparity[row, col] += np.float32(0.5) * (left - right) / (max(left, right) + np.float32(1e-9))
                rival = FAR
                for k in range(len(score)):
                    if abs(k - best) > 1:
                        rival = min(rival, score[k])
                margin[row, col] = rival - score[best]
    return disparity, margin
