"""Matching costs: census signatures and colours compared, for a range of disparities or for one surface.

Source: Zabih and Woodfill, Non-parametric local transforms for computing visual correspondence, 1994.
"""

from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt16, UInt64

from omnisyn_cli.compute.jit import inlined, kernel
from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.geometry.sampling import filter_across_seam
from omnisyn_cli.stereo.semi_global import FIXED_POINT_SCALE, MAX_COST, DisparityRange

CENSUS_RADIUS = 3
"""Rows and columns on every side of a census window: 7×7 pixels fit a signature of 64 bits."""

CENSUS_NOISE = np.float32(0.004)
"""A neighbour counts as brighter if it is so by more than one grey level of 8 bits (1/255)."""

COST_PER_CENSUS_BIT = np.float32(1.0 / 24.0)
"""Half of the 48 bits differ between unrelated windows, which is a cost of 1."""

OUT_OF_VIEW_COST = np.float32(0.6)
"""Cost where the second image shows nothing (outside or masked): worse than a match, better than a contradiction;
chosen by eye."""

MIN_TEXTURE_VARIANCE = 1e-4
"""Variance of the luminance in a window, which is (2.5/255)²: less texture decides nothing."""

INVALID_COST = np.float32(MAX_COST)
"""Cost of a surface behind the camera."""


class ColourCost(NamedTuple):
    """How colours count beside the census.

    Attributes:
        weight: of colour differences against the census, in [0, 1].
        scale: 1 / the sum of differences over three channels that costs 1.
    """

    weight: np.float32
    scale: np.float32

    @staticmethod
    def from_truncation(weight: float, truncation: float) -> "ColourCost":
        """From the weight and the mean difference of a channel at which the cost is truncated."""
        return ColourCost(np.float32(weight), np.float32(1.0 / (3.0 * truncation)))


class ReferenceImage(NamedTuple):
    """What the cost volume reads of the first image, row after row."""

    colours: Float[np.ndarray, "height width 3"]
    census: UInt64[np.ndarray, "height width"]


class CandidateImage(NamedTuple):
    """What the cost volume reads of the second image: column after column, as all candidates lie in one column."""

    colours: Float[np.ndarray, "3 width height"]
    census: UInt64[np.ndarray, "width height"]
    usable: Bool[np.ndarray, "width height"]


def census_transform(luminance: Float[np.ndarray, "height width"]) -> UInt64[np.ndarray, "height width"]:
    """Which of the 48 neighbours in 7×7 are brighter than each pixel, as bits; columns wrap, end rows repeat."""
    padded = np.pad(luminance, ((0, 0), (CENSUS_RADIUS, CENSUS_RADIUS)), mode="wrap").astype(np.float32, copy=False)
    signature = np.zeros(luminance.shape, np.uint64)
    run_ranges(partial(_census_rows, padded, signature), len(signature))
    return signature


@kernel()
def _census_rows(padded, signature, begin, end):  # type: ignore[no-untyped-def]
    height, width = signature.shape
    for row in range(begin, end):
        for i in range(-CENSUS_RADIUS, CENSUS_RADIUS + 1):
            r = min(max(row + i, 0), height - 1)
            for j in range(2 * CENSUS_RADIUS + 1):
                if i != 0 or j != CENSUS_RADIUS:
                    for col in range(width):
                        brighter = np.uint64(padded[r, col + j] > padded[row, col + CENSUS_RADIUS] + CENSUS_NOISE)
                        signature[row, col] = (signature[row, col] << np.uint64(1)) | brighter


def is_textured(image: Float[np.ndarray, "height width 3"]) -> Bool[np.ndarray, "height width"]:
    """Where the luminance varies within a window of the census."""
    luminance = luminance_of(image)
    side = 2 * CENSUS_RADIUS + 1
    blur = partial(cv2.blur, ksize=(side, side))
    mean = filter_across_seam(blur, luminance, CENSUS_RADIUS)
    square = filter_across_seam(blur, luminance * luminance, CENSUS_RADIUS)
    return np.asarray(square - mean * mean > MIN_TEXTURE_VARIANCE)


def cost_volume(
    first: Float[np.ndarray, "height width 3"],
    second: Float[np.ndarray, "height width 3"],
    second_usable: Bool[np.ndarray, "height width"],
    disparities: DisparityRange,
    colour_weight: float,
    colour_truncation: float,
) -> UInt16[np.ndarray, " costs"]:
    """Cost in [0, 1] of every disparity of the ranges, fixed-point, flat as :class:`DisparityRange` says.

    Args:
        first: RGB.
        second: RGB.
        second_usable: where the second image may be matched.
        disparities: what is tried.
        colour_weight: weight of the absolute colour difference against the census, in [0, 1].
        colour_truncation: the colour difference that costs 1.
    """
    own = ReferenceImage(first, census_transform(luminance_of(first)))
    other = CandidateImage(
        np.ascontiguousarray(second.transpose(2, 1, 0)),
        np.ascontiguousarray(census_transform(luminance_of(second)).T),
        np.ascontiguousarray(second_usable.T),
    )
    cost, colour = (
        np.empty(disparities.offsets[-1], np.uint16),
        ColourCost.from_truncation(colour_weight, colour_truncation),
    )
    run_ranges(
        partial(_fill_cost_volume, own, other, disparities.lowest, disparities.offsets, colour, cost),
        len(disparities.lowest),
    )
    return cost


def luminance_of(image: Float[np.ndarray, "height width 3"]) -> Float[np.ndarray, "height width"]:
    """The mean of the channels."""
    return np.asarray((image[..., 0] + image[..., 1] + image[..., 2]) / np.float32(3.0))


@kernel()
def _fill_cost_volume(first, second, lowest, offsets, colour, cost, begin, end):  # type: ignore[no-untyped-def]
    height, width = lowest.shape
    for row in range(begin, end):
        for col in range(width):
            at, r = offsets[row * width + col], row + lowest[row, col]
            own, bits = cost[at : offsets[row * width + col + 1]], first.census[row, col]
            red, green, blue = first.colours[row, col, 0], first.colours[row, col, 1], first.colours[row, col, 2]
            count = np.uint64(max(min(len(own), height - r), 0))  # unsigned, so that the loop vectorises
            reds, greens, blues = second.colours[0, col, r:], second.colours[1, col, r:], second.colours[2, col, r:]
            candidate_bits, candidate_usable = second.census[col, r:], second.usable[col, r:]
            for k in range(count):
                difference = abs(red - reds[k]) + abs(green - greens[k]) + abs(blue - blues[k])
                value = _combine_costs(bits ^ candidate_bits[k], difference, colour)
                own[k] = _to_fixed_point(value if candidate_usable[k] else OUT_OF_VIEW_COST)
            for k in range(count, np.uint64(len(own))):  # below the last row: beyond the other epipole
                own[k] = _to_fixed_point(OUT_OF_VIEW_COST)


@inlined()
def _to_fixed_point(cost):  # type: ignore[no-untyped-def]
    return np.uint16(np.int32(cost * np.float32(FIXED_POINT_SCALE) + np.float32(0.5)))


def surface_cost(
    first: Float[np.ndarray, "height width 3"],
    first_census: UInt64[np.ndarray, "height width"],
    second: Float[np.ndarray, "height width 3"],
    second_usable: Bool[np.ndarray, "height width"],
    disparity: Float[np.ndarray, "height width"],
    colour_weight: float,
    colour_truncation: float,
) -> Float[np.ndarray, "height width"]:
    """Cost in [0, 1] of one surface at every pixel.

    The second image is warped to the first one before windows are compared, so that they slant as the surface does.
    Where ``disparity`` (rows) is negative the surface is behind the camera: :data:`INVALID_COST`.
    """
    warped, seen = np.zeros_like(first), np.zeros(disparity.shape, np.bool_)
    run_ranges(partial(_warp_rows, second, second_usable, disparity, warped, seen), len(warped))
    differing_bits = first_census ^ census_transform(luminance_of(warped))
    cost, colour = np.empty(disparity.shape, np.float32), ColourCost.from_truncation(colour_weight, colour_truncation)
    run_ranges(partial(_surface_cost_rows, first, warped, differing_bits, disparity, seen, colour, cost), len(cost))
    return cost


@kernel()
def _warp_rows(second, second_usable, disparity, warped, seen, begin, end):  # type: ignore[no-untyped-def]
    height, width = disparity.shape
    for row in range(begin, end):
        for col in range(width):
            target = row + disparity[row, col]
            if disparity[row, col] >= 0 and target <= height - 1:
                r = min(int(target), height - 2)
                share = np.float32(target - r)
                seen[row, col] = second_usable[r, col] and second_usable[r + 1, col]
                for k in range(3):
                    warped[row, col, k] = (1 - share) * second[r, col, k] + share * second[r + 1, col, k]


@kernel()
def _surface_cost_rows(  # type: ignore[no-untyped-def]
    first, warped, differing_bits, disparity, seen, colour, cost, begin, end
):
    """Fills some rows of ``cost``.

    Args:
        first: RGB.
        warped: RGB of the second image where the surface says that it shows the same point.
        differing_bits: census bits that differ between the two.
        disparity: rows; negative behind the camera.
        seen: where ``warped`` holds usable pixels.
        colour: how colours count.
        cost: written.
        begin: first row.
        end: the row after the last.
    """
    for row in range(begin, end):
        for col in range(cost.shape[1]):
            if disparity[row, col] < 0:
                cost[row, col] = INVALID_COST
            elif not seen[row, col]:
                cost[row, col] = OUT_OF_VIEW_COST
            else:
                difference = np.float32(0.0)
                for k in range(3):
                    difference += abs(first[row, col, k] - warped[row, col, k])
                cost[row, col] = _combine_costs(differing_bits[row, col], difference, colour)


@inlined()
def _combine_costs(differing_bits, colour_difference, colour):  # type: ignore[no-untyped-def]
    """The cost of one match in [0, 1]: census and colour, each truncated at 1 and weighted."""
    census_cost = np.float32(_count_bits(differing_bits)) * COST_PER_CENSUS_BIT
    colour_cost = colour_difference * colour.scale
    census_weight = np.float32(1.0) - colour.weight
    return census_weight * min(census_cost, np.float32(1.0)) + colour.weight * min(colour_cost, np.float32(1.0))


@inlined()
def _count_bits(x):  # type: ignore[no-untyped-def]
    """Population count of 64 bits: sums of 2, 4 and 8 neighbouring bits side by side, then of all bytes."""
    x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (x * np.uint64(0x0101010101010101)) >> np.uint64(56)
