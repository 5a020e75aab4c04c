"""The figures of a bench as tables and as a page."""

import json
import math
from collections.abc import Sequence
from pathlib import Path

from omnisyn_cli import __version__
from omnisyn_cli.evaluation.bench_settings import DEFAULT_METHOD, machine_in_words
from omnisyn_cli.evaluation.plots import pareto_plot
from omnisyn_cli.evaluation.tables import Cell, Column, Row, Table, render_page
from omnisyn_cli.interpolation.planning.figures import (
    FRAME_STAGES,
    STANDARD_FRAMES,
    Figures,
    first_seconds,
    frame_seconds,
    gain,
    pair_stages,
    pareto_front,
    standard_seconds,
)
from omnisyn_cli.io.outputs import staged_folder, write_errors

REPORT_NAME = "bench"
"""Of the files of a report, without their endings."""

WS_PSNR = Column("WS-PSNR, dB", 1)

MEMORY = Column("Memory, MB", -1, 0)
"""The greatest resident size of a run."""

FRONT_MARK, OTHER_MARK = "●", "○"
"""Whether a setting is on the Pareto front."""


def write_bench_report(folder: Path, measured: Sequence[Figures]) -> None:
    """Write ``bench.html``, ``bench.json`` and, where there is accuracy, ``bench.png``; the folder's parent exists.

    WriteError: the disk is full, or the folder went away.
    """
    diagram, tables = pareto_plot(measured, DEFAULT_METHOD), bench_tables(measured)
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
    """What settings cost and are worth, one table for each size of frames that has scores; then their stages."""
    sizes = dict.fromkeys(figures.setting.size for figures in measured if figures.scores)
    trades = [_trade_table([f for f in measured if f.setting.size == size and f.scores], size) for size in sizes]
    return [*trades, _stage_table(measured)]


def _trade_table(measured: Sequence[Figures], size: tuple[int, int]) -> Table:
    reference = next((f for f in measured if f.setting.method == DEFAULT_METHOD), measured[0])
    columns = {
        WS_PSNR: _ws_psnr,
        Column(f"against {reference.setting.method}, dB", 1): lambda f: gain(f, reference)[0],
        Column("± dB", 0): lambda f: gain(f, reference)[1],
        Column(f"{STANDARD_FRAMES} frames, s", -1, 1): standard_seconds,
        Column("First frame, s", -1, 1): first_seconds,
        Column("Each further frame, s", -1, 3): frame_seconds,
        MEMORY: _megabytes,
    }
    front = pareto_front(measured)
    rows = tuple(
        Row(
            f"{FRONT_MARK if f in front else OTHER_MARK} {f.setting.name}",
            tuple(Cell(of(f)) for of in columns.values()),
        )
        for f in sorted(measured, key=standard_seconds)
    )
    note = (
        f"Mean of {len(reference.scores)} pairs; ± is the standard error of the mean difference from pair to pair. "
        f"{FRONT_MARK}: nothing else is both faster and more accurate. Seconds are of computing, of one core."
    )
    return Table(f"What settings cost and are worth, {size[1]}x{size[0]}", note, "Setting", tuple(columns), rows)


def _stage_table(measured: Sequence[Figures]) -> Table:
    of_pairs = list(dict.fromkeys(stage for figures in measured for stage in pair_stages(figures)))
    stages = ("start", *of_pairs, *FRAME_STAGES)
    columns = (*(Column(stage, -1, 3 if stage in FRAME_STAGES else 2) for stage in stages), MEMORY, WS_PSNR)
    rows = tuple(_stage_row(figures, stages) for figures in measured)
    note = (
        f"Seconds of computing: start once, {', '.join(of_pairs)} for each pair, {', '.join(FRAME_STAGES)} for "
        "each frame; encode is the encoder's work and all that is in no other stage. Memory is the peak of the program "
        "without the encoder."
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
