"""Tours of the Zillow Indoor Dataset (ZInD): ``TOUR/zind_data.json`` with ``TOUR/panos/*.jpg``.

What is assumed is said in :mod:`omnisyn_cli.io.pose_formats.zind`. There is no depth; a floor without
``scale_meters_per_coordinate`` has no scale and cannot be used.

Every complete room with two or more panoramas is one scene, its panoramas in the order of their numbers.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from omnisyn_cli.errors import PoseError
from omnisyn_cli.evaluation.datasets.scene import NoScaleError, Scene, SceneFrame, SceneSource
from omnisyn_cli.io.pose_formats.files import natural_key
from omnisyn_cli.io.pose_formats.zind import POSES, Panorama, pose_on_floor, read_tour
from omnisyn_cli.io.pose_models import validated

__all__ = ["find_scenes"]


def find_scenes(folder: Path) -> list[SceneSource]:
    """The rooms of all tours of a folder, or of a single tour; none where nothing has this layout."""
    if (folder / POSES).exists():
        return _rooms(folder.resolve().name, folder)
    tours = sorted(path.parent for path in folder.glob(f"*/{POSES}"))
    return [room for tour in tours for room in _rooms(tour.name, tour)]


def _rooms(name: str, folder: Path) -> list[SceneSource]:
    """Rooms with at least two panoramas; a damaged tour is one source that says so when it is read."""
    path = folder / POSES
    try:
        tour = read_tour(path)
        rooms = {
            (floor, room): {
                key: validated(path, Panorama, value, ("merger", floor, room, part, key))
                for part, panoramas in parts.items()
                for key, value in panoramas.items()
            }
            for floor, in_it in tour.merger.items()
            for room, parts in in_it.items()
        }
    except PoseError as error:
        return [SceneSource(name, partial(_fail, error))]
    sources = []
    for (floor, room), panoramas in rooms.items():
        if len(panoramas) > 1:
            title, scale = f"{name}/{floor}/{room}", tour.scale_meters_per_coordinate.get(floor)
            sources.append(SceneSource(title, partial(_read, title, folder, floor, panoramas, scale)))
    return sources


def _fail(error: PoseError) -> Scene:
    raise error


def _read(name: str, folder: Path, floor: str, panoramas: dict[str, Panorama], scale: float | None) -> Scene:
    if scale is None:
        raise NoScaleError(
            f"{folder / POSES}: expected metres per coordinate of {floor}, got null; choose other floors"
        )
    frames = tuple(
        SceneFrame(key, folder / panoramas[key].image_path, pose_on_floor(panoramas[key], scale))
        for key in sorted(panoramas, key=natural_key)
    )
    return Scene(name, frames)
