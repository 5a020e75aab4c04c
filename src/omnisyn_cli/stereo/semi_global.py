"""Semi-global matching along meridians.

Rows are polar angles of a frame whose zenith is the epipole, so a match lies in the same column, ``disparity`` rows
further down. Columns wrap, which makes every diagonal path as long as a meridian and all of them independent.

Source: Hirschmüller, Stereo processing by semi-global matching and mutual information, 2008; census transform:
Zabih and Woodfill, 1994.
"""

from __future__ import annotations

import numba
import numpy as np
from jaxtyping import Bool, Float, UInt64

from omnisyn_cli.jit import compiled_kernel, one_at_a_time, parallel_kernel

__all__ = ["FORBIDDEN", "aggregate", "census", "choose", "sweep_cost", "warp_cost"]

HALF_WINDOW = 3
NOISE = np.float32(0.004)
"""A neighbour counts as brighter when it is so by more than one grey level."""

CONTRADICTION = np.float32(1.0 / 24.0)
"""One census bit; half of the 48 differ between unrelated windows, which is a cost of 1."""

UNSEEN = np.float32(0.6)
"""Cost of what leads out of the image or into a mask: worse than a match, better than a contradiction."""

FORBIDDEN = np.float32(4.0)
"""Cost of what cannot be."""

RUN_UP = 64
"""Columns that a horizontal path walks before the seam, so that the seam is no border."""

FAR = np.float32(1e9)


@compiled_kernel(parallel=True, nogil=True)
def census_kernel(luminance):  # type: ignore[no-untyped-def]
    """Which of the 48 neighbours in 7×7 are brighter than each pixel ``(height, width)``, as bits of uint64.

    Columns wrap, end rows repeat. For other kernels; from Python it is :func:`census`.
    """
    height, width = luminance.shape
    wide = np.empty((height, width + 2 * HALF_WINDOW), np.float32)
    wide[:, HALF_WINDOW:-HALF_WINDOW] = luminance
    wide[:, :HALF_WINDOW] = luminance[:, -HALF_WINDOW:]
    wide[:, -HALF_WINDOW:] = luminance[:, :HALF_WINDOW]
    signature = np.zeros((height, width), np.uint64)
    for row in numba.prange(height):
        for i in range(-HALF_WINDOW, HALF_WINDOW + 1):
            r = min(max(row + i, 0), height - 1)
            for j in range(2 * HALF_WINDOW + 1):
                if i != 0 or j != HALF_WINDOW:
                    for col in range(width):
                        brighter = np.uint64(wide[r, col + j] > wide[row, col + HALF_WINDOW] + NOISE)
                        signature[row, col] = (signature[row, col] << np.uint64(1)) | brighter
    return signature


census = one_at_a_time(census_kernel)


@parallel_kernel()
def sweep_cost(
    first: Float[np.ndarray, "height width 3"],
    second: Float[np.ndarray, "height width 3"],
    usable: Bool[np.ndarray, "height width"],
    lowest: Float[np.ndarray, "height width"],
    levels: int,
    colour_share: float,
    truncation: float,
) -> Float[np.ndarray, "height width levels"]:
    """Cost in [0, 1] of the disparities 0, 1, … levels − 1 (rows).

    Args:
        first: RGB.
        second: RGB.
        usable: where the second image may be matched.
        lowest: rows; smaller disparities are :data:`FORBIDDEN`.
        levels: how many disparities.
        colour_share: weight of the absolute colour difference against the census.
        truncation: the colour difference that counts as 1.
    """
    height, width, _ = first.shape
    grey_a = (first[..., 0] + first[..., 1] + first[..., 2]) / np.float32(3.0)
    grey_b = (second[..., 0] + second[..., 1] + second[..., 2]) / np.float32(3.0)
    bits_a, bits_b = census_kernel(grey_a), census_kernel(grey_b)
    colour = np.float32(colour_share)
    scale = np.float32(1.0 / (3.0 * truncation))
    cost = np.empty((height, width, levels), np.float32)
    for row in numba.prange(height):
        for col in range(width):
            for level in range(levels):
                r = row + level
                if level < lowest[row, col]:
                    cost[row, col, level] = FORBIDDEN
                elif r >= height or not usable[r, col]:
                    cost[row, col, level] = UNSEEN
                else:
                    contradictions = bits_a[row, col] ^ bits_b[r, col]
                    difference = difference_of_pixels(first, second, row, r, col) * scale
                    cost[row, col, level] = mixed_cost(contradictions, difference, colour)
    return cost


@parallel_kernel()
def warp_cost(
    first: Float[np.ndarray, "height width 3"],
    first_census: UInt64[np.ndarray, "height width"],
    second: Float[np.ndarray, "height width 3"],
    usable: Bool[np.ndarray, "height width"],
    disparity: Float[np.ndarray, "height width"],
    colour_share: float,
    truncation: float,
) -> Float[np.ndarray, "height width"]:
    """Cost in [0, 1] of one surface: the second image is warped by it first, so that windows lean as the surface does.

    Where ``disparity`` (rows) is negative the surface is behind the camera: :data:`FORBIDDEN`.
    """
    height, width, _ = first.shape
    warped = np.zeros((height, width, 3), np.float32)
    seen = np.zeros((height, width), np.bool_)
    for row in numba.prange(height):
        for col in range(width):
            target = row + disparity[row, col]
            if disparity[row, col] >= 0 and target <= height - 1:
                r = min(int(target), height - 2)
                share = np.float32(target - r)
                seen[row, col] = usable[r, col] and usable[r + 1, col]
                for k in range(3):
                    warped[row, col, k] = (1 - share) * second[r, col, k] + share * second[r + 1, col, k]
    bits = census_kernel((warped[..., 0] + warped[..., 1] + warped[..., 2]) / np.float32(3.0))
    scale = np.float32(1.0 / (3.0 * truncation))
    cost = np.empty((height, width), np.float32)
    for row in numba.prange(height):
        for col in range(width):
            if disparity[row, col] < 0:
                cost[row, col] = FORBIDDEN
            elif not seen[row, col]:
                cost[row, col] = UNSEEN
            else:
                contradictions = first_census[row, col] ^ bits[row, col]
                difference = difference_of_pixels(first, warped, row, row, col) * scale
                cost[row, col] = mixed_cost(contradictions, difference, np.float32(colour_share))
    return cost


@parallel_kernel(fastmath=True)
def aggregate(
    cost: Float[np.ndarray, "height width levels"],
    luminance: Float[np.ndarray, "height width"],
    step: float,
    jump: float,
    contrast: float,
) -> Float[np.ndarray, "height width levels"]:
    """The sum over eight path directions of the cheapest way to each pixel and level.

    Args:
        cost: matching cost.
        luminance: a jump is cheaper by ``1 / (1 + |difference| / contrast)`` across an edge.
        step: penalty for neighbouring levels (``inf``-like for labels without an order).
        jump: penalty for any other change of level.
        contrast: grey difference at which a jump costs half.
    """
    height, width, levels = cost.shape
    total = np.zeros((height, width, levels), np.float32)
    small, large, scale = np.float32(step), np.float32(jump), np.float32(1.0 / contrast)
    for way in range(6):
        lean, down = way // 2 - 1, way % 2 == 0
        for origin in numba.prange(width):
            ahead, behind = np.full(levels + 2, FAR, np.float32), np.full(levels + 2, FAR, np.float32)
            behind[1 : levels + 1] = 0
            cheapest, grey = np.float32(0), luminance[0 if down else height - 1, origin]
            for k in range(height):
                row, col = k if down else height - 1 - k, (origin + lean * k) % width
                here = luminance[row, col]
                leap = cheapest + large / (1 + abs(here - grey) * scale)
                cheapest = _walk(cost[row, col], behind, ahead, leap, cheapest, small)
                for level in range(levels):
                    total[row, col, level] += ahead[level + 1]
                ahead, behind, grey = behind, ahead, here
    for row in numba.prange(height):
        for side in range(2):
            ahead, behind = np.full(levels + 2, FAR, np.float32), np.full(levels + 2, FAR, np.float32)
            behind[1 : levels + 1] = 0
            cheapest, grey = np.float32(0), luminance[row, 0]
            for k in range(-RUN_UP, width):
                col = (k if side == 0 else width - 1 - k) % width
                here = luminance[row, col]
                leap = cheapest + large / (1 + abs(here - grey) * scale)
                cheapest = _walk(cost[row, col], behind, ahead, leap, cheapest, small)
                if k >= 0:
                    for level in range(levels):
                        total[row, col, level] += ahead[level + 1]
                ahead, behind, grey = behind, ahead, here
    return total


@parallel_kernel()
def choose(
    total: Float[np.ndarray, "height width levels"],
) -> tuple[Float[np.ndarray, "height width"], Float[np.ndarray, "height width"]]:
    """The cheapest level of every pixel to a fraction, and by how much its best rival is dearer (0 = a tie)."""
    height, width, levels = total.shape
    level = np.empty((height, width), np.float32)
    margin = np.empty((height, width), np.float32)
    for row in numba.prange(height):
        for col in range(width):
            score = total[row, col]
            best = int(np.argmin(score))
            rival = FAR
            for k in range(levels):
                if abs(k - best) > 1:
                    rival = min(rival, score[k])
            level[row, col] = best
            if 0 < best < levels - 1:
                left, right = score[best - 1] - score[best], score[best + 1] - score[best]
                level[row, col] += np.float32(0.5) * (left - right) / (max(left, right) + np.float32(1e-9))
            margin[row, col] = rival - score[best]
    return level, margin


@numba.njit(inline="always")
def _walk(cost, behind, ahead, leap, cheapest, small):  # type: ignore[no-untyped-def]
    lowest = FAR
    for level in range(cost.shape[0]):
        best = min(min(behind[level + 1], leap), min(behind[level], behind[level + 2]) + small)
        value = cost[level] + best - cheapest
        ahead[level + 1] = value
        lowest = min(lowest, value)
    return lowest


@numba.njit(inline="always")
def mixed_cost(contradictions, difference, colour):  # type: ignore[no-untyped-def]
    """Of one match, in [0, 1]: census bits that differ, and a difference of colours that counts ``colour`` of it."""
    share = np.float32(_count_bits(contradictions)) * CONTRADICTION
    texture = np.float32(1.0) - colour
    return texture * min(share, np.float32(1.0)) + colour * min(difference, np.float32(1.0))


@numba.njit(inline="always")
def _count_bits(x):  # type: ignore[no-untyped-def]
    x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (x * np.uint64(0x0101010101010101)) >> np.uint64(56)


@numba.njit(inline="always")
def difference_of_pixels(a, b, row_a, row_b, col):  # type: ignore[no-untyped-def]
    return (
        abs(a[row_a, col, 0] - b[row_b, col, 0])
        + abs(a[row_a, col, 1] - b[row_b, col, 1])
        + abs(a[row_a, col, 2] - b[row_b, col, 2])
    )
