"""The tables of a report: means by method, pair, share of the way and distance, with the best of them marked.

A mean is over all frames (or panoramas, or pairs) that a method measured. A method that lacks one which another method
measured is not called the best, since it may have been lucky with what it measured; tables show the numbers.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence

from omnisyn_cli.evaluation.grouping import (
    Pair,
    band_name,
    distance_band,
    finished,
    frames_of,
    is_bound,
    mean,
    methods_of,
    pair_names,
    pair_of,
    ranked_methods,
    stages_of,
    time_band,
)
from omnisyn_cli.evaluation.records import SCORES, FrameRecord, UnitRecord
from omnisyn_cli.evaluation.table import Cell, Column, Row, Table, marked_columns, marked_row

__all__ = ["depth_table", "report_tables"]


FRAME_COLUMNS = {
    "ws_psnr": Column("WS-PSNR, dB", 1),
    "psnr": Column("PSNR, dB", 1),
    "ws_ssim": Column("WS-SSIM", 1, 4),
    "ssim": Column("SSIM", 1, 4),
    "lrce": Column("LRCE", -1, 4),
    "lpips": Column("LPIPS", -1, 4),
}

DEPTH_COLUMNS = {
    "imae": Column("IMAE, 1/m", -1, 4),
    "irmse": Column("IRMSE, 1/m", -1, 4),
    "mae": Column("MAE, m", -1, 3),
    "rmse": Column("RMSE, m", -1, 3),
    "abs_rel": Column("AbsRel", -1, 4),
    "delta_105": Column("δ < 1.05", 1, 4),
    "delta_110": Column("δ < 1.10", 1, 4),
    "delta_125": Column("δ < 1.25", 1, 4),
    "delta_125_squared": Column("δ < 1.25²", 1, 4),
    "delta_125_cubed": Column("δ < 1.25³", 1, 4),
}

TEMPORAL_COLUMNS = {
    "warping_error": Column("Warping error", -1, 4),
    "flicker": Column("Flicker", -1, 4),
    "end_first": Column("At the first panorama", -1, 4),
    "end_second": Column("At the second panorama", -1, 4),
}

Values = Iterable[Mapping[str, float]]

Placed = tuple[tuple[Pair, int], Mapping[str, float]]
"""Values with their pair and their number there."""


def report_tables(records: Sequence[UnitRecord]) -> list[Table]:
    """All tables that the records have figures for, the means per method first."""
    tables = [
        mean_table(records),
        pair_table(records),
        time_table(records),
        distance_table(records),
        baseline_table(records),
        depth_table(records, weighted=False),
        depth_table(records, weighted=True),
        temporal_table(records),
        seconds_table(records),
    ]
    return [table for table in tables if table.rows]


def mean_table(records: Sequence[UnitRecord]) -> Table:
    """Means of all scores per method, the best method first, and the reasons of those that measured nothing."""
    table = _method_table(
        "Means per method",
        "Mean over all frames between the panoramas; each is compared with the true one.",
        records, FRAME_COLUMNS, _frame_scores, "Frames",
    )  # fmt: skip
    missing = set(methods_of(records)) - {row.name for row in table.rows}
    absent = [Row(name, (), _reasons(records, name)) for name in ranked_methods(records) if name in missing]
    return Table(table.title, table.note, table.corner, table.columns, (*table.rows, *absent))


def depth_table(records: Sequence[UnitRecord], *, weighted: bool) -> Table:
    """The paper's depth table per method, over all panoramas whose true depth is known."""

    def figures(record: UnitRecord) -> Values:
        return ((depth.weighted if weighted else depth.plain) for depth in record.depths)

    how = "weighted by solid angle" if weighted else "every pixel counts alike"
    note = f"On pixels with a true depth between 1 m and 50 m; {how}. Estimates beyond 100 m count as 100 m in metres."
    return _method_table(f"Depth, {how}", note, records, DEPTH_COLUMNS, figures, "Panoramas")


def temporal_table(records: Sequence[UnitRecord]) -> Table:
    """Steadiness per method."""
    note = (
        "Warping error: difference of a frame and the next one warped into it along the geometry. Flicker: second "
        "difference in time of each point. At a panorama: root mean square difference from the panorama itself."
    )
    return _method_table("Steadiness", note, records, TEMPORAL_COLUMNS, lambda record: [record.temporal], "Pairs")


def seconds_table(records: Sequence[UnitRecord]) -> Table:
    """Mean wall time per pair by stage and in total; a stage that a method does not have took no time."""
    stages = stages_of(records)
    columns = {stage: Column(stage) for stage in stages} | {"total": Column("Total", -1)}

    def figures(record: UnitRecord) -> Values:
        zeros = dict.fromkeys(stages, 0.0)
        return [{**zeros, "total": math.fsum(record.seconds.values()), **record.seconds}] if record.seconds else []

    return _method_table("Seconds per pair", "Mean wall time by stage.", records, columns, figures, "Pairs")


def pair_table(records: Sequence[UnitRecord]) -> Table:
    """WS-PSNR of every method on every pair."""
    names = pair_names(records)
    return _score_table("Scenes", "Scene", records, lambda record, _: (0, names[pair_of(record)]))


def time_table(records: Sequence[UnitRecord]) -> Table:
    """WS-PSNR by the share of the way."""

    def part(_: UnitRecord, frame: FrameRecord) -> tuple[float, str]:
        begin, end = time_band(frame.t)
        return begin, f"{begin:.1f} to {end:.1f}"

    return _score_table("Share of the way", "t", records, part)


def distance_table(records: Sequence[UnitRecord]) -> Table:
    """WS-PSNR by the distance to the nearer panorama."""

    def band(_: UnitRecord, frame: FrameRecord) -> tuple[float, str]:
        number = distance_band(frame.distance)
        return number, band_name(number)

    return _score_table("Distance to the nearer panorama", "Distance", records, band)


def baseline_table(records: Sequence[UnitRecord]) -> Table:
    """WS-PSNR by the distance between the two panoramas."""

    def band(record: UnitRecord, _: FrameRecord) -> tuple[float, str]:
        number = distance_band(record.baseline)
        return number, band_name(number)

    return _score_table("Baseline", "Between the panoramas", records, band)


def _method_table(
    title: str,
    note: str,
    records: Sequence[UnitRecord],
    columns: Mapping[str, Column],
    figures: Callable[[UnitRecord], Values],
    counted: str,
) -> Table:
    """One row for each method, best first; columns that nobody has are left out, the last one counts the values."""
    placed = {method: _placed(records, method, figures) for method in ranked_methods(records)}
    every = [one for listed in placed.values() for one in listed]
    present = [key for key in columns if any(key in values for _, values in every)]
    totals = [len({where for where, values in every if key in values}) for key in present]
    rows = [
        Row(method, (*(_cell(listed, key) for key in present), Cell(len(listed))), is_bound=is_bound(method))
        for method, listed in placed.items()
        if listed
    ]
    shown = (*(columns[key] for key in present), Column(counted, 0, 0))
    return Table(title, note, "Method", shown, marked_columns(shown, rows, [*totals, len(rows)]))


def _placed(records: Sequence[UnitRecord], method: str, figures: Callable[[UnitRecord], Values]) -> list[Placed]:
    """The values of a method, each with its pair and its number there, which are the same for all methods."""
    return [
        ((pair_of(record), number), values)
        for record in finished(records)
        if record.method == method
        for number, values in enumerate(figures(record))
        if values
    ]


def _score_table(
    title: str,
    corner: str,
    records: Sequence[UnitRecord],
    place: Callable[[UnitRecord, FrameRecord], tuple[float, str]],
) -> Table:
    """Mean WS-PSNR with a column for each method and a row for each group of frames, in order of ``place``."""
    methods = [method for method in ranked_methods(records) if any(frames_of(records, method))]
    groups: dict[tuple[float, str], dict[str, list[float]]] = {}
    shown: dict[tuple[float, str], set[tuple[Pair, str]]] = {}
    for record in finished(records):
        for frame in record.frames:
            if "ws_psnr" in frame.scores:
                where = place(record, frame)
                groups.setdefault(where, {}).setdefault(record.method, []).append(frame.scores["ws_psnr"])
                shown.setdefault(where, set()).add((pair_of(record), frame.name))
    columns = tuple(Column(method, 1) for method in methods)
    rows = [
        marked_row(
            columns,
            Row(where[1], tuple(Cell(mean(group.get(method, ())), len(group.get(method, ()))) for method in methods)),
            len(shown[where]),
        )
        for where, group in sorted(groups.items(), key=lambda item: item[0][0])
    ]
    return Table(title, "Mean WS-PSNR, dB.", corner, columns, tuple(rows))


def _frame_scores(record: UnitRecord) -> Values:
    return ({key: frame.scores[key] for key in SCORES if key in frame.scores} for frame in record.frames)


def _cell(listed: Sequence[Placed], key: str) -> Cell:
    values = [values[key] for _, values in listed if key in values]
    return Cell(mean(values), len(values))


def _reasons(records: Sequence[UnitRecord], method: str) -> str:
    """Why a method measured nothing: each reason once, the most frequent first."""
    of_method = [record for record in records if record.method == method]
    reasons = Counter(f"{record.status}: {record.reason}" for record in of_method if record.status != "done")
    return "; ".join(reason for reason, _ in reasons.most_common()) or "no frame between the panoramas"
