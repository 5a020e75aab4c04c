"""The figures of a bench as tables and as a page."""

import json
import math
from collections.abc import Sequence
from pathlib import Path

from omnisyn_cli import __version__
from omnisyn_cli.evaluation import pareto
from omnisyn_cli.evaluation.bench import machine_in_words
from omnisyn_cli.evaluation.pareto import Figures
from omnisyn_cli.evaluation.plots import pareto_plot
from omnisyn_cli.evaluation.tables import Cell, Column, Row, Table, render_page
from omnisyn_cli.io.outputs import staged_folder, write_errors

__all__ = ["bench_tables", "write_bench_report"]

REPORT_NAME = "bench"

WS_PSNR = Column("WS-PSNR, dB", 1)

MEMORY = Column("Memory, MB", -1, 0)


def write_bench_report(folder: Path, measured: Sequence[Figures]) -> None:
    """Write ``bench.html``, ``bench.json`` and, where there is accuracy, ``bench.png``.

    Args:
        folder: where to; its parent must exist.
        measured: figures of all settings.

    Raises:
        WriteError: the disk is full, or the folder went away.
    """
    diagram, tables = pareto_plot(measured), bench_tables(measured)
    about = {"version": __version__, "machine": machine_in_words()}
    page = render_page("bench.html.j2", tables=tables, diagram=diagram, **about)
    values = {**about, "settings": [figures.to_json() for figures in measured]}
    with staged_folder(folder) as staged, write_errors(folder):
        text = json.dumps(values, ensure_ascii=False, allow_nan=False, indent=1) + "\n"
        (staged / f"{REPORT_NAME}.json").write_text(text, encoding="utf-8")
        (staged / f"{REPORT_NAME}.html").write_text(page, encoding="utf-8")
        if diagram is not None:
            (staged / f"{REPORT_NAME}.png").write_bytes(diagram)


def bench_tables(measured: Sequence[Figures]) -> list[Table]:
    """Which setting to take for which budget, one table for each size of frames, then what everything takes."""
    sizes = dict.fromkeys(figures.setting.size for figures in measured)
    choices = [_choice_table([f for f in measured if f.setting.size == size], size) for size in sizes]
    return [*(table for table in choices if table.rows), _stage_table(measured)]


def _choice_table(measured: Sequence[Figures], size: tuple[int, int]) -> Table:
    columns = {
        WS_PSNR: _ws_psnr,
        Column(f"{pareto.STANDARD_FRAMES} frames, s", -1, 1): pareto.standard_seconds,
        Column("First frame, s", -1, 1): pareto.first_seconds,
        Column("Each further frame, s", -1, 3): pareto.frame_seconds,
        MEMORY: _megabytes,
    }
    rows = tuple(
        Row(f"from {pareto.standard_seconds(f):.1f} s: {f.setting.name}", tuple(Cell(of(f)) for of in columns.values()))
        for f in pareto.pareto_front(measured)
    )
    note = "The most accurate setting that fits; from fewer seconds than in the first line on, the first one."
    title = f"Which setting for which budget, {size[1]}x{size[0]}"
    return Table(title, note, "Budget and setting", tuple(columns), rows)


def _stage_table(measured: Sequence[Figures]) -> Table:
    of_pairs = list(dict.fromkeys(stage for figures in measured for stage in pareto.pair_stages(figures)))
    stages = ("start", *of_pairs, *pareto.FRAME_STAGES)
    columns = (*(Column(stage, -1, 3 if stage in pareto.FRAME_STAGES else 2) for stage in stages), MEMORY, WS_PSNR)
    rows = tuple(_stage_row(figures, stages) for figures in measured)
    note = (
        f"Seconds: start once, {', '.join(of_pairs)} for each pair, {', '.join(pareto.FRAME_STAGES)} for each frame. "
        "The encoder runs beside the other stages: encode is the time that they waited for it. Memory is the peak of "
        "the program without the encoder."
    )
    return Table("All settings", note, "Setting", columns, rows)


def _stage_row(figures: Figures, stages: Sequence[str]) -> Row:
    if figures.status != "done":
        return Row(figures.setting.name, (), figures.reason)
    seconds = (figures.seconds.get(stage, 0.0) for stage in stages)
    return Row(figures.setting.name, tuple(Cell(value) for value in (*seconds, _megabytes(figures), _ws_psnr(figures))))


def _ws_psnr(figures: Figures) -> float:
    return math.nan if figures.ws_psnr is None else figures.ws_psnr


def _megabytes(figures: Figures) -> float:
    return math.nan if figures.memory is None else figures.memory / 1e6
