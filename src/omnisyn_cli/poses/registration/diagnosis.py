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
from omnisyn_cli.poses.registration.robust import Estimate, estimate_relative_pose, inlier_scale, supporting

Verdict = Literal["fits", "close", "mistake", "contradiction", "in place", "unknown"]
"""``close``: off by little, refine; ``mistake``: a hypothesis explains it; ``contradiction``: none does; ``in place``:
taken from one place, only rotations can be judged; ``unknown``: too few matches."""

FITS = (math.radians(0.5), math.radians(2.0))
"""Rotation and direction that may be off without a remark."""

CLOSE = (math.radians(15.0), math.radians(20.0))
"""Rotation and direction that are taken for inaccuracy rather than for a mistake in writing."""

EXPLAINED = (math.radians(3.0), math.radians(5.0))
"""How close a correction has to come."""

EXPLAINED_BY_DEGREES = (math.radians(1.0), math.radians(1.0))
"""The same where thousands of corrections are tried, of which one may come close by chance."""

GAIN = 3.0
"""A correction has to come closer than the poses as given by this factor."""

INDISTINGUISHABLE = math.radians(1.0)
"""Corrections whose results differ by less are not told apart."""

SIGNIFICANT = 25.0
"""Decrease of the misfit (χ² of five degrees of freedom stays below it in 9,999 cases of 10,000) that is worth a
change."""


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
    supporting: int

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
    if estimate is None:
        return Diagnosis("unknown", len(matches), None, None, (), is_refinable=False)
    given = _fit(given_relative, estimate, matches)
    verdict, explanations = _judged(first, second, given, estimate, matches)
    is_refinable = verdict in ("fits", "close") and _improves(given_relative, estimate, matches)
    return Diagnosis(verdict, len(matches), estimate, given, explanations, is_refinable)


def _fit(first_from_second: Pose, estimate: Estimate, matches: Matches) -> Fit:
    """How well a relative pose fits, and how far it is from what was found."""
    agreed, scale = matches.select(estimate.inliers), inlier_scale(matches)
    return Fit(
        *_off(first_from_second, estimate),
        float(np.median(np.abs(least_squares.epipolar_residual(first_from_second, agreed)))),
        float(np.mean(least_squares.is_in_front(first_from_second, agreed, scale))),
        int(supporting(first_from_second, matches, scale).sum()),
    )


def _judged(
    first: Pose, second: Pose, given: Fit, estimate: Estimate, matches: Matches
) -> tuple[Verdict, tuple[Explanation, ...]]:
    certain = 3.0 * estimate.uncertainty.rotation, 3.0 * estimate.uncertainty.direction
    if given.is_within((max(FITS[0], certain[0]), max(FITS[1], certain[1]))):
        return ("in place" if estimate.is_in_place else "fits"), ()
    explanations = _explanations(first, second, given, estimate, matches)
    if explanations:
        return "mistake", explanations
    return ("close" if given.is_within(CLOSE) and not estimate.is_in_place else "contradiction"), ()


def _explanations(
    first: Pose, second: Pose, given: Fit, estimate: Estimate, matches: Matches
) -> tuple[Explanation, ...]:
    """Of the simplest kind of hypothesis that explains it, all that explain it equally well."""
    singles = conventions.single_hypotheses()
    kinds: list[tuple[Iterable[ConventionHypothesis], tuple[float, float]]] = [
        ([hypothesis for hypothesis in singles if hypothesis.is_common], EXPLAINED),
        ([hypothesis for hypothesis in singles if not hypothesis.is_common], EXPLAINED),
        (conventions.combined_hypotheses(), EXPLAINED),
    ]
    if not given.is_within(CLOSE):
        in_degrees = conventions.degree_hypotheses(first, second, estimate.first_from_second, EXPLAINED_BY_DEGREES[0])
        kinds.append((in_degrees, EXPLAINED_BY_DEGREES))
    for hypotheses, limits in kinds:
        corrected = ((each, least_squares.relative_pose(*each.correct(first, second))) for each in hypotheses)
        found = [
            Explanation(hypothesis, _fit(relative, estimate, matches))
            for hypothesis, relative in corrected
            if (off := _off(relative, estimate))
            and off[0] <= limits[0]
            and off[1] <= limits[1]
            and GAIN * max(off) <= given.worst
        ]
        if found:
            best = min(explanation.fit.worst for explanation in found)
            return tuple(e for e in found if e.fit.worst <= best + INDISTINGUISHABLE)
    return ()


def _off(relative: Pose, estimate: Estimate) -> tuple[float, float]:
    """Radians by which rotation and direction differ from what was found."""
    rotation = least_squares.rotation_error(relative, estimate.first_from_second)
    if estimate.is_in_place:
        return rotation, 0.0
    if not relative.position.any():
        return rotation, math.radians(180.0)
    return rotation, least_squares.direction_error(relative, estimate.first_from_second)


def _improves(given: Pose, estimate: Estimate, matches: Matches) -> bool:
    if estimate.is_in_place or not given.position.any():
        return False
    agreed = matches.select(estimate.inliers | supporting(given, matches, inlier_scale(matches)))
    noise = least_squares.noise_of(estimate.first_from_second, agreed)
    before, after = (least_squares.robust_misfit(pose, agreed, noise) for pose in (given, estimate.first_from_second))
    return before - after > SIGNIFICANT
