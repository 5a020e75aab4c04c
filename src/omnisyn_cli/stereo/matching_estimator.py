"""Depth of a pair without a network: semi-global matching, planes, and filling.

:meth:`MatchingDepthEstimator.features` names the stages, each in a module of its own.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.compute.threads import both, limited_threads
from omnisyn_cli.geometry.pose import at_same_position, distance_between
from omnisyn_cli.geometry.regions import connected_regions
from omnisyn_cli.geometry.resize import resize_area
from omnisyn_cli.geometry.sphere import pixel_directions, solid_angles
from omnisyn_cli.geometry.sweep import motion_in_baselines
from omnisyn_cli.stereo.costs import is_textured
from omnisyn_cli.stereo.descriptor_costs import DescriptorModel, with_descriptors
from omnisyn_cli.stereo.disparity import (
    EPIPOLE_NO_INFINITY_DEG,
    DisparityMap,
    MatchingOptions,
    is_measurable,
    left_right_check,
    match_all_disparities,
)
from omnisyn_cli.stereo.expected_depth import Matches, PairPrior, at_best_scale, expected_planes, median_disagreement
from omnisyn_cli.stereo.filling import fill_with_planes
from omnisyn_cli.stereo.map_filters import joint_upsample, remove_speckles
from omnisyn_cli.stereo.plane_fitting import PlanePoints, find_planes
from omnisyn_cli.stereo.plane_sweep import sweep_directions, sweep_planes
from omnisyn_cli.stereo.rectify import MAX_INVERSE_DEPTH, RectifiedPair, rectify, usable_pixels
from omnisyn_cli.stereo.stereo_features import StereoFeatures
from omnisyn_cli.stereo.surface_labels import CandidatePlanes, label_surfaces
from omnisyn_cli.types import DepthEstimate, View

__all__ = ["INCONSISTENT_MATCH_WEIGHT", "MatchingDepthEstimator", "MatchingOptions"]

# Weight in filling of a disparity that only one direction found, against 1 for a consistent one; chosen by eye.
INCONSISTENT_MATCH_WEIGHT = 0.002
MAX_WALL_TILT_SINE = 0.1  # sine of the tilt (6°) up to which a fitted plane is a wall that says how the room is turned
# A pair is narrow if matches are consistent in 60 % of the texture that is 15° or more below the horizon, and above.
# Walks of 1 m through generated rooms and streets are, walks of 3 m are not.
STEEP_SINE, NARROW_MATCHED_SHARE = 0.26, 0.6
SAME_PLANE_TOLERANCE = 0.03  # difference of two normals, relative to their length: less than a row of disparity
# Of the logarithm of inverse depth, between a prior and consistent matches: from there on they contradict each other.
# (Six of nine pairs of real tours do, and three of 23 generated walks.)
MAX_MEDIAN_DISAGREEMENT = 0.5
MIN_SCALED_DISAGREEMENT = 0.2  # likewise: up to there matches correct a prior's scale, beyond it descriptors do first

FeaturesPair = tuple[StereoFeatures, StereoFeatures]


@dataclass(frozen=True)
class MatchingDepthEstimator:
    """Inverse depth of both panoramas of a pair by classical stereo; a :class:`~omnisyn_cli.types.DepthEstimator`.

    Estimates have ``options.size`` whatever the size of the images. The sky is 0. Near the two epipoles, where nothing
    can be measured, and where only one view sees, values are extrapolated from the surroundings with a confidence of 0.
    Panoramas from one position have no parallax: everything is then 0 with confidence 0.
    """

    options: MatchingOptions = field(default_factory=MatchingOptions)  # of matching
    threads: int | None = None  # at most this many; None = a core each. The result does not depend on it.
    descriptors: DescriptorModel | None = None  # of a network, for the costs of matches; None compares windows alone
    prior: PairPrior | None = None  # asks a network what to expect; None leaves it out

    def __call__(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        """Estimates for ``first`` and for ``second``, each in its own frame; ImageError for a panorama not 2:1."""
        for view in (first, second):
            view.check_shape()
        if at_same_position(first.pose, second.pose):
            return self._no_depth(), self._no_depth()
        baseline = distance_between(first.pose, second.pose)
        of_first, of_second = self.features(first, second)
        with limited_threads(self.threads):
            return both(
                lambda: self._upsampled_estimate(first, of_first, baseline),
                lambda: self._upsampled_estimate(second, of_second, baseline),
            )

    def features(self, first: View, second: View) -> FeaturesPair:
        """What stereo says of panoramas from two positions, at half of ``options.size``, in their cameras' frames."""
        return next(self.candidates(first, second))

    def candidates(self, first: View, second: View) -> Iterator[FeaturesPair]:
        """:meth:`features`; where matches contradict the prior once without it and, if wanted, once with it."""
        height, width = self.options.size
        options, prior = self.options_for(first, second), self.prior
        with limited_threads(self.threads):
            pair = rectify(first, second, (height // 2, width // 2))
            if self.descriptors is not None:
                pair = with_descriptors(pair, first, second, self.descriptors)
            matches = _match(pair, options)
            expecting = pair if prior is None else prior(pair, first, second, matches)
            disagreement = median_disagreement(expecting, matches)
            if disagreement >= MIN_SCALED_DISAGREEMENT:
                expecting = at_best_scale(expecting)
        if disagreement >= MAX_MEDIAN_DISAGREEMENT:
            yield self._features(first, second, pair, matches)
        if expecting.priors is not None:
            yield self._features(first, second, expecting)

    def _features(self, first: View, second: View, pair: RectifiedPair, matches: Matches | None = None) -> FeaturesPair:
        """Of matches, which are found now unless they are given."""
        options = self.options_for(first, second)
        with limited_threads(self.threads):
            found = _label(pair, matches or _match(pair, options), options)
            return both(
                lambda: _features_in_camera_frame(first, second, pair, found[0]),
                lambda: _features_in_camera_frame(second, first, pair.reversed(), found[1]),
            )

    def options_for(self, first: View, second: View) -> MatchingOptions:
        """The options for a pair: colours count less where one of the pictures is clipped."""
        if not (first.is_clipped or second.is_clipped):
            return self.options
        return replace(self.options, colour_weight=self.options.clipped_colour_weight)

    def _upsampled_estimate(self, view: View, features: StereoFeatures, baseline: float) -> DepthEstimate:
        """At full size, with the edges of the image, in 1/metre."""
        guide = resize_area(view.image, self.options.size)
        inverse_depth = joint_upsample(np.where(features.sky, 0.0, features.filled), features.image, guide)
        confidence = resize_area(features.valid.astype(np.float32), self.options.size)
        return DepthEstimate(inverse_depth / np.float32(baseline), confidence, features.valid)

    def _no_depth(self) -> DepthEstimate:
        return DepthEstimate(np.zeros(self.options.size, np.float32), np.zeros(self.options.size, np.float32))


def _match(pair: RectifiedPair, options: MatchingOptions) -> Matches:
    """The matches of both directions, checked left against right: cost volume and semi-global matching."""
    # one direction after the other: costs take much memory
    matches = match_all_disparities(pair, options), match_all_disparities(pair.reversed(), options)
    return left_right_check(matches, options.left_right_rows, options.near_left_right_rows)


def _label(pair: RectifiedPair, matches: Matches, options: MatchingOptions) -> Matches:
    """The surfaces of both directions: planes found, pixels labelled, and checked left against right."""
    pairs = pair, pair.reversed()
    planes = _find_planes(pairs, matches, options)
    surfaces = both(*(partial(label_surfaces, *each, options) for each in zip(pairs, matches, planes, strict=True)))
    return left_right_check(surfaces, options.left_right_rows, options.near_left_right_rows)


def _find_planes(
    pairs: tuple[RectifiedPair, RectifiedPair], matches: tuple[DisparityMap, DisparityMap], options: MatchingOptions
) -> tuple[CandidatePlanes, CandidatePlanes]:
    """The planes that pixels may lie on, in the frame of either direction: swept, expected, and through matches.

    Both directions have the same: a plane that only one may choose fails the left-right check.
    """
    if not pairs[0].is_canonical_order:
        second, first = _find_planes(pairs[::-1], matches[::-1], options)
        return first, second
    points = both(*(partial(_plane_points, pair, each) for pair, each in zip(pairs, matches, strict=True)))
    fitted = find_planes(points, pairs[0].grid.up, max_planes=options.max_planes, min_support=options.min_plane_support)
    axes = _sweep_axes(pairs[0].grid.up, fitted)
    directions = sweep_directions(pairs[0])
    swept = np.zeros((0, 3)) if _is_narrow_baseline(pairs, matches) else sweep_planes(directions, axes)
    measured = _distinct(swept, expected_planes(pairs[0], directions, swept))
    planes = _distinct(measured, fitted)
    candidates = CandidatePlanes(planes, np.arange(len(planes)) < len(measured))
    return candidates, candidates.seen_by_second()


def _sweep_axes(up: np.ndarray, fitted: Float[np.ndarray, "planes 3"]) -> Float[np.ndarray, "axes 3"]:
    """Up, and the two level axes that the best supported wall is across and along, if there is any."""
    upright = [normal for normal in fitted if abs(normal @ up) < MAX_WALL_TILT_SINE * np.linalg.norm(normal)]
    if not upright:
        return up[None]
    level = upright[0] - (upright[0] @ up) * up
    level = level / np.linalg.norm(level)
    return np.stack([up, level, np.cross(up, level)])


def _is_narrow_baseline(pairs: tuple[RectifiedPair, RectifiedPair], matches: tuple[DisparityMap, DisparityMap]) -> bool:
    """Whether matching sees enough of ground and ceiling, so that no sweep has to."""
    for pair, each in zip(pairs, matches, strict=True):
        weight = np.sin(pair.grid.polar_angle) * (is_textured(pair.first) & pair.first_usable)
        for side in (-1.0, 1.0):
            around = weight * (side * pair.grid.sin_elevation > STEEP_SINE)
            if (around * each.valid).sum() < NARROW_MATCHED_SHARE * around.sum():
                return False
    return True


def _plane_points(pair: RectifiedPair, matches: DisparityMap) -> PlanePoints:
    """The unique ones of left-right consistent matches; they may be off by one row."""
    grid = pair.grid
    row, col = np.nonzero(matches.valid if matches.unique is None else matches.valid & matches.unique)
    inverse_depth = grid.inverse_depth(matches.disparity[row, col], row)
    is_usable = inverse_depth < MAX_INVERSE_DEPTH
    row, col, inverse_depth = row[is_usable], col[is_usable], inverse_depth[is_usable]
    tolerance = grid.inverse_depth_per_row(matches.disparity[row, col], row)
    solid_angle = np.sin(grid.polar_angle[row, 0])
    return PlanePoints(grid.directions[row, col], inverse_depth, tolerance, solid_angle, row, col)


def _distinct(
    planes: Float[np.ndarray, "planes 3"], more: Float[np.ndarray, "more 3"]
) -> Float[np.ndarray, "distinct 3"]:
    """The planes, and those of ``more`` that none before them is equal to."""
    kept = list(planes)
    for normal in more:
        if not any(np.linalg.norm(normal - each) < SAME_PLANE_TOLERANCE * np.linalg.norm(normal) for each in kept):
            kept.append(normal)
    return np.reshape(kept, (-1, 3))


def _features_in_camera_frame(
    view: View, other: View, pair: RectifiedPair, disparities: DisparityMap
) -> StereoFeatures:
    """From disparity in the frame of the pair to inverse depth in the frame of the camera, with sky and filling."""
    size, pose, grid = pair.size, view.pose, pair.grid
    image, usable = resize_area(view.image, size), usable_pixels(view, size)
    in_pair = pair.remap_to(pose.rotation, size)
    inverse_depth = in_pair.nearest(grid.inverse_depth(disparities.disparity))
    consistent = in_pair.nearest(disparities.valid & is_measurable(grid, disparities.disparity))
    consistent = remove_speckles(inverse_depth, consistent & usable)
    is_infinity_known = np.broadcast_to(grid.is_away_from_epipoles(EPIPOLE_NO_INFINITY_DEG), size)
    sin_elevation = pixel_directions(*size) @ pose.rotation[1]
    sky = find_sky(inverse_depth, consistent & in_pair.nearest(is_infinity_known), sin_elevation, solid_angles(*size))
    weight = np.where(sky, 0.0, np.where(consistent, 1.0, INCONSISTENT_MATCH_WEIGHT * usable))
    filled = np.where(sky, 0.0, fill_with_planes(inverse_depth, weight, image, usable))
    return StereoFeatures(
        image=image, matched=inverse_depth, left_right_consistent=consistent, sky=sky, filled=filled, usable=usable,
        second_from_first=motion_in_baselines(pose, other.pose), up=np.asarray(pose.rotation[1]),
        expected=None if pair.priors is None else pair.priors[0].remapped(in_pair),
    )  # fmt: skip


MAX_SKY_INVERSE_DEPTH = 0.02  # in 1/baselines: a matching resolution of a few hundred rows cannot tell this from 0
MIN_SKY_TEXTURE_SHARE = 0.05  # share of the sky where texture must have shown that there is no parallax; chosen by eye
MIN_SKY_SHARE = 0.01  # share of the sphere: a smaller region is no sky; chosen by eye
MAX_SKY_GAP_SHARE = 0.003  # share of the sphere: smaller gaps in the sky are closed; chosen by eye
ZENITH_SINE = 0.9  # sine of the elevation (64°) above which a region reaches the zenith


def find_sky(
    inverse_depth: Float[np.ndarray, "height width"], valid: Bool[np.ndarray, "height width"],
    sin_elevation: Float[np.ndarray, "height width"], solid_angle: Float[np.ndarray, "height width"],
) -> Bool[np.ndarray, "height width"]:  # fmt: skip
    """Where the panorama shows the sky, given inverse depth in 1/baselines, valid where matching measured it.

    A bright wall, an overexposed ceiling or a lamp is as smooth as a cloudless sky. The sky reaches the zenith, and
    wherever it has texture (clouds, a gradient, the rims of what stands before it) that texture has no parallax.
    """
    is_above = sin_elevation > 0.0
    is_far = (inverse_depth < MAX_SKY_INVERSE_DEPTH) & is_above
    labels = connected_regions(is_far, is_diagonal=False)
    at_zenith = np.unique(labels[(sin_elevation > ZENITH_SINE) & is_far])
    region = np.isin(labels, at_zenith[at_zenith > 0])
    area, textured_area = (solid_angle * region).sum(), (solid_angle * (region & valid)).sum()
    if area < MIN_SKY_SHARE * solid_angle.sum() or textured_area < MIN_SKY_TEXTURE_SHARE * area:
        return np.zeros_like(is_far)
    labels = connected_regions(~region & is_above, is_diagonal=False)
    is_gap = np.bincount(labels.ravel(), solid_angle.ravel()) < MAX_SKY_GAP_SHARE * solid_angle.sum()
    is_gap[0] = False
    return np.asarray(region | is_gap[labels])
