"""A diagnosis in words, and as values for programs."""

import math
from typing import Any

import numpy as np

from omnisyn_cli.poses.registration.diagnosis import Diagnosis, Explanation, Fit, Verdict
from omnisyn_cli.poses.registration.robust import Estimate

PLAUSIBLE_CAMERA_HEIGHTS = (0.3, 4.0)
"""Metres above the floor: from a tripod on the ground to the roof of a car."""

EXPECTED_CAMERA_HEIGHT = 1.5
"""Metres above the floor, of a camera on a tripod or in a raised hand."""

MAX_ALTERNATIVES = 4
"""Further explanations that are printed; ``--json`` lists all."""

VERDICTS: dict[Verdict, str] = {
    "fits": "the poses fit",
    "close": "the poses nearly fit",
    "mistake": "the poses do not fit",
    "contradiction": "the poses do not fit, and no common mistake explains it",
    "in place": "the pictures were taken (nearly) from one place; the rotations fit, a direction cannot be seen",
}


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
    measured = f"{diagnosis.matches} matches, {found} agree with one another, {given.support_mask} with the poses given"
    if not (estimate.have_same_position or _has_no_direction(given)):
        measured += f"; median residual {_degrees(given.residual)}, with the poses found {_degrees(estimate.residual)}"
        measured += f"; {given.in_front:.0%} of the points in front of both cameras"
    sentences.append(measured)
    sentences.extend(_advice(diagnosis))
    return sentences


def camera_height_sentence(height: float, found_baseline: float | None = None) -> str:
    """What a height in metres above the floor says about the distances between cameras.

    Args:
        height: by these distances.
        found_baseline: mean distance of neighbours that poses from the pictures were scaled to; None for given poses.
    """
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
                "name": explanation.hypothesis.name,
                "words": explanation.hypothesis.words,
                "remedy": explanation.hypothesis.remedy,
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
    sentences = [
        f"it looks as if {best.hypothesis.words} [{best.hypothesis.name}]",
        f"undone, the rotation is off by {_degrees(best.fit.rotation)} and the direction by "
        f"{_degrees(best.fit.direction)}; median residual {_degrees(best.fit.residual)}, {best.fit.in_front:.0%} of "
        "the points in front of both cameras",
        f"to do: {best.hypothesis.remedy}",
    ]
    return [*sentences, *_alternatives(others)]


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
        "supporting_matches": fit.support_mask,
    }


def _degrees(radians: float) -> str:
    degrees = math.degrees(radians)
    return f"{degrees:.3f}°" if degrees < 1 else f"{degrees:.1f}°"


def _finite(radians: float) -> float | None:
    return math.degrees(radians) if np.isfinite(radians) else None
