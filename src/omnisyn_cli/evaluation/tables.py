"""The tables of a report: means by method, pair, share of the way and distance, with the best of them marked.

A mean is over all frames (or panoramas, or pairs) that a method measured, with its standard error over scenes. Methods
are called the best if none beats them by more than chance explains, and they beat another one. A method that lacks a
frame which another method measured is not, since it may have been lucky with what it measured.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import stdev

from omnisyn_cli.evaluation import grouping
from omnisyn_cli.evaluation.results import FrameRecord, UnitRecord, mean


@dataclass(frozen=True)
class Column:
    """A column of figures; ``better`` is +1 where more is better, −1 where less is, 0 where neither."""

    title: str
    better: int = 0
    digits: int = 2

    @property
    def heading(self) -> str:
        """The title with an arrow in the direction of what is better."""
        return self.title + {1: " ↑", -1: " ↓", 0: ""}[self.better]


@dataclass(frozen=True)
class Cell:
    """A mean over ``count`` values, NaN of none, with its standard error; or one value, and the name of what has it."""

    value: float
    count: int = 1
    error: float = math.nan
    is_best: bool = False
    name: str = ""


@dataclass(frozen=True)
class Row:
    """One line of a table: figures, or the reason why there are none."""

    name: str
    cells: tuple[Cell, ...] = ()
    reason: str = ""
    is_bound: bool = False


@dataclass(frozen=True)
class Table:
    """A table: ``corner`` is the title of the column with the rows' names, ``note`` a sentence about it."""

    title: str
    note: str
    corner: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]


@dataclass(frozen=True)
class Means:
    """A table of means by method."""

    title: str  # of the table
    counted: str  # what the last column counts
    subject: str  # of the figures, see :func:`omnisyn_cli.evaluation.grouping.figures_of`
    columns: Mapping[str, Column]  # by figure
    note: str  # a sentence about them


# How close pictures are to the true ones.
FRAMES = Means(
    "Means per method", "Frames", "frame",
    {
        "ws_psnr": Column("WS-PSNR, dB", 1),
        "psnr": Column("PSNR, dB", 1),
        "psnr_top": Column("PSNR of the top eighth, dB", 1),
        "psnr_bottom": Column("of the bottom eighth, dB", 1),
        "ws_ssim": Column("WS-SSIM", 1, 4),
        "ssim": Column("SSIM", 1, 4),
        "lrce": Column("LRCE", -1, 4),
        "aligned_psnr": Column("WS-PSNR aligned, dB", 1),
        "aligned_ssim": Column("WS-SSIM aligned", 1, 4),
        "misplacement": Column("Misplacement, degrees", -1),
    },
    "Mean over all frames between the panoramas; each is compared with the true one.",
)  # fmt: skip
# The paper's depth table, over all panoramas whose true depth is known.
DEPTHS = tuple(
    Means(
        f"Depth, {how}", "Panoramas", subject,
        {
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
        },
        f"On pixels with a true depth between 1 m and 50 m; {how}. Estimates beyond 100 m count as 100 m in metres.",
    )
    for how, subject in (("every pixel counts alike", "depth"), ("weighted by solid angle", "depth-weighted"))
)  # fmt: skip
# What neighbouring true frames and both photographs do not show.
ARTEFACTS = Means(
    "Changes, flying pixels and shards", "Frames", "frame",
    {
        "change_psnr": Column("Change from frame to frame, dB", 1),
        "flying": Column("Flying pixels, share of the sphere", -1, 5),
        "shards": Column("Shards, share of edges", -1, 4),
    },
    "Change: PSNR of the difference to the frame before, against that of the true frames. Flying pixels are more "
    "than 30 of 255 levels off the truth, and neither photograph has their colour near where it could show them. "
    "Shards are edges that neither photograph has anywhere near; they need no true frame.",
)  # fmt: skip
# Whether depth knows where it is wrong.
CONFIDENCE = Means(
    "What is known of errors of depth", "Panoramas", "doubt",
    {
        "unsure_area": Column("Unsure area", 0, 4),
        "within_5_unsure": Column("within 5 % there", 1, 4),
        "within_5_sure": Column("within 5 % elsewhere", 1, 4),
        "rank_correlation": Column("Rank correlation of doubt and error", 1, 3),
        "calibration_error": Column("Calibration error", -1, 4),
    },
    "On pixels with a true depth between 1 m and 50 m, weighted by solid angle. Unsure is where both directions of "
    "matching did not agree. Doubt is 1 − confidence, error is relative (Spearman). Calibration error: how far "
    "confidence is from the share of the values within 10 %, in bins of confidence, on average.",
)  # fmt: skip
# How much consecutive frames differ that should not.
STEADINESS = Means(
    "Steadiness", "Pairs", "temporal",
    {
        "warping_error": Column("Warping error", -1, 4),
        "flicker": Column("Flicker", -1, 4),
        "end_first": Column("At the first panorama", -1, 4),
        "end_second": Column("At the second panorama", -1, 4),
    },
    "Warping error: difference of a frame and the next one warped into it along the geometry. Flicker: second "
    "difference in time of each point. At a panorama: root mean square difference from the panorama itself.",
)  # fmt: skip
# Kinds of pixels: every pixel is of one of the first four, and may be of the others as well.
KINDS = {
    "agree": "Both views agree", "disagree": "they disagree", "one_view": "one view only", "hole": "hole",
    "silhouette": "Beside silhouettes", "top": "Top eighth", "bottom": "bottom eighth",
}  # fmt: skip
# Where pictures are wrong. Nothing is marked: every method has kinds of its own.
KIND_TABLES = tuple(
    Means(
        title, "Frames", f"kind-{figure}",
        {kind: Column(name, 0, digits) for kind, name in KINDS.items()},
        f"{note} Kinds are those of a method's own surfaces: what both views show there, or one, or neither, and "
        "whether within a tenth at one distance; beside silhouettes is up to 2 pixels from a jump of depth.",
    )
    for title, note, figure, digits in (
        ("Error by kind of pixel, dB", "PSNR of the pixels of a kind, weighted by solid angle.", "psnr", 2),
        ("Area by kind of pixel", "Share of the sphere.", "area", 4),
        ("Share of the squared error by kind of pixel", "1 is that of the whole picture.", "error", 4),
    )
)  # fmt: skip

DIFFERENCE_COLUMNS = (
    Column("Gain, dB"), Column("standard error"), Column("least"), Column("most"), Column("Frames", 0, 0),
)  # fmt: skip
# Below tables with standard errors.
ERROR_NOTE = (
    "± is the standard error over scenes, or over pairs of a single scene. Marked methods beat another one, and none "
    "beats them, by more than chance explains (95 %, paired by frame)."
)


def report_tables(records: Sequence[UnitRecord]) -> list[Table]:
    """All tables that the records have figures for, the means per method first."""
    tables = [
        mean_table(records),
        tour_table(records),
        *_score_tables(records),
        *(method_table(records, means) for means in (*KIND_TABLES, ARTEFACTS)),
        _worst_table(records, "frame", "WS-PSNR, dB, and the frame that has it", "ws_psnr"),
        _worst_table(records, "change", "PSNR of the change from the frame before, dB", "change_psnr"),
        *(method_table(records, means) for means in (*DEPTHS, CONFIDENCE, STEADINESS)),
        _seconds_table(records),
    ]
    return [table for table in tables if table.rows]


def mean_table(records: Sequence[UnitRecord]) -> Table:
    """Means of all scores per method, the best method first, and the reasons of those that measured nothing."""
    table = method_table(records, FRAMES)
    shown, absent = {row.name for row in table.rows}, []
    gaps = sorted(grouping.gaps(records), key=lambda gap: -len(gap.pairs))  # the most frequent reason first
    for method in grouping.ranked_methods(records):
        if method not in shown:
            reasons = "; ".join(f"{gap.status}: {gap.reason}" for gap in gaps if gap.method == method)
            absent.append(Row(method, (), reasons or "no frame between the panoramas"))
    return replace(table, rows=(*table.rows, *absent))


def tour_table(records: Sequence[UnitRecord]) -> Table:
    """What it is worth that depth comes from both neighbours: each method in tours against itself in pairs alone."""
    note = "WS-PSNR in a tour minus that of the pair alone, of the same frames; the standard error is over scenes."
    rows = [
        Row(base, _difference_cells(found))
        for base in grouping.ranked_methods(records)
        if (found := grouping.differences(records, base, f"{base}:{grouping.TOUR_PARAMETER}"))
    ]
    return Table("In tours", note, "Method", DIFFERENCE_COLUMNS, tuple(rows))


def _difference_cells(found: Mapping[str, Sequence[float]]) -> tuple[Cell, ...]:
    """Of differences by scene."""
    every = [value for values in found.values() for value in values]
    of_scenes = [mean(values) for values in found.values()]
    error = stdev(of_scenes) / math.sqrt(len(of_scenes)) if len(of_scenes) > 1 else math.nan
    return tuple(map(Cell, (mean(every), error, min(every), max(every), len(every))))


def _worst_table(records: Sequence[UnitRecord], what: str, least: str, score: str) -> Table:
    """A row for each pair, a column for each method: the frame with the least of a score."""
    names = grouping.pair_names(records)
    worst = {
        (names[record.pair], record.method): Cell(frame.scores[score], name=frame.name)
        for record in grouping.finished(records)
        for frame in record.frames
        if frame.name == record.worst.get(score)
    }
    methods = [method for method in grouping.ranked_methods(records) if any(by == method for _, by in worst)]
    rows = tuple(
        Row(name, tuple(worst.get((name, method), Cell(math.nan)) for method in methods))
        for name in dict.fromkeys(pair for pair, _ in worst)
    )
    columns = tuple(Column(method, 1) for method in methods)
    return Table(f"Worst {what} of each pair", f"The least {least}.", "Pair", columns, rows)


def _seconds_table(records: Sequence[UnitRecord]) -> Table:
    """Mean wall time per pair by stage and in total; a stage that a method does not have took no time."""
    zeros = dict.fromkeys(grouping.stages_of(records), 0.0)
    timed = [
        replace(unit, seconds=zeros | {"total": math.fsum(unit.seconds.values())} | dict(unit.seconds))
        for unit in records
        if unit.seconds
    ]
    columns = {stage: Column(stage) for stage in zeros} | {"total": Column("Total", -1)}
    return method_table(timed, Means("Seconds per pair", "Pairs", "seconds", columns, "Mean wall time by stage."))


def _score_tables(records: Sequence[UnitRecord]) -> Iterator[Table]:
    """WS-PSNR by pair, by the share of the way, by the distance to the nearer panorama, and by the baseline."""
    names = grouping.pair_names(records)
    for title, corner, group in (
        ("Scenes", "Scene", lambda unit, _: (0, names[unit.pair])),
        ("Share of the way", "t", lambda _, frame: grouping.time_band(frame.t)),
        ("Distance to the nearer panorama", "Distance", lambda _, frame: grouping.distance_band(frame.distance)),
        ("Baseline", "Between the panoramas", lambda unit, _: grouping.distance_band(unit.baseline)),
    ):
        yield _score_table(title, corner, records, group)
    depths = {record.pair: record.median_depth for record in records if record.median_depth is not None}
    known = [replace(record, median_depth=depths[record.pair]) for record in records if record.pair in depths]
    if known:  # of one of the methods of each pair
        title = "Baseline over median depth"
        yield _score_table(title, "Pairs", known, lambda unit, _: grouping.relative_baseline_bin(unit))


def method_table(records: Sequence[UnitRecord], means: Means) -> Table:
    """One row for each method, best first; columns that nobody has are left out, the last one counts the values."""
    placed: dict[str, dict[tuple[str, str, str, int], Mapping[str, float]]] = {}
    for method in grouping.ranked_methods(records):
        found = {
            (*record.pair, number): figures
            for record in grouping.finished(records, method)
            for number, figures in enumerate(f for about, f in grouping.figures_of(record) if about[0] == means.subject)
            if not means.columns.keys().isdisjoint(figures)
        }
        if found:
            placed[method] = found
    present = [key for key in means.columns if any(key in f for found in placed.values() for f in found.values())]
    marked = [
        _cells(
            [{where: figures[key] for where, figures in found.items() if key in figures} for found in placed.values()],
            [0 if grouping.is_oracle(method) else means.columns[key].better for method in placed],
        )
        for key in present
    ]
    counts = [Cell(len(found)) for found in placed.values()]
    rows = tuple(
        Row(name, cells, "", grouping.is_oracle(name))
        for name, cells in zip(placed, zip(*marked, counts, strict=True), strict=True)
    )
    shown = (*(means.columns[key] for key in present), Column(means.counted, 0, 0))
    return Table(means.title, means.note, "Method", shown, rows)


def _score_table(
    title: str, corner: str, records: Sequence[UnitRecord],
    group: Callable[[UnitRecord, FrameRecord], tuple[float, str]],
) -> Table:  # fmt: skip
    """Mean WS-PSNR with a column for each method and a row for each ``group`` of frames, which has order and name."""
    methods = [method for method in grouping.ranked_methods(records) if any(grouping.frames_of(records, method))]
    better = [0 if grouping.is_oracle(method) else 1 for method in methods]
    samples: defaultdict[tuple[float, str], dict[str, dict[tuple[str, ...], float]]]
    samples = defaultdict(lambda: {method: {} for method in methods})
    for record in grouping.finished(records):
        for frame in record.frames:
            if "ws_psnr" in frame.scores:
                of_method = samples[group(record, frame)][record.method]
                of_method[*record.pair, frame.name] = frame.scores["ws_psnr"]
    rows = [
        Row(name, _cells(list(of_methods.values()), better))
        for (_, name), of_methods in sorted(samples.items(), key=lambda item: item[0][0])
    ]
    return Table(title, "Mean WS-PSNR, dB.", corner, tuple(Column(method, 1) for method in methods), tuple(rows))


def _cells(samples: Sequence[grouping.Sample], better: Sequence[int]) -> tuple[Cell, ...]:
    """Means with their errors, the best of them marked; those of which neither more nor less is better take no part."""
    signed = [
        {where: sign * value for where, value in sample.items()} if sign and sample else None
        for sample, sign in zip(samples, better, strict=True)
    ]
    return tuple(
        Cell(mean(sample.values()), len(sample), grouping.error_and_groups(sample)[0], is_best)
        for sample, is_best in zip(samples, grouping.undominated(signed), strict=True)
    )


def format_cell(cell: Cell, digits: int) -> str:
    """A figure with its standard error, if there is one."""
    value = format_value(cell.value, digits)
    return value if math.isnan(cell.error) else f"{value} ± {format_value(cell.error, digits)}"


def format_value(value: float, digits: int) -> str:
    """A figure as text: an en dash where nothing was measured, ∞ for equal pictures."""
    if math.isnan(value):
        return "–"
    return ("∞" if value > 0 else "−∞") if math.isinf(value) else f"{value:.{digits}f}"
