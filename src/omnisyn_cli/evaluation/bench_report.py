"""The figures of a bench as tables, as a diagram and as a page."""

from __future__ import annotations

import base64
import io
import json
import math
from collections.abc import Sequence
from pathlib import Path

from omnisyn_cli import __version__
from omnisyn_cli.evaluation.bench import machine_in_words
from omnisyn_cli.evaluation.markup import Html, element, page
from omnisyn_cli.evaluation.page import STYLE, table_section
from omnisyn_cli.evaluation.pareto import (
    FRAME_STAGES,
    STANDARD_FRAMES,
    Figures,
    first_seconds,
    frame_seconds,
    pair_stages,
    pareto_front,
    standard_seconds,
)
from omnisyn_cli.evaluation.plots import COLOURS, DOTS_PER_INCH, HEIGHT, LEGEND_COLUMNS, MARKERS, WIDTH
from omnisyn_cli.evaluation.table import Cell, Column, Row, Table
from omnisyn_cli.io.paths import write_errors
from omnisyn_cli.io.staging import staged_folder

__all__ = ["bench_tables", "pareto_diagram", "write_bench_report"]

REPORT_NAME = "bench"

MEGA = 1e6


def write_bench_report(folder: Path, measured: Sequence[Figures]) -> None:
    """Write ``bench.html``, ``bench.json`` and, where there is accuracy, ``bench.png``.

    Args:
        folder: where to; its parent must exist.
        measured: figures of all settings.

    Raises:
        WriteError: the disk is full, or the folder went away.
    """
    diagram = pareto_diagram(measured)
    values = {
        "version": __version__,
        "machine": machine_in_words(),
        "settings": [figures.to_json() for figures in measured],
    }
    with staged_folder(folder) as staged, write_errors(folder):
        text = json.dumps(values, ensure_ascii=False, allow_nan=False, indent=1) + "\n"
        (staged / f"{REPORT_NAME}.json").write_text(text, encoding="utf-8")
        (staged / f"{REPORT_NAME}.html").write_text(_page(measured, diagram), encoding="utf-8")
        if diagram is not None:
            (staged / f"{REPORT_NAME}.png").write_bytes(diagram)


def bench_tables(measured: Sequence[Figures]) -> list[Table]:
    """Which setting to take for which budget, one table for each size of frames, then what everything takes."""
    sizes = dict.fromkeys(figures.setting.size for figures in measured)
    choices = [_choice_table([f for f in measured if f.setting.size == size], size) for size in sizes]
    return [*(table for table in choices if table.rows), _stage_table(measured)]


def _choice_table(measured: Sequence[Figures], size: tuple[int, int]) -> Table:
    columns = (
        Column("WS-PSNR, dB", 1), Column(f"{STANDARD_FRAMES} frames, s", -1, 1), Column("First frame, s", -1, 1),
        Column("Each further frame, s", -1, 3), Column("Memory, MB", -1, 0),
    )  # fmt: skip
    rows = tuple(
        Row(f"from {standard_seconds(f):.1f} s: {f.setting.name}", _overview(f)) for f in pareto_front(measured)
    )
    note = "The most accurate setting that fits; from fewer seconds than in the first line on, the first one."
    return Table(f"Which setting for which budget, {size[1]}x{size[0]}", note, "Budget and setting", columns, rows)


def _overview(figures: Figures) -> tuple[Cell, ...]:
    values = (_number(figures.ws_psnr), standard_seconds(figures), first_seconds(figures), frame_seconds(figures))
    return tuple(Cell(value) for value in (*values, _number(figures.memory) / MEGA))


def _stage_table(measured: Sequence[Figures]) -> Table:
    of_pairs = list(dict.fromkeys(stage for figures in measured for stage in pair_stages(figures)))
    stages = ("start", *of_pairs, *FRAME_STAGES)
    columns = tuple(Column(stage, -1, 3 if stage in FRAME_STAGES else 2) for stage in stages)
    more = (Column("Memory, MB", -1, 0), Column("WS-PSNR, dB", 1))
    rows = tuple(_stage_row(figures, stages) for figures in measured)
    note = (
        f"Seconds: start once, {', '.join(of_pairs)} for each pair, {', '.join(FRAME_STAGES)} for each frame. The "
        "encoder runs beside the other stages: encode is the time that they waited for it. Memory is the peak of the "
        "program without the encoder."
    )
    return Table("All settings", note, "Setting", (*columns, *more), rows)


def _stage_row(figures: Figures, stages: Sequence[str]) -> Row:
    if figures.status != "done" or figures.seconds is None:
        return Row(figures.setting.name, (), figures.reason)
    cells = [Cell(figures.seconds.get(stage, 0.0)) for stage in stages]
    return Row(figures.setting.name, (*cells, Cell(_number(figures.memory) / MEGA), Cell(_number(figures.ws_psnr))))


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def pareto_diagram(measured: Sequence[Figures]) -> bytes | None:
    """Accuracy against the seconds of a standard clip as a PNG file, a line along the best of each size.

    None where no setting has an accuracy.
    """
    rated = [figures for figures in measured if figures.status == "done" and figures.ws_psnr is not None]
    if not rated:
        return None
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, HEIGHT + 0.5), dpi=DOTS_PER_INCH, layout="constrained")
    axes = figure.add_subplot()
    presets = list(dict.fromkeys(f.setting.preset for f in rated))
    for index, size in enumerate(dict.fromkeys(f.setting.size for f in rated)):
        of_size = [f for f in rated if f.setting.size == size]
        marker = MARKERS[index % len(MARKERS)]
        front = pareto_front(of_size)
        axes.plot([standard_seconds(f) for f in front], [_number(f.ws_psnr) for f in front], color="0.6", zorder=1)
        for preset in presets:
            points = [(standard_seconds(f), _number(f.ws_psnr)) for f in of_size if f.setting.preset == preset]
            axes.scatter(
                [x for x, _ in points], [y for _, y in points], marker=marker, s=45, zorder=2,
                color=COLOURS[presets.index(preset) % len(COLOURS)], label=f"{preset}, {size[1]}x{size[0]}",
            )  # fmt: skip
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter("{x:g}")
    axes.set_xlabel(f"Seconds for {STANDARD_FRAMES} frames between two panoramas")
    axes.set_ylabel("WS-PSNR, dB")
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=LEGEND_COLUMNS, frameon=False, fontsize="small")
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()


def _page(measured: Sequence[Figures], diagram: bytes | None) -> str:
    title = "OmniSyn settings"
    about = f"omnisyn {__version__} on {machine_in_words()}"
    tables = [table_section(table) for table in bench_tables(measured)]
    return page(title, STYLE, element("h1", title), element("p", about), *_picture(diagram), *tables)


def _picture(diagram: bytes | None) -> list[Html]:
    if diagram is None:
        return []
    source = "data:image/png;base64," + base64.b64encode(diagram).decode("ascii")
    caption = "Accuracy against time; the lines join the settings that no other one beats in both."
    figure = element("figure", element("img", src=source, alt=caption), element("figcaption", caption))
    return [element("div", figure, class_="plots")]
