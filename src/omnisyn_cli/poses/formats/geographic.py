"""Places on earth with compass headings, as poses in one local world: x east, y up, −z north at its origin.

Panoramas may tell their place by their own tags: EXIF GPS and the GPano pose that cameras and stitchers write.
``PoseHeadingDegrees`` is the compass heading of the image centre, ``PosePitchDegrees`` its height above the horizon,
``PoseRollDegrees`` the roll at which the horizon turns counter-clockwise as it grows; where heading is missing, EXIF's
``GPSImgDirection`` stands in for it. Cameras without a compass write placeholders: a GoPro MAX has heading, pitch and
roll 0 in every picture, Insta360 Studio has latitude and longitude 0 where there was no GPS.

Source: Google, "Photo Sphere XMP Metadata"; Exif 2.32 and 3.0, GPS attribute information.
"""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, enu_axes, enu_from_geographic, rotation_from_heading
from omnisyn_cli.io.decode import ImageHeader, read_header
from omnisyn_cli.io.documents import listed
from omnisyn_cli.poses.file import distinct_names
from omnisyn_cli.poses.formats import files
from omnisyn_cli.poses.formats.files import WORLD_UP, ImportedPoses, ImportedView, ImportOptions, Origin

ELLIPSOID_ALTITUDE_REFS = (2, 3)  # Values of ``GPSAltitudeRef`` for altitudes above and below the ellipsoid (Exif 3.0)
POSE_TAGS = ("Heading", "Pitch", "Roll")  # GPano's, between ``Pose`` and ``Degrees``

# Largest absolute values of the fields of :class:`Place`, in their units.
PLACE_LIMITS = {"latitude": 90.0, "longitude": 180.0, "heading": 360.0, "pitch": 90.0, "roll": 180.0, "altitude": 1e6}


@dataclass(frozen=True)
class Place:
    """Where a panorama was taken and how it was held."""

    # WGS84, degrees
    latitude: float
    longitude: float
    heading: float | None  # of the image centre, degrees clockwise from true north, or None where it is not known
    pitch: float = 0.0  # of the image centre above the horizon, degrees
    roll: float = 0.0  # of the camera, clockwise about its line of sight, degrees: the horizon turns counter-clockwise
    altitude: float | None = None  # metres, or None where it is not known

    def check(self, where: str, remedy: str) -> None:
        """Refuse (PoseError from ``where`` to ``remedy``) numbers that are too large for what they mean."""
        for name, limit in PLACE_LIMITS.items():
            value = getattr(self, name)
            if value is not None and not abs(value) <= limit:
                raise PoseError(f"{where}: expected {name} within ±{limit:g}, got {value:g}; {remedy}")


def imported_places(
    where: str, places: Mapping[str, Place], images: Mapping[str, Path | None], options: ImportOptions,
    notes: Sequence[str],
) -> ImportedPoses:  # fmt: skip
    """Places by name in the local world of the origin that is asked for, or of the first place.

    Without any altitude all are taken to be equally high. Headings count from the meridian of each place, which is
    turned into the world exactly; missing ones are found by :mod:`.headings`.
    PoseError: some have an altitude and some have none, or nothing tells a heading; ``where`` begins the message.
    """
    without = [name for name, place in places.items() if place.altitude is None]
    if 0 < len(without) < len(places):
        raise PoseError(f"{where}: expected altitudes for all panoramas or none, got none for '{without[0]}'; add it")
    first = next(iter(places.values()))
    origin = options.origin or (first.latitude, first.longitude, first.altitude or 0.0)
    worlds = {name: local_world((p.latitude, p.longitude, p.altitude or 0.0), origin) for name, p in places.items()}
    held = {name: worlds[name].rotation @ rotation_at(place, options) for name, place in places.items()}
    rotations = {name: held[name] for name, place in places.items() if place.heading is not None}
    if len(rotations) < len(places):
        from omnisyn_cli.poses.formats.headings import rotations_by_neighbours  # OpenCV takes a while to import

        positions = {name: world.position for name, world in worlds.items()}
        rotations, more = rotations_by_neighbours(positions, rotations, held, images)
        notes = [*more, *notes]
    if unknown := [name for name in places if name not in rotations]:
        raise PoseError(
            f"{where}: expected a compass heading (GPano:PoseHeadingDegrees or GPSImgDirection), got none for "
            f"{listed(unknown)}, and neither pictures nor ways tell it; give a table of places (CSV) with headings"
        )
    views = [ImportedView(name, Pose(rotations[name], worlds[name].position), images[name]) for name in places]
    flat = ["altitudes: none given, all panoramas are taken to be equally high"] if without else []
    return ImportedPoses(tuple(views), (origin_note(origin), *flat, *notes))


def rotation_at(place: Place, options: ImportOptions) -> Float[np.ndarray, "3 3"]:
    """World-from-camera at the place itself; as if it looked north where nobody knows."""
    roll = -place.roll if options.roll == "clockwise" else place.roll
    return rotation_from_heading(*(math.radians(angle) for angle in (place.heading or 0.0, place.pitch, roll)))


def local_world(place: Origin, origin: Origin) -> Pose:
    """The local world (x east, y up, −z north) of one place, seen in that of another."""
    ours = WORLD_UP["z"]
    turn = ours @ enu_axes(*origin[:2]) @ enu_axes(*place[:2]).T @ ours.T
    return Pose(turn, ours @ enu_from_geographic(*place, origin))


def origin_note(origin: Origin) -> str:
    """What the world's axes mean."""
    latitude, longitude, altitude = origin
    return f"origin: latitude {latitude:.8g}, longitude {longitude:.8g}, altitude {altitude:.6g} m; x east, −z north"


def altitudes_note(source: str) -> str:
    """What it means that altitudes count from the sea."""
    return (
        f"altitudes: {source} counts from the mean sea level, WGS84 from the ellipsoid; only differences are used, "
        "which agree within about 0.1 mm per metre of way"
    )


def read_exif(sources: Sequence[Path], options: ImportOptions) -> ImportedPoses:
    """Poses of image files, or of the images in folders, each once; those without any place are left out and named."""
    found: dict[str, Path] = {}
    for source in sources:
        for path in files.images_in(source) if source.is_dir() else [source]:
            found.setdefault(os.path.realpath(path), path)
    paths = list(found.values())
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
    return files.noted({
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
