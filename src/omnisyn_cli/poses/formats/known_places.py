"""Panoramas that know their place on earth: by their own tags, or by a table.

Tags are EXIF GPS and the GPano pose that cameras and stitchers write. ``PoseHeadingDegrees`` is the compass heading of
the image centre, ``PosePitchDegrees`` its height above the horizon, ``PoseRollDegrees`` the roll at which the horizon
turns counter-clockwise as it grows; where heading is missing, EXIF's ``GPSImgDirection`` stands in for it. Cameras
without a compass write placeholders: a GoPro MAX has heading, pitch and roll 0 in every picture, Insta360 Studio has
latitude and longitude 0 where there was no GPS.

Tables are as street-view tools write them: CSV or JSON with lat, lng, heading, and pitch and roll if known. JSON may be
a list of objects, an object of objects by image name, or either of them below one of the keys ``panoramas``, ``images``
and ``data``; the coordinates may sit in an object ``location``. Angles are degrees as GPano defines them.

Source: Google, "Photo Sphere XMP Metadata"; Exif 2.32 and 3.0, GPS attribute information.
"""

import csv
import io
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import takewhile
from pathlib import Path
from typing import Any

from omnisyn_cli.errors import PoseError
from omnisyn_cli.io.decode import ImageHeader, read_header
from omnisyn_cli.io.documents import listed, read_json, read_text
from omnisyn_cli.poses.formats.files import ImportedPoses, ImportOptions, find_image, images_in, noted, numbers
from omnisyn_cli.poses.formats.geographic import PLACE_LIMITS, Place, altitudes_note, imported_places

ELLIPSOID_ALTITUDE_REFS = (2, 3)  # Values of ``GPSAltitudeRef`` for altitudes above and below the ellipsoid (Exif 3.0)
POSE_TAGS = ("Heading", "Pitch", "Roll")  # GPano's, between ``Pose`` and ``Degrees``

# What a column may be called, in small letters; the first name that occurs wins.
COLUMNS = {
    "image": ("image", "file", "filename", "file_name", "name", "path", "pano_id", "panoid", "id"),
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "lng", "lon", "long"),
    "altitude": ("altitude", "alt", "elevation", "originalelevationaboveegm96"),
    "heading": ("heading", "yaw", "bearing", "compass_angle", "computed_compass_angle"),
    "pitch": ("pitch",),
    "roll": ("roll",),
}

REQUIRED_COLUMNS = ("image", "latitude", "longitude", "heading")

MAX_RADIAN_HEADING = 6.3  # Just above 2π: headings that all stay below may be radians


def read_exif(sources: Sequence[Path], options: ImportOptions) -> ImportedPoses:
    """Poses of image files, or of the images in folders; images without any place are left out and named.

    A file that is given twice, by itself and in its folder, counts once.
    """
    paths = _different(path for source in sources for path in (images_in(source) if source.is_dir() else [source]))
    headers = {name: read_header(path) for name, path in zip(_names(paths), paths, strict=True)}
    placed = {name: header for name, header in headers.items() if _has_place(header)}
    where = str(sources[0])
    if not placed:
        raise PoseError(
            f"{where}: expected images with EXIF GPS, got none in {len(paths)} images; give a table of places (CSV), "
            "or let 'omnisyn poses estimate' find the poses"
        )
    untold = _placeholders(placed)
    places = {name: _place_in_exif(header, has_pose=name not in untold) for name, header in placed.items()}
    notes = _exif_notes(list(placed.values()), [name for name in headers if name not in placed], untold)
    return imported_places(where, places, {name: header.path for name, header in placed.items()}, options, notes)


def _different(paths: Iterable[Path]) -> list[Path]:
    """Paths without those that lead to the file of an earlier one."""
    files: dict[str, Path] = {}
    for path in paths:
        files.setdefault(os.path.realpath(path), path)
    return list(files.values())


def _names(paths: Sequence[Path]) -> list[str]:
    """Paths from the folder that all images lie below: their file names, where that is their own folder."""
    places = [Path(os.path.realpath(path.parent), path.name) for path in paths]
    levels = zip(*(place.parent.parts for place in places), strict=False)
    shared = len(list(takewhile(lambda level: len(set(level)) == 1, levels)))
    return ["/".join(place.parts[shared:]) for place in places]


def _has_place(header: ImageHeader) -> bool:
    """Whether there is GPS; 0° north and 0° east is the sea, and what programs write for nothing."""
    places = [header.degrees(f"GPS:{name}", negative) for name, negative in (("Latitude", "S"), ("Longitude", "W"))]
    return "GPS:Latitude" in header.attributes and places != [0.0, 0.0]


def _placeholders(headers: Mapping[str, ImageHeader]) -> list[str]:
    """Panoramas of cameras that say heading, pitch and roll 0 every time: all GoPros, others from two pictures on."""
    cameras: dict[tuple[str, str], list[str]] = {}
    for name, header in headers.items():
        make, model = (str(header.attributes.get(tag, "")) for tag in ("Make", "Model"))
        cameras.setdefault((make, model), []).append(name)
    return [
        name
        for (make, _), names in cameras.items()
        if (len(names) > 1 or make.lower() == "gopro")
        and all(headers[each].number(f"GPano:Pose{tag}Degrees") == 0.0 for each in names for tag in POSE_TAGS)
        for name in names
    ]


def _place_in_exif(header: ImageHeader, *, has_pose: bool) -> Place:
    """The place of a panorama, with the tags of GPano unless they are placeholders."""
    heading = header.number("GPano:PoseHeadingDegrees") if has_pose else None
    if heading is None:
        heading = header.number("GPS:ImgDirection")
    angles = []
    for name, negative in (("Latitude", "S"), ("Longitude", "W")):
        angle = header.degrees(f"GPS:{name}", negative)
        if angle is None:
            value = header.attributes.get(f"GPS:{name}")
            raise PoseError(
                f"{header.path}: expected GPS {name} as degrees, minutes and seconds, got {value!r}; correct the tag"
            )
        if not header.attributes.get(f"GPS:{name}Ref"):
            raise PoseError(f"{header.path}: expected GPS {name}Ref (on which half of the earth), got none; add it")
        angles.append(angle)
    pitch, roll = (header.number(f"GPano:Pose{name}Degrees") or 0.0 for name in ("Pitch", "Roll"))
    place = Place(angles[0], angles[1], heading, pitch, roll, header.altitude)
    place.check(str(header.path), "correct the tag")
    return place


def _exif_notes(headers: list[ImageHeader], skipped: list[str], untold: list[str]) -> list[str]:
    notes = []
    if untold:
        notes.append(f"headings: 0 as well as pitch and roll in all of {listed(untold)}, taken for placeholders")
    if any(h.altitude is not None and h.number("GPS:AltitudeRef") not in ELLIPSOID_ALTITUDE_REFS for h in headers):
        notes.append(altitudes_note("EXIF"))
    by_compass = [
        h for h in headers if h.number("GPano:PoseHeadingDegrees") is None and h.number("GPS:ImgDirection") is not None
    ]
    if by_compass:
        names = listed([header.path.name for header in by_compass])
        notes.append(f"headings: no GPano heading in {names}; GPSImgDirection is taken as that of the image centre")
    magnetic = [h for h in by_compass if str(h.attributes.get("GPS:ImgDirectionRef", "")).strip().upper() == "M"]
    if magnetic:
        names = listed([header.path.name for header in magnetic])
        notes.append(f"headings: magnetic north in {names}, taken as true north; the declination is not corrected")
    if any(h.number("GPano:PosePitchDegrees") is None for h in headers):
        notes.append("pitch and roll: taken as 0 where GPano does not say")
    if any(float(h.attributes["GPS:Latitude"][0]) % 1 for h in headers):
        notes.append("positions: written as fractions of degrees, which OpenImageIO reads to about half a metre only")
    if skipped:
        notes.append(f"left out: {listed(skipped)} without GPS")
    return notes


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
        places[name] = _place_in_table(where, row)
        images[name] = find_image(where, name, [source.parent, source.parent / "images"], options)
    return imported_places(str(source), places, images, options, _table_notes([row for _, row in rows]))


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


def _place_in_table(where: str, row: Mapping[str, Any]) -> Place:
    names = [name for name in PLACE_LIMITS if name in REQUIRED_COLUMNS or name in row]
    place = Place(**{name: float(numbers(where, [str(row.get(name, ""))], 1, name)[0]) for name in names})
    place.check(where, "correct it")
    return place


def _table_notes(rows: list[dict[str, Any]]) -> tuple[str, ...]:
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
