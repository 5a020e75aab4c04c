"""Matching costs: census signatures and colours compared, for a range of disparities or for one surface.

Source: Zabih and Woodfill, Non-parametric local transforms for computing visual correspondence, 1994.
"""

from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt16, UInt64

from omnisyn_cli.compute.arrays import empty, zeros
from omnisyn_cli.compute.jit import inlined, kernel, subkernel
from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.geometry.sampling import filter_across_seam
from omnisyn_cli.stereo.semi_global import FIXED_POINT_SCALE, MAX_COST, DisparityRange

CENSUS_RADIUS = 3  # rows and columns on every side of a census window: 7×7 pixels fit a signature of 64 bits
# A neighbour counts as brighter if it is so by more than one grey level of 8 bits (1/255).
CENSUS_NOISE = np.float32(0.004)
# Half of the 48 bits differ between unrelated windows, which is a cost of 1.
COST_PER_CENSUS_BIT = np.float32(1.0 / 24.0)

# Cost where the second image shows nothing (outside or masked): worse than a match, better than a contradiction; chosen
# by eye.
OUT_OF_VIEW_COST = np.float32(0.6)
HALF_CENSUS_BITS = np.uint64(24)  # signatures are made and compared in two halves
MIN_TEXTURE_VARIANCE = 1e-4  # variance of the luminance in a window, which is (2.5/255)²: less texture decides nothing
INVALID_COST = np.float32(MAX_COST)  # cost of a surface behind the camera


class ColourCost(NamedTuple):
    """How colours count beside the census."""

    weight: np.float32  # against the census, in [0, 1]
    scale: np.float32  # 1 / the sum of differences over three channels that costs 1

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


class WarpedImage(NamedTuple):
    """What a surface is compared with: the second image, row after row."""

    colours: Float[np.ndarray, "height width 3"]
    usable: Bool[np.ndarray, "height width"]


def census_transform(luminance: Float[np.ndarray, "height width"]) -> UInt64[np.ndarray, "height width"]:
    """Which of the 48 neighbours in 7×7 are brighter than each pixel, as bits; columns wrap, end rows repeat."""
    padded = np.pad(luminance, ((0, 0), (CENSUS_RADIUS, CENSUS_RADIUS)), mode="wrap").astype(np.float32, copy=False)
    signature = np.empty(luminance.shape, np.uint64)
    run_ranges(partial(_census_rows, padded, signature), len(signature))
    return signature


@kernel()
def _census_rows(padded, signature, begin, end):  # type: ignore[no-untyped-def]
    buffers = _census_buffers(signature.shape[1])
    for row in range(begin, end):
        _census_of_row(padded, row, 0, buffers, signature[row])


@inlined()
def _census_buffers(width):  # type: ignore[no-untyped-def]
    """Of one row: what is brighter than a pixel, and bits of the neighbours before it and after it."""
    return empty(width, np.float32), empty(width, np.uint32), empty(width, np.uint32)


@subkernel()
def _census_of_row(padded, row, left, buffers, signature):  # type: ignore[no-untyped-def]
    """Fills signatures of a row from a column on, in halves of 32 bits: a processor compares twice as many at once."""
    count = len(signature)
    threshold, before, after = buffers[0][:count], buffers[1][:count], buffers[2][:count]
    own, last = padded[row, left:], len(padded) - 1
    centre = own[CENSUS_RADIUS:]
    for col in range(np.uint64(len(signature))):
        threshold[col] = centre[col] + CENSUS_NOISE
        before[col] = after[col] = np.uint32(0)
    _append_seven(padded[max(row - 3, 0), left:], threshold, before)
    _append_seven(padded[max(row - 2, 0), left:], threshold, before)
    _append_seven(padded[max(row - 1, 0), left:], threshold, before)
    _append_three(own, threshold, before)
    _append_three(own[CENSUS_RADIUS + 1 :], threshold, after)
    _append_seven(padded[min(row + 1, last), left:], threshold, after)
    _append_seven(padded[min(row + 2, last), left:], threshold, after)
    _append_seven(padded[min(row + 3, last), left:], threshold, after)
    for col in range(np.uint64(len(signature))):
        signature[col] = (np.uint64(before[col]) << HALF_CENSUS_BITS) | np.uint64(after[col])


@subkernel()
def _append_seven(values, threshold, bits):  # type: ignore[no-untyped-def]
    """Whether each of seven values from every column on is brighter; unrolled by hand, else it is not vectorised."""
    second, third, fourth, fifth, sixth, last = values[1:], values[2:], values[3:], values[4:], values[5:], values[6:]
    for col in range(np.uint64(len(bits))):  # an index without a sign is not tested for counting from the end
        least = threshold[col]
        three = _appended(_appended(_appended(bits[col], values[col], least), second[col], least), third[col], least)
        five = _appended(_appended(three, fourth[col], least), fifth[col], least)
        bits[col] = _appended(_appended(five, sixth[col], least), last[col], least)


@subkernel()
def _append_three(values, threshold, bits):  # type: ignore[no-untyped-def]
    """The same of three values."""
    second, last = values[1:], values[2:]
    for col in range(np.uint64(len(bits))):
        two = _appended(_appended(bits[col], values[col], threshold[col]), second[col], threshold[col])
        bits[col] = _appended(two, last[col], threshold[col])


@inlined()
def _appended(bits, value, threshold):  # type: ignore[no-untyped-def]
    return np.uint32(bits << np.uint32(1)) | np.uint32(value > threshold)


def is_textured(image: Float[np.ndarray, "height width 3"]) -> Bool[np.ndarray, "height width"]:
    """Where the luminance varies within a window of the census."""
    luminance = luminance_of(image)
    side = 2 * CENSUS_RADIUS + 1
    blur = partial(cv2.blur, ksize=(side, side))
    mean = filter_across_seam(blur, luminance, CENSUS_RADIUS)
    square = filter_across_seam(blur, luminance * luminance, CENSUS_RADIUS)
    return np.asarray(square - mean * mean > MIN_TEXTURE_VARIANCE)


def cost_volume(
    first: Float[np.ndarray, "height width 3"], second: Float[np.ndarray, "height width 3"],
    second_usable: Bool[np.ndarray, "height width"], disparities: DisparityRange, colour_weight: float,
    colour_truncation: float,
) -> UInt16[np.ndarray, " costs"]:  # fmt: skip
    """Cost in [0, 1] of every disparity of the ranges, fixed-point, flat as :class:`DisparityRange` says.

    Images are RGB, and ``second_usable`` says where the second one may be matched. Absolute colour differences count by
    ``colour_weight`` in [0, 1] against the census; ``colour_truncation`` is the difference that costs 1.
    """
    own = ReferenceImage(first, census_transform(luminance_of(first)))
    other = CandidateImage(
        np.ascontiguousarray(second.transpose(2, 1, 0)),
        np.ascontiguousarray(census_transform(luminance_of(second)).T),
        np.ascontiguousarray(second_usable.T),
    )
    cost = np.empty(disparities.offsets[-1], np.uint16)
    colour = ColourCost.from_truncation(colour_weight, colour_truncation)
    fill = partial(_fill_cost_volume, own, other, disparities.lowest, disparities.offsets, colour, cost)
    run_ranges(fill, len(disparities.lowest))
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
    first: Float[np.ndarray, "height width 3"], first_census: UInt64[np.ndarray, "height width"],
    second: Float[np.ndarray, "height width 3"], second_usable: Bool[np.ndarray, "height width"],
    disparity: Float[np.ndarray, "height width"], colour_weight: float, colour_truncation: float,
) -> Float[np.ndarray, "height width"]:  # fmt: skip
    """Cost in [0, 1] of one surface at every pixel.

    The second image is warped to the first one before windows are compared, so that they slant as the surface does.
    Where ``disparity`` (rows) is negative the surface is behind the camera: :data:`INVALID_COST`.
    """
    cost, colour = np.empty(disparity.shape, np.float32), ColourCost.from_truncation(colour_weight, colour_truncation)
    own, other = ReferenceImage(first, first_census), WarpedImage(second, second_usable)
    run_ranges(partial(_surface_cost_rows, own, other, disparity, colour, cost), len(cost))
    return cost


@kernel()
def _surface_cost_rows(first, second, disparity, colour, cost, begin, end):  # type: ignore[no-untyped-def]
    """Fills rows of ``cost``: ``second`` is warped by ``disparity`` (rows; negative behind the camera) to ``first``."""
    height, width = disparity.shape
    top, bottom = max(begin - CENSUS_RADIUS, 0), min(end + CENSUS_RADIUS, height)
    luminance = zeros((bottom - top, width + 2 * CENSUS_RADIUS), np.float32)  # 0 where the second image shows nothing
    difference = empty((bottom - top, width), np.float32)
    seen = empty((bottom - top, 2), np.int64)
    for row in range(top, bottom):
        out = luminance[row - top], difference[row - top], seen[row - top]
        _warp_row(first.colours[row], second, disparity[row], row, *out)
    buffers, signature = _census_buffers(width), empty(width, np.uint64)
    for row in range(begin, end):
        left, right = seen[row - top]
        if left < right:
            _census_of_row(luminance, row - top, left, buffers, signature[left:right])
        for col in range(np.uint64(width)):
            differs = difference[row - top, col]
            value = _combine_costs(first.census[row, col] ^ signature[col], differs, colour)
            value = value if differs >= 0 else OUT_OF_VIEW_COST
            cost[row, col] = value if disparity[row, col] >= 0 else INVALID_COST


@inlined()
def _warp_row(own, second, disparity, row, luminance, difference, seen):  # type: ignore[no-untyped-def]
    """Fills a row of the warped image, by disparities in rows.

    ``luminance`` gets columns from beyond the seam; ``difference`` is that of the colours, −1 where nothing is
    compared; ``seen`` the first column where something is compared, and the one after the last.
    """
    height, width = second.usable.shape
    seen[0], seen[1] = width, 0
    for col in range(width):
        target = row + disparity[col]
        difference[col] = -1.0
        if disparity[col] >= 0 and target <= height - 1:
            r = min(int(target), height - 2)
            share = np.float32(target - r)
            upper, lower = second.colours[r, col], second.colours[r + 1, col]
            red = np.float32((1 - share) * upper[0] + share * lower[0])
            green = np.float32((1 - share) * upper[1] + share * lower[1])
            blue = np.float32((1 - share) * upper[2] + share * lower[2])
            luminance[col + CENSUS_RADIUS] = (red + green + blue) / np.float32(3.0)
            if second.usable[r, col] and second.usable[r + 1, col]:
                seen[0], seen[1] = min(seen[0], col), col + 1
                difference[col] = abs(own[col, 0] - red) + abs(own[col, 1] - green) + abs(own[col, 2] - blue)
    for k in range(CENSUS_RADIUS):
        luminance[CENSUS_RADIUS - 1 - k] = luminance[CENSUS_RADIUS + (width - 1 - k) % width]
        luminance[width + CENSUS_RADIUS + k] = luminance[CENSUS_RADIUS + k % width]


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
