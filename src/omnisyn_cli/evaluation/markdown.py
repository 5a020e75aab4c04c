"""The tables of a report as Markdown."""

from __future__ import annotations

import re
from collections.abc import Sequence

from omnisyn_cli.evaluation.grouping import Gap
from omnisyn_cli.evaluation.table import Cell, Column, Row, Table, format_value

__all__ = ["render_markdown"]

SPECIAL = re.compile(r"([\\`*_{}\[\]<>#|!~&])")


def render_markdown(tables: Sequence[Table], gaps: Sequence[Gap], version: str) -> str:
    """All tables and what was not measured; the best figures are bold."""
    parts = [f"# OmniSyn evaluation\n\nomnisyn {_escaped(version)}"]
    parts += [_table(table) for table in tables]
    if gaps:
        parts.append("## Not measured\n\n" + "\n".join(_gap(gap) for gap in gaps))
    elif not tables:
        parts.append("Nothing has been measured yet.")
    return "\n\n".join(parts) + "\n"


def _table(table: Table) -> str:
    arrows = {1: " ↑", -1: " ↓", 0: ""}
    head = [_escaped(table.corner), *(_escaped(column.title) + arrows[column.better] for column in table.columns)]
    ruler = ["---", *("---:" for _ in table.columns)]
    lines = [_line(head), _line(ruler), *(_line(_row(row, table.columns)) for row in table.rows)]
    return "\n\n".join([f"## {_escaped(table.title)}", _escaped(table.note), "\n".join(lines)])


def _row(row: Row, columns: Sequence[Column]) -> list[str]:
    if not row.cells:
        return [_escaped(row.name), _escaped(row.reason), *("" for _ in columns[1:])]
    name = _escaped(row.name) + (" (upper bound)" if row.is_bound else "")
    return [name, *(_cell(cell, column) for cell, column in zip(row.cells, columns, strict=True))]


def _cell(cell: Cell, column: Column) -> str:
    text = format_value(cell.value, column.digits)
    return f"**{text}**" if cell.is_best else text


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _gap(gap: Gap) -> str:
    method = _escaped(gap.method) if gap.method else "all methods"
    return f"- {method}, {gap.status}: {_escaped(gap.reason)} ({_escaped(', '.join(gap.pairs))})"


def _escaped(text: str) -> str:
    """Text that Markdown shows as it is, on one line."""
    return SPECIAL.sub(r"\\\1", " ".join(text.split()))
