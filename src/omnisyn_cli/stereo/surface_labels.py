"""Which surface every pixel lies on: one of the large planes, infinity, what is expected, or the semi-global match.

Planes carry depth over untextured areas, and their windows slant as the plane does. Only so do floors under the camera
match at all.

Source: the labelling idea of Sinha et al., Piecewise planar stereo for image-based rendering, 2009.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt16

from omnisyn_cli.geometry.resize import resize_area
from omnisyn_cli.stereo.costs import census_transform, is_textured, luminance_of, surface_cost
from omnisyn_cli.stereo.disparity import DisparityMap, MatchingOptions, least_ground_disparity
from omnisyn_cli.stereo.plane_fitting import planes_from_second
from omnisyn_cli.stereo.plane_sweep import EXPLAINED_COST, plane_disparity
from omnisyn_cli.stereo.rectify import EpipolarGrid, RectifiedPair
from omnisyn_cli.stereo.semi_global import IMPOSSIBLE_COST, DisparityRange, aggregate_costs, to_fixed_point

NOT_VISIBLE_DISPARITY = np.float32(-1.0)  # disparity of a surface that a pixel cannot show
# The support of a plane is spread by a Gaussian of 1/24 of the height (7.5°); chosen by eye.
PLANE_SUPPORT_SIGMAS_PER_HEIGHT = 24.0
FULL_PLANE_SUPPORT_DENSITY = 0.05  # share of supporting points around a pixel that counts fully; chosen by eye
DENSITY_ROWS = 64  # rows of the masks that are blurred: 2.8° each, where the blur spreads over 7.5°

# Share of the texture around a pixel from which on a plane that explains it is fully supported. Windows that do not
# belong together hardly ever agree by chance.
FULL_EXPLAINED_SHARE = 0.1
MIN_SKY_EPIPOLE_SINE = 0.35  # sine of the angle to an epipole (20°) from which on static texture means that it is far
MIN_STATIC_TEXTURE_SHARE = 0.02  # of the upper half, for the sky to be open; chosen by eye
LEVEL_PLANE_COSINE = 0.97  # cosine of the tilt (14°) up to which a plane counts as floor or ceiling; chosen by eye
MIN_LEVEL_INVERSE_DISTANCE = 0.03  # in 1/baselines: floors and ceilings farther away bound nothing; chosen by eye
# A surface is beyond the floor if its disparity is lower than at 85 % of the floor's inverse depth, less one row.
LEVEL_BOUND_SHARE, LEVEL_BOUND_SLACK_ROWS = 0.85, 1.0

# Logarithms of the factors of inverse depth at which what is expected is a candidate, and its extra cost. (Eight of 23
# generated walks have it, and gain 0.3 dB in the mean.)
EXPECTED_LOG_FACTORS, EXPECTED_BIAS = np.array([-0.3, -0.15, 0.0, 0.15, 0.3], np.float32), 0.1


class CandidatePlanes(NamedTuple):
    """Planes that pixels may lie on, best supported first."""

    normals: Float[np.ndarray, "planes 3"]  # as long as the inverse distance (1/baselines)
    is_measured: Bool[np.ndarray, " planes"]  # in the images, as swept and expected ones; others are fitted to matches

    def seen_by_second(self) -> "CandidatePlanes":
        """Those that the second camera sees, in the frame of the reversed pair."""
        normals = planes_from_second(self.normals)
        is_seen = np.isfinite(normals).all(axis=-1)
        return CandidatePlanes(normals[is_seen], self.is_measured[is_seen])


def label_surfaces(
    pair: RectifiedPair, matches: DisparityMap, candidates: CandidatePlanes, options: MatchingOptions
) -> DisparityMap:
    """The surface that explains each pixel best, given left-right consistent matches of the first image and planes.

    A plane is valid also where there is no texture; a match is not.
    """
    grid, planes = pair.grid, candidates.normals
    # Above the horizon and away from the epipoles no parallax means infinity. Texture without any there is static:
    # clouds, or what stands at the horizon.
    can_show_infinity = (grid.sin_elevation > 0) & (np.sin(grid.polar_angle) > MIN_SKY_EPIPOLE_SINE)
    is_static = matches.valid & can_show_infinity & (matches.disparity < 1.0)
    is_sky_open = bool(is_static.sum() > MIN_STATIC_TEXTURE_SHARE * can_show_infinity.sum())
    disparities = _candidate_disparities(pair, matches, planes, options, is_sky_open=is_sky_open)
    bound, support = _floor_and_ceiling_bound(grid, planes, is_sky_open=is_sky_open), PlaneSupport.of(pair, matches)

    def bias(k: int, cost: np.ndarray) -> np.ndarray:
        if k == 0:
            return np.where(matches.valid, options.valid_match_bias, options.invalid_match_bias)
        if k > len(planes) + is_sky_open:
            return np.full(cost.shape, EXPECTED_BIAS)
        if k > len(planes):
            known = _smoothed_support(is_static)
        else:
            known = support.around(planes[k - 1], bool(candidates.is_measured[k - 1]), cost)
        return options.unsupported_plane_penalty * (1.0 - known)

    costs, luminance = np.empty((*pair.size, len(disparities)), np.uint16), luminance_of(pair.first)
    signature, colour = census_transform(luminance), (options.colour_weight, options.colour_truncation)
    for k, disparity in enumerate(disparities):  # costs of all of them would not fit the cache of a processor
        cost = surface_cost(pair.first, signature, pair.second, pair.second_usable, disparity, *colour)
        own_bias = bias(k, cost)
        cost += options.outside_floor_ceiling_penalty * (disparities[k] < bound)
        if pair.prior is not None:
            cost += pair.prior.cost(disparities[k])
        costs[..., k] = to_fixed_point(cost + own_bias)
    label = _select_labels(costs, luminance, disparities, options)
    disparity = np.take_along_axis(disparities, label[None], axis=0)[0]
    return DisparityMap(disparity, pair.first_usable & ((label > 0) | matches.valid))


def _select_labels(
    costs: UInt16[np.ndarray, "height width candidates"], luminance: np.ndarray, disparities: np.ndarray,
    options: MatchingOptions,
) -> Int[np.ndarray, "height width"]:  # fmt: skip
    """The index of the best candidate of each pixel: semi-global matching over labels, which have no order."""
    labels = DisparityRange.from_bounds(np.zeros(luminance.shape, np.int32), len(disparities) - 1)
    penalty = options.label_penalty
    total = aggregate_costs(costs.ravel(), labels, luminance, penalty, penalty, options.label_contrast)
    total = total.reshape(costs.shape)
    for k, disparity in enumerate(disparities):
        total[..., k][disparity < 0] = IMPOSSIBLE_COST
    return np.asarray(total.argmin(axis=-1))


def _candidate_disparities(
    pair: RectifiedPair, matches: DisparityMap, planes: np.ndarray, options: MatchingOptions, *, is_sky_open: bool
) -> Float32[np.ndarray, "candidates height width"]:
    """Disparities of the matches, of the planes, of infinity if the sky is open, and of the prior at a few scales."""
    grid, lowest = pair.grid, least_ground_disparity(pair.grid, options)
    surfaces = [plane_disparity(grid, normal) for normal in planes]
    if is_sky_open:
        surfaces.append(np.where(grid.sin_elevation > 0, 0.0, NOT_VISIBLE_DISPARITY))
    if pair.priors is not None and pair.are_priors_candidates:
        expected = np.square(pair.priors[0].sqrt_inv_depth)
        surfaces += [grid.disparity(factor * expected) for factor in np.exp(EXPECTED_LOG_FACTORS)]
    possible = [np.where(surface < lowest, NOT_VISIBLE_DISPARITY, surface) for surface in surfaces]
    return np.stack([matches.disparity, *possible]).astype(np.float32)


class PlaneSupport(NamedTuple):
    """What speaks for planes: matches on them, and for measured planes texture that they explain."""

    size: tuple[int, int]  # of the image
    # of those with a valid match
    pixels: Int[np.ndarray, " matches"]
    directions: Float[np.ndarray, "matches 3"]
    inverse_depth: Float[np.ndarray, " matches"]
    tolerance: Float[np.ndarray, " matches"]
    # where there is texture, and how much of it is around each pixel
    textured: Bool[np.ndarray, "height width"]
    texture: Float32[np.ndarray, "height width"]

    @staticmethod
    def of(pair: RectifiedPair, matches: DisparityMap) -> "PlaneSupport":
        """What speaks for the planes of a pair."""
        grid, textured, (row, col) = pair.grid, is_textured(pair.first), np.nonzero(matches.valid)
        disparity = matches.disparity[row, col]
        return PlaneSupport(
            pair.size, np.flatnonzero(matches.valid), grid.directions[row, col], grid.inverse_depth(disparity, row),
            grid.inverse_depth_per_row(disparity, row), textured,
            np.maximum(_density(textured), FULL_PLANE_SUPPORT_DENSITY),
        )  # fmt: skip

    def around(
        self, normal: Float[np.ndarray, " 3"], is_measured: bool, cost: Float32[np.ndarray, "height width"]
    ) -> Float32[np.ndarray, "height width"]:
        """How much speaks for a plane around every pixel, in [0, 1].

        Texture does for a measured plane only: a fitted one would find such texture by chance.
        """
        is_on_plane = np.zeros(self.size, bool)
        is_on_plane.ravel()[self.pixels] = np.abs(self.directions @ normal - self.inverse_depth) < self.tolerance
        by_matches = _smoothed_support(is_on_plane)
        if not is_measured:
            return by_matches
        share = _density(self.textured & (cost < EXPLAINED_COST)) / self.texture
        return np.asarray(np.maximum(by_matches, np.minimum(share / FULL_EXPLAINED_SHARE, 1.0)))


def _smoothed_support(mask: np.ndarray) -> Float32[np.ndarray, "height width"]:
    """1 among pixels of a mask, falling to 0 some 10° away."""
    return np.asarray(np.minimum(_density(mask) / FULL_PLANE_SUPPORT_DENSITY, 1.0))


def _density(mask: np.ndarray) -> Float32[np.ndarray, "height width"]:
    """Share of the pixels around each one that are in a mask."""
    height, width = mask.shape
    rows = min(DENSITY_ROWS, height)
    small = np.tile(resize_area(mask.astype(np.float32), (rows, 2 * rows)), 2)  # two turns, so that the seam is inside
    blurred = cv2.GaussianBlur(small, (0, 0), sigmaX=rows / PLANE_SUPPORT_SIGMAS_PER_HEIGHT)
    large = cv2.resize(blurred, (2 * width, height))
    return np.concatenate([large[:, width : width + width // 2], large[:, width // 2 : width]], axis=1)


def _floor_and_ceiling_bound(
    grid: EpipolarGrid, planes: np.ndarray, *, is_sky_open: bool
) -> Float32[np.ndarray, "height width"]:
    """Disparity below which a pixel is clearly farther than the floor or, unless the sky is open, the ceiling."""
    bound = np.full(grid.directions.shape[:2], NOT_VISIBLE_DISPARITY, np.float32)
    for side in (-1.0,) if is_sky_open else (-1.0, 1.0):
        for normal in planes:  # the best supported one first
            inverse_distance = float(np.linalg.norm(normal))
            is_level = side * (normal @ grid.up) > LEVEL_PLANE_COSINE * inverse_distance
            if is_level and inverse_distance > MIN_LEVEL_INVERSE_DISTANCE:
                lowered = grid.disparity(LEVEL_BOUND_SHARE * (grid.directions @ normal)) - LEVEL_BOUND_SLACK_ROWS
                bound = np.maximum(bound, lowered)
                break
    return bound
