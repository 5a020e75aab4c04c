"""Disparity maps of a rectified pair: semi-global matching in either direction, and the left-right check of both."""

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt16

from omnisyn_cli.compute.jit import fast_kernel
from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sweep import swap_cameras_in_epipole_frame
from omnisyn_cli.geometry.tolerances import LEFT_RIGHT_TOLERANCE
from omnisyn_cli.stereo.costs import cost_volume, is_textured, luminance_of
from omnisyn_cli.stereo.descriptor_costs import add_to_volume
from omnisyn_cli.stereo.rectify import EpipolarGrid, RectifiedPair, rectify
from omnisyn_cli.stereo.semi_global import DisparityRange, aggregate_costs, uniqueness_margin, winner_takes_all
from omnisyn_cli.types import View

# Impossible disparities that are tried all the same: what has no match takes these, not the least wrong possible one.
# (Without them the shadow of a lamp on an untextured road fell to pieces.)
ROWS_BEYOND_EPIPOLE = 4
# A winner this close to the least possible disparity may have wanted to go below it, so it is not valid.
DISPARITY_BOUND_SLACK_ROWS = 1.5
# Sine of the angle below the horizon (10°) where the bound on the ground's distance begins: ground may slope away;
# chosen by eye.
GROUND_BOUND_MIN_SINE = 0.17
# Rows by which disparities of neighbouring rows may differ and still be one surface to interpolate on.
# (With more, noise confirms itself: the shadow of a lamp on an untextured road fell to pieces.)
MAX_INTERPOLATED_STEP = 2.0
# Degrees from an epipole: within the first nothing is measurable; within the second near things hardly move either, so
# no parallax does not mean infinity. Chosen by eye.
EPIPOLE_BLIND_DEG, EPIPOLE_NO_INFINITY_DEG = 4.0, 20.0


@dataclass(frozen=True)
class MatchingOptions:
    """Parameters of semi-global matching and plane labelling.

    Costs and penalties are in units of the matching cost: 0 is a perfect match, 1 an unrelated window. Unless said
    otherwise the defaults were tuned by hand on ray-traced warehouses.
    """

    size: tuple[int, int] = (512, 1024)  # ``(height, width)`` of the estimates; matching runs at half of it
    # radians. On a path halfway between the cameras a surface that passes at a perpendicular distance of h baselines
    # has a parallax of ``2·atan(1 / 2h)``.
    max_parallax: float = math.radians(112.0)
    # baselines above the ground. It bounds the disparity below the horizon from below: shading that moves with the
    # camera otherwise passes for infinitely far ground.
    max_camera_height: float = 10.0
    colour_weight: float = 0.5  # weight of colour differences against the census, in [0, 1]
    # the same where much of a picture was clipped at white. (In a white hall one stop more costs 0.8 dB with it and 2.3
    # dB without.)
    clipped_colour_weight: float = 0.1
    colour_truncation: float = 0.1  # colour difference that counts as a contradiction
    # penalties of semi-global matching for disparity changes by one row and by more
    p1: float = 0.1
    p2: float = 3.0
    p2_contrast: float = 0.05  # grey difference that halves P2
    min_margin: float = 0.2  # least margin of the aggregated cost over the best rival for a valid disparity
    # least margin of the pixel's own cost for a match to propose planes: repeating tiles of a ceiling agree about a
    # plane that is not there
    min_uniqueness: float = 0.05
    max_planes: int = 24  # fitted planes per pair
    min_plane_support: float = 0.004  # least share of the matched solid angle of both panoramas that a plane explains
    # as ``p2`` and ``p2_contrast``, between surface labels
    label_penalty: float = 3.0
    label_contrast: float = 0.15
    # extra cost of the semi-global match against a plane, where it is valid and where it is not
    valid_match_bias: float = 0.15
    invalid_match_bias: float = 0.5
    # extra cost of a plane far from every point that it was fitted to, and of infinity far from static texture: a
    # ceiling is not the sky because a window shows some
    unsupported_plane_penalty: float = 0.2
    outside_floor_ceiling_penalty: float = 0.3  # extra cost of a surface below the floor or above a ceiling
    # rows by which both directions may differ, for far and for near things
    left_right_rows: float = 1.0
    near_left_right_rows: float = 2.0


@dataclass(frozen=True)
class DisparityMap:
    """Disparities from one panorama to the other."""

    disparity: Float[np.ndarray, "height width"]  # rows
    valid: Bool[np.ndarray, "height width"]  # where matching decided clearly; the other values are guesses
    unique: Bool[np.ndarray, "height width"] | None = None  # where nothing matches nearly as well; None: not measured


class LeftRightTolerance(NamedTuple):
    """Rows by which both directions may differ: ``share · disparity``, but at least ``far`` and at most ``near``."""

    far: float
    near: float  # without it anything passed for agreement on an untextured road
    share: float


def match_disparities(
    pair: RectifiedPair, disparities: DisparityRange, options: MatchingOptions, *, is_complete_range: bool
) -> tuple[DisparityMap, UInt16[np.ndarray, " costs"]]:
    """Cost volume with the prior, semi-global matching and winner-takes-all over the given ranges; also the costs.

    ``is_complete_range`` says that no other disparities exist.
    """
    cost = cost_volume(
        pair.first, pair.second, pair.second_usable, disparities, options.colour_weight, options.colour_truncation
    )
    add_to_volume(cost, pair, disparities)
    if pair.prior is not None:
        pair.prior.add_to(cost, disparities)
    luminance = luminance_of(pair.first)
    total = aggregate_costs(cost, disparities, luminance, options.p1, options.p2, options.p2_contrast)
    disparity, margin = winner_takes_all(total, disparities, is_complete_range=is_complete_range)
    return DisparityMap(disparity, (margin > options.min_margin) & pair.first_usable), cost


def match_all_disparities(pair: RectifiedPair, options: MatchingOptions) -> DisparityMap:
    """Semi-global matching over all possible disparities."""
    lowest = least_ground_disparity(pair.grid, options)
    disparities = _possible_disparities(lowest, options)
    matches, cost = match_disparities(pair, disparities, options, is_complete_range=True)
    is_at_bound = (lowest > 0) & (matches.disparity <= lowest + DISPARITY_BOUND_SLACK_ROWS)
    unique = uniqueness_margin(cost, disparities, matches.disparity) > options.min_uniqueness
    return replace(matches, valid=matches.valid & ~is_at_bound, unique=unique)


def least_ground_disparity(grid: EpipolarGrid, options: MatchingOptions) -> Float[np.ndarray, "height width"]:
    """Disparity of ground that lies ``max_camera_height`` below the camera; 0 at and above the horizon."""
    sin_depression = np.maximum(-grid.sin_elevation - GROUND_BOUND_MIN_SINE, 0.0)
    return grid.disparity(sin_depression / options.max_camera_height)


def _possible_disparities(lowest: np.ndarray, options: MatchingOptions) -> DisparityRange:
    """From the least disparity of every pixel to the largest parallax, and at most a little beyond the epipole."""
    height = lowest.shape[0]
    largest = max(1, math.ceil(options.max_parallax / math.pi * height) - 1)
    to_epipole = np.arange(height - 1 + ROWS_BEYOND_EPIPOLE, ROWS_BEYOND_EPIPOLE - 1, -1)
    highest = np.minimum(largest, to_epipole)[:, None]
    begin = np.clip(np.ceil(lowest), 0, highest).astype(np.int32)
    return DisparityRange.from_bounds(begin, np.broadcast_to(highest, lowest.shape).astype(np.int32))


def left_right_check(
    maps: tuple[DisparityMap, DisparityMap], far_rows: float, near_rows: float | None = None
) -> tuple[DisparityMap, DisparityMap]:
    """Both maps, each in its own direction's frame, with only those disparities valid that the other one confirms.

    They may differ by ``far_rows``, and where disparities are large by ``near_rows``; None makes no difference.
    """
    tolerance = LeftRightTolerance(far_rows, near_rows or far_rows, LEFT_RIGHT_TOLERANCE)
    first, second = (
        replace(own, valid=own.valid & _is_left_right_consistent(own.disparity, other.disparity, tolerance))
        for own, other in (maps, maps[::-1])
    )
    return first, second


def _is_left_right_consistent(
    disparity: np.ndarray, other: np.ndarray, tolerance: LeftRightTolerance
) -> Bool[np.ndarray, "height width"]:
    """Whether the other direction points back to (nearly) the same pixel.

    A match lies between two rows of the other map. Near surfaces are foreshortened in one of the images, where the
    disparity changes a lot from row to row. So the other map is interpolated, unless an edge lies between the rows.
    """
    out = np.empty(disparity.shape, np.bool_)
    swapped = swap_cameras_in_epipole_frame(other)
    run_ranges(partial(_check_left_right_rows, disparity, swapped, tolerance, MAX_INTERPOLATED_STEP, out), len(out))
    return out


@fast_kernel()
def _check_left_right_rows(disparity, other, tolerance, max_step, out, begin, end):  # type: ignore[no-untyped-def]
    height, width = disparity.shape
    for row in range(begin, end):
        for col in range(width):
            value = disparity[row, col]
            target = row + value
            above = min(max(math.floor(target), 0), height - 2)
            share = min(max(target - above, 0.0), 1.0)
            upper, lower = other[above, col], other[above + 1, col]
            found = upper if share < 0.5 else lower
            if abs(lower - upper) <= max_step:
                found = upper + share * (lower - upper)
            allowed = min(max(tolerance.share * value, tolerance.far), tolerance.near)
            out[row, col] = target <= height - 1 and abs(found - value) <= allowed


def is_measurable(grid: EpipolarGrid, disparity: np.ndarray) -> Bool[np.ndarray, "height width"]:
    """Not next to an epipole, and no claim of infinity in the wider surroundings of one."""
    is_infinity_known = grid.is_away_from_epipoles(EPIPOLE_NO_INFINITY_DEG)
    return np.asarray(grid.is_away_from_epipoles(EPIPOLE_BLIND_DEG) & ((disparity >= 1.0) | is_infinity_known))


AGREEMENT_ROWS = 128  # of a pair that is matched for its pose alone: a twentieth of a second
# Disparity from which on a match speaks for a direction: what is far matches whatever the direction.
MIN_PARALLAX_ROWS = 1.5


def dense_agreement(first: View, second: View, first_from_second: Pose) -> float:
    """Share of the texture of both panoramas, by solid angle, that has consistent matches with parallax.

    Repeated things, such as the goods on a shelf, can make sparse matches support a direction and its opposite equally
    well. Dense matches tell the two apart: on 28 generated and ray-traced pairs the true direction has 1.5 to 13 times
    as many as the opposite one. Their own poses do not matter; ``first_from_second`` is of two positions.
    """
    posed = View(first.image, Pose.identity(), first.mask), View(second.image, first_from_second, second.mask)
    options = MatchingOptions(size=(2 * AGREEMENT_ROWS, 4 * AGREEMENT_ROWS))
    pair = rectify(*posed, (AGREEMENT_ROWS, 2 * AGREEMENT_ROWS))
    pairs = pair, pair.reversed()
    matches = match_all_disparities(pairs[0], options), match_all_disparities(pairs[1], options)
    shares = []
    for each, found in zip(pairs, left_right_check(matches, options.left_right_rows), strict=True):
        texture = np.sin(each.grid.polar_angle) * (is_textured(each.first) & each.first_usable)
        agrees = found.valid & (found.disparity >= MIN_PARALLAX_ROWS)
        shares.append(float((texture * agrees).sum() / max(float(texture.sum()), 1e-9)))
    return 0.5 * sum(shares)
