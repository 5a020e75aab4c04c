"""COLMAP text models: ``cameras.txt`` and ``images.txt``.

World-to-camera quaternions ``QW QX QY QZ`` and translations in OpenCV axes (x right, y down, z forward); a camera of
model ``EQUIRECTANGULAR`` (parameters w, h) sees a direction at ``x = (atan2(dx, dz) / 2π + ½)·w``,
``y = (½ − atan2(−dy, hypot(dx, dz)) / π)·h`` with pixel centres at ½: our panorama. The world has neither a scale nor a
fixed orientation; after most reconstructions y points down.

Source: COLMAP documentation, "Output Format"; ``src/colmap/sensor/models.h``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, quaternion_from_rotation
from omnisyn_cli.io.pose_formats.axes import checked_quaternion, foreign_from_pose, pose_from_foreign
from omnisyn_cli.io.pose_formats.files import find_image, listed
from omnisyn_cli.io.pose_formats.model import ImportedPoses, ImportedView, ImportOptions
from omnisyn_cli.io.pose_formats.text import data_lines, numbers, read_text

__all__ = ["colmap_files", "read_colmap"]

PANORAMIC = frozenset({"EQUIRECTANGULAR"})

HEADER = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"


def read_colmap(source: Path, options: ImportOptions) -> ImportedPoses:
    """Poses of the panoramas of a model: its folder, or its ``images.txt``.

    Raises:
        PoseError: no such files, a malformed line, or no panoramic camera.
    """
    folder = source if source.is_dir() else source.parent
    models = _camera_models(folder / "cameras.txt") if (folder / "cameras.txt").is_file() else {}
    up, camera = options.up or "-y", options.camera or "opencv"
    views, skipped = [], []
    above = (folder, folder.parent, folder.parent.parent)
    folders = [candidate for place in above for candidate in (place, place / "images")]
    path = folder / "images.txt"
    for number, line in _image_lines(path):
        where = f"{path}:{number}"
        fields = line.split(maxsplit=9)
        if len(fields) != 10:
            raise PoseError(f"{where}: expected {HEADER}, got {len(fields)} fields; correct the line")
        if models.get(fields[8], "EQUIRECTANGULAR") not in PANORAMIC:
            skipped.append(fields[9])
            continue
        name = fields[9].strip()
        pose = _pose(where, fields, camera, up)
        views.append(ImportedView(name, pose, find_image(where, name, folders, options)))
    if not views:
        raise PoseError(
            f"{path}: expected images of an EQUIRECTANGULAR camera, got {len(skipped)} of others and no panorama; "
            "only panoramas can be used"
        )
    return ImportedPoses(tuple(views), tuple(_notes(models, skipped, options)))


def colmap_files(poses: Mapping[str, Pose], sizes: Mapping[str, tuple[int, int]]) -> dict[str, str]:
    """``cameras.txt``, ``images.txt`` and an empty ``points3D.txt`` by name; sizes are ``(height, width)``."""
    cameras = {size: number for number, size in enumerate(dict.fromkeys(sizes.values()), start=1)}
    camera_lines = [
        f"{number} EQUIRECTANGULAR {width} {height} {width} {height}" for (height, width), number in cameras.items()
    ]
    image_lines = [
        f"{number} {_world_to_camera(pose)} {cameras[sizes[name]]} {name}\n"
        for number, (name, pose) in enumerate(poses.items(), start=1)
    ]
    return {
        "cameras.txt": _text("CAMERA_ID MODEL WIDTH HEIGHT PARAMS[w h]", camera_lines),
        "images.txt": _text(f"{HEADER}, then a line of POINTS2D[X Y POINT3D_ID] (none)", image_lines),
        "points3D.txt": _text("POINT3D_ID X Y Z R G B ERROR TRACK[IMAGE_ID POINT2D_IDX] (none)", []),
    }


def _pose(where: str, fields: Sequence[str], camera: str, up: str) -> Pose:
    values = numbers(where, fields[1:8], 7, "QW QX QY QZ TX TY TZ")
    world_to_camera = Pose(checked_quaternion(where, values[:4]), values[4:])
    inverse = world_to_camera.inverse()
    return pose_from_foreign(inverse.rotation, inverse.position, camera=camera, up=up)


def _world_to_camera(pose: Pose) -> str:
    rotation, position = foreign_from_pose(pose, camera="opencv", up="-y")
    inverse = Pose(rotation, position).inverse()
    return " ".join(map(repr, [*quaternion_from_rotation(inverse.rotation).tolist(), *inverse.position.tolist()]))


def _text(columns: str, lines: list[str]) -> str:
    return "\n".join([f"# {columns}", *lines]) + "\n"


def _camera_models(path: Path) -> dict[str, str]:
    models = {}
    for number, line in data_lines(path):
        fields = line.split()
        if len(fields) < 4:
            raise PoseError(f"{path}:{number}: expected CAMERA_ID MODEL WIDTH HEIGHT, got '{line:.60}'; correct it")
        models[fields[0]] = fields[1].upper()
    return models


def _image_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Number and text of the first line of every image; the second, its 2-D points, may be empty and is passed over."""
    lines = enumerate(read_text(path).splitlines(), start=1)
    for number, line in lines:
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        yield number, line.strip()
        follower, points = next(lines, (number + 1, ""))
        if len(points.split()) % 3:
            raise PoseError(
                f"{path}:{follower}: expected 2-D points in threes (X Y POINT3D_ID), or an empty line, after each "
                f"image, got {len(points.split())} fields; insert the line"
            )


def _notes(models: Mapping[str, str], skipped: list[str], options: ImportOptions) -> list[str]:
    notes = ["distances: COLMAP knows no scale, they are in its own units and taken as metres"]
    if options.up is None:
        notes.append("world: y is taken to point down, as after most reconstructions; --up says otherwise")
    if not models:
        notes.append("cameras: no cameras.txt, all images are taken as equirectangular panoramas")
    if skipped:
        notes.append(f"left out: {listed(skipped)}, whose cameras are not EQUIRECTANGULAR")
    return notes
