"""What a match costs: census signatures and colours compared, for disparities per pixel or for one surface.

Source: Zabih and Woodfill, Non-parametric local transforms for computing visual correspondence, 1994.
"""

import numba
import numpy as np
from jaxtyping import Bool, Float, UInt16, UInt64

from omnisyn_cli.runtime.jit import compiled_kernel, one_at_a_time, parallel_kernel
from omnisyn_cli.stereo.semi_global import MOST_COST, PARTS, Bands

HALF_WINDOW = 3
NOISE = np.float32(0.004)
"""A neighbour counts as brighter when it is so by more than one grey level."""

CONTRADICTION = np.float32(1.0 / 24.0)
"""One census bit; half of the 48 differ between unrelated windows, which is a cost of 1."""

OUTSIDE = np.float32(0.6)
"""Cost of what leads out of the image or into a mask: worse than a match, better than a contradiction."""

FORBIDDEN = np.float32(MOST_COST)
"""Cost of what cannot be."""


@compiled_kernel(parallel=True, nogil=True)
def _census(luminance):  # type: ignore[no-untyped-def]
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


census = one_at_a_time(_census)


def sweep_cost(
    first: Float[np.ndarray, "height width 3"],
    second: Float[np.ndarray, "height width 3"],
    usable: Bool[np.ndarray, "height width"],
    bands: Bands,
    colour_share: float,
    truncation: float,
) -> UInt16[np.ndarray, " numbers"]:
    """Cost in [0, 1] of every disparity of the bands, in parts (:data:`omnisyn_cli.stereo.semi_global.PARTS`).

    Args:
        first: RGB.
        second: RGB.
        usable: where the second image may be matched.
        bands: the disparities.
        colour_share: weight of the absolute colour difference against the census.
        truncation: the colour difference that counts as 1.
    """
    return np.asarray(_sweep(first, second, usable, bands.lowest, bands.begin, colour_share, truncation))


@parallel_kernel()
def _sweep(first, second, usable, lowest, begin, colour_share, truncation):  # type: ignore[no-untyped-def]
    height, width, _ = first.shape
    grey_a = (first[..., 0] + first[..., 1] + first[..., 2]) / np.float32(3.0)
    grey_b = (second[..., 0] + second[..., 1] + second[..., 2]) / np.float32(3.0)
    bits_a, bits_b = _census(grey_a), _census(grey_b)
    colour = np.float32(colour_share)
    scale = np.float32(1.0 / (3.0 * truncation))
    cost, ahead, bits_ahead = np.empty(begin[-1], np.uint16), _columns(second), np.ascontiguousarray(bits_b.T)
    is_usable = np.ascontiguousarray(usable.T)
    for row in numba.prange(height):
        for col in range(width):
            at, r = begin[row * width + col], row + lowest[row, col]
            own, bits = cost[at : begin[row * width + col + 1]], bits_a[row, col]
            red, green, blue = first[row, col, 0], first[row, col, 1], first[row, col, 2]
            count = np.uint64(max(min(len(own), height - r), 0))
            reds, greens, blues = ahead[0, col, r:], ahead[1, col, r:], ahead[2, col, r:]
            these, usables = bits_ahead[col, r:], is_usable[col, r:]
            for k in range(count):
                difference = abs(red - reds[k]) + abs(green - greens[k]) + abs(blue - blues[k])
                value = _mixed(bits ^ these[k], difference * scale, colour)
                own[k] = _in_parts(value if usables[k] else OUTSIDE)
            for k in range(count, np.uint64(len(own))):
                own[k] = _in_parts(OUTSIDE)
    return cost


@numba.njit(inline="always")
def _in_parts(value):  # type: ignore[no-untyped-def]
    return np.uint16(np.int32(value * np.float32(PARTS) + np.float32(0.5)))


@numba.njit(inline="always")
def _columns(image):  # type: ignore[no-untyped-def]
    """The channels of an image, column after column: what a match is looked for in lies side by side."""
    return np.ascontiguousarray(image.transpose(2, 1, 0))


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
    bits = _census((warped[..., 0] + warped[..., 1] + warped[..., 2]) / np.float32(3.0))
    scale = np.float32(1.0 / (3.0 * truncation))
    cost = np.empty((height, width), np.float32)
    for row in numba.prange(height):
        for col in range(width):
            if disparity[row, col] < 0:
                cost[row, col] = FORBIDDEN
            elif not seen[row, col]:
                cost[row, col] = OUTSIDE
            else:
                contradictions = first_census[row, col] ^ bits[row, col]
                difference = _difference(first, warped, row, row, col) * scale
                cost[row, col] = _mixed(contradictions, difference, np.float32(colour_share))
    return cost


@numba.njit(inline="always")
def _mixed(contradictions, difference, colour):  # type: ignore[no-untyped-def]
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
def _difference(a, b, row_a, row_b, col):  # type: ignore[no-untyped-def]
    return (
        abs(a[row_a, col, 0] - b[row_b, col, 0])
        + abs(a[row_a, col, 1] - b[row_b, col, 1])
        + abs(a[row_a, col, 2] - b[row_b, col, 2])
    )
