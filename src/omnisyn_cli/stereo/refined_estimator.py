"""Depth of a pair by matching, made better by a network that has seen many rooms and streets, and sharpened.

At a larger size it is known which surfaces there are, and measured again where exactly they lie and end. Around every
pixel the surfaces of the smaller map within some pixels span a band of disparities. Only these are matched, so that a
larger size costs little more than a smaller one, and what repeats elsewhere cannot mislead.
"""

from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from jaxtyping import Float32

from omnisyn_cli.compute.threads import both, limited_threads
from omnisyn_cli.geometry.lookup import Lookup
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import filter_across_seam, turned_directions
from omnisyn_cli.geometry.sweep import agreement_around, free_space_agreement, motion_in_baselines
from omnisyn_cli.stereo.costs import sweep_cost
from omnisyn_cli.stereo.stereo_features import Answer, Evidence, PlanesNetwork, evidence_planes
from omnisyn_cli.stereo.filling import median_around, remove_speckles, upsample
from omnisyn_cli.stereo.matching_estimator import SPECKLE, MatchingDepthEstimator, agreeing, is_measurable
from omnisyn_cli.stereo.rectify import RectifiedPair, rectify, resize_area, usable_pixels
from omnisyn_cli.stereo.semi_global import Bands, aggregate, choose
from omnisyn_cli.stereo.depth_sizes import doubled_sizes
from omnisyn_cli.stereo.surface_labels import Matches, MatchingOptions, Meridians
from omnisyn_cli.types import DepthEstimate, View

__all__ = ["RefinedDepthEstimator"]

NEIGHBOURHOOD = 12
"""Pixels: edges of the smaller map are no farther from those of the things than this."""

SLACK = 4
"""Rows by which a disparity may lie beyond those of its neighbourhood."""

MOST = 128
"""Rows that a band is long at most, around the disparity of its pixel."""

SAME = 0.1
"""Relative difference of inverse depth up to which what was found at two sizes is the same surface."""

SURE = np.float32(0.8)
"""Least confidence of what was measured again."""


def sharpened(
    first: View, second: View, answers: tuple[Answer, Answer], size: tuple[int, int], options: MatchingOptions
) -> tuple[Answer, Answer]:
    """Both panoramas' answers at a larger size; the panoramas must not stand at one position.

    Args:
        first: a panorama.
        second: the other one.
        answers: of both, at a smaller size, each in the frame of its own camera.
        size: height and width of the answers wanted.
        options: of the matching.
    """
    views = (first, second)
    bases = both(*(partial(_enlarged, view, answer, size) for view, answer in zip(views, answers, strict=True)))
    pair = rectify(first, second, size)
    pairs = (pair, pair.reversed())
    grids = [Meridians.of(each) for each in pairs]
    there, back = (  # one after the other: costs take much memory
        _match(each, grid, _in_pair(base[0], view, each), options)
        for each, grid, base, view in zip(pairs, grids, bases, views, strict=True)
    )
    matches = agreeing((there, back), options.agreement)
    return both(*(partial(_measured, *each) for each in zip(views, bases, pairs, grids, matches, strict=True)))


def _enlarged(view: View, answer: Answer, size: tuple[int, int]) -> Answer:
    """The answer at a larger size, its edges at those of the picture."""
    inverse_depth, confidence = answer
    low_guide, guide = (resize_area(view.image, each) for each in (inverse_depth.shape, size))
    return upsample(inverse_depth, low_guide, guide), resize_area(confidence, size)


def _in_pair(inverse_depth: np.ndarray, view: View, pair: RectifiedPair) -> np.ndarray:
    """A map of a camera in the frame of the pair that it is the first of."""
    directions = turned_directions(pair.size, view.pose.rotation, pair.world_from_frame)
    return Lookup.along(directions, inverse_depth.shape).nearest(inverse_depth)


def _match(pair: RectifiedPair, grid: Meridians, known: np.ndarray, options: MatchingOptions) -> Matches:
    """The best disparities among those around what is known."""
    bands = _bands(grid.disparity(known))
    cost = sweep_cost(pair.first, pair.second, pair.second_usable, bands, options.colour_share, options.truncation)
    total = aggregate(cost, bands, pair.first.mean(-1), options.step, options.jump, options.contrast)
    disparity, margin = choose(total, bands, is_all=False)
    return Matches(disparity, (margin > options.margin) & pair.first_usable)


def _bands(known: Float32[np.ndarray, "height width"]) -> Bands:
    """What the neighbourhood of every pixel spans."""
    least, greatest = _range_around(known)
    lowest = np.maximum(np.maximum(np.floor(least) - SLACK, np.rint(known) - MOST // 2), 0)
    highest = np.minimum(np.ceil(greatest) + SLACK, lowest + MOST - 1)
    return Bands.between(lowest.astype(np.int32), highest.astype(np.int32))


def _range_around(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least and the greatest value within the neighbourhood of every pixel, over the seam."""
    window = np.ones((2 * NEIGHBOURHOOD + 1, 2 * NEIGHBOURHOOD + 1), np.uint8)
    least, greatest = (
        filter_across_seam(partial(extreme, kernel=window), values, NEIGHBOURHOOD)
        for extreme in (cv2.erode, cv2.dilate)
    )
    return least, greatest


def _measured(view: View, base: Answer, pair: RectifiedPair, grid: Meridians, matches: Matches) -> Answer:
    """The answer with everything replaced that matching is sure of and that lies on a surface known around there.

    Single pixels are noise more often than things: every pixel then takes the median of those around it.
    """
    size = pair.size
    at = pair.from_camera(view.pose, size)
    exact = at.nearest(grid.inverse_depth(matches.disparity).astype(np.float32))
    is_sure = at.nearest(matches.seen & is_measurable(grid, matches.disparity))
    is_sure = remove_speckles(exact, is_sure & usable_pixels(view, size), SPECKLE, 0.1)
    least, greatest = _range_around(base[0])
    is_known = (exact >= (1.0 - SAME) * least) & (exact <= (1.0 + SAME) * greatest)
    taken = is_sure & is_known
    inverse_depth = median_around(np.where(taken, exact, base[0]))
    return inverse_depth, np.where(taken, np.maximum(base[1], SURE), base[1])


@dataclass(frozen=True)
class RefinedDepthEstimator:
    """Inverse depth of both panoramas; a :class:`~omnisyn_cli.types.DepthEstimator`.

    Where matching is unsure the network chooses for each pixel alone, so the median of the answers around it is taken,
    which keeps edges. A place that the other panorama looks through loses its confidence, and one amid places where
    both differ loses some.

    In a larger picture matching and the network see less of the scene around a pixel, but matching measures more
    exactly. So they say what is there, and its place is measured again at twice the size, until there are enough rows
    (:mod:`omnisyn_cli.stereo.refined_estimator`).

    Panoramas from one position have no parallax: everything is then 0 with confidence 0.

    Attributes:
        matching: finds the evidence.
        refinement: the network; None leaves it out, to see what it is worth: what matching filled is taken as it is.
        rows: that depth is looked for at, see :func:`omnisyn_cli.stereo.depth_sizes.estimate_sizes`.
    """

    matching: MatchingDepthEstimator
    refinement: PlanesNetwork | None
    rows: int

    def __call__(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        """Estimates for ``first`` and for ``second``, each in its own frame; ImageError for a panorama not 2:1."""
        if np.array_equal(first.pose.position, second.pose.position):
            return self.matching(first, second)
        with limited_threads(self.matching.threads):
            return self._estimates(first, second)

    def _estimates(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        there, back = self.matching.evidence(first, second)
        answers = self._answers(there, back)
        picture_rows = max(view.image.shape[0] for view in (first, second))
        for size in doubled_sizes(there.filled.shape[0], self.rows // 2, picture_rows)[1:]:
            answers = sharpened(first, second, answers, size, self.matching.options_for(first, second))
        baseline = float(np.linalg.norm(second.pose.position - first.pose.position))
        (one, trust), (other, back_trust) = answers
        estimates = both(
            lambda: _estimate(first, second, (one, trust), other, baseline, there.sure),
            lambda: _estimate(second, first, (other, back_trust), one, baseline, back.sure),
        )
        return both(
            partial(_confirmed, estimates, (first.pose, second.pose), baseline),
            partial(_confirmed, estimates[::-1], (second.pose, first.pose), baseline),
        )

    def _answers(self, there: Evidence, back: Evidence) -> tuple[Answer, Answer]:
        if self.refinement is None:
            return _filled(there), _filled(back)
        planes = both(lambda: evidence_planes(there, back), lambda: evidence_planes(back, there))
        return _refined(there, *self.refinement(planes[0])), _refined(back, *self.refinement(planes[1]))


def _filled(evidence: Evidence) -> Answer:
    """What matching alone says, believed where it is sure."""
    return evidence.filled.astype(np.float32), evidence.sure.astype(np.float32)


def _refined(evidence: Evidence, inverse_depth: np.ndarray, confidence: np.ndarray) -> Answer:
    return np.where(evidence.sure, inverse_depth, median_around(inverse_depth)), confidence


def _estimate(
    view: View, other: View, answer: Answer, back: np.ndarray, baseline: float, sure: np.ndarray
) -> DepthEstimate:
    """In 1/metre; not trusted where masked, or where the other panorama, whose answer is ``back``, looks through."""
    inverse_depth, confidence = answer
    trust = confidence * free_space_agreement(inverse_depth, back, motion_in_baselines(view.pose, other.pose))
    trust = trust * usable_pixels(view, inverse_depth.shape)
    return DepthEstimate((inverse_depth / baseline).astype(np.float32), trust.astype(np.float32), sure)


def _confirmed(
    estimates: tuple[DepthEstimate, DepthEstimate], poses: tuple[Pose, Pose], baseline: float
) -> DepthEstimate:
    """The first of two estimates, trusted as far as the second one agrees with it around there."""
    own, other = (estimate.inverse_depth * np.float32(baseline) for estimate in estimates)
    agreement = agreement_around(own, other, motion_in_baselines(*poses))
    return replace(estimates[0], confidence=estimates[0].confidence * agreement)
