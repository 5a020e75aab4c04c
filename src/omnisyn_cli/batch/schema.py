"""The lines of a manifest, and one as a type: its files, and every option of an interpolation with its values."""

import csv
import io
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

from pydantic import ConfigDict, Field, StringConstraints, ValidationError, create_model

from omnisyn_cli.errors import InputError
from omnisyn_cli.interpolation.job import CHOICES, INPUT_FILES, INPUT_LISTS, OUTPUTS, InterpolationJob
from omnisyn_cli.io.documents import expected, json_path, parse_json, problem_sentence, read_text

MAX_MANIFEST_BYTES = 1 << 30  # one GiB: larger files are no manifests. Set by hand.
LIST_COLUMNS = frozenset({"inputs", *INPUT_LISTS})  # columns of CSV with several file names, separated by semicolons


def read_lines(path: Path) -> Iterator[tuple[int, dict[str, Any] | str]]:
    """Number and fields of every line that is not empty, or what is wrong with it; InputError: an unreadable file."""
    text = read_text(path, "a manifest", MAX_MANIFEST_BYTES, InputError)
    if path.suffix.lower() == ".csv":
        yield from _rows(csv.DictReader(io.StringIO(text), strict=True))
        return
    for number, line in enumerate(text.split("\n"), start=1):
        if line.strip():
            yield number, _parsed(line)


def _rows(rows: "csv.DictReader[str]") -> Iterator[tuple[int, dict[str, Any] | str]]:
    """Rows of a CSV file; none of one with repeated columns."""
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
    for key in LIST_COLUMNS & cells.keys():
        cells[key] = [name.strip() for name in cells[key].split(";")]
    return cells


Name = Annotated[str, StringConstraints(min_length=1)]


def _like(pattern: str, wanted: str) -> Any:
    """The type of text that is like a pattern, which people call ``wanted``."""
    return Annotated[str, expected(wanted, lambda text: re.fullmatch(pattern, text))]


# Type and default of what a line says beside the options of its interpolation.
LINE_FIELDS: dict[str, Any] = {
    "id": (
        _like(r"\w[\w.-]{0,119}", "at most 120 letters, digits, _, - and ., the first one a letter, digit or _"),
        ...,
    ),
    "inputs": (Annotated[list[Name], Field(min_length=2)] | None, None),
    **dict.fromkeys(("scene", "poses", "group", *OUTPUTS), (Name | None, None)),
}
# Types of options that a line writes in another way than :class:`InterpolationJob`, which says all other ranges.
MANIFEST_TYPES: Mapping[str, Any] = {
    "size": _like(r"[1-9][0-9]{0,5}x[1-9][0-9]{0,5}", "WIDTHxHEIGHT such as 2048x1024") | None,
    "encoder_preset": Name | None,
    **dict.fromkeys(INPUT_FILES, Name | None),
    **dict.fromkeys(INPUT_LISTS, list[Name] | None),
    "nadir": Annotated[float, Field(ge=0, lt=90)] | None,
    "hfov": Annotated[float, Field(gt=0, le=360)] | None,
    "vfov": Annotated[float, Field(gt=0, le=180)] | None,
    "fov": Annotated[float, Field(gt=0, lt=180)] | None,
    **{name: Literal[names] for name, names in CHOICES.items()},
}
# Fields of :class:`InterpolationJob` that a line does not choose.
RUN_FIELDS = {"images", "threads", "overwrite", "finds_order", "tour", "is_chain"}
# Types of the fields of :class:`InterpolationJob` in a line.
OPTION_TYPES = {**get_type_hints(InterpolationJob, include_extras=True), **MANIFEST_TYPES}
# Type and default of the options of an interpolation.
OPTION_FIELDS: dict[str, Any] = {
    field.name: (OPTION_TYPES[field.name], None if field.default == () else field.default)
    for field in fields(InterpolationJob)
    if field.name not in RUN_FIELDS | LINE_FIELDS.keys()
}
LINE_CONFIG = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

Line: Any = create_model("Line", __config__=LINE_CONFIG, **LINE_FIELDS, **OPTION_FIELDS)  # One line of a manifest.


def check_options(options: Mapping[str, Any]) -> None:
    """InputError unless all jobs of a manifest can have these options: known, not each job's own, valid values."""
    common = sorted(Line.model_fields.keys() - LINE_FIELDS.keys() | {"poses"})
    for name in options:
        if name not in common:
            raise InputError(f"expected an option for all jobs, got {name!r}; choose from {', '.join(common)}")
    try:
        Line.model_validate({"id": "job", "scene": "scene", **options})
    except ValidationError as error:
        raise InputError("; ".join(problem_sentences(error))) from None


def problem_sentences(error: ValidationError) -> Iterator[str]:
    """Every problem of a line: where, what was expected, what came and what to do."""
    for problem in error.errors(include_url=False):
        yield f"{json_path(problem['loc'])}: {problem_sentence(problem, Line)}"
