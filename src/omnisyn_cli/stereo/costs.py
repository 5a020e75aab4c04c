"""What a match costs: census signatures and colours compared, for disparities per pixel or for one surface.

Source: Zabih and Woodfill, Non-parametric local transforms for computing visual correspondence, 1994.
"""

from functools import partial

import numpy as np
from jaxtyping import Bool, Float, UInt16, UInt64

from omnisyn_cli.compute.jit import inlined, kernel
from omnisyn_cli.compute.threads import run_bands
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


def census(luminance: Float[np.ndarray, "height width"]) -> UInt64[np.ndarray, "height width"]:
    """Which of the 48 neighbours in 7×7 are brighter than each pixel, as bits; columns wrap, end rows repeat."""
    wide = np.pad(luminance, ((0, 0), (HALF_WINDOW, HALF_WINDOW)), mode="wrap").astype(np.float32, copy=False)
    signature = np.zeros(luminance.shape, np.uint64)
    run_bands(partial(_compare_with_neighbours, wide, signature), len(signature))
    return signature


@kernel()
def _compare_with_neighbours(wide, signature, begin, end):  # type: ignore[no-untyped-def]
    height, width = signature.shape
    for row in range(begin, end):
        for i in range(-HALF_WINDOW, HALF_WINDOW + 1):
            r = min(max(row + i, 0), height - 1)
            for j in range(2 * HALF_WINDOW + 1):
                if i != 0 or j != HALF_WINDOW:
                    for col in range(width):
                        brighter = np.uint64(wide[r, col + j] > wide[row, col + HALF_WINDOW] + NOISE)
                        signature[row, col] = (signature[row, col] << np.uint64(1)) | brighter


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
    bits, bits_ahead = census(_grey(first)), np.ascontiguousarray(census(_grey(second)).T)
    ahead, is_usable = np.ascontiguousarray(second.transpose(2, 1, 0)), np.ascontiguousarray(usable.T)
    colour, scale = np.float32(colour_share), np.float32(1.0 / (3.0 * truncation))
    cost = np.empty(bands.begin[-1], np.uint16)
    others = (ahead, bits_ahead, is_usable)
    run_bands(partial(_sweep, first, bits, *others, bands.lowest, bands.begin, colour, scale, cost), len(bands.lowest))
    return cost


def _grey(image: Float[np.ndarray, "height width 3"]) -> Float[np.ndarray, "height width"]:
    return np.asarray((image[..., 0] + image[..., 1] + image[..., 2]) / np.float32(3.0))


@kernel()
def _sweep(  # type: ignore[no-untyped-def]
    first, census_of_first, ahead, bits_ahead, is_usable, lowest, starts, colour, scale, cost, begin, end
):
    """What is ahead lies column after column: all that a pixel may match lies side by side."""
    height, width = lowest.shape
    for row in range(begin, end):
        for col in range(width):
            at, r = starts[row * width + col], row + lowest[row, col]
            own, bits = cost[at : starts[row * width + col + 1]], census_of_first[row, col]
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


@inlined()
def _in_parts(value):  # type: ignore[no-untyped-def]
    return np.uint16(np.int32(value * np.float32(PARTS) + np.float32(0.5)))


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
    warped, seen = np.zeros_like(first), np.zeros(disparity.shape, np.bool_)
    run_bands(partial(_warp, second, usable, disparity, warped, seen), len(warped))
    contradictions = first_census ^ census(_grey(warped))
    cost = np.empty(disparity.shape, np.float32)
    colour, scale = np.float32(colour_share), np.float32(1.0 / (3.0 * truncation))
    run_bands(
        partial(_compare_with_warped, first, warped, contradictions, disparity, seen, colour, scale, cost), len(cost)
    )
    return cost


@kernel()
def _warp(second, usable, disparity, warped, seen, begin, end):  # type: ignore[no-untyped-def]
    height, width = disparity.shape
    for row in range(begin, end):
        for col in range(width):
            target = row + disparity[row, col]
            if disparity[row, col] >= 0 and target <= height - 1:
                r = min(int(target), height - 2)
                share = np.float32(target - r)
                seen[row, col] = usable[r, col] and usable[r + 1, col]
                for k in range(3):
                    warped[row, col, k] = (1 - share) * second[r, col, k] + share * second[r + 1, col, k]


@kernel()
def _compare_with_warped(  # type: ignore[no-untyped-def]
    first, warped, contradictions, disparity, seen, colour, scale, cost, begin, end
):
    for row in range(begin, end):
        for col in range(cost.shape[1]):
            if disparity[row, col] < 0:
                cost[row, col] = FORBIDDEN
            elif not seen[row, col]:
                cost[row, col] = OUTSIDE
            else:
                difference = np.float32(0.0)
                for k in range(3):
                    difference += abs(first[row, col, k] - warped[row, col, k])
                cost[row, col] = _mixed(contradictions[row, col], difference * scale, colour)


@inlined()
def _mixed(contradictions, difference, colour):  # type: ignore[no-untyped-def]
    """Of one match, in [0, 1]: census bits that differ, and a difference of colours that counts ``colour`` of it."""
    share = np.float32(_count_bits(contradictions)) * CONTRADICTION
    texture = np.float32(1.0) - colour
    return texture * min(share, np.float32(1.0)) + colour * min(difference, np.float32(1.0))


@inlined()
def _count_bits(x):  # type: ignore[no-untyped-def]
    x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (x * np.uint64(0x0101010101010101)) >> np.uint64(56)
