"""Tables of panoramas: CSV or JSON with places on earth, or with positions in metres.

Street-view tools write lat, lng and heading, and pitch and roll if known; surveyors and mobile mappers x, y and z in
metres, z up, with the same angles or a camera-to-world quaternion. The header may be a comment with a title (NavVis:
``# pano poses v1.0: ID; filename; timestamp; pano_pos_x; …``). JSON may be a list of objects, an object of objects by
image name, or either of them below one of the keys ``panoramas``, ``images`` and ``data``; coordinates may sit in an
object ``location``. Angles are degrees as GPano defines them, headings those from +y, north, to +x, east.

Source: NavVis, "Panorama Image Poses", whose panoramas have x forward, y left, z up.
"""

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.io.documents import listed, read_json, read_text
from omnisyn_cli.poses.entries import checked_quaternion
from omnisyn_cli.poses.formats import files
from omnisyn_cli.poses.formats.files import WORLD_UP, ImportedPoses, ImportedView, ImportOptions
from omnisyn_cli.poses.formats.geographic import PLACE_LIMITS, Place, altitudes_note, imported_places, rotation_at

# What a column may be called, in small letters; the first name that occurs wins.
COLUMNS = {
    "image": ("image", "file", "filename", "file_name", "name", "path", "pano_id", "panoid", "id"),
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "lng", "lon", "long"),
    "altitude": ("altitude", "alt", "elevation", "originalelevationaboveegm96"),
    "heading": ("heading", "yaw", "bearing", "compass_angle", "computed_compass_angle"),
    "pitch": ("pitch",),
    "roll": ("roll",),
    **{axis: (axis, f"pano_pos_{axis}", f"pos_{axis}", f"position_{axis}", f"t{axis}") for axis in "xyz"},
    **{f"q{part}": (f"q{part}", f"pano_ori_{part}", f"ori_{part}", f"quat_{part}") for part in "wxyz"},
}
Rows = dict[str, tuple[str, dict[str, Any]]]  # place and fields of each, by the name of its image
POSITION, QUATERNION = ("x", "y", "z"), ("qw", "qx", "qy", "qz")
REQUIRED_COLUMNS = ("image", "latitude", "longitude", "heading")
MAX_RADIAN_HEADING = 6.3  # Just above 2π: headings that all stay below may be radians
MAX_LOCAL_METRES = 1e4  # farther from the origin, coordinates are those of a country and counted from the first ones


def is_metric(source: Path) -> bool:
    """Whether a table has positions in metres, and no places on earth."""
    _, first = next(_rows(source, ()), ("", {}))
    return "latitude" not in first and not first.keys().isdisjoint(POSITION)


def read_table(source: Path, options: ImportOptions) -> ImportedPoses:
    """Poses of a CSV or JSON table of places on earth."""
    rows, images = _named_rows(source, REQUIRED_COLUMNS, options)
    places = {name: _place_in_table(where, row) for name, (where, row) in rows.items()}
    return imported_places(str(source), places, images, options, _table_notes([row for _, row in rows.values()]))


def read_xyz(source: Path, options: ImportOptions) -> ImportedPoses:
    """Poses of a CSV or JSON table of positions in metres."""
    rows, images = _named_rows(source, ("image", *POSITION), options)
    poses = {name: _metric_pose(where, row, options) for name, (where, row) in rows.items()}
    fields = [row for _, row in rows.values()]
    are_guessed = options.camera is None and any({*QUATERNION} <= row.keys() for row in fields)
    first = next(iter(poses.values())).position
    start = first if np.abs(first).max() > MAX_LOCAL_METRES else np.zeros(3)
    views = [ImportedView(name, Pose(p.rotation, p.position - start), images[name]) for name, p in poses.items()]
    notes = {
        "world: z is taken to point up, as surveyors have it; --up says otherwise": options.up is None,
        "cameras: taken to have x forward, y left, z up, as NavVis has it; --camera-axes says otherwise": are_guessed,
        "positions: counted from the first panorama, as coordinates are large": start.any(),
    }
    return ImportedPoses(tuple(views), (*files.noted(notes), *_table_notes(fields)))


def _named_rows(source: Path, required: Sequence[str], options: ImportOptions) -> tuple[Rows, dict[str, Path | None]]:
    """Place and fields of every row by the name of its image, and the images that were found."""
    rows: Rows = {}
    images = {}
    for where, row in _rows(source, required):
        name = str(row.get("image", "")).strip()
        if not name or name in rows:
            found = f"'{name}' twice" if name else "none"
            raise PoseError(f"{where}: expected the name of another image, got {found}; correct it")
        rows[name] = where, row
        images[name] = files.find_image(where, name, [source.parent, source.parent / "images"], options)
    if not rows:
        raise PoseError(f"{source}: expected at least one panorama, got none; check the file")
    return rows, images


def _metric_pose(where: str, row: Mapping[str, Any], options: ImportOptions) -> Pose:
    """Our pose of a row with a quaternion, or with a heading."""
    position = _numbers(where, row, POSITION)
    if {*QUATERNION} <= row.keys():
        foreign = Pose(checked_quaternion(where, _numbers(where, row, QUATERNION)), position)
        return options.pose(foreign, camera="flu", up="z")
    if "heading" not in row:
        raise PoseError(f"{where}: expected a quaternion (qw, qx, qy, qz) or a heading, got neither; add it")
    rotation = rotation_at(_place_in_table(where, {**row, "latitude": 0, "longitude": 0}), options)
    return Pose(rotation, WORLD_UP[options.up or "z"] @ position)


def _numbers(where: str, row: Mapping[str, Any], names: Sequence[str]) -> np.ndarray:
    return np.array([files.numbers(where, [str(row.get(name, ""))], 1, name)[0] for name in names])


def _rows(source: Path, required: Sequence[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    return (_json_rows if source.suffix.lower() == ".json" else _csv_rows)(source, required)


def _csv_rows(source: Path, required: Sequence[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Place (file and line) and fields by our names of every row."""
    text = re.sub(r"^#(?:[^:,;\t\n]*:)?", "", read_text(source))
    first = text.split("\n", 1)[0]
    delimiter = max(",;\t", key=first.count)
    reader = csv.DictReader(io.StringIO(text), delimiter=delimiter, skipinitialspace=True)
    try:
        _check_columns(f"{source}:1", [name or "" for name in reader.fieldnames or []], required)
        for row in reader:
            if next(iter(row.values()), "").startswith("#"):
                continue
            fields = _renamed({key: value for key, value in row.items() if key})
            if delimiter != ",":  # which then may be a decimal comma
                numbers = fields.keys() & COLUMNS.keys() - {"image"}
                fields |= {key: re.sub(r"^(\s*[+-]?\d+),(\d+\s*)$", r"\1.\2", fields[key]) for key in numbers}
            yield f"{source}:{reader.line_num}", fields
    except csv.Error as error:
        raise PoseError(f"{source}:{reader.line_num}: expected CSV, got '{error}'; correct the line") from error


def _json_rows(source: Path, required: Sequence[str]) -> Iterator[tuple[str, dict[str, Any]]]:
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
        _check_columns(where, list(flat), required)
        yield where, _renamed(flat)


def _renamed(row: Mapping[str, Any]) -> dict[str, Any]:
    """The fields that are needed, by our names; what is empty is left out; others keep theirs."""
    lower = {key.strip().lower(): value for key, value in row.items()}
    chosen = {ours: next((name for name in names if name in lower), None) for ours, names in COLUMNS.items()}
    fields = {ours: lower.pop(name) for ours, name in chosen.items() if name is not None}
    return {key: value for key, value in {**lower, **fields}.items() if value not in (None, "")}


def _check_columns(where: str, names: list[str], required_columns: Sequence[str]) -> None:
    known = {name.strip().lower() for name in names}
    for required in required_columns:
        if not known & set(COLUMNS[required]):
            raise PoseError(
                f"{where}: expected {required} ({' or '.join(COLUMNS[required][:4])}), got only {listed(names, 8)}; "
                "add it, or name the format with --format"
            )


def _place_in_table(where: str, row: Mapping[str, Any]) -> Place:
    names = [name for name in PLACE_LIMITS if name in REQUIRED_COLUMNS or name in row]
    place = Place(**dict(zip(names, _numbers(where, row, names).tolist(), strict=True)))
    place.check(where, "correct it")
    return place


def _table_notes(rows: list[dict[str, Any]]) -> tuple[str, ...]:
    headings = [float(row["heading"]) for row in rows if "heading" in row and "qw" not in row]
    ignored = sorted({key for row in rows for key in row} - set(COLUMNS) - {"location"})
    are_small = any(headings) and all(abs(heading) <= MAX_RADIAN_HEADING for heading in headings)
    notes = {
        "angles: degrees; heading of the image centre clockwise from true north, pitch up, roll as in GPano": headings,
        "headings: all within ±6.3, are they radians? they are taken as degrees": are_small,
        altitudes_note("a street-view elevation"): any("altitude" in row for row in rows),
        f"ignored: columns {listed(ignored, 8)}": ignored,
    }
    return files.noted(notes)
