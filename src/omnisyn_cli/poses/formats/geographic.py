"""Places on earth with compass headings, as poses in one local world: x east, y up, −z north at its origin."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, enu_from_geographic, rotation_from_heading
from omnisyn_cli.io.documents import listed
from omnisyn_cli.poses.formats.headings import rotations_by_neighbours
from omnisyn_cli.poses.formats.model import ImportedPoses, ImportedView, ImportOptions, Origin

PLUMB_LINE_LENGTH = 1e6
"""Metres between the two points that give a plumb line; any length serves, a long one keeps more digits."""

PLACE_LIMITS = {"latitude": 90.0, "longitude": 180.0, "heading": 360.0, "pitch": 90.0, "roll": 180.0, "altitude": 1e6}
"""Largest absolute values of the fields of :class:`Place`, in their units."""


@dataclass(frozen=True)
class Place:
    """Where a panorama was taken and how it was held.

    Attributes:
        latitude, longitude: WGS84, degrees.
        heading: of the image centre, degrees clockwise from true north, or None where it is not known.
        pitch: of the image centre above the horizon, degrees.
        roll: of the camera, clockwise about its line of sight, degrees: the horizon turns counter-clockwise.
        altitude: metres, or None where it is not known.
    """

    latitude: float
    longitude: float
    heading: float | None
    pitch: float = 0.0
    roll: float = 0.0
    altitude: float | None = None

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
    turned into the world exactly; missing ones are found by :func:`rotations_by_neighbours`.
    PoseError: some have an altitude and some have none, or nothing tells a heading; ``where`` begins the message.
    """
    without = [name for name, place in places.items() if place.altitude is None]
    if 0 < len(without) < len(places):
        raise PoseError(f"{where}: expected altitudes for all panoramas or none, got none for '{without[0]}'; add it")
    first = next(iter(places.values()))
    origin = options.origin or (first.latitude, first.longitude, first.altitude or 0.0)
    worlds = {name: local_world((p.latitude, p.longitude, p.altitude or 0.0), origin) for name, p in places.items()}
    held = {name: worlds[name].rotation @ _rotation(place, options) for name, place in places.items()}
    rotations = {name: held[name] for name, place in places.items() if place.heading is not None}
    if len(rotations) < len(places):
        positions = {name: world.position for name, world in worlds.items()}
        found, more = rotations_by_neighbours(positions, rotations, held, images)
        rotations, notes = {**rotations, **found}, [*more, *notes]
    if unknown := [name for name in places if name not in rotations]:
        raise PoseError(
            f"{where}: expected a compass heading (GPano:PoseHeadingDegrees or GPSImgDirection), got none for "
            f"{listed(unknown)}, and neither pictures nor ways tell it; give a table of places (CSV) with headings"
        )
    views = [ImportedView(name, Pose(rotations[name], worlds[name].position), images[name]) for name in places]
    flat = ["altitudes: none given, all panoramas are taken to be equally high"] if without else []
    return ImportedPoses(tuple(views), (origin_note(origin), *flat, *notes))


def _rotation(place: Place, options: ImportOptions) -> Float[np.ndarray, "3 3"]:
    """World-from-camera at the place itself; as if it looked north where nobody knows."""
    roll = -place.roll if options.roll == "clockwise" else place.roll
    return rotation_from_heading(*(math.radians(angle) for angle in (place.heading or 0.0, place.pitch, roll)))


def local_world(place: Origin, origin: Origin) -> Pose:
    """The local world (x east, y up, −z north) of one place, seen in that of another."""
    latitude, longitude, _ = place
    up = _plumb(latitude, longitude, origin)
    north = _plumb(latitude + 90.0, longitude, origin)  # upwards a quarter of the meridian further, pole or not
    return Pose(np.stack([np.cross(north, up), up, -north], axis=-1), _position(*place, origin))


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


def _position(latitude: float, longitude: float, altitude: float, origin: Origin) -> Float[np.ndarray, " 3"]:
    east, north, up = enu_from_geographic(latitude, longitude, altitude, origin)
    return np.array([east, up, -north])


def _plumb(latitude: float, longitude: float, origin: Origin) -> Float[np.ndarray, " 3"]:
    """Unit vector upwards at a place: altitude grows along a straight line."""
    along = _position(latitude, longitude, PLUMB_LINE_LENGTH, origin) - _position(latitude, longitude, 0.0, origin)
    return np.asarray(along / PLUMB_LINE_LENGTH)
