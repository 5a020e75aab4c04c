"""Panoramas that carry their own place: EXIF GPS and the GPano pose that cameras and stitchers write.

``PoseHeadingDegrees`` is the compass heading of the image centre, ``PosePitchDegrees`` its height above the horizon,
``PoseRollDegrees`` the roll at which the horizon turns counter-clockwise as it grows; where heading is missing, EXIF's
``GPSImgDirection`` stands in for it.

Source: Google, "Photo Sphere XMP Metadata"; Exif 2.32 and 3.0, GPS attribute information.
"""

import os
from collections.abc import Iterable, Sequence
from itertools import takewhile
from pathlib import Path

from omnisyn_cli.errors import PoseError
from omnisyn_cli.io.decode import ImageHeader, read_header
from omnisyn_cli.io.documents import listed
from omnisyn_cli.poses.formats.files import images_in
from omnisyn_cli.poses.formats.geographic import Place, altitudes_note, imported_places
from omnisyn_cli.poses.formats.model import ImportedPoses, ImportOptions

ELLIPSOID_ALTITUDE_REFS = (2, 3)
"""Values of ``GPSAltitudeRef`` for altitudes above and below the ellipsoid (Exif 3.0)."""


def read_exif(sources: Sequence[Path], options: ImportOptions) -> ImportedPoses:
    """Poses of image files, or of the images in folders; images without any place are left out and named.

    A file that is given twice, by itself and in its folder, counts once.
    """
    paths = _different(path for source in sources for path in (images_in(source) if source.is_dir() else [source]))
    headers = {name: read_header(path) for name, path in zip(_names(paths), paths, strict=True)}
    placed = {name: header for name, header in headers.items() if "GPS:Latitude" in header.attributes}
    where = str(sources[0])
    if not placed:
        raise PoseError(
            f"{where}: expected images with EXIF GPS, got none in {len(paths)} images; give a table of places (CSV), "
            "or let 'omnisyn poses estimate' find the poses"
        )
    places = {name: _place(header) for name, header in placed.items()}
    notes = _notes(list(placed.values()), [name for name in headers if name not in placed])
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


def _place(header: ImageHeader) -> Place:
    heading = header.number("GPano:PoseHeadingDegrees")
    if heading is None:
        heading = header.number("GPS:ImgDirection")
    if heading is None:
        raise PoseError(
            f"{header.path}: expected a compass heading (GPano:PoseHeadingDegrees or GPSImgDirection), got none; "
            "add the tag, or give a table of places (CSV) with headings"
        )
    angles = []
    for name, negative in (("Latitude", "S"), ("Longitude", "W")):
        angle = header.degrees(f"GPS:{name}", negative)
        if angle is None:
            value = header.attributes.get(f"GPS:{name}")
            raise PoseError(
                f"{header.path}: expected GPS {name} as degrees, minutes and seconds, got {value!r}; correct the tag"
            )
        angles.append(angle)
    pitch, roll = (header.number(f"GPano:Pose{name}Degrees") or 0.0 for name in ("Pitch", "Roll"))
    place = Place(angles[0], angles[1], heading, pitch, roll, header.altitude)
    place.check(str(header.path), "correct the tag")
    return place


def _notes(headers: list[ImageHeader], skipped: list[str]) -> list[str]:
    notes = []
    if any(h.altitude is not None and h.number("GPS:AltitudeRef") not in ELLIPSOID_ALTITUDE_REFS for h in headers):
        notes.append(altitudes_note("EXIF"))
    by_compass = [h for h in headers if h.number("GPano:PoseHeadingDegrees") is None]
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
