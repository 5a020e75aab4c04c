"""Tables of places as street-view tools write them: CSV or JSON with lat, lng, heading, and pitch and roll if known.

JSON may be a list of objects, an object of objects by image name, or either of them below one of the keys
``panoramas``, ``images`` and ``data``; the coordinates may sit in an object ``location``. Angles are degrees as
GPano defines them.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from omnisyn_cli.errors import PoseError
from omnisyn_cli.io.pose_formats.files import find_image, listed
from omnisyn_cli.io.pose_formats.geographic import (
    Place,
    altitudes_note,
    origin_note,
    poses_from_places,
    unit_problem,
    with_altitudes,
)
from omnisyn_cli.io.pose_formats.model import ImportedPoses, ImportedView, ImportOptions
from omnisyn_cli.io.pose_formats.text import numbers, read_json, read_text

__all__ = ["read_table"]

COLUMNS = {
    "image": ("image", "file", "filename", "file_name", "name", "path", "pano_id", "panoid", "id"),
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "lng", "lon", "long"),
    "altitude": ("altitude", "alt", "elevation", "originalelevationaboveegm96"),
    "heading": ("heading", "yaw", "bearing", "compass_angle", "computed_compass_angle"),
    "pitch": ("pitch",),
    "roll": ("roll",),
}
"""What a column may be called, in small letters; the first name that occurs wins."""

REQUIRED = ("image", "latitude", "longitude", "heading")

RADIANS = 6.3
"""Headings that all stay below are suspicious."""


def read_table(source: Path, options: ImportOptions) -> ImportedPoses:
    """Poses of a CSV or JSON table.

    Raises:
        PoseError: columns are missing, or a value is no number or out of range, with its line or place.
    """
    rows = list(_json_rows(source) if source.suffix.lower() == ".json" else _csv_rows(source))
    if not rows:
        raise PoseError(f"{source}: expected at least one panorama, got none; check the file")
    places: dict[str, Place] = {}
    images = {}
    for where, row in rows:
        name = str(row.get("image", "")).strip()
        if not name or name in places:
            found = f"'{name}' twice" if name else "none"
            raise PoseError(f"{where}: expected the name of another image, got {found}; correct it")
        places[name] = _place(where, row)
        images[name] = find_image(where, name, [source.parent, source.parent / "images"], options)
    complete, notes = with_altitudes(str(source), places)
    poses, origin = poses_from_places(complete, options.origin)
    views = tuple(ImportedView(name, pose, images[name]) for name, pose in zip(places, poses, strict=True))
    return ImportedPoses(views, (origin_note(origin), *notes, *_notes([row for _, row in rows])))


def _csv_rows(source: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Place (file and line) and fields by our names of every row."""
    text = read_text(source)
    first = text.split("\n", 1)[0]
    delimiter = max(",;\t", key=first.count)
    reader = csv.DictReader(io.StringIO(text), delimiter=delimiter)
    try:
        _check_columns(f"{source}:1", [name or "" for name in reader.fieldnames or []])
        for row in reader:
            yield f"{source}:{reader.line_num}", _renamed({key: value for key, value in row.items() if key})
    except csv.Error as error:
        raise PoseError(f"{source}:{reader.line_num}: expected CSV, got '{error}'; correct the line") from error


def _json_rows(source: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    document = read_json(source)
    for key in ("panoramas", "images", "data"):
        if isinstance(document, dict) and isinstance(document.get(key), (list, dict)):
            document = document[key]
    if isinstance(document, dict):
        document = [{"image": name, **value} if isinstance(value, dict) else value for name, value in document.items()]
    if not isinstance(document, list):
        raise PoseError(f"{source}: expected a list of panoramas, got {type(document).__name__}; see docs/poses.md")
    for index, row in enumerate(document):
        where = f"{source}: panorama {index + 1}"
        if not isinstance(row, dict):
            raise PoseError(f"{where}: expected an object with lat, lng and heading, got {row!r:.60}; correct it")
        location = row.get("location")
        flat = {**row, **location} if isinstance(location, dict) else row
        _check_columns(where, list(flat))
        yield where, _renamed(flat)


def _renamed(row: Mapping[str, Any]) -> dict[str, Any]:
    """The fields that are needed, by our names; what is empty is left out; others keep theirs."""
    lower = {key.strip().lower(): value for key, value in row.items()}
    chosen = {ours: next((name for name in names if name in lower), None) for ours, names in COLUMNS.items()}
    fields = {ours: lower.pop(name) for ours, name in chosen.items() if name is not None}
    return {key: value for key, value in {**lower, **fields}.items() if value not in (None, "")}


def _check_columns(where: str, names: list[str]) -> None:
    known = {name.strip().lower() for name in names}
    for required in REQUIRED:
        if not known & set(COLUMNS[required]):
            raise PoseError(
                f"{where}: expected {required} ({' or '.join(COLUMNS[required][:4])}), got only {listed(names, 8)}; "
                "add it, or name the format with --format"
            )


def _place(where: str, row: Mapping[str, Any]) -> Place:
    values = {name: _number(where, row, name) for name in ("latitude", "longitude", "heading", "pitch", "roll")}
    altitude = _number(where, row, "altitude") if "altitude" in row else None
    place = Place(**values, altitude=altitude)
    if problem := unit_problem(place):
        raise PoseError(f"{where}: {problem}; correct it")
    return place


def _number(where: str, row: Mapping[str, Any], name: str) -> float:
    if name not in row and name in ("pitch", "roll"):
        return 0.0
    return float(numbers(where, [str(row.get(name, ""))], 1, name)[0])


def _notes(rows: list[dict[str, Any]]) -> list[str]:
    notes = ["angles: degrees; heading of the image centre clockwise from true north, pitch up, roll as in GPano"]
    if all(abs(float(row["heading"])) <= RADIANS for row in rows) and any(float(row["heading"]) for row in rows):
        notes.append("headings: all within ±6.3, are they radians? they are taken as degrees")
    if any("altitude" in row for row in rows):
        notes.append(altitudes_note("a street-view elevation"))
    ignored = sorted({key for row in rows for key in row} - set(COLUMNS) - {"location"})
    if ignored:
        notes.append(f"ignored: columns {listed(ignored, 8)}")
    return notes
