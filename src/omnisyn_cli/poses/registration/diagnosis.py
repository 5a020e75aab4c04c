"""Do the poses of two panoramas fit what they see, and if not, which hypothesis explains it: in words and as values."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.poses.registration import conventions, least_squares
from omnisyn_cli.poses.registration.conventions import ConventionHypothesis
from omnisyn_cli.poses.registration.features import Matches
from omnisyn_cli.poses.registration.robust import Estimate, estimate_from_subset, estimate_relative_pose, support_mask

Verdict = Literal["fits", "close", "mistake", "contradiction", "in place", "unknown"]
"""``close``: off by little, refine; ``mistake``: a hypothesis explains it; ``contradiction``: none does; ``in place``:
taken from one place, only rotations can be judged; ``unknown``: too few matches."""

FIT_LIMITS = (math.radians(0.5), math.radians(2.0))  # Errors of rotation and direction up to which poses fit

# Errors that are taken for inaccuracy rather than for a mistake in convention: wrong axes are off by far more.
CLOSE_LIMITS = (math.radians(15.0), math.radians(20.0))
# Errors that poses may keep once a convention is corrected; given poses are rarely more exact.
EXPLANATION_LIMITS = (math.radians(3.0), math.radians(5.0))
# The same where thousands of corrections are tried, of which one may come close by chance.
DEGREES_EXPLANATION_LIMITS = (math.radians(1.0), math.radians(1.0))
MIN_IMPROVEMENT = 3.0  # Factor by which a correction has to reduce the larger error of the poses as given
TIE_ANGLE = math.radians(1.0)  # Corrections whose errors differ by less cannot be told apart by one pair

# Decrease of χ² that is worth a change: χ² of five degrees of freedom stays below it in 9,999 cases of 10,000.
MIN_CHI_SQUARED_GAIN = 25.0
PLAUSIBLE_CAMERA_HEIGHTS = (0.3, 4.0)  # Metres above the floor: from a tripod on the ground to the roof of a car
EXPECTED_CAMERA_HEIGHT = 1.5  # Metres above the floor, of a camera on a tripod or in a raised hand
MAX_ALTERNATIVES = 4  # Further explanations that are printed; ``--json`` lists all

VERDICTS: dict[Verdict, str] = {
    "fits": "the poses fit",
    "close": "the poses nearly fit",
    "mistake": "the poses do not fit",
    "contradiction": "the poses do not fit, and no common mistake explains it",
    "in place": "the pictures were taken (nearly) from one place; the rotations fit, a direction cannot be seen",
}


@dataclass(frozen=True)
class Fit:
    """How well a relative pose fits what was found in the pictures."""

    rotation: float  # radians between both rotations
    direction: float  # radians between both directions of the second camera; π without its own, 0 without theirs
    residual: float  # median angle to the epipolar circles over the matches that agree with what was found; radians
    in_front: float  # share of these with a point in front of both cameras
    supporting: int  # number of all matches that agree with it

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
    """What is known about the poses of a pair."""

    verdict: Verdict  # in a word
    matches: int  # number of matches
    estimate: Estimate | None  # what the pictures say; None if too little
    given: Fit | None  # how well the poses fit as they are; None if unknown
    explanations: tuple[Explanation, ...]  # hypotheses that explain it equally well, the most common one first
    is_refinable: bool  # refining would make the poses fit significantly better


def diagnose(first: Pose, second: Pose, matches: Matches) -> Diagnosis:
    """Judge the camera-to-world poses of a pair by its matches."""
    given_relative = least_squares.relative_pose(first, second)
    known = [given_relative] if given_relative.position.any() else []
    estimate = estimate_relative_pose(matches, known)
    if estimate is not None and known and not estimate.have_same_position:
        # Repeated things support opposite directions: if as many matches agree with the given one, it is not to blame.
        supporting = support_mask(given_relative, matches)
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
    agreed = matches.select(estimate.inliers)
    return Fit(
        *_pose_errors(first_from_second, estimate),
        float(np.median(np.abs(least_squares.epipolar_residual(first_from_second, agreed)))),
        float(np.mean(least_squares.is_in_front(first_from_second, agreed, matches.tolerance))),
        int(support_mask(first_from_second, matches).sum()),
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
    agreed = matches.select(estimate.inliers | support_mask(given, matches))
    noise = least_squares.noise_std(estimate.first_from_second, agreed)
    poses = (given, estimate.first_from_second)
    before, after = (least_squares.robust_chi_squared(pose, agreed, noise) for pose in poses)
    return before - after > MIN_CHI_SQUARED_GAIN


def diagnosis_sentences(diagnosis: Diagnosis) -> list[str]:
    """What is to be said about a pair, the verdict first."""
    estimate, given = diagnosis.estimate, diagnosis.given
    if estimate is None or given is None:
        return [
            f"too few matches to judge the poses: {diagnosis.matches}, and not enough of them agree with any pose",
            "the pictures may have too little in common, or too little texture",
        ]
    found = int(estimate.inliers.sum())
    sentences = [VERDICTS[diagnosis.verdict], _error_sentence(given, estimate)]
    measured = f"{diagnosis.matches} matches, {found} agree with one another, {given.supporting} with the poses given"
    if not (estimate.have_same_position or _has_no_direction(given)):
        measured += f"; median residual {_degrees(given.residual)}, with the poses found {_degrees(estimate.residual)}"
        measured += f"; {given.in_front:.0%} of the points in front of both cameras"
    return [*sentences, measured, *_advice(diagnosis)]


def camera_height_sentence(height: float, found_baseline: float | None = None) -> str:
    """What a height in metres says about distances, or about the mean that poses from pictures were scaled to."""
    doubt, advice = "", "are the distances in metres?"
    if found_baseline is not None:
        baseline = found_baseline * EXPECTED_CAMERA_HEIGHT / height
        advice = f"if they were {EXPECTED_CAMERA_HEIGHT:g} m above it, give --baseline {baseline:.2g}"
    if not is_plausible_camera_height(height):
        doubt = f", which is unusual; {advice}"
    return f"by these distances, the cameras are {height:.2f} m above the floor{doubt}"


def is_plausible_camera_height(height: float) -> bool:
    """Whether cameras stand as high as that above the floor, in metres."""
    low, high = PLAUSIBLE_CAMERA_HEIGHTS
    return low <= height <= high


def diagnosis_values(diagnosis: Diagnosis) -> dict[str, Any]:
    """The same for JSON; angles in degrees, None where unknown."""
    estimate, given = diagnosis.estimate, diagnosis.given
    return {
        "verdict": diagnosis.verdict,
        "matches": diagnosis.matches,
        "agreeing_matches": None if estimate is None else int(estimate.inliers.sum()),
        "best_residual_deg": None if estimate is None else math.degrees(estimate.residual),
        "rotation_uncertainty_deg": None if estimate is None else _finite(estimate.uncertainty.rotation),
        "direction_uncertainty_deg": None if estimate is None else _finite(estimate.uncertainty.direction),
        "given": None if given is None else _fit_values(given),
        "mistakes": [
            {
                **{key: getattr(explanation.hypothesis, key) for key in ("name", "words", "remedy")},
                "corrected": _fit_values(explanation.fit),
            }
            for explanation in diagnosis.explanations
        ],
        "refine_helps": diagnosis.is_refinable,
    }


def _error_sentence(given: Fit, estimate: Estimate) -> str:
    rotation = f"the rotation is off by {_degrees(given.rotation)}"
    if estimate.have_same_position:
        return rotation
    spread = estimate.uncertainty
    rotation += f" (± {_degrees(spread.rotation)})"
    if _has_no_direction(given):
        return f"{rotation}; the poses put both cameras in one place, the pictures do not"
    return (
        f"{rotation}, the direction of the second camera by {_degrees(given.direction)} "
        f"(± {_degrees(spread.direction)}); its distance cannot be checked"
    )


def _has_no_direction(given: Fit) -> bool:
    """Whether poses have both cameras in one place where the pictures have not, see :class:`Fit`."""
    return given.direction == math.radians(180.0)


def _advice(diagnosis: Diagnosis) -> list[str]:
    if diagnosis.given is not None and _has_no_direction(diagnosis.given):
        return ["give each panorama its own position, or start without poses: `omnisyn poses estimate`"]
    if diagnosis.verdict == "contradiction":
        return ["look for swapped or wrong images, or start without poses: `omnisyn poses estimate`"]
    if diagnosis.is_refinable:
        return ["refining makes them fit better: `omnisyn poses refine`"]
    if not diagnosis.explanations:
        return []
    best, *others = diagnosis.explanations
    return [
        f"it looks as if {best.hypothesis.words} [{best.hypothesis.name}]",
        f"undone, the rotation is off by {_degrees(best.fit.rotation)} and the direction by "
        f"{_degrees(best.fit.direction)}; median residual {_degrees(best.fit.residual)}, {best.fit.in_front:.0%} of "
        "the points in front of both cameras",
        f"to do: {best.hypothesis.remedy}",
        *_alternatives(others),
    ]


def _alternatives(others: list[Explanation]) -> list[str]:
    """Hypotheses with other words only: several corrections may go by one name."""
    lines = list(dict.fromkeys(f"{e.hypothesis.words} [{e.hypothesis.name}]" for e in others))
    more = len(lines) - MAX_ALTERNATIVES
    shown = lines[:MAX_ALTERNATIVES] + ([f"and {more} more (--json lists them)"] if more > 0 else [])
    return ["this pair cannot tell it from:", *(f"  {line}" for line in shown)] if lines else []


def _fit_values(fit: Fit) -> dict[str, Any]:
    return {
        "rotation_off_deg": math.degrees(fit.rotation),
        "direction_off_deg": math.degrees(fit.direction),
        "residual_deg": math.degrees(fit.residual),
        "in_front_share": fit.in_front,
        "supporting_matches": fit.supporting,
    }


def _degrees(radians: float) -> str:
    degrees = math.degrees(radians)
    return f"{degrees:.3f}°" if degrees < 1 else f"{degrees:.1f}°"


def _finite(radians: float) -> float | None:
    return math.degrees(radians) if np.isfinite(radians) else None
