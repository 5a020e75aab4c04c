"""COLMAP text models: ``cameras.txt`` and ``images.txt``.

World-to-camera quaternions ``QW QX QY QZ`` and translations in OpenCV axes (x right, y down, z forward); a camera of
model ``EQUIRECTANGULAR`` (parameters w, h) sees a direction at ``x = (atan2(dx, dz) / 2π + ½)·w``,
``y = (½ − atan2(−dy, hypot(dx, dz)) / π)·h`` with pixel centres at ½: our panorama. The world has neither a scale nor a
fixed orientation; after most reconstructions y points down.

Source: COLMAP documentation, "Output Format"; ``src/colmap/sensor/models.h``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, quaternion_from_rotation
from omnisyn_cli.io.documents import listed, read_text
from omnisyn_cli.poses.entries import checked_quaternion
from omnisyn_cli.poses.formats.files import data_lines, find_view, numbers
from omnisyn_cli.poses.formats.model import ImportedPoses, ImportOptions, foreign_from_pose, noted

__all__ = ["IMAGES", "colmap_files", "model_folder", "read_colmap"]

IMAGES = "images.txt"

PANORAMIC = "EQUIRECTANGULAR"

HEADER = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"


def model_folder(source: Path, images: str = IMAGES) -> Path:
    """The folder of a model inside ``source``: itself, or the usual ``sparse/0`` and ``sparse``."""
    candidates = [source, source / "sparse" / "0", source / "sparse"]
    return next((path for path in candidates if (path / images).is_file()), source)


def read_colmap(source: Path, options: ImportOptions) -> ImportedPoses:
    """Poses of the panoramas of a model: its folder, or its ``images.txt``."""
    folder = model_folder(source) if source.is_dir() else source.parent
    models = _camera_models(folder / "cameras.txt") if (folder / "cameras.txt").is_file() else {}
    views, skipped = [], []
    above = (folder, folder.parent, folder.parent.parent)
    folders = [candidate for place in above for candidate in (place, place / "images")]
    path = folder / IMAGES
    for number, line in _image_lines(path):
        where = f"{path}:{number}"
        fields = line.split(maxsplit=9)
        if len(fields) != 10:
            raise PoseError(f"{where}: expected {HEADER}, got {len(fields)} fields; correct the line")
        if models.get(fields[8], PANORAMIC) != PANORAMIC:
            skipped.append(fields[9])
            continue
        name = fields[9].strip()
        values = numbers(where, fields[1:8], 7, "QW QX QY QZ TX TY TZ")
        world_to_camera = Pose(checked_quaternion(where, values[:4]), values[4:])
        pose = options.pose(world_to_camera.inverse(), camera="opencv", up="-y")
        views.append(find_view(where, name, pose, folders, options))
    if not views:
        raise PoseError(
            f"{path}: expected images of an EQUIRECTANGULAR camera, got {len(skipped)} of others and no panorama; "
            "only panoramas can be used"
        )
    notes = {
        "distances: COLMAP knows no scale, they are in its own units and taken as metres": True,
        "world: y is taken to point down, as after most reconstructions; --up says otherwise": options.up is None,
        "cameras: no cameras.txt, all images are taken as equirectangular panoramas": not models,
        f"left out: {listed(skipped)}, whose cameras are not EQUIRECTANGULAR": skipped,
    }
    return ImportedPoses(tuple(views), noted(notes))


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
        IMAGES: _text(f"{HEADER}, then a line of POINTS2D[X Y POINT3D_ID] (none)", image_lines),
        "points3D.txt": _text("POINT3D_ID X Y Z R G B ERROR TRACK[IMAGE_ID POINT2D_IDX] (none)", []),
    }


def _world_to_camera(pose: Pose) -> str:
    inverse = foreign_from_pose(pose, camera="opencv", up="-y").inverse()
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
