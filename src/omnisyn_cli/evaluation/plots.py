"""The diagrams of a report, as PNG files in memory."""

import io
import math
from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from omnisyn_cli.evaluation.grouping import finished, frames_of, ranked_methods
from omnisyn_cli.evaluation.results import UnitRecord, mean
from omnisyn_cli.interpolation.planning import figures as planned
from omnisyn_cli.interpolation.planning.figures import Figures

# By the name of the file.
PLOT_TITLES = {"ws-psnr-by-seconds": "Quality against time"}
FIGURE_WIDTH, FIGURE_HEIGHT, LEGEND_LINE_HEIGHT = 6.4, 3.8, 0.22  # inches; text stays readable on a telephone
LEGEND_COLUMNS = 3  # as many names as fit the width of a diagram
DOTS_PER_INCH = 160  # sharp on screens of twice the usual density
# Okabe and Ito's colours, which the colour-blind can tell apart, without yellow; markers change when they repeat.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")
# Of the methods, in their order, so that diagrams can be read without colours.
MARKERS = ("o", "s", "^", "D", "v", "P", "X")


def report_plots(records: Sequence[UnitRecord]) -> dict[str, bytes]:
    """Every diagram that there are figures for: a key of :data:`PLOT_TITLES` -> PNG file."""
    figure = _quality_by_seconds(records)
    return {} if figure is None else {"ws-psnr-by-seconds": _png(figure)}


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
