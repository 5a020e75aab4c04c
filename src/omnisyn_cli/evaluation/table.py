"""A table of a report as values: columns, rows of figures, and which of them are the best.

A mean over less than all there is takes no part in being the best: a method may have been lucky with what it measured.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from omnisyn_cli.evaluation.grouping import is_bound

__all__ = ["Cell", "Column", "Row", "Table", "format_value", "marked_columns", "marked_row"]


@dataclass(frozen=True)
class Column:
    """A column of figures; ``better`` is +1 where more is better, −1 where less is, 0 where neither."""

    title: str
    better: int = 0
    digits: int = 2


@dataclass(frozen=True)
class Cell:
    """A mean over ``count`` values; NaN of none."""

    value: float
    count: int = 1
    is_best: bool = False


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


def marked_columns(columns: Sequence[Column], rows: Sequence[Row], every: Sequence[int]) -> tuple[Row, ...]:
    """The rows with the best of each column marked; ``every`` is how many values there are for a column."""
    bounds = [row.is_bound for row in rows]
    by_column = [
        _marked([row.cells[index] for row in rows], [column.better] * len(rows), bounds, number)
        for index, (column, number) in enumerate(zip(columns, every, strict=True))
    ]
    return tuple(
        Row(row.name, tuple(cells[index] for cells in by_column), row.reason, row.is_bound)
        for index, row in enumerate(rows)
    )


def marked_row(columns: Sequence[Column], row: Row, every: int) -> Row:
    """The row with its best marked; ``every`` is how many values there are for it."""
    bounds = [is_bound(column.title) for column in columns]
    cells = _marked(row.cells, [column.better for column in columns], bounds, every)
    return Row(row.name, tuple(cells), row.reason, row.is_bound)


def _marked(cells: Sequence[Cell], better: Sequence[int], bounds: Sequence[bool], every: int) -> list[Cell]:
    """The cells with the best of them marked, equal ones together; means over less than ``every`` take no part."""
    takes_part = [
        cell.count == every > 0 and sign != 0 and not bound and not math.isnan(cell.value)
        for cell, sign, bound in zip(cells, better, bounds, strict=True)
    ]
    if sum(takes_part) < 2:
        return list(cells)
    best = max(sign * cell.value for cell, sign, part in zip(cells, better, takes_part, strict=True) if part)
    return [
        Cell(cell.value, cell.count, part and sign * cell.value == best)
        for cell, sign, part in zip(cells, better, takes_part, strict=True)
    ]


def format_value(value: float, digits: int) -> str:
    """A figure as text: an en dash where nothing was measured, ∞ for equal pictures."""
    if math.isnan(value):
        return "–"
    return ("∞" if value > 0 else "−∞") if math.isinf(value) else f"{value:.{digits}f}"
