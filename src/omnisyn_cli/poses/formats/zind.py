"""Tours of the Zillow Indoor Dataset: ``zind_data.json``.

A 2-D similarity per panorama, ``floor_plan_transformation``, takes coordinates of its room to those of the floor:
``global = scale · [[cos r, −sin r], [sin r, cos r]] · local + translation`` with r in degrees. A point ``(x, y, z)``
of the room, z up, appears at azimuth ``atan2(−x, y)`` right of the panorama's centre: y is ahead and x is to the left,
so these coordinates are left-handed and x is negated here. Camera heights are 1 in the room's units;
``scale_meters_per_coordinate`` of the floor makes metres of the floor's units. Panoramas are level.

Source: ZInD, ``data_organization.md``; ``code/transformations.py``.
"""

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.io.documents import ForeignModel, listed, read_json, validated
from omnisyn_cli.poses.formats.files import find_view
from omnisyn_cli.poses.formats.model import ImportedPoses, ImportOptions

ZIND_FILE_NAME = "zind_data.json"


class Similarity(ForeignModel):
    """From a room's coordinates to those of its floor."""

    translation: Annotated[list[float], Field(min_length=2, max_length=2)]
    rotation: float
    scale: Annotated[float, Field(gt=0)]


class Panorama(ForeignModel):
    """One panorama; camera_height is in units of its room."""

    image_path: Annotated[str, Field(min_length=1)]
    floor_plan_transformation: Similarity
    camera_height: Annotated[float, Field(gt=0)] = 1.0


class Tour(ForeignModel):
    """The file: floor, complete room, partial room and panorama by their names; panoramas are checked one by one."""

    merger: Annotated[dict[str, dict[str, dict[str, dict[str, Any]]]], Field(min_length=1)]
    scale_meters_per_coordinate: dict[str, float | None] = Field(default_factory=dict)


def read_tour(path: Path) -> Tour:
    """What a ``zind_data.json`` says; PoseError: no such file, or a malformed one."""
    return validated(path, Tour, read_json(path))


def pose_on_floor(panorama: Panorama, metres: float) -> Pose:
    """The mirrored similarity: (x, y) of the floor is (−x, −z) of ours, counter-clockwise there is clockwise here.

    A unit of the floor is ``metres`` long.
    """
    similarity = panorama.floor_plan_transformation
    x, y = similarity.translation
    height = panorama.camera_height * similarity.scale
    rotation = rotation_from_heading(math.radians(similarity.rotation))
    return Pose(rotation, np.array([metres * -x, metres * height, metres * -y]))


def read_zind(source: Path, options: ImportOptions) -> ImportedPoses:
    """Poses of the panoramas of one floor of a ``zind_data.json``, or of its folder.

    The world's y counts from the floor, x and z span the floor plan.
    """
    path = source / ZIND_FILE_NAME if source.is_dir() else source
    tour = read_tour(path)
    floor = _floor(path, tour, options)
    metres = tour.scale_meters_per_coordinate.get(floor)
    panoramas = [
        validated(path, Panorama, value, ("merger", floor, complete, partial, name))
        for complete, partials in tour.merger[floor].items()
        for partial, entries in partials.items()
        for name, value in entries.items()
    ]
    views = tuple(
        find_view(str(path), panorama.image_path, pose_on_floor(panorama, metres or 1.0), [path.parent], options)
        for panorama in panoramas
    )
    if metres:
        distances = f"distances: metres, {metres:.6g} per unit of the floor plan"
    else:
        distances = f"distances: the scale of {floor} is unknown, units of the floor plan are taken as metres"
    heights = "heights: those of the cameras above the floor; panoramas are taken to be level"
    return ImportedPoses(views, (f"floor: {floor}", distances, heights))


def _floor(path: Path, tour: Tour, options: ImportOptions) -> str:
    """The floor that was asked for, or the only one."""
    floors = list(tour.merger)
    if options.floor is None and len(floors) == 1:
        return floors[0]
    if options.floor not in floors:
        wanted = f"the floor '{options.floor}'" if options.floor else "one floor"
        raise PoseError(f"{path}: expected {wanted}, got {listed(floors)}; choose with --floor")
    return options.floor
