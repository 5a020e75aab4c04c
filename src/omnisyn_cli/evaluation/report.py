"""The report of an evaluation: a page to read, tables to paste, figures to compute with.

It is made of the records alone, whatever number of them there is, so that an unfinished evaluation has one as well.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from omnisyn_cli import __version__
from omnisyn_cli.evaluation.gallery import depth_sections, frame_sections
from omnisyn_cli.evaluation.grouping import gaps
from omnisyn_cli.evaluation.markdown import render_markdown
from omnisyn_cli.evaluation.page import render_page
from omnisyn_cli.evaluation.plots import report_plots
from omnisyn_cli.evaluation.records import UnitRecord, latest_records
from omnisyn_cli.evaluation.table import Table
from omnisyn_cli.evaluation.tables import report_tables
from omnisyn_cli.io.paths import write_errors
from omnisyn_cli.io.staging import staged_folder

__all__ = ["CSV_COLUMNS", "REPORT_NAME", "write_report"]

REPORT_NAME = "report"
"""Of the files, before the extensions ``.html``, ``.md``, ``.json`` and ``.csv``."""

CSV_COLUMNS = (
    "scene", "first", "second", "method", "baseline", "subject", "name", "t", "distance", "metric", "value",
)  # fmt: skip
"""``subject`` is what was measured: ``frame``, ``depth``, ``depth-weighted``, ``temporal`` or ``seconds``; ``name`` is
that of the frame or panorama; ``distance`` is to the nearer panorama; lengths are metres."""


def write_report(folder: Path, records: Iterable[UnitRecord]) -> None:
    """Write ``report.html``, ``report.md``, ``report.json``, ``report.csv`` and the diagrams as PNG files.

    Files of an earlier report are replaced all together at the end. Of several records of one unit the last one counts.

    Args:
        folder: where the files go, and where the pictures lie that the records name; its parent must exist.
        records: all that was measured until now.

    Raises:
        WriteError: the disk is full, or the folder went away.
    """
    units = latest_records(records)
    tables, plots = report_tables(units), report_plots(units)
    page = render_page(
        units, tables, plots, frame_sections(folder, units), depth_sections(folder, units), __version__
    )  # fmt: skip
    texts = {
        "html": page,
        "md": render_markdown(tables, gaps(units), __version__),
        "json": _json(units, tables),
        "csv": _csv(units),
    }
    with staged_folder(folder) as staged, write_errors(folder):
        for extension, text in texts.items():
            (staged / f"{REPORT_NAME}.{extension}").write_bytes(text.encode("utf-8", "backslashreplace"))
        for name, data in plots.items():
            (staged / f"{name}.png").write_bytes(data)


def _json(units: Sequence[UnitRecord], tables: Sequence[Table]) -> str:
    """Strict JSON: tables of means and all units; what is infinite or undefined is a string or null."""
    content = {
        "version": __version__,
        "tables": [_strict(asdict(table)) for table in tables],
        "gaps": [asdict(gap) for gap in gaps(units)],
        "units": [unit.to_json() for unit in units],
    }
    return json.dumps(content, ensure_ascii=False, allow_nan=False, indent=1) + "\n"


def _strict(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _strict(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_strict(item) for item in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def _csv(units: Sequence[UnitRecord]) -> str:
    """One line for each figure."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for unit in units:
        about = (unit.scene, unit.first, unit.second, unit.method, unit.baseline)
        writer.writerows(
            (*about, *rest, metric, value) for rest, scores in _figures(unit) for metric, value in scores.items()
        )
    return file.getvalue()


def _figures(unit: UnitRecord) -> Iterator[tuple[tuple[str, str, float | str, float | str], Mapping[str, float]]]:
    """Subject, name, t and distance, and the figures by metric."""
    for frame in unit.frames:
        yield ("frame", frame.name, frame.t, frame.distance), frame.scores
    for depth in unit.depths:
        yield ("depth", depth.view, "", ""), depth.plain
        yield ("depth-weighted", depth.view, "", ""), depth.weighted
    yield ("temporal", "", "", ""), unit.temporal
    yield ("seconds", "", "", ""), unit.seconds
