"""Tours of the Zillow Indoor Dataset (ZInD): ``TOUR/zind_data.json`` with ``TOUR/panos/*.jpg``.

What is assumed (from ``data_organization.md`` and ``code/transformations.py``, zillow/zind):

* ``merger / floor / complete_room / partial_room / pano`` holds ``image_path``, ``camera_height`` and
  ``floor_plan_transformation`` (``translation`` 2, ``rotation`` in degrees, ``scale``).
* Room coordinates are left-handed: a point (x, y, z) is seen at the azimuth atan2(−x, y), positive to the right of the
  image centre, z is up. The rotation takes a room's coordinates to those of the floor,
  ``(x·cos − y·sin, x·sin + y·cos)·scale + translation``. Here the position is therefore ``(−x, height, −y)`` and the
  rotation a compass heading.
* ``scale_meters_per_coordinate`` turns coordinates of a floor into metres; where it is null, the scene has no scale.
* Panoramas are level, ``camera_height · scale`` above one flat floor. There is no depth.

Every complete room with two or more panoramas is one scene, its panoramas in the order of their numbers.
"""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, TypeAdapter

from omnisyn_cli.errors import PoseError
from omnisyn_cli.evaluation.datasets.scene import NoScaleError, Scene, SceneFrame, SceneSource, read_json
from omnisyn_cli.geometry.pose import Pose, rotation_from_heading

__all__ = ["find_scenes"]

POSES = "zind_data.json"


class _Transformation(BaseModel):
    translation: tuple[float, float]
    rotation: float
    scale: float


class _Panorama(BaseModel):
    image_path: str
    camera_height: float
    floor_plan_transformation: _Transformation


_Rooms = dict[str, dict[str, dict[str, _Panorama]]]


class _Tour(BaseModel):
    scale_meters_per_coordinate: dict[str, float | None]
    merger: dict[str, _Rooms]


TOUR: TypeAdapter[_Tour] = TypeAdapter(_Tour)


def find_scenes(folder: Path) -> list[SceneSource]:
    """The rooms of all tours of a folder, or of a single tour; none where nothing has this layout."""
    if (folder / POSES).exists():
        return _rooms(folder.resolve().name, folder)
    tours = sorted(path.parent for path in folder.glob(f"*/{POSES}"))
    return [room for tour in tours for room in _rooms(tour.name, tour)]


def _rooms(name: str, folder: Path) -> list[SceneSource]:
    """Rooms with at least two panoramas; a damaged tour is one source that says so when it is read."""
    try:
        tour = read_json(folder / POSES, TOUR)
    except PoseError as error:
        return [SceneSource(name, partial(_fail, error))]
    sources = []
    for floor, rooms in tour.merger.items():
        for room, parts in rooms.items():
            panoramas = {key: value for part in parts.values() for key, value in part.items()}
            if len(panoramas) > 1:
                scale = tour.scale_meters_per_coordinate.get(floor)
                title = f"{name}/{floor}/{room}"
                sources.append(SceneSource(title, partial(_read, title, folder, floor, panoramas, scale)))
    return sources


def _fail(error: PoseError) -> Scene:
    raise error


def _read(name: str, folder: Path, floor: str, panoramas: dict[str, _Panorama], scale: float | None) -> Scene:
    if scale is None:
        raise NoScaleError(
            f"{folder / POSES}: expected metres per coordinate of {floor}, got null; choose other floors"
        )
    ordered = sorted(panoramas.items(), key=_number)
    frames = [SceneFrame(key, folder / value.image_path, _pose(value, scale)) for key, value in ordered]
    return Scene(name, tuple(frames))


def _number(item: tuple[str, Any]) -> tuple[int, str]:
    """``pano_12`` comes after ``pano_2``."""
    digits = item[0].rpartition("_")[2]
    return (int(digits) if digits.isdecimal() else 0), item[0]


def _pose(panorama: _Panorama, scale: float) -> Pose:
    place = panorama.floor_plan_transformation
    x, y = place.translation
    height = panorama.camera_height * place.scale
    return Pose(rotation_from_heading(math.radians(place.rotation)), scale * np.array([-x, height, -y]))
