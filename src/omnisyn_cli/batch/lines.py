"""The lines of a JSONL or CSV file with their numbers, before anybody asks what they mean."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from omnisyn_cli.errors import InputError
from omnisyn_cli.io.documents import parse_json, read_text

LARGEST_FILE = 1 << 30

LISTS = frozenset({"inputs", "masks"})
"""Columns of CSV with several file names, separated by semicolons."""


def read_lines(path: Path) -> Iterator[tuple[int, dict[str, Any] | str]]:
    """Number and fields of every line that is not empty; a string says what is wrong with one.

    Raises:
        InputError: the file cannot be read.
    """
    text = read_text(path, "a manifest", LARGEST_FILE, InputError)
    if path.suffix.lower() == ".csv":
        yield from _rows(csv.DictReader(io.StringIO(text), strict=True))
        return
    for number, line in enumerate(text.split("\n"), start=1):
        if line.strip():
            yield number, _parsed(line)


def _rows(rows: csv.DictReader[str]) -> Iterator[tuple[int, dict[str, Any] | str]]:
    """Of CSV; nothing of a file whose columns are not told apart."""
    try:
        columns = rows.fieldnames or ()
        if repeated := [column for column, count in Counter(columns).items() if count > 1 and column]:
            yield rows.line_num, f"expected every column once, got '{repeated[0]:.60}' twice; remove one of them"
            return
        for row in rows:
            yield rows.line_num, _cells(row)
    except csv.Error as error:
        yield rows.line_num, f"expected CSV, got '{error}'; correct it there"


def _parsed(line: str) -> dict[str, Any] | str:
    try:
        value = parse_json(line)
    except ValueError as error:
        return str(error)
    if isinstance(value, dict):
        return value
    return f"expected an object in braces, got {type(value).__name__}; correct it there"


def _cells(row: dict[str | Any, Any]) -> dict[str, Any] | str:
    if None in row:
        return f"expected as many cells as columns, got {len(row[None])} more; correct it there"
    cells: dict[str, Any] = {key: cell for key, cell in row.items() if cell not in (None, "")}
    for key in LISTS & cells.keys():
        cells[key] = [name.strip() for name in cells[key].split(";")]
    return cells
