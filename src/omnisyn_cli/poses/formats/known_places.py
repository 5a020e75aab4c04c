"""Panoramas that know their place on earth by their own tags.

Tags are EXIF GPS and the GPano pose that cameras and stitchers write. ``PoseHeadingDegrees`` is the compass heading of
the image centre, ``PosePitchDegrees`` its height above the horizon, ``PoseRollDegrees`` the roll at which the horizon
turns counter-clockwise as it grows; where heading is missing, EXIF's ``GPSImgDirection`` stands in for it. Cameras
without a compass write placeholders: a GoPro MAX has heading, pitch and roll 0 in every picture, Insta360 Studio has
latitude and longitude 0 where there was no GPS.

Source: Google, "Photo Sphere XMP Metadata"; Exif 2.32 and 3.0, GPS attribute information.
"""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from omnisyn_cli.errors import PoseError
from omnisyn_cli.io.decode import ImageHeader, read_header
from omnisyn_cli.io.documents import listed
from omnisyn_cli.poses.file import distinct_names
from omnisyn_cli.poses.formats.files import ImportedPoses, ImportOptions, images_in, noted
from omnisyn_cli.poses.formats.geographic import Place, altitudes_note, imported_places

ELLIPSOID_ALTITUDE_REFS = (2, 3)  # Values of ``GPSAltitudeRef`` for altitudes above and below the ellipsoid (Exif 3.0)
POSE_TAGS = ("Heading", "Pitch", "Roll")  # GPano's, between ``Pose`` and ``Degrees``


def read_exif(sources: Sequence[Path], options: ImportOptions) -> ImportedPoses:
    """Poses of image files, or of the images in folders, each once; those without any place are left out and named."""
    files: dict[str, Path] = {}
    for source in sources:
        for path in images_in(source) if source.is_dir() else [source]:
            files.setdefault(os.path.realpath(path), path)
    paths = list(files.values())
    headers = {name: read_header(path) for name, path in zip(distinct_names(paths), paths, strict=True)}
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


def _exif_notes(headers: list[ImageHeader], skipped: list[str], untold: list[str]) -> tuple[str, ...]:
    by_compass = [
        h for h in headers if h.number("GPano:PoseHeadingDegrees") is None and h.number("GPS:ImgDirection") is not None
    ]
    magnetic = [h for h in by_compass if str(h.attributes.get("GPS:ImgDirectionRef", "")).strip().upper() == "M"]
    of_compass, of_magnetic = (listed([header.path.name for header in each]) for each in (by_compass, magnetic))
    return noted({
        f"headings: 0 as well as pitch and roll in all of {listed(untold)}, taken for placeholders": untold,
        altitudes_note("EXIF"): any(
            h.altitude is not None and h.number("GPS:AltitudeRef") not in ELLIPSOID_ALTITUDE_REFS for h in headers),
        f"headings: no GPano heading in {of_compass}; GPSImgDirection is taken as that of the image centre": by_compass,
        f"headings: magnetic north in {of_magnetic}, taken as true north; the declination is not corrected": magnetic,
        "pitch and roll: taken as 0 where GPano does not say": any(
            h.number("GPano:PosePitchDegrees") is None for h in headers),
        "positions: written as fractions of degrees, which OpenImageIO reads to about half a metre only": any(
            float(h.attributes["GPS:Latitude"][0]) % 1 for h in headers),
        f"left out: {listed(skipped)} without GPS": skipped,
    })  # fmt: skip
