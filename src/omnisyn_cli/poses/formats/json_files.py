"""Formats of one JSON file: nerfstudio's, OpenSfM's, and that of the Zillow Indoor Dataset (ZInD).

nerfstudio's ``transforms.json`` has camera-to-world matrices in OpenGL axes, which are ours, in a world with z up. An
``EQUIRECTANGULAR`` camera with ``fl_x = fl_y = h = w / 2`` sees at normalised image coordinates ``(x, y)``, x from −1
to 1 and y from −½ (bottom) to ½, the direction ``(sin πx · sin φ, cos φ, −cos πx · sin φ)``, ``φ = π (½ − y)``.
``applied_transform`` says how the file's world was made from that of its own source; poses are taken as the file has
them, but for a scale in it (or in ``applied_scale``), which is undone.

OpenSfM's ``reconstruction.json`` has world-to-camera angle-axis rotations and translations. Cameras look along z with y
down (OpenCV axes); a ``spherical`` (formerly ``equirectangular``) camera sees a direction at ``u = atan2(x, z) / 2π``,
``v = −atan2(−y, hypot(x, z)) / 2π``, in units of the image's width from its centre. The world has x east, y north, z up
at ``reference_lla``, in metres where the images had GPS.

ZInD's ``zind_data.json`` has a 2-D similarity per panorama, ``floor_plan_transformation``, which takes coordinates of
its room to those of the floor: ``global = scale · [[cos r, −sin r], [sin r, cos r]] · local + translation`` with r in
degrees. A point ``(x, y, z)`` of the room, z up, appears at azimuth ``atan2(−x, y)`` right of the panorama's centre: y
is ahead and x is to the left, so these coordinates are left-handed and x is negated here. Camera heights are 1 in the
room's units; ``scale_meters_per_coordinate`` of the floor makes metres of the floor's units. Panoramas are level.

Source: nerfstudio documentation, "Data conventions"; ``nerfstudio/cameras/cameras.py``; OpenSfM documentation,
"Geometric Models" and "Reconstruction file format"; ZInD, ``data_organization.md``; ``code/transformations.py``.
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, rotation_from_heading, rotation_from_rotation_vector
from omnisyn_cli.io.documents import ForeignModel, listed, read_json, validated
from omnisyn_cli.io.outputs import relative_name
from omnisyn_cli.poses.entries import checked_rotation
from omnisyn_cli.poses.formats.files import ImportedPoses, ImportOptions, find_view, foreign_from_pose, noted
from omnisyn_cli.poses.formats.geographic import local_world, origin_note

Row = Annotated[list[float], Field(min_length=4, max_length=4)]
Matrix = Annotated[list[Row], Field(min_length=3, max_length=4)]
EQUIRECTANGULAR = "EQUIRECTANGULAR"


class Frame(ForeignModel):
    """One image."""

    file_path: Annotated[str, Field(min_length=1)]
    transform_matrix: Matrix
    camera_model: str | None = None


class Transforms(ForeignModel):
    """The file."""

    frames: Annotated[list[Frame], Field(min_length=1)]
    camera_model: str | None = None
    applied_transform: Matrix | None = None
    applied_scale: Annotated[float, Field(gt=0)] = 1.0


def read_nerfstudio(source: Path, options: ImportOptions) -> ImportedPoses:
    """Poses of the panoramas of a ``transforms.json``, or of its folder."""
    path = source / "transforms.json" if source.is_dir() else source
    document = validated(path, Transforms, read_json(path))
    scale = document.applied_scale * _scale_of(path, document.applied_transform)
    views, skipped, undeclared, is_scaled = [], [], False, abs(scale - 1.0) > 1e-9
    for index, frame in enumerate(document.frames):
        model = frame.camera_model or document.camera_model
        undeclared |= model is None
        if model is not None and model.upper() != EQUIRECTANGULAR:
            skipped.append(frame.file_path)
            continue
        where = f"{path}: frames[{index}]"
        matrix = np.array(frame.transform_matrix)
        if len(matrix) == 4 and np.abs(matrix[3] - (0, 0, 0, 1)).max() > 1e-6:
            raise PoseError(f"{where}: expected a last row [0, 0, 0, 1], got {matrix[3].tolist()}; transpose it")
        rotation = checked_rotation(f"{where}.transform_matrix", matrix[:3, :3])
        with np.errstate(over="ignore"):
            position = matrix[:3, 3] / scale
        if not np.isfinite(position).all():
            raise PoseError(f"{where}: expected a finite position, got {position.tolist()}; check applied_scale")
        pose = options.pose(Pose(rotation, position), camera="opengl", up="z")
        name = frame.file_path.removeprefix("./")
        views.append(find_view(where, name, pose, [path.parent], options))
    if not views:
        raise PoseError(
            f"{path}: expected frames with camera_model EQUIRECTANGULAR, got {len(skipped)} of others; "
            "only panoramas can be used"
        )
    notes = {
        "distances: nerfstudio promises no scale, they are taken as metres": True,
        "world: applied_transform is kept: z of the file's world is up": document.applied_transform is not None,
        f"distances: divided by the applied scale {scale:.6g}, back to those of the file's own source": is_scaled,
        "cameras: no camera_model, images are taken as equirectangular panoramas": undeclared,
        f"left out: {listed(skipped)}, whose camera_model is not EQUIRECTANGULAR": skipped,
    }
    return ImportedPoses(tuple(views), noted(notes), is_metric=False)


def nerfstudio_text(
    poses: Mapping[str, Pose], sizes: Mapping[str, tuple[int, int]], images: Mapping[str, Path | None], folder: Path,
    companions: Mapping[str, Mapping[str, str]] = MappingProxyType({}),
    shared: Mapping[str, Any] = MappingProxyType({}),
) -> str:  # fmt: skip
    """The file's text; paths of images are written relative to ``folder``, sizes are ``(height, width)``.

    ``companions`` are further keys of frames (depth, masks), ``shared`` further keys of the file.
    """
    frames = [
        _frame(name, pose, sizes[name], images[name], folder) | dict(companions.get(name, {}))
        for name, pose in poses.items()
    ]
    lines = ",\n".join(f"  {json.dumps(frame, ensure_ascii=False)}" for frame in frames)
    head = json.dumps({"camera_model": EQUIRECTANGULAR, "orientation_override": "none", **shared}, ensure_ascii=False)
    return f'{head[:-1]}, "frames": [\n{lines}\n]}}\n'


def _frame(name: str, pose: Pose, size: tuple[int, int], image: Path | None, folder: Path) -> dict[str, Any]:
    foreign = foreign_from_pose(pose, camera="opengl", up="z")
    matrix = np.vstack([np.column_stack([foreign.rotation, foreign.position]), [0.0, 0.0, 0.0, 1.0]])
    file = name if image is None else relative_name(image, folder)
    height, width = size
    intrinsics = {"w": width, "h": height, "fl_x": width / 2, "fl_y": height, "cx": width / 2, "cy": height / 2}
    return {"file_path": file, **intrinsics, "transform_matrix": matrix.tolist()}


def _scale_of(path: Path, transform: list[Row] | None) -> float:
    """The scale of a similarity: the cube root of its determinant."""
    if transform is None:
        return 1.0
    linear = np.array(transform)[:3, :3]
    determinant = float(np.linalg.det(linear))
    if not determinant > 0:
        raise PoseError(f"{path}: applied_transform: expected a scaled rotation, got determinant {determinant:.3g}")
    scale = float(np.cbrt(determinant))
    checked_rotation(f"{path}: applied_transform", linear / scale)
    return scale


SPHERICAL_PROJECTIONS = frozenset({"spherical", "equirectangular"})
MAX_ABSOLUTE = 1e9  # Radians or metres; more is a mistake, and its square might overflow

Vector = Annotated[list[Annotated[float, Field(ge=-MAX_ABSOLUTE, le=MAX_ABSOLUTE)]], Field(min_length=3, max_length=3)]


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
    return ImportedPoses(tuple(views), noted(notes), is_metric=is_on_earth)


def _is_panorama(path: Path, name: str, shot: Shot, reconstruction: Reconstruction) -> bool:
    if shot.camera not in reconstruction.cameras:
        raise PoseError(
            f"{path}: shots.'{name}'.camera: expected one of the cameras {listed(list(reconstruction.cameras))}, "
            f"got '{shot.camera}'; correct it"
        )
    return reconstruction.cameras[shot.camera].projection_type.lower() in SPHERICAL_PROJECTIONS


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
    """The mirrored similarity, ``metres`` per unit: (x, y) there is (−x, −z) here, counter-clockwise is clockwise."""
    similarity = panorama.floor_plan_transformation
    x, y = similarity.translation
    height = panorama.camera_height * similarity.scale
    rotation = rotation_from_heading(math.radians(similarity.rotation))
    return Pose(rotation, np.array([metres * -x, metres * height, metres * -y]))


def read_zind(source: Path, options: ImportOptions) -> ImportedPoses:
    """Poses of one floor of a ``zind_data.json``, or of its folder; y counts from the floor, x and z span its plan."""
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
    return ImportedPoses(views, (f"floor: {floor}", distances, heights), is_metric=bool(metres))


def _floor(path: Path, tour: Tour, options: ImportOptions) -> str:
    """The floor that was asked for, or the only one."""
    floors = list(tour.merger)
    if options.floor is None and len(floors) == 1:
        return floors[0]
    if options.floor not in floors:
        wanted = f"the floor '{options.floor}'" if options.floor else "one floor"
        raise PoseError(f"{path}: expected {wanted}, got {listed(floors)}; choose with --floor")
    return options.floor
