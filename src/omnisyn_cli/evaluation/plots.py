"""The diagrams of a report, as PNG files in memory."""

import io
import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from omnisyn_cli.evaluation.grouping import distance_band, finished, frames_of, ranked_methods, stages_of, time_band
from omnisyn_cli.evaluation.metrics.depth import merged_reliability
from omnisyn_cli.evaluation.results import FrameRecord, UnitRecord, mean
from omnisyn_cli.interpolation.planning import figures as planned
from omnisyn_cli.interpolation.planning.figures import Figures

# By the name of the file.
PLOT_TITLES = {
    "ws-psnr-by-distance": "WS-PSNR against the distance from the nearer panorama",
    "ws-psnr-by-share": "WS-PSNR along the way",
    "ws-psnr-by-seconds": "Quality against time",
    "seconds-by-stage": "Seconds per pair, by stage",
    "reliability": "Reliability of depth: the share within 10 % (full) and 5 % (dotted) by confidence",
}
FIGURE_WIDTH, FIGURE_HEIGHT, LEGEND_LINE_HEIGHT = 6.4, 3.8, 0.22  # inches; text stays readable on a telephone
LEGEND_COLUMNS = 3  # as many names as fit the width of a diagram
DOTS_PER_INCH = 160  # sharp on screens of twice the usual density
# Okabe and Ito's colours, which the colour-blind can tell apart, without yellow; markers change when they repeat.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")
# Of the methods, in their order, so that diagrams can be read without colours.
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
MAX_POINTS = 2000  # frames up to which single points are drawn; more would hide the means


def report_plots(records: Sequence[UnitRecord]) -> dict[str, bytes]:
    """Every diagram that there are figures for: a key of :data:`PLOT_TITLES` -> PNG file."""
    return {name: _png(figure) for name, figure in _diagrams(records).items() if figure is not None}


def _diagrams(records: Sequence[UnitRecord]) -> dict[str, Figure | None]:
    return {
        "ws-psnr-by-distance": _quality_by(
            records, lambda f: (f.distance, distance_band(f.distance)[0]), "Distance from the nearer panorama, m"
        ),
        "ws-psnr-by-share": _quality_by(records, lambda f: (f.t, time_band(f.t)[0]), "Share of the way, t"),
        "ws-psnr-by-seconds": _quality_by_seconds(records),
        "seconds-by-stage": _seconds_by_stage(records),
        "reliability": _reliability(records),
    }


def _quality_by(
    records: Sequence[UnitRecord], coordinates: Callable[[FrameRecord], tuple[float, float]], title: str
) -> Figure | None:
    """Frames as points, means over bands as lines; ``coordinates``: place on the axis ``title`` and band of frames."""
    drawn = {
        method: [(*coordinates(frame), score) for score, frame in frames_of(records, method) if math.isfinite(score)]
        for method in ranked_methods(records)
    }
    drawn = {method: points for method, points in drawn.items() if points}
    if not drawn:
        return None
    figure, axes = _new_figure(len(drawn))
    shows_points = sum(map(len, drawn.values())) <= MAX_POINTS
    for index, (method, points) in enumerate(drawn.items()):
        style = _style(index)
        if shows_points:
            axes.scatter([x for x, _, _ in points], [y for _, _, y in points], s=9, alpha=0.3, color=style["color"])
        bands: defaultdict[float, list[tuple[float, float]]] = defaultdict(list)
        for place, band, score in points:
            bands[band].append((place, score))
        line = np.array([[mean(values) for values in zip(*bands[band], strict=True)] for band in sorted(bands)])
        axes.plot(*line.T, linewidth=1.6, markersize=5, label=_legend_label(method), **style)
    axes.set_xlim(left=0.0)
    _finish(figure, axes, title, "WS-PSNR, dB")
    return figure


def _quality_by_seconds(records: Sequence[UnitRecord]) -> Figure | None:
    """What a method's quality costs: mean WS-PSNR against mean seconds per pair."""
    points = {}
    for method in ranked_methods(records):
        units = [record for record in finished(records, method) if record.seconds]
        score = mean(value for value, _ in frames_of(records, method))
        seconds = mean(record.seconds.get("total", math.fsum(record.seconds.values())) for record in units)
        if math.isfinite(score) and seconds > 0:
            points[method] = (seconds, score)
    if not points:
        return None
    figure, axes = _new_figure(len(points))
    for index, (method, (seconds, score)) in enumerate(points.items()):
        axes.plot([seconds], [score], linestyle="none", markersize=8, label=_legend_label(method), **_style(index))
    axes.set_xscale("log", subs=(2, 5))
    _finish(figure, axes, "Seconds per pair", "WS-PSNR, dB")
    return figure


def _seconds_by_stage(records: Sequence[UnitRecord]) -> Figure | None:
    """Mean wall time of a pair as bars that are made of the stages."""
    units = [record for record in finished(records) if record.seconds]
    if not units:
        return None
    methods = [method for method in ranked_methods(records) if finished(units, method)]
    stages, names = stages_of(units), list(map(_legend_label, methods))
    figure, axes = _new_figure(len(stages), height=0.9 + 0.3 * len(methods))
    left = np.zeros(len(methods))
    for index, stage in enumerate(stages):
        widths = [mean(unit.seconds.get(stage, 0.0) for unit in finished(units, method)) for method in methods]
        axes.barh(names, widths, left=left, label=_legend_label(stage), color=_colour(index))
        left = left + widths
    axes.invert_yaxis()
    axes.set_xlim(left=0.0, right=1.03 * left.max())
    _finish(figure, axes, "Seconds per pair", "")
    return figure


def _reliability(records: Sequence[UnitRecord]) -> Figure | None:
    """How often depth of some confidence is right; on the diagonal, confidence is that share."""
    diagrams = {
        method: merged_reliability(found)
        for method in ranked_methods(records)
        if (found := [d.reliability for record in finished(records, method) for d in record.depths if d.reliability])
    }
    if not diagrams:
        return None
    figure, axes = _new_figure(len(diagrams))
    axes.plot([0, 1], [0, 1], color="0.6", linewidth=1.0, zorder=1)
    for index, (method, diagram) in enumerate(diagrams.items()):
        at, ten, five = (list(diagram[name].values()) for name in ("confidence", "within_10", "within_5"))
        axes.plot(at, ten, linewidth=1.6, markersize=5, label=_legend_label(method), **_style(index))
        axes.plot(at, five, linewidth=1.2, linestyle=":", color=_colour(index))
    axes.set(xlim=(0, 1), ylim=(0, 1))
    _finish(figure, axes, "Confidence", "Share of the values")
    return figure


def pareto_plot(measured: Sequence[Figures], reference_method: str) -> bytes | None:
    """Accuracy against the computing of a standard clip as PNG: a line along the front; None without accuracy.

    Full points are on the front. Bars are the standard error of the difference to the default, from pair to pair.
    """
    rated = sorted((f for f in measured if f.status == "done" and f.scores), key=planned.standard_seconds)
    if not rated:
        return None
    figure, axes = _new_figure(len(rated), FIGURE_HEIGHT + 0.8)
    front = planned.pareto_front(rated)
    axes.plot([planned.standard_seconds(f) for f in front], [planned.quality(f) for f in front], color="0.6", zorder=1)
    reference = next((f for f in rated if f.setting.method == reference_method), rated[0])
    for index, figures in enumerate(rated):
        error = planned.gain(figures, reference)[1]
        style = {**_style(index), "markerfacecolor": _colour(index) if figures in front else "white"}
        method, (height, width) = figures.setting.method, figures.setting.size
        axes.errorbar(
            planned.standard_seconds(figures), planned.quality(figures), yerr=None if math.isnan(error) else error,
            linestyle="none", markersize=7, capsize=2, linewidth=1.0,
            label=_legend_label(f"{method.removeprefix('omnisyn-')}, {width}x{height}"), **style,
        )  # fmt: skip
    axes.set_xscale("log", subs=(2, 3, 5))
    _finish(
        figure, axes, f"Seconds of computing for {planned.STANDARD_FRAMES} frames between two panoramas", "WS-PSNR, dB"
    )
    return _png(figure)


def _new_figure(entries: int, height: float = FIGURE_HEIGHT) -> tuple[Figure, Axes]:
    """A diagram with room for a legend of so many entries below it."""
    size = (FIGURE_WIDTH, height + LEGEND_LINE_HEIGHT * math.ceil(entries / LEGEND_COLUMNS))
    figure = Figure(size, DOTS_PER_INCH, layout="constrained")
    return figure, figure.add_subplot()


def _finish(figure: Figure, axes: Axes, x_title: str, y_title: str) -> None:
    if axes.get_xscale() == "log":
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter("{x:g}")
    axes.set(xlabel=x_title, ylabel=y_title, axisbelow=True)
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=LEGEND_COLUMNS, frameon=False, fontsize="small")


def _png(figure: Figure) -> bytes:
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()


def _style(index: int) -> dict[str, Any]:
    return {"color": _colour(index), "marker": MARKERS[index // len(COLOURS) % len(MARKERS)]}


def _colour(index: int) -> str:
    return COLOURS[index % len(COLOURS)]


def _legend_label(name: str) -> str:
    """A name as it is: no formulas, and no leading underscore, which would hide it from a legend."""
    shown = name.replace("$", r"\$")
    return f"\u200b{shown}" if shown.startswith("_") else shown
