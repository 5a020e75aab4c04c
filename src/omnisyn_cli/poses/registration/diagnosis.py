"""Do the poses of two panoramas fit what they see, and if not, which convention hypothesis would explain it?"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.poses.registration import conventions, least_squares
from omnisyn_cli.poses.registration.conventions import ConventionHypothesis
from omnisyn_cli.poses.registration.features import Matches
from omnisyn_cli.poses.registration.robust import (
    Estimate,
    estimate_from_subset,
    estimate_relative_pose,
    inlier_threshold,
    support_mask,
)

Verdict = Literal["fits", "close", "mistake", "contradiction", "in place", "unknown"]
"""``close``: off by little, refine; ``mistake``: a hypothesis explains it; ``contradiction``: none does; ``in place``:
taken from one place, only rotations can be judged; ``unknown``: too few matches."""

FIT_LIMITS = (math.radians(0.5), math.radians(2.0))
"""Errors of rotation and direction up to which poses fit."""

CLOSE_LIMITS = (math.radians(15.0), math.radians(20.0))
"""Errors that are taken for inaccuracy rather than for a mistake in convention: wrong axes are off by far more."""

EXPLANATION_LIMITS = (math.radians(3.0), math.radians(5.0))
"""Errors that poses may keep once a convention is corrected; given poses are rarely more exact."""

DEGREES_EXPLANATION_LIMITS = (math.radians(1.0), math.radians(1.0))
"""The same where thousands of corrections are tried, of which one may come close by chance."""

MIN_IMPROVEMENT = 3.0
"""Factor by which a correction has to reduce the larger error of the poses as given."""

TIE_ANGLE = math.radians(1.0)
"""Corrections whose errors differ by less cannot be told apart by one pair."""

MIN_CHI_SQUARED_GAIN = 25.0
"""Decrease of χ² that is worth a change: χ² of five degrees of freedom stays below it in 9,999 cases of 10,000."""


@dataclass(frozen=True)
class Fit:
    """How well a relative pose fits.

    Attributes:
        rotation: radians between its rotation and that found in the pictures.
        direction: radians between its direction of the second camera and that found; π where it has none, 0 where
            the pictures have none.
        residual: median angle to the epipolar circles over the matches that agree with what was found; radians.
        in_front: share of these with a point in front of both cameras.
        supporting: number of all matches that agree with it.
    """

    rotation: float
    direction: float
    residual: float
    in_front: float
    support_mask: int

    def is_within(self, limits: tuple[float, float]) -> bool:
        """Whether rotation and direction are at most ``limits``."""
        return self.rotation <= limits[0] and self.direction <= limits[1]

    @property
    def worst(self) -> float:
        """The larger one of both errors, radians."""
        return max(self.rotation, self.direction)


@dataclass(frozen=True)
class Explanation:
    """A hypothesis and how well the poses fit once it is undone."""

    hypothesis: ConventionHypothesis
    fit: Fit


@dataclass(frozen=True)
class Diagnosis:
    """What is known about the poses of a pair.

    Attributes:
        verdict: in a word.
        matches: number of matches.
        estimate: what the pictures say; None if too little.
        given: how well the poses fit as they are; None if unknown.
        explanations: hypotheses that explain it equally well, the most common one first.
        is_refinable: refining would make the poses fit significantly better.
    """

    verdict: Verdict
    matches: int
    estimate: Estimate | None
    given: Fit | None
    explanations: tuple[Explanation, ...]
    is_refinable: bool


def diagnose(first: Pose, second: Pose, matches: Matches) -> Diagnosis:
    """Judge the camera-to-world poses of a pair by its matches."""
    given_relative = least_squares.relative_pose(first, second)
    known = [given_relative] if given_relative.position.any() else []
    estimate = estimate_relative_pose(matches, known)
    if estimate is not None and known and not estimate.have_same_position:
        # Repeated things support opposite directions: if as many matches agree with the given one, it is not to blame.
        supporting = support_mask(given_relative, matches, inlier_threshold(matches))
        is_opposite = _pose_errors(given_relative, estimate)[1] > math.radians(90.0)
        if is_opposite and supporting.sum() >= estimate.inliers.sum():
            estimate = estimate_from_subset(matches, supporting, known)
    if estimate is None:
        return Diagnosis("unknown", len(matches), None, None, (), is_refinable=False)
    given = _fit(given_relative, estimate, matches)
    verdict, explanations = _judge(first, second, given, estimate, matches)
    is_refinable = verdict in ("fits", "close") and _improves(given_relative, estimate, matches)
    return Diagnosis(verdict, len(matches), estimate, given, explanations, is_refinable)


def _fit(first_from_second: Pose, estimate: Estimate, matches: Matches) -> Fit:
    """How well a relative pose fits, and how far it is from what was found."""
    agreed, scale = matches.select(estimate.inliers), inlier_threshold(matches)
    return Fit(
        *_pose_errors(first_from_second, estimate),
        float(np.median(np.abs(least_squares.epipolar_residual(first_from_second, agreed)))),
        float(np.mean(least_squares.is_in_front(first_from_second, agreed, scale))),
        int(support_mask(first_from_second, matches, scale).sum()),
    )


def _judge(
    first: Pose, second: Pose, given: Fit, estimate: Estimate, matches: Matches
) -> tuple[Verdict, tuple[Explanation, ...]]:
    # three standard deviations: poses are not blamed for what the matches cannot tell
    certain = 3.0 * estimate.uncertainty.rotation, 3.0 * estimate.uncertainty.direction
    if given.is_within((max(FIT_LIMITS[0], certain[0]), max(FIT_LIMITS[1], certain[1]))):
        return ("in place" if estimate.have_same_position else "fits"), ()
    explanations = _explanations(first, second, given, estimate, matches)
    if explanations:
        return "mistake", explanations
    return ("close" if given.is_within(CLOSE_LIMITS) and not estimate.have_same_position else "contradiction"), ()


def _explanations(
    first: Pose, second: Pose, given: Fit, estimate: Estimate, matches: Matches
) -> tuple[Explanation, ...]:
    """Of the simplest kind of hypothesis that explains it, all that explain it equally well."""
    singles = conventions.single_hypotheses()
    kinds: list[tuple[Iterable[ConventionHypothesis], tuple[float, float]]] = [
        ([hypothesis for hypothesis in singles if hypothesis.is_common], EXPLANATION_LIMITS),
        ([hypothesis for hypothesis in singles if not hypothesis.is_common], EXPLANATION_LIMITS),
        (conventions.combined_hypotheses(), EXPLANATION_LIMITS),
    ]
    if not given.is_within(CLOSE_LIMITS):
        limits = DEGREES_EXPLANATION_LIMITS
        kinds.append((conventions.degree_hypotheses(first, second, estimate.first_from_second, limits[0]), limits))
    for hypotheses, limits in kinds:
        corrected = ((each, least_squares.relative_pose(*each.correct(first, second))) for each in hypotheses)
        found = [
            Explanation(hypothesis, _fit(relative, estimate, matches))
            for hypothesis, relative in corrected
            if (off := _pose_errors(relative, estimate))
            and off[0] <= limits[0]
            and off[1] <= limits[1]
            and MIN_IMPROVEMENT * max(off) <= given.worst
        ]
        if found:
            best = min(explanation.fit.worst for explanation in found)
            return tuple(e for e in found if e.fit.worst <= best + TIE_ANGLE)
    return ()


def _pose_errors(relative: Pose, estimate: Estimate) -> tuple[float, float]:
    """Radians by which rotation and direction differ from what was found."""
    rotation = least_squares.rotation_error(relative, estimate.first_from_second)
    if estimate.have_same_position:
        return rotation, 0.0
    if not relative.position.any():
        return rotation, math.radians(180.0)
    return rotation, least_squares.direction_error(relative, estimate.first_from_second)


def _improves(given: Pose, estimate: Estimate, matches: Matches) -> bool:
    if estimate.have_same_position or not given.position.any():
        return False
    agreed = matches.select(estimate.inliers | support_mask(given, matches, inlier_threshold(matches)))
    noise = least_squares.noise_std(estimate.first_from_second, agreed)
    poses = (given, estimate.first_from_second)
    before, after = (least_squares.robust_chi_squared(pose, agreed, noise) for pose in poses)
    return before - after > MIN_CHI_SQUARED_GAIN
