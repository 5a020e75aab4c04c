"""How far means can be relied on: standard errors over scenes, and whether a difference is more than chance.

Frames of one scene are alike, so that it is scenes that count; pairs do where there is a single scene.
"""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

from omnisyn_cli.evaluation.results import mean

Sample = Mapping[tuple[Any, ...], float]
"""Values by where they were measured: the scene, the first panorama, the second, and what tells the rest apart."""

PAIR_PARTS = 3
"""Parts of such a key that name a pair."""

STUDENT_T = (math.inf, 12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26, 2.23)
"""97.5 % quantiles of Student's distribution, by degrees of freedom; the last one is enough for more."""


def standard_error(sample: Sample) -> float:
    """Of the mean of all values, which are grouped by scene; NaN of a single group.

    Source: Cameron and Miller, "A Practitioner's Guide to Cluster-Robust Inference", 2015, equation 11.
    """
    return _error_and_groups(sample)[0]


def beats(sample: Sample, other: Sample) -> bool:
    """Whether the mean is higher than that of another, of the same keys, by more than chance explains (95 %)."""
    difference = {where: value - other[where] for where, value in sample.items()}
    error, groups = _error_and_groups(difference)
    return bool(mean(difference.values()) > STUDENT_T[min(groups - 1, len(STUDENT_T) - 1)] * error)


def undominated(samples: Sequence[Sample | None]) -> list[bool]:
    """Those that no other one beats, if they beat any; None takes no part, nor does who lacks a value of another."""
    everywhere = {where for sample in samples if sample is not None for where in sample}
    taking_part = [sample is not None and sample.keys() == everywhere for sample in samples]
    found = []
    for sample, is_complete in zip(samples, taking_part, strict=True):
        others = [other for other, has in zip(samples, taking_part, strict=True) if has and other is not sample]
        if sample is None or not is_complete:
            found.append(False)
            continue
        is_beaten = any(beats(other, sample) for other in others if other is not None)
        found.append(not is_beaten and any(beats(sample, other) for other in others if other is not None))
    return found


def _error_and_groups(sample: Sample) -> tuple[float, int]:
    parts = 1 if len({where[0] for where in sample}) > 1 else PAIR_PARTS
    center, sums = mean(sample.values()), defaultdict[tuple[Any, ...], float](float)
    for where, value in sample.items():
        sums[where[:parts]] += value - center
    groups = len(sums)
    if groups < 2 or not math.isfinite(center):
        return math.nan, groups
    return math.sqrt(groups / (groups - 1) * math.fsum(each * each for each in sums.values())) / len(sample), groups
