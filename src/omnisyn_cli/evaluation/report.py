"""The reports of an evaluation and of a bench: a page to read, tables to paste, figures to compute with.

They are made of what was measured alone, however much of it there is, so that an unfinished evaluation has one as well.
"""

import csv
import io
import json
import math
import re
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from omnisyn_cli import __version__
from omnisyn_cli.evaluation.bench_settings import DEFAULT_METHOD, machine_in_words
from omnisyn_cli.evaluation.grouping import Gap, figures_of, finished, gaps
from omnisyn_cli.evaluation.plots import PLOT_TITLES, pareto_plot, report_plots
from omnisyn_cli.evaluation.results import UnitRecord, json_values
from omnisyn_cli.evaluation.tables import ERROR_NOTE, Cell, Column, Row, Table, format_cell, report_tables
from omnisyn_cli.evaluation.visualization import ERROR_SCALE, depth_sections, frame_sections
from omnisyn_cli.interpolation.planning import figures as planned
from omnisyn_cli.interpolation.planning.figures import FRAME_STAGES, Figures
from omnisyn_cli.io.encode import data_uri
from omnisyn_cli.io.outputs import staged_folder, write_errors

# ``subject`` is what was measured: ``frame``, ``kind-psnr``, ``kind-area``, ``kind-error`` (of the pixels of a kind,
# which ``metric`` names), ``depth``, ``depth-weighted``, ``doubt``, ``reliability-area``, ``reliability-confidence``,
# ``reliability-within_5``, ``reliability-within_10`` (of a bin of confidence, whose middle ``metric`` is), ``temporal``
# or ``seconds``; ``name`` is that of the frame or panorama; ``distance`` is to the nearer panorama; lengths in metres.
CSV_COLUMNS = (
    "scene", "first", "second", "method", "baseline", "subject", "name", "t", "distance", "metric", "value",
)  # fmt: skip
MARKDOWN_SPECIAL = re.compile(r"([\\`*_{}\[\]<>#|!~&])")  # characters that mean something in Markdown, and are escaped
WS_PSNR = Column("WS-PSNR, dB", 1)
MEMORY = Column("Memory, MB", -1, 0)  # the greatest resident size of a run
FRONT_MARK, OTHER_MARK = "●", "○"  # whether a setting is on the Pareto front


def write_report(folder: Path, records: Iterable[UnitRecord], about: Mapping[str, str] = MappingProxyType({})) -> None:
    """Write ``report.html``, ``report.md``, ``report.json``, ``report.csv`` and the diagrams as PNG files.

    Files of an earlier report are replaced all together at the end. Of several records of one unit the last one counts.
    ``about`` says what was asked for, such as the data set and the command. Pictures that the records name lie in
    ``folder``, whose parent exists. WriteError: the disk is full, or the folder went away.
    """
    units = list({record.unit: record for record in records}.values())
    about = {**about, **_about_units(units)}
    tables, plots, missing = report_tables(units), report_plots(units), gaps(units)
    page = _environment(autoescape=True).get_template("report.html.j2").render(
        about=about, error_note=ERROR_NOTE, counts=Counter(unit.status for unit in units), tables=tables, gaps=missing,
        plots=plots, titles=PLOT_TITLES, frames=frame_sections(folder, units), depths=depth_sections(folder, units),
        error_scale=ERROR_SCALE,
    )  # fmt: skip
    markdown = _environment(finalize=_escaped).get_template("report.md.j2")
    texts = {
        "report.html": page,
        "report.md": markdown.render(tables=tables, gaps=missing, about=about, error_note=ERROR_NOTE),
        "report.json": _json(units, tables, missing, about),
        "report.csv": _csv(units),
    }
    _write(folder, texts, {f"{name}.png": data for name, data in plots.items()})


def _write(folder: Path, texts: Mapping[str, str], pictures: Mapping[str, bytes]) -> None:
    """Write files, all together."""
    files = {**{name: text.encode("utf-8", "backslashreplace") for name, text in texts.items()}, **pictures}
    with staged_folder(folder) as staged, write_errors(folder):
        for name, data in files.items():
            (staged / name).write_bytes(data)


def _about_units(units: Sequence[UnitRecord]) -> dict[str, str]:
    """What was measured and with what: scenes, pairs, frames and their sizes, the date and the version."""
    measured = finished(units)
    pairs = {unit.pair for unit in measured}
    frames = {(*unit.pair, frame.name) for unit in measured for frame in unit.frames}
    sizes = sorted({unit.size for unit in measured})
    return {
        "scenes": f"{len({scene for scene, *_ in pairs})}, with {len(pairs)} pairs and {len(frames)} frames",
        "sizes": ", ".join(f"{width}x{height}" for height, width in sizes) or "none",
        "date": time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime()),
        "version": f"omnisyn {__version__}",
    }


def _json(
    units: Sequence[UnitRecord], tables: Sequence[Table], missing: Sequence[Gap], about: Mapping[str, str]
) -> str:
    """Strict JSON: tables of means and all units; what is infinite or undefined is a string or null."""
    content = {
        "version": __version__,
        "about": about,
        "tables": [asdict(table) for table in tables],
        "gaps": [asdict(gap) for gap in missing],
        "units": [asdict(unit) for unit in units],
    }
    return json.dumps(json_values(content), ensure_ascii=False, allow_nan=False, indent=1) + "\n"


def _csv(units: Sequence[UnitRecord]) -> str:
    """One line for each figure."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for unit in units:
        about = (unit.scene, unit.first, unit.second, unit.method, unit.baseline)
        writer.writerows(
            (*about, *rest, metric, value) for rest, scores in figures_of(unit) for metric, value in scores.items()
        )
    return file.getvalue()


def _environment(**options: Any) -> Environment:
    loader, spaces = PackageLoader("omnisyn_cli.evaluation"), {"trim_blocks": True, "lstrip_blocks": True}
    options |= {**spaces, "keep_trailing_newline": True, "undefined": StrictUndefined}
    environment = Environment(loader=loader, **options)  # noqa: S701 - Markdown is escaped by `finalize`
    environment.filters.update(figure=format_cell, data_uri=data_uri)
    return environment


def _escaped(value: Any) -> str:
    """Text that Markdown shows as it is, on one line."""
    return MARKDOWN_SPECIAL.sub(r"\\\1", " ".join(str(value).split()))


def write_bench_report(folder: Path, measured: Sequence[Figures]) -> None:
    """Write ``bench.html``, ``.json`` and, where there is accuracy, ``.png``. WriteError: no space, or no folder."""
    diagram, about = pareto_plot(measured, DEFAULT_METHOD), {"version": __version__, "machine": machine_in_words()}
    template = _environment(autoescape=True).get_template("bench.html.j2")
    values = {**about, "settings": [asdict(figures) for figures in measured]}
    texts = {
        "bench.html": template.render(tables=bench_tables(measured), diagram=diagram, **about),
        "bench.json": json.dumps(values, ensure_ascii=False, allow_nan=False, indent=1) + "\n",
    }
    _write(folder, texts, {} if diagram is None else {"bench.png": diagram})


def bench_tables(measured: Sequence[Figures]) -> list[Table]:
    """What settings cost and are worth, one table for each size of frames that has scores; then their stages."""
    sizes = dict.fromkeys(figures.setting.size for figures in measured if figures.scores)
    trades = [_trade_table([f for f in measured if f.setting.size == size and f.scores], size) for size in sizes]
    return [*trades, _stage_table(measured)]


def _trade_table(measured: Sequence[Figures], size: tuple[int, int]) -> Table:
    reference = next((f for f in measured if f.setting.method == DEFAULT_METHOD), measured[0])
    columns: dict[Column, Callable[[Figures], float]] = {
        WS_PSNR: lambda f: _number(f.ws_psnr),
        Column(f"against {reference.setting.method}, dB", 1): lambda f: planned.gain(f, reference)[0],
        Column("± dB", 0): lambda f: planned.gain(f, reference)[1],
        Column(f"{planned.STANDARD_FRAMES} frames, s", -1, 1): planned.standard_seconds,
        Column("First frame, s", -1, 1): planned.first_seconds,
        Column("Each further frame, s", -1, 3): planned.frame_seconds,
        MEMORY: lambda f: _number(f.memory) / 1e6,
    }
    front = planned.pareto_front(measured)
    rows = tuple(
        Row(
            f"{FRONT_MARK if f in front else OTHER_MARK} {f.setting.name}",
            tuple(Cell(of(f)) for of in columns.values()),
        )
        for f in sorted(measured, key=planned.standard_seconds)
    )
    note = (
        f"Mean of {len(reference.scores)} pairs; ± is the standard error of the mean difference from pair to pair. "
        f"{FRONT_MARK}: nothing else is both faster and more accurate. Seconds are of computing, of one core."
    )
    return Table(f"What settings cost and are worth, {size[1]}x{size[0]}", note, "Setting", tuple(columns), rows)


def _stage_table(measured: Sequence[Figures]) -> Table:
    of_pairs = list(dict.fromkeys(stage for figures in measured for stage in planned.pair_stages(figures)))
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
    values = (*seconds, _number(figures.memory) / 1e6, _number(figures.ws_psnr))
    return Row(figures.setting.name, tuple(map(Cell, values)))


def _number(value: float | None) -> float:
    return math.nan if value is None else value
