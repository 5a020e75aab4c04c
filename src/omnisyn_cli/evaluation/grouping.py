"""Records of finished units, sorted into the groups that tables and diagrams show, and how far means can be relied on.

Standard errors are over scenes, since frames of one scene are alike; over pairs where there is a single scene.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from omnisyn_cli.evaluation.results import FrameRecord, UnitRecord, mean

BOUND = "oracle-depth"  # the method that is given the true depth: whatever its parameters, an upper bound of the others
TOUR_PARAMETER = "neighbours=2"  # the parameter of a method that lets depth come from both neighbours of a panorama
MAIN_SCORE = "ws_psnr"  # the score that methods are ranked by
# Metres: distances are put together from one edge (excluded) to the next (included).
BAND_EDGES = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0, math.inf)
# Baseline over median depth, from and below: 2 m are wide in a room and narrow in a street.
BASELINE_BINS = {"narrow": (0.0, 0.25), "medium": (0.25, 0.6), "wide": (0.6, math.inf)}
TIME_BANDS = 5  # parts of equal length that the way between two panoramas is cut into
# Stages in the order in which they are gone through; others follow.
STAGES = ("depth", "flow", "mesh", "render", "fuse")

# Values by where they were measured: the scene, the first panorama, the second, and what tells the rest apart.
Sample = Mapping[tuple[Any, ...], float]
PAIR_PARTS = 3  # parts of such a key that name a pair
# 97.5 % quantiles of Student's distribution, by degrees of freedom; the last one is enough for more.
STUDENT_T = (math.inf, 12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26, 2.23)


def finished(records: Iterable[UnitRecord], method: str | None = None) -> list[UnitRecord]:
    """The units that were measured, all or those of a method."""
    return [record for record in records if record.status == "done" and method in (None, record.method)]


def is_oracle(method: str) -> bool:
    """Whether a method is an upper bound, which is shown but never marked as the best."""
    return method.partition(":")[0] == BOUND


def ranked_methods(records: Sequence[UnitRecord]) -> list[str]:
    """All methods, the one with the highest mean WS-PSNR first, those that measured nothing last."""

    def standing(method: str) -> float:
        score = mean(value for value, _ in frames_of(records, method))
        return -math.inf if math.isnan(score) else score

    return sorted(dict.fromkeys(record.method for record in records if record.method), key=standing, reverse=True)


def frames_of(records: Iterable[UnitRecord], method: str) -> Iterator[tuple[float, FrameRecord]]:
    """The :data:`MAIN_SCORE` of every frame of a method that has it, with the frame."""
    for record in finished(records, method):
        yield from ((frame.scores[MAIN_SCORE], frame) for frame in record.frames if MAIN_SCORE in frame.scores)


def differences(records: Sequence[UnitRecord], method: str, other: str) -> dict[str, list[float]]:
    """By scene, how much higher the :data:`MAIN_SCORE` of ``other`` is in every frame that both methods have."""
    found: defaultdict[str, list[float]] = defaultdict(list)
    scores = {record.pair: record for record in finished(records, method)}
    for record in finished(records, other):
        before = scores[record.pair].frames if record.pair in scores else ()
        for own, frame in zip(before, record.frames, strict=False):
            if MAIN_SCORE in own.scores and MAIN_SCORE in frame.scores:
                found[record.scene].append(frame.scores[MAIN_SCORE] - own.scores[MAIN_SCORE])
    return dict(found)


def figures_of(record: UnitRecord) -> Iterator[tuple[tuple[str, str, float | str, float | str], Mapping[str, float]]]:
    """What was measured of what: subject, name, t and distance, as far as there are any, and the figures by metric."""
    for frame in record.frames:
        yield ("frame", frame.name, frame.t, frame.distance), frame.scores
        for figure, numbers in frame.by_kind.items():
            yield (f"kind-{figure}", frame.name, frame.t, frame.distance), numbers
    for depth in record.depths:
        yield ("depth", depth.view, "", ""), depth.plain
        yield ("depth-weighted", depth.view, "", ""), depth.weighted
        yield ("doubt", depth.view, "", ""), depth.doubt
        for figure, numbers in depth.reliability.items():
            yield (f"reliability-{figure}", depth.view, "", ""), numbers
    yield ("temporal", "", "", ""), record.temporal
    yield ("seconds", "", "", ""), record.seconds


def stages_of(records: Iterable[UnitRecord]) -> list[str]:
    """All stages that took time, without the total."""
    found = dict.fromkeys(stage for record in finished(records) for stage in record.seconds if stage != "total")
    return [stage for stage in STAGES if stage in found] + [stage for stage in found if stage not in STAGES]


def distance_band(metres: float) -> tuple[float, str]:
    """Lower edge and name of the band of :data:`BAND_EDGES` of a distance; millimetres beyond an edge do not count."""
    rounded = round(metres, 2)
    band = max(1, next(index for index, edge in enumerate(BAND_EDGES) if rounded <= edge))
    lower, upper = BAND_EDGES[band - 1], BAND_EDGES[band]
    return lower, f"more than {lower:g} m" if math.isinf(upper) else f"{lower:g} to {upper:g} m"


def baseline_bin(ratio: float) -> str:
    """The name of the bin of a baseline over median depth."""
    return next(name for name, (least, below) in BASELINE_BINS.items() if least <= ratio < below)


def median_depth(inverse_depth: Float[np.ndarray, "height width"]) -> float:
    """Metres, of what is not the sky in a map of 1/metre; 1 km where there is nothing else."""
    near = inverse_depth[::4, ::4]
    near = near[np.isfinite(near) & (near > 0)]
    return 1.0 / float(np.median(near)) if near.size else 1e3


def relative_baseline_bin(record: UnitRecord) -> tuple[float, str]:
    """Order and name of the bin of a unit, with its bounds; its median depth is known."""
    name = baseline_bin(record.baseline / (record.median_depth or math.inf))
    least, below = BASELINE_BINS[name]
    return least, f"{name} (from {least:g})" if math.isinf(below) else f"{name} ({least:g} to {below:g})"


def time_band(t: float) -> tuple[float, str]:
    """Begin and name of the part of the way, ``[begin, end)`` in [0, 1], that ``t`` lies in."""
    band = min(math.floor(t * TIME_BANDS + 1e-9), TIME_BANDS - 1)
    return band / TIME_BANDS, f"{band / TIME_BANDS:.1f} to {(band + 1) / TIME_BANDS:.1f}"


def pair_names(records: Iterable[UnitRecord]) -> dict[tuple[str, str, str], str]:
    """What each pair is called: its scene, and which panoramas where the scene has several pairs."""
    pairs = dict.fromkeys(record.pair for record in records if record.method)
    counts = Counter(scene for scene, *_ in pairs)
    return {pair: pair[0] if counts[pair[0]] == 1 else f"{pair[0]}: {pair[1]} → {pair[2]}" for pair in pairs}


@dataclass(frozen=True)
class Gap:
    """Something that was not measured."""

    method: str  # empty where a whole scene was not used
    status: str  # ``unavailable``, ``skipped`` or ``failed``
    reason: str  # why
    pairs: tuple[str, ...]  # the pairs or scenes that it concerns


def gaps(records: Sequence[UnitRecord]) -> list[Gap]:
    """All that was not measured: whole scenes first, then method by method; equal reasons together."""
    names = pair_names(records)
    found: defaultdict[tuple[str, str, str], list[str]] = defaultdict(list)
    for record in sorted(records, key=lambda record: record.method != ""):
        if record.status != "done":
            where = names[record.pair] if record.method else record.scene
            found[record.method, record.status, record.reason].append(where)
    return [Gap(*key, tuple(where)) for key, where in found.items()]


def beats(sample: Sample, other: Sample) -> bool:
    """Whether the mean is higher than that of another, of the same keys, by more than chance explains (95 %)."""
    difference = {where: value - other[where] for where, value in sample.items()}
    error, groups = error_and_groups(difference)
    return bool(mean(difference.values()) > STUDENT_T[min(groups - 1, len(STUDENT_T) - 1)] * error)


def undominated(samples: Sequence[Sample | None]) -> list[bool]:
    """Those that no other one beats, if they beat any; None takes no part, nor does who lacks a value of another."""
    everywhere = {where for sample in samples if sample is not None for where in sample}
    complete = [sample for sample in samples if sample is not None and sample.keys() == everywhere]
    return [
        sample is not None
        and sample.keys() == everywhere
        and any(beats(sample, other) for other in complete)
        and not any(beats(other, sample) for other in complete)
        for sample in samples
    ]


def error_and_groups(sample: Sample) -> tuple[float, int]:
    """The standard error of the mean of all values, NaN of a single group; and how many groups (scenes) there are.

    Source: Cameron and Miller, "A Practitioner's Guide to Cluster-Robust Inference", 2015, equation 11.
    """
    parts = 1 if len({where[0] for where in sample}) > 1 else PAIR_PARTS
    center, sums = mean(sample.values()), defaultdict[tuple[Any, ...], float](float)
    for where, value in sample.items():
        sums[where[:parts]] += value - center
    groups = len(sums)
    if groups < 2 or not math.isfinite(center):
        return math.nan, groups
    return math.sqrt(groups / (groups - 1) * math.fsum(each * each for each in sums.values())) / len(sample), groups
