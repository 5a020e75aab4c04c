"""Layouts that need no more than a reader of poses: this program's own, renders of Habitat, and tours of ZInD.

* Own: scene folders with ``poses.json`` (see :mod:`omnisyn_cli.poses.file`), which lists the panoramas in walking
  order, with their depth and masks.
* Habitat renders of Matterport3D and Replica as PanoGRF makes and PanSplat reads them:
  ``SCENE/NN/{rgb.png, depth.png, rot.txt, tran.txt}``, the views NN in the order of their names, see
  :mod:`omnisyn_cli.poses.formats.habitat`. ``depth.png`` may be missing; it is 0 where the scan has a hole.
* Zillow Indoor Dataset: ``TOUR/zind_data.json`` with ``TOUR/panos/*.jpg``, see
  :mod:`omnisyn_cli.poses.formats.zind`. Every complete room with two or more panoramas is one scene, its panoramas in
  the order of their numbers. There is no depth; a floor without ``scale_meters_per_coordinate`` has no scale and cannot
  be used.

A single scene or tour is a data set of one.
"""

from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Never

from omnisyn_cli.errors import PoseError
from omnisyn_cli.evaluation.datasets.sources import NoScaleError, SceneFrame, SceneSource, scene_folders
from omnisyn_cli.io.documents import validated
from omnisyn_cli.poses.file import read_poses
from omnisyn_cli.poses.formats.files import natural_key
from omnisyn_cli.poses.formats.habitat import habitat_pose
from omnisyn_cli.poses.formats.zind import POSES as TOUR
from omnisyn_cli.poses.formats.zind import Panorama, pose_on_floor, read_tour

POSES = "poses.json"

HABITAT_POSITION = "*/tran.txt"


def own_scenes(folder: Path, *, allow_outside: bool = False) -> list[SceneSource]:
    """The scenes of a folder, by name; none where nothing has this layout.

    Args:
        folder: of scenes, or a single scene.
        allow_outside: whether depth and masks of a scene may lie outside of its folder.
    """
    return [
        SceneSource(name, partial(_own_frames, scene, allow_outside)) for name, scene in scene_folders(folder, POSES)
    ]


def _own_frames(folder: Path, allow_outside: bool) -> Iterator[SceneFrame]:
    for image, panorama in read_poses(folder / POSES, allow_outside=allow_outside).panoramas.items():
        yield SceneFrame(image, folder / image, panorama.pose, panorama.depth, panorama.mask)


def habitat_scenes(folder: Path) -> list[SceneSource]:
    """The scenes of a folder, or the folder itself as one scene; none where nothing has this layout."""
    return [
        SceneSource(name, partial(_habitat_frames, scene)) for name, scene in scene_folders(folder, HABITAT_POSITION)
    ]


def _habitat_frames(folder: Path) -> Iterator[SceneFrame]:
    for view in sorted(path.parent for path in folder.glob(HABITAT_POSITION)):
        depth = view / "depth.png"
        known = depth if depth.is_file() else None
        yield SceneFrame(view.name, view / "rgb.png", habitat_pose(view), known, has_holes=True)


def zind_scenes(folder: Path) -> list[SceneSource]:
    """The rooms of all tours of a folder, or of a single tour; none where nothing has this layout."""
    return [room for name, tour in scene_folders(folder, TOUR) for room in _rooms(name, tour)]


def _rooms(name: str, folder: Path) -> list[SceneSource]:
    """Rooms with at least two panoramas; a damaged tour is one source that says so when it is read."""
    path = folder / TOUR
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
    return [
        SceneSource(
            f"{name}/{floor}/{room}",
            partial(_room_frames, folder, floor, panoramas, tour.scale_meters_per_coordinate.get(floor)),
        )
        for (floor, room), panoramas in rooms.items()
        if len(panoramas) > 1
    ]


def _fail(error: PoseError) -> Never:
    raise error


def _room_frames(folder: Path, floor: str, panoramas: dict[str, Panorama], scale: float | None) -> Iterable[SceneFrame]:
    if scale is None:
        raise NoScaleError(f"{folder / TOUR}: expected metres per coordinate of {floor}, got null; choose other floors")
    for key in sorted(panoramas, key=natural_key):
        yield SceneFrame(key, folder / panoramas[key].image_path, pose_on_floor(panoramas[key], scale))
