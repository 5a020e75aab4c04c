"""Records of finished units, sorted into the groups that tables and diagrams show."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from omnisyn_cli.evaluation.records import FrameRecord, UnitRecord

__all__ = [
    "Gap",
    "Pair",
    "band_name",
    "distance_band",
    "finished",
    "frames_of",
    "gaps",
    "is_bound",
    "mean",
    "methods_of",
    "pair_names",
    "pair_of",
    "ranked_methods",
    "stages_of",
    "time_band",
]

BOUNDS = frozenset({"oracle-depth"})
"""Methods that are told what the others have to find out, whatever their parameters."""

MAIN_SCORE = "ws_psnr"

BAND_EDGES = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0, math.inf)
"""Metres: distances are put together from one edge (excluded) to the next (included)."""

TIME_BANDS = 5
"""Parts of equal length that the way between two panoramas is cut into."""

STAGES = ("depth", "flow", "mesh", "render", "fuse")
"""Stages in the order in which they are gone through; others follow."""

Pair = tuple[str, str, str]
"""Scene, first and second panorama."""


def finished(records: Iterable[UnitRecord]) -> list[UnitRecord]:
    """The units that were measured."""
    return [record for record in records if record.status == "done"]


def is_bound(method: str) -> bool:
    """Whether a method is an upper bound, which is shown but never called the best."""
    return method.partition(":")[0] in BOUNDS


def methods_of(records: Iterable[UnitRecord]) -> list[str]:
    """Names of methods in the order in which they appear; records about a whole scene have none."""
    return list(dict.fromkeys(record.method for record in records if record.method))


def ranked_methods(records: Sequence[UnitRecord]) -> list[str]:
    """All methods, the one with the highest mean WS-PSNR first, those that measured nothing last."""

    def standing(method: str) -> float:
        score = mean(value for value, _ in frames_of(records, method))
        return -math.inf if math.isnan(score) else score

    return sorted(methods_of(records), key=standing, reverse=True)


def frames_of(records: Iterable[UnitRecord], method: str) -> Iterator[tuple[float, FrameRecord]]:
    """The :data:`MAIN_SCORE` of every frame of a method that has it, with the frame."""
    for record in finished(records):
        if record.method == method:
            yield from ((frame.scores[MAIN_SCORE], frame) for frame in record.frames if MAIN_SCORE in frame.scores)


def stages_of(records: Iterable[UnitRecord]) -> list[str]:
    """All stages that took time, without the total."""
    found = dict.fromkeys(stage for record in finished(records) for stage in record.seconds if stage != "total")
    return [stage for stage in STAGES if stage in found] + [stage for stage in found if stage not in STAGES]


def mean(values: Iterable[float]) -> float:
    """Arithmetic mean; NaN of nothing, infinite if one value is."""
    listed = list(values)
    return math.fsum(listed) / len(listed) if listed else math.nan


def distance_band(metres: float) -> int:
    """Number of the band of :data:`BAND_EDGES` that a distance lies in; millimetres beyond an edge do not count."""
    rounded = round(metres, 2)
    return max(1, next(index for index, edge in enumerate(BAND_EDGES) if rounded <= edge))


def band_name(band: int) -> str:
    """A band in words."""
    lower, upper = BAND_EDGES[band - 1], BAND_EDGES[band]
    return f"more than {lower:g} m" if math.isinf(upper) else f"{lower:g} to {upper:g} m"


def time_band(t: float) -> tuple[float, float]:
    """The part of the way, ``[begin, end)`` in [0, 1], that ``t`` lies in."""
    band = min(math.floor(t * TIME_BANDS + 1e-9), TIME_BANDS - 1)
    return band / TIME_BANDS, (band + 1) / TIME_BANDS


def pair_names(records: Iterable[UnitRecord]) -> dict[Pair, str]:
    """What each pair is called: its scene, and which panoramas where the scene has several pairs."""
    pairs: defaultdict[str, dict[Pair, None]] = defaultdict(dict)
    for record in records:
        if record.method:
            pairs[record.scene][pair_of(record)] = None
    return {
        pair: scene if len(listed) == 1 else f"{scene}: {pair[1]} → {pair[2]}"
        for scene, listed in pairs.items()
        for pair in listed
    }


def pair_of(record: UnitRecord) -> Pair:
    """Scene, first and second panorama."""
    return record.scene, record.first, record.second


@dataclass(frozen=True)
class Gap:
    """Something that was not measured.

    Attributes:
        method: empty where a whole scene was not used.
        status: ``unavailable``, ``skipped`` or ``failed``.
        reason: why.
        pairs: the pairs or scenes that it concerns.
    """

    method: str
    status: str
    reason: str
    pairs: tuple[str, ...]


def gaps(records: Sequence[UnitRecord]) -> list[Gap]:
    """All that was not measured: whole scenes first, then method by method; equal reasons together."""
    names = pair_names(records)
    found: defaultdict[tuple[str, str, str], list[str]] = defaultdict(list)
    for record in sorted(records, key=lambda record: record.method != ""):
        if record.status != "done":
            where = names[pair_of(record)] if record.method else record.scene
            found[record.method, record.status, record.reason].append(where)
    return [Gap(*key, tuple(where)) for key, where in found.items()]
