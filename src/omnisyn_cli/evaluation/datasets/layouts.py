"""Layouts of data sets: this program's own, renders of Habitat, tours of ZInD, and the authors' CARLA.

* Own: scene folders with ``poses.json`` (see :mod:`omnisyn_cli.poses.file`), which lists the panoramas in walking
  order, with their depth and masks.
* Habitat renders of Matterport3D and Replica as PanoGRF makes and PanSplat reads them:
  ``SCENE/NN/{rgb.png, depth.png, rot.txt, tran.txt}``, the views NN in the order of their names, see
  :mod:`omnisyn_cli.poses.formats.trajectories`. ``depth.png`` may be missing; it is 0 where the scan has a hole.
* Zillow Indoor Dataset: ``TOUR/zind_data.json`` with ``TOUR/panos/*.jpg``, see
  :mod:`omnisyn_cli.poses.formats.json_files`. Every complete room with two or more panoramas is one scene, its
  panoramas in the order of their numbers. There is no depth; a floor without ``scale_meters_per_coordinate`` has no
  scale and cannot be used.
* Tours of photographs, which are data sets when it is asked for: each photograph is the truth between its neighbours.
* The CARLA data that the authors of OmniSyn published: ``Town*/run/{rgb,depth}/FRAME.png`` with ``gnss_data.json``,
  see :func:`carla_scenes`. Frames without both pictures are left out, as the authors do. Every run is one scene.

A single scene or tour is a data set of one.
"""

import hashlib
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Never

import numpy as np
from jaxtyping import Float

from omnisyn_cli.errors import InputError, PoseError
from omnisyn_cli.evaluation.datasets.sources import (
    NoScaleError,
    PairChooser,
    Scene,
    SceneFrame,
    SceneSource,
    scene_folders,
)
from omnisyn_cli.geometry.pose import Pose, enu_from_geographic, rotation_from_heading
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.io import read_inverse_depth, read_panorama
from omnisyn_cli.io.documents import ForeignModel, read_json, validated
from omnisyn_cli.io.outputs import make_folder, real_path
from omnisyn_cli.io.placement import Reading
from omnisyn_cli.poses.estimation import PictureOptions, estimate_poses
from omnisyn_cli.poses.file import POSES_NAME, read_poses, write_poses
from omnisyn_cli.poses.formats.files import natural_key
from omnisyn_cli.poses.formats.json_files import ZIND_FILE_NAME, Panorama, pose_on_floor, read_tour
from omnisyn_cli.poses.formats.trajectories import habitat_pose
from omnisyn_cli.runtime.models import sha256_of
from omnisyn_cli.synthesis.still_outlines import PICTURE_SIZE, find_still_region, spread_out
from omnisyn_cli.types import View

HABITAT_POSITION = "*/tran.txt"  # the file of a panorama's position in data sets rendered by Habitat
# JPEG files, in the order of their names, are a tour where no pose file names its panoramas.
PHOTOGRAPHS = "*.[jJ][pP]*[gG]"


def own_scenes(folder: Path, *, allow_outside: bool = False) -> list[SceneSource]:
    """The scenes of a folder in this layout, by name; ``allow_outside``: their depth and masks may lie elsewhere."""
    return [
        SceneSource(name, partial(_own_frames, scene, allow_outside))
        for name, scene in scene_folders(folder, POSES_NAME)
    ]


def _own_frames(folder: Path, allow_outside: bool) -> Iterator[SceneFrame]:
    for image, panorama in read_poses(folder / POSES_NAME, allow_outside=allow_outside).panoramas.items():
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
    return [room for name, tour in scene_folders(folder, ZIND_FILE_NAME) for room in _rooms(name, tour)]


def _rooms(name: str, folder: Path) -> list[SceneSource]:
    """Rooms with at least two panoramas; a damaged tour is one source that says so when it is read."""
    path = folder / ZIND_FILE_NAME
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
        path = folder / ZIND_FILE_NAME
        raise NoScaleError(f"{path}: expected metres per coordinate of {floor}, got null; choose other floors")
    for key in sorted(panoramas, key=natural_key):
        yield SceneFrame(key, folder / panoramas[key].image_path, pose_on_floor(panoramas[key], scale))


RUN_POSES = "gnss_data.json"  # positions of a run in the authors' CARLA data
LENGTH_TOLERANCE = 0.05  # relative difference of two measures of one length that is put down to the shape of the earth
MAX_PNG_DEPTH = 65.535  # metres; the largest number that the files can hold


class _Location(ForeignModel):
    x: float
    y: float
    z: float


class _Rotation(ForeignModel):
    pitch: float
    yaw: float
    roll: float


class _Entry(ForeignModel):
    frame: int
    location: _Location
    rotation: _Rotation
    latitude: float | None = None
    longitude: float | None = None


class _Run(ForeignModel):
    frames: list[_Entry]


def carla_scenes(folder: Path) -> list[SceneSource]:
    """The runs of all towns of a folder, of one town, or a single run; none where nothing has this layout.

    What is assumed (from the authors' ``data_readers/carla_reader.py``, AugmentariumLab/omnisyn):

    * ``gnss_data.json`` lists the frames of a run in the order of driving: ``frame`` (the number in the file names),
      ``location`` (x, y, z) and ``rotation`` (pitch, yaw, roll in degrees) of Unreal's left-handed world: x forward,
      y right, z up, yaw clockwise seen from above, pitch up, roll clockwise. ``latitude`` and ``longitude`` (degrees)
      are there as well.
    * Here the position is ``(y, z, −x)``. Directions come from the locations, lengths from the geographic positions, as
      the authors take them, where both differ by more than :data:`LENGTH_TOLERANCE`: then locations are not in
      metres. Where they agree, the locations are kept, which are exact.
    * The image centre looks along the car.
    * ``depth`` is a 16-bit PNG in millimetres, in equirectangular pixels, but *along the axis of the cube face* that
      each pixel was rendered on (``use_euclidean_dist`` of the authors' reader): the Euclidean distance is that value
      over the largest component of the pixel's direction. Zero and 65535 mean that nothing is there or it is farther.
    """
    pattern = next((p for p in (RUN_POSES, f"*/{RUN_POSES}", f"*/*/{RUN_POSES}") if any(folder.glob(p))), RUN_POSES)
    runs = sorted(path.parent for path in folder.glob(pattern))
    names = [run.relative_to(folder).as_posix() if run != folder else real_path(folder).name for run in runs]
    return [SceneSource(name, partial(_frames, run)) for name, run in zip(names, runs, strict=True)]


def _frames(run: Path) -> Iterator[SceneFrame]:
    listed = validated(run / RUN_POSES, _Run, {"frames": read_json(run / RUN_POSES)}).frames
    entries = [entry for entry in listed if all(path.is_file() for path in _files(run, entry))]
    locations = [[entry.location.y, entry.location.z, -entry.location.x] for entry in entries]
    positions = _scaled(np.array(locations).reshape(-1, 3), entries)
    for entry, position in zip(entries, positions, strict=True):
        turn = entry.rotation
        rotation = rotation_from_heading(*map(math.radians, (turn.yaw, turn.pitch, turn.roll)))
        image, depth = _files(run, entry)
        yield SceneFrame(image.name, image, Pose(rotation, position), depth, None, read_face_depth)


def _files(run: Path, entry: _Entry) -> tuple[Path, Path]:
    return run / "rgb" / f"{entry.frame}.png", run / "depth" / f"{entry.frame}.png"


def _scaled(positions: np.ndarray, entries: list[_Entry]) -> Float[np.ndarray, "frames 3"]:
    """Locations in metres; see :func:`carla_scenes`."""
    places = [(e.latitude, e.longitude) for e in entries if e.latitude is not None and e.longitude is not None]
    if not entries or len(places) != len(entries):
        return positions
    origin = (*places[0], 0.0)
    there = np.array([enu_from_geographic(*place, 0.0, origin) for place in places])
    offsets = positions - positions[0]
    farthest = int(np.argmax(np.linalg.norm(offsets, axis=1)))
    length, geographic = np.linalg.norm(offsets[farthest]), np.linalg.norm(there[farthest])
    if length == 0 or geographic == 0 or abs(geographic / length - 1) < LENGTH_TOLERANCE:
        return positions
    return np.asarray(positions[0] + offsets * (geographic / length))


def read_face_depth(path: Path) -> Float[np.ndarray, "height width"]:
    """Inverse Euclidean distance of depth along the axes of cube faces, see :func:`carla_scenes`."""
    inverse = read_inverse_depth(path)
    along_axis = np.abs(pixel_directions(*inverse.shape)).max(axis=-1)
    is_known = inverse > 1.0 / (MAX_PNG_DEPTH - 5e-4)
    return np.where(is_known, inverse * along_axis, 0.0).astype(np.float32)


def tours_of_photographs(
    folder: Path, choose: PairChooser, report: Path, threads: int | None = None, *, allow_outside: bool = False
) -> list[SceneSource]:
    """A scene for each pair that is chosen, with its photographs between; all of a folder, or of the folders in it.

    Without ``poses.json`` poses are estimated, in an unknown unit, and kept in the folder of the ``report``.
    InputError: none, a damaged file, or an absent pair.
    """
    scenes = []
    places = {place: name for each in (POSES_NAME, PHOTOGRAPHS) for name, place in scene_folders(folder, each)}
    for place, name in places.items():
        is_posed = (place / POSES_NAME).is_file()
        if is_posed:
            found = own_scenes(place, allow_outside=allow_outside)[0].frames()
        else:
            files = sorted(place.glob(PHOTOGRAPHS), key=lambda path: natural_key(path.name))
            found = (SceneFrame(path.name, path, Pose.identity()) for path in files)  # no poses are known yet
        for pair in choose(Scene(name, tuple(found))):
            frames = (pair.first, *pair.between, pair.second)
            read = partial(tuple, frames) if is_posed else partial(_located, frames, report, threads)
            scenes.append(SceneSource(f"{name}: {frames[0].image.stem} to {frames[-1].image.stem}", read))
    if not scenes:
        raise InputError(f"{folder}: expected three photographs (JPEG) of a tour or more, got fewer; check the folder")
    return scenes


def still_region_of(folder: Path) -> np.ndarray | None:
    """What moves with the camera in all photographs of a folder, see :mod:`omnisyn_cli.synthesis.still_outlines`."""
    paths, reading = sorted(folder.glob(PHOTOGRAPHS)), Reading(size=PICTURE_SIZE)
    read = (read_panorama(paths[index], reading=reading) for index in spread_out(len(paths)))
    return find_still_region(View(picture.image, Pose.identity(), picture.mask) for picture in read)


def _located(frames: Sequence[SceneFrame], report: Path, threads: int | None) -> Iterator[SceneFrame]:
    """The frames with the poses that all of them together give, or gave when these pictures were asked about before."""
    digest = hashlib.sha256("".join(sha256_of(frame.image) for frame in frames).encode()).hexdigest()
    kept = report / f"poses-{digest[:16]}.json"
    if not kept.is_file():
        found = estimate_poses([frame.image for frame in frames], options=PictureOptions(threads=threads))
        make_folder(report, "the report")
        write_poses(kept, found.panoramas, is_metric=False)
    panoramas = read_poses(kept).panoramas
    for frame in (frame for frame in frames if frame.name in panoramas):  # one of each place
        yield replace(frame, pose=panoramas[frame.name].pose)
