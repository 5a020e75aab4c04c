"""Tables of places as street-view tools write them: CSV or JSON with lat, lng, heading, and pitch and roll if known.

JSON may be a list of objects, an object of objects by image name, or either of them below one of the keys
``panoramas``, ``images`` and ``data``; the coordinates may sit in an object ``location``. Angles are degrees as
GPano defines them.
"""

import csv
import io
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from omnisyn_cli.errors import PoseError
from omnisyn_cli.io.documents import listed, read_json, read_text
from omnisyn_cli.poses.formats.files import find_image, numbers
from omnisyn_cli.poses.formats.geographic import PLACE_LIMITS, Place, altitudes_note, imported_places
from omnisyn_cli.poses.formats.model import ImportedPoses, ImportOptions, noted

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

REQUIRED_COLUMNS = ("image", "latitude", "longitude", "heading")

MAX_RADIAN_HEADING = 6.3
"""Just above 2π: headings that all stay below may be radians."""


def read_table(source: Path, options: ImportOptions) -> ImportedPoses:
    """Poses of a CSV or JSON table."""
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
    return imported_places(str(source), places, images, options, _notes([row for _, row in rows]))


def _csv_rows(source: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Place (file and line) and fields by our names of every row."""
    text = read_text(source)
    first = text.split("\n", 1)[0]
    delimiter = max(",;\t", key=first.count)
    reader = csv.DictReader(io.StringIO(text), delimiter=delimiter)
    try:
        _check_columns(f"{source}:1", [name or "" for name in reader.fieldnames or []])
        for row in reader:
            fields = _renamed({key: value for key, value in row.items() if key})
            if delimiter != ",":
                fields |= {key: _with_point(fields[key]) for key in PLACE_LIMITS if key in fields}
            yield f"{source}:{reader.line_num}", fields
    except csv.Error as error:
        raise PoseError(f"{source}:{reader.line_num}: expected CSV, got '{error}'; correct the line") from error


def _with_point(number: str) -> str:
    """A number with a decimal comma as one with a point, where commas do not separate columns."""
    return re.sub(r"^(\s*[+-]?\d+),(\d+\s*)$", r"\1.\2", number)


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
    for required in REQUIRED_COLUMNS:
        if not known & set(COLUMNS[required]):
            raise PoseError(
                f"{where}: expected {required} ({' or '.join(COLUMNS[required][:4])}), got only {listed(names, 8)}; "
                "add it, or name the format with --format"
            )


def _place(where: str, row: Mapping[str, Any]) -> Place:
    names = [name for name in PLACE_LIMITS if name in REQUIRED_COLUMNS or name in row]
    place = Place(**{name: float(numbers(where, [str(row.get(name, ""))], 1, name)[0]) for name in names})
    place.check(where, "correct it")
    return place


def _notes(rows: list[dict[str, Any]]) -> tuple[str, ...]:
    headings = [float(row["heading"]) for row in rows]
    ignored = sorted({key for row in rows for key in row} - set(COLUMNS) - {"location"})
    return noted(
        {
            "angles: degrees; heading of the image centre clockwise from true north, pitch up, roll as in GPano": True,
            "headings: all within ±6.3, are they radians? they are taken as degrees": (
                any(headings) and all(abs(heading) <= MAX_RADIAN_HEADING for heading in headings)
            ),
            altitudes_note("a street-view elevation"): any("altitude" in row for row in rows),
            f"ignored: columns {listed(ignored, 8)}": ignored,
        }
    )
