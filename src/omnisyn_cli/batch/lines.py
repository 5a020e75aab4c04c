"""The lines of a JSONL or CSV file with their numbers, before anybody asks what they mean."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from omnisyn_cli.io.paths import read_text

__all__ = ["read_lines"]

LARGEST_FILE = 1 << 30

LISTS = frozenset({"inputs", "masks"})
"""Columns of CSV with several file names, separated by semicolons."""


def read_lines(path: Path) -> Iterator[tuple[int, dict[str, Any] | str]]:
    """Number and fields of every line that is not empty; a string says what is wrong with one.

    Raises:
        InputError: the file cannot be read.
    """
    text = read_text(path, "a manifest", LARGEST_FILE)
    if path.suffix.lower() == ".csv":
        rows = csv.DictReader(io.StringIO(text), strict=True)
        try:
            for row in rows:
                yield rows.line_num, _cells(row)
        except csv.Error as error:
            yield rows.line_num, f"expected CSV, got '{error}'"
        return
    for number, line in enumerate(text.split("\n"), start=1):
        if line.strip():
            yield number, _parsed(line)


def _parsed(line: str) -> dict[str, Any] | str:
    try:
        value = json.loads(line)
    except (ValueError, RecursionError) as error:
        return f"expected JSON, got '{error}'"
    return value if isinstance(value, dict) else f"expected an object {{…}}, got {type(value).__name__}"


def _cells(row: dict[str | Any, Any]) -> dict[str, Any] | str:
    if None in row:
        return f"expected as many cells as columns, got {len(row[None])} more"
    cells: dict[str, Any] = {key: cell for key, cell in row.items() if cell not in (None, "")}
    for key in LISTS & cells.keys():
        cells[key] = [name.strip() for name in cells[key].split(";")]
    return cells
