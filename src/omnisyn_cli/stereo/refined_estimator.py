"""Depth of a pair by stereo matching, completed by a network and refined at larger sizes.

Refinement knows which surfaces there are, and measures again where exactly they lie and end. The depths of the smaller
map around a pixel span a range of disparities, and only these are matched. So a larger size costs little more than a
smaller one, and what repeats elsewhere cannot mislead.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.compute.threads import both, limited_threads
from omnisyn_cli.geometry.pose import at_same_position, distance_between
from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.geometry.resize import resize_area
from omnisyn_cli.geometry.sampling import rotated_directions, window_max, window_min
from omnisyn_cli.geometry.sweep import free_space_agreement, motion_in_baselines, neighbourhood_agreement
from omnisyn_cli.geometry.tolerances import MAX_SQRT_INV_DEPTH, SAME_SURFACE_TOLERANCE
from omnisyn_cli.stereo.depth_sizes import doubled_sizes
from omnisyn_cli.stereo.disparity import (
    DisparityMap,
    MatchingOptions,
    is_measurable,
    left_right_check,
    match_disparities,
)
from omnisyn_cli.stereo.expected_depth import fill_as_expected
from omnisyn_cli.stereo.map_filters import joint_upsample, median_filter, remove_speckles
from omnisyn_cli.stereo.matching_estimator import FeaturesPair, MatchingDepthEstimator
from omnisyn_cli.stereo.rectify import RectifiedPair, rectify, usable_pixels
from omnisyn_cli.stereo.semi_global import DisparityRange
from omnisyn_cli.stereo.stereo_features import (
    CompletionModel,
    InvDepthWithConfidence,
    StereoFeatures,
    completion_channels,
)
from omnisyn_cli.types import DepthEstimate, View

EDGE_SEARCH_RADIUS = 12  # pixels: edges of the smaller map are no farther from the true edges than this; chosen by eye
# Of the largest inverse depth that the network can say. Nearer surfaces keep what matching filled in: floors and
# ceilings of wide pairs are nearer than a quarter of the baseline.
NETWORK_RANGE_SHARE = 0.95
RANGE_SLACK_ROWS = 4  # rows by which a disparity may lie beyond those of its neighbourhood; chosen by eye
MAX_RANGE_ROWS = 128  # rows of the longest range, around the disparity of its pixel: it bounds time and memory
# A prior that matches contradict is used unless the score falls by more. (Of nine such pairs it falls by 0.20 for one,
# which would lose 2 dB, and by 0.05 at most for the others, which have −0.2 to +2.3 dB by the prior, +1.2 in the mean.)
MAX_SCORE_LOSS = 0.1
REMEASURED_CONFIDENCE = np.float32(0.8)  # least confidence of what refinement has measured; chosen by eye
ViewPair = tuple[View, View]
EstimatePair = tuple[DepthEstimate, DepthEstimate]
InvDepthPair = tuple[InvDepthWithConfidence, InvDepthWithConfidence]


@dataclass(frozen=True)
class RefinedDepthEstimator:
    """Inverse depth of both panoramas; a :class:`~omnisyn_cli.types.DepthEstimator`.

    In a larger picture matching and the network see less of the scene around a pixel, but matching measures more
    exactly. So depth is found at a small size, and measured again at twice the size until there are enough rows.

    Panoramas from one position have no parallax: everything is then 0 with confidence 0.
    """

    matching: MatchingDepthEstimator  # finds the stereo features
    # the network; None leaves it out for comparison: the filled map is then taken as it is
    completion: CompletionModel | None
    rows: int  # that depth is looked for at, see :func:`omnisyn_cli.stereo.depth_sizes.refinement_sizes`
    # score in [0, 1] of how depth predicts the photographs from each other; None does not try a contradicted prior
    judge: Callable[[ViewPair, EstimatePair], float] | None = None

    def __call__(self, first: View, second: View) -> EstimatePair:
        """Estimates for ``first`` and for ``second``, each in its own frame; ImageError for a panorama not 2:1."""
        if at_same_position(first.pose, second.pose):
            return self.matching(first, second)
        with limited_threads(self.matching.threads):
            return self._run_stages((first, second))

    def _run_stages(self, views: ViewPair) -> EstimatePair:
        """All stages: those of :meth:`MatchingDepthEstimator.features`, completion, refinement, and confidence."""
        if self.judge is None:
            return self._estimates(views, self.matching.features(*views))
        found = [self._estimates(views, each) for each in self.matching.candidates(*views)]
        if len(found) == 1:
            return found[0]
        plain, expecting = (self.judge(views, each) for each in found)
        return found[0 if plain > expecting + MAX_SCORE_LOSS else 1]

    def _estimates(self, views: ViewPair, features: FeaturesPair) -> EstimatePair:
        of_first, of_second = self._complete_with_network(features)
        completed = fill_as_expected(features[0], of_first), fill_as_expected(features[1], of_second)
        refined = self._refine_at_larger_sizes(views, completed)
        return _checked_estimates(views, refined, features)

    def _complete_with_network(self, features: tuple[StereoFeatures, StereoFeatures]) -> InvDepthPair:
        """The network's depth, or the filled map without one.

        Where stereo is not valid it chooses between two depths for each pixel alone: medians are smoother, with edges.
        """
        first, second = features
        if self.completion is None:
            return _filled_map(first), _filled_map(second)
        channels = both(lambda: completion_channels(first, second), lambda: completion_channels(second, first))
        answers = [self.completion(each) for each in channels]
        return _smooth_invalid_pixels(first, *answers[0]), _smooth_invalid_pixels(second, *answers[1])

    def _refine_at_larger_sizes(self, views: ViewPair, maps: InvDepthPair) -> InvDepthPair:
        """Measured again at twice the size, and again, up to the rows wanted and those of the pictures."""
        image_rows = max(view.image.shape[0] for view in views)
        for size in doubled_sizes(maps[0][0].shape[0], self.rows // 2, image_rows)[1:]:
            maps = refine_depth_at_size(views, maps, size, self.matching.options_for(*views))
        return maps


def _filled_map(features: StereoFeatures) -> InvDepthWithConfidence:
    return features.filled.astype(np.float32), features.valid.astype(np.float32)


def _smooth_invalid_pixels(
    features: StereoFeatures, inverse_depth: np.ndarray, confidence: np.ndarray
) -> InvDepthWithConfidence:
    smoothed = np.where(features.valid, inverse_depth, median_filter(inverse_depth))
    is_beyond_network = features.filled > NETWORK_RANGE_SHARE * MAX_SQRT_INV_DEPTH**2
    return np.where(is_beyond_network, np.maximum(smoothed, features.filled), smoothed).astype(np.float32), confidence


def refine_depth_at_size(
    views: ViewPair, maps: InvDepthPair, size: tuple[int, int], options: MatchingOptions
) -> InvDepthPair:
    """Maps of both panoramas, from two positions and each in its camera's frame, measured again at a larger size."""
    coarse = both(*(partial(_upsample_map, view, each, size) for view, each in zip(views, maps, strict=True)))
    pair = rectify(*views, size)
    pairs = (pair, pair.reversed())
    found = []  # one after the other: costs take much memory
    for each, (inverse_depth, _), view in zip(pairs, coarse, views, strict=True):
        directions = rotated_directions(each.size, view.pose.rotation, each.world_from_frame)
        coarse_depth = RemapTable.for_directions(directions, inverse_depth.shape).nearest(inverse_depth)
        ranges = _ranges_around(each.grid.disparity(coarse_depth))
        found.append(match_disparities(each, ranges, options, is_complete_range=False)[0])
    disparities = left_right_check((found[0], found[1]), options.left_right_rows)
    return both(*(partial(_replace_remeasured, *each) for each in zip(views, coarse, pairs, disparities, strict=True)))


def _upsample_map(view: View, coarse: InvDepthWithConfidence, size: tuple[int, int]) -> InvDepthWithConfidence:
    """The map at a larger size, its edges at those of the picture."""
    inverse_depth, confidence = coarse
    low_guide, guide = (resize_area(view.image, each) for each in (inverse_depth.shape, size))
    return joint_upsample(inverse_depth, low_guide, guide), resize_area(confidence, size)


def _ranges_around(disparity: Float32[np.ndarray, "height width"]) -> DisparityRange:
    """What the neighbourhood of every pixel spans, and a little more."""
    least, greatest = (extreme(disparity, EDGE_SEARCH_RADIUS) for extreme in (window_min, window_max))
    nearby = np.maximum(np.floor(least) - RANGE_SLACK_ROWS, np.rint(disparity) - MAX_RANGE_ROWS // 2)
    lowest = np.maximum(nearby, 0)
    highest = np.minimum(np.ceil(greatest) + RANGE_SLACK_ROWS, lowest + MAX_RANGE_ROWS - 1)
    return DisparityRange.from_bounds(lowest.astype(np.int32), highest.astype(np.int32))


def _replace_remeasured(
    view: View, coarse: InvDepthWithConfidence, pair: RectifiedPair, disparities: DisparityMap
) -> InvDepthWithConfidence:
    """The coarse map with every valid new match on a surface known around there; a median removes single pixels."""
    size, grid, (coarse_depth, coarse_confidence) = pair.size, pair.grid, coarse
    in_pair = pair.remap_to(view.pose.rotation, size)
    exact = in_pair.nearest(grid.inverse_depth(disparities.disparity).astype(np.float32))
    valid = in_pair.nearest(disparities.valid & is_measurable(grid, disparities.disparity))
    valid = remove_speckles(exact, valid & usable_pixels(view, size))
    least, greatest = (extreme(coarse_depth, EDGE_SEARCH_RADIUS) for extreme in (window_min, window_max))
    is_known = (exact >= (1.0 - SAME_SURFACE_TOLERANCE) * least) & (exact <= (1.0 + SAME_SURFACE_TOLERANCE) * greatest)
    taken = valid & is_known
    inverse_depth = median_filter(np.where(taken, exact, coarse_depth))
    return inverse_depth, np.where(taken, np.maximum(coarse_confidence, REMEASURED_CONFIDENCE), coarse_confidence)


def _checked_estimates(
    views: ViewPair, maps: InvDepthPair, features: tuple[StereoFeatures, StereoFeatures]
) -> EstimatePair:
    """Estimates in 1/metre; what speaks against their confidence, in each panorama beside the other one.

    There is none where masked or where the other panorama looks through the surface, less where both disagree nearby.
    """
    baseline = distance_between(views[0].pose, views[1].pose)
    in_metres = [(inverse_depth / baseline).astype(np.float32) for inverse_depth, _ in maps]
    in_baselines = [each * np.float32(baseline) for each in in_metres]

    def estimate(own: int, other: int) -> DepthEstimate:
        inverse_depth, confidence = maps[own]
        motion = motion_in_baselines(views[own].pose, views[other].pose)
        confidence = confidence * free_space_agreement(inverse_depth, maps[other][0], motion)
        confidence = (confidence * usable_pixels(views[own], inverse_depth.shape)).astype(np.float32)
        agreement = neighbourhood_agreement(in_baselines[own], in_baselines[other], motion)
        return DepthEstimate(in_metres[own], confidence * agreement, features[own].valid)

    return both(partial(estimate, 0, 1), partial(estimate, 1, 0))
