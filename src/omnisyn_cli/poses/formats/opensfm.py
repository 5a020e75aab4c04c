"""OpenSfM's ``reconstruction.json``: world-to-camera angle-axis rotations and translations.

Cameras look along z with y down (OpenCV axes); a ``spherical`` (formerly ``equirectangular``) camera sees a direction
at ``u = atan2(x, z) / 2π``, ``v = −atan2(−y, hypot(x, z)) / 2π``, in units of the image's width from its centre. The
world has x east, y north, z up at ``reference_lla``, in metres where the images had GPS.

Source: OpenSfM documentation, "Geometric Models" and "Reconstruction file format".
"""

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.io.documents import ForeignModel, listed, read_json, validated
from omnisyn_cli.poses.formats.files import find_view
from omnisyn_cli.poses.formats.geographic import local_world, origin_note
from omnisyn_cli.poses.formats.model import ImportedPoses, ImportOptions, noted

SPHERICAL_PROJECTIONS = frozenset({"spherical", "equirectangular"})

MAX_ABSOLUTE = 1e9
"""Radians or metres; more is a mistake, and its square might overflow."""

Vector = Annotated[
    list[Annotated[float, Field(ge=-MAX_ABSOLUTE, le=MAX_ABSOLUTE)]], Field(min_length=3, max_length=3)
]  # fmt: skip


class Camera(ForeignModel):
    """A camera model; only its kind matters."""

    projection_type: str


class Shot(ForeignModel):
    """One image."""

    camera: str
    rotation: Vector
    translation: Vector


class Reference(ForeignModel):
    """Where on earth the world's origin lies."""

    latitude: float = 0.0
    longitude: float = 0.0
    altitude: float = 0.0


class Reconstruction(ForeignModel):
    """One connected part of the scene."""

    cameras: dict[str, Camera]
    shots: Annotated[dict[str, Shot], Field(min_length=1)]
    reference_lla: Reference = Reference()


def read_opensfm(source: Path, options: ImportOptions) -> ImportedPoses:
    """Poses of the panoramas of the largest reconstruction of a ``reconstruction.json``, or of its folder."""
    path = source / "reconstruction.json" if source.is_dir() else source
    document = read_json(path)
    parts = document if isinstance(document, list) else [document]
    if not parts:
        raise PoseError(f"{path}: expected a reconstruction, got an empty list; run the reconstruction again")
    every = [validated(path, Reconstruction, part, (f"[{index}]",)) for index, part in enumerate(parts)]
    largest = max(every, key=lambda part: len(part.shots))
    chosen = {name: shot for name, shot in largest.shots.items() if _is_panorama(path, name, shot, largest)}
    if not chosen:
        raise PoseError(f"{path}: expected shots of a spherical camera, got none; only panoramas can be used")
    reference = largest.reference_lla
    origin = reference.latitude, reference.longitude, reference.altitude
    is_on_earth = origin[:2] != (0.0, 0.0)  # without GPS OpenSfM writes zeros
    if options.origin is not None and not is_on_earth:
        raise PoseError(f"{path}: expected a reference_lla to tell --origin from, got none; leave --origin out")
    world = Pose.identity() if options.origin is None else local_world(origin, options.origin)
    folders = [path.parent, path.parent / "images"]
    views = []
    for name, shot in chosen.items():
        world_to_camera = Pose(rotation_from_rotation_vector(np.array(shot.rotation)), np.array(shot.translation))
        pose = world @ options.pose(world_to_camera.inverse(), camera="opencv", up="z")
        views.append(find_view(str(path), name, pose, folders, options))
    skipped = [name for name in largest.shots if name not in chosen]
    counts = ", ".join(str(len(part.shots)) for part in every)
    notes = {
        "distances: no reference_lla, so no GPS: the scale is unknown and taken as metres": not is_on_earth,
        origin_note(options.origin or origin): is_on_earth,
        "distances: metres, as exact as the GPS of the images": is_on_earth,
        f"reconstructions: {len(every)} with {counts} shots, the largest is taken": len(every) > 1,
        f"left out: {listed(skipped)}, whose cameras are not spherical": skipped,
    }
    return ImportedPoses(tuple(views), noted(notes))


def _is_panorama(path: Path, name: str, shot: Shot, reconstruction: Reconstruction) -> bool:
    if shot.camera not in reconstruction.cameras:
        raise PoseError(
            f"{path}: shots.'{name}'.camera: expected one of the cameras {listed(list(reconstruction.cameras))}, "
            f"got '{shot.camera}'; correct it"
        )
    return reconstruction.cameras[shot.camera].projection_type.lower() in SPHERICAL_PROJECTIONS
