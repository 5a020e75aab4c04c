"""COLMAP text models: ``cameras.txt`` and ``images.txt``.

World-to-camera quaternions ``QW QX QY QZ`` and translations in OpenCV axes (x right, y down, z forward); a camera of
model ``EQUIRECTANGULAR`` (parameters w, h) sees a direction at ``x = (atan2(dx, dz) / 2π + ½)·w``,
``y = (½ − atan2(−dy, hypot(dx, dz)) / π)·h`` with pixel centres at ½: our panorama. The world has neither a scale nor a
fixed orientation; after most reconstructions y points down.

Source: COLMAP documentation, "Output Format"; ``src/colmap/sensor/models.h``.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, quaternion_from_rotation
from omnisyn_cli.io.documents import listed, read_text
from omnisyn_cli.poses.entries import checked_quaternion
from omnisyn_cli.poses.formats.files import data_lines, find_view, numbers
from omnisyn_cli.poses.formats.model import ImportedPoses, ImportOptions, foreign_from_pose, noted

IMAGES = "images.txt"

EQUIRECTANGULAR = "EQUIRECTANGULAR"

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
        if models.get(fields[8], EQUIRECTANGULAR) != EQUIRECTANGULAR:
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


def colmap_files(
    poses: Mapping[str, Pose], sizes: Mapping[str, tuple[int, int]], points: Sequence[str] = ()
) -> dict[str, str]:
    """``cameras.txt``, ``images.txt`` and ``points3D.txt`` by name.

    Args:
        poses: world-from-camera, by the names of the images.
        sizes: ``(height, width)``, likewise.
        points: ``X Y Z R G B`` of each, in COLMAP's world; they are seen in no image as far as the file says.
    """
    cameras = {size: number for number, size in enumerate(dict.fromkeys(sizes.values()), start=1)}
    camera_lines = [
        f"{number} EQUIRECTANGULAR {width} {height} {width} {height}" for (height, width), number in cameras.items()
    ]
    image_lines = [
        f"{number} {_numbers(_camera_from_world(pose))} {cameras[sizes[name]]} {name}\n"
        for number, (name, pose) in enumerate(poses.items(), start=1)
    ]
    return _model(camera_lines, image_lines, points)


def colmap_rig_files(
    poses: Mapping[str, Pose], faces: Mapping[str, Float[np.ndarray, "3 3"]], side: int, points: Sequence[str] = ()
) -> dict[str, str]:
    """A model of square pinhole cameras of 90° in one place, turned to the faces of a cube: COLMAP 3.12 and later.

    The five files of the model, and ``rig_config.json``. The image ``NAME`` of a face is called ``FACE/NAME``.

    Args:
        poses: world-from-camera of the panoramas, by the names that the images of all faces have.
        faces: by name, rig-from-face in COLMAP's camera axes; the first is the reference and unturned.
        side: rows and columns of a face.
        points: see :func:`colmap_files`.
    """
    rig_poses = {face: Pose(np.asarray(turn).T, np.zeros(3)) for face, turn in faces.items()}
    half = repr(side / 2)
    camera_lines = [f"{k} PINHOLE {side} {side} {half} {half} {half} {half}" for k in range(1, len(faces) + 1)]
    sensors = [f"CAMERA {k} 1 {_numbers(pose)}" for k, pose in enumerate(rig_poses.values(), start=1)][1:]
    image_lines, frame_lines = [], []
    for frame, (name, pose) in enumerate(poses.items(), start=1):
        rig_from_world, first = _camera_from_world(pose), (frame - 1) * len(faces) + 1
        data = " ".join(f"CAMERA {k + 1} {first + k}" for k in range(len(faces)))
        frame_lines.append(f"{frame} 1 {_numbers(rig_from_world)} {len(faces)} {data}")
        image_lines += [
            f"{first + k} {_numbers(face_from_rig @ rig_from_world)} {k + 1} {face}/{name}\n"
            for k, (face, face_from_rig) in enumerate(rig_poses.items())
        ]
    sensor = "SENSORS[TYPE SENSOR_ID HAS_POSE QW QX QY QZ TX TY TZ]"
    return {
        **_model(camera_lines, image_lines, points),
        "rigs.txt": _text(
            f"RIG_ID NUM_SENSORS REF_SENSOR_TYPE REF_SENSOR_ID {sensor}",
            [" ".join([f"1 {len(faces)} CAMERA 1", *sensors])],
        ),
        "frames.txt": _text(
            "FRAME_ID RIG_ID RIG_FROM_WORLD[QW QX QY QZ TX TY TZ] NUM_DATA_IDS DATA_IDS[SENSOR_TYPE SENSOR_ID DATA_ID]",
            frame_lines,
        ),
        "rig_config.json": json.dumps([{"cameras": [_in_rig(*item) for item in rig_poses.items()]}], indent=1) + "\n",
    }


def _in_rig(face: str, face_from_rig: Pose) -> dict[str, Any]:
    """A camera in the configuration of ``colmap rig_configurator``."""
    if np.array_equal(face_from_rig.rotation, np.eye(3)):
        return {"image_prefix": f"{face}/", "ref_sensor": True}
    turn = quaternion_from_rotation(face_from_rig.rotation).tolist()
    return {"image_prefix": f"{face}/", "cam_from_rig_rotation": turn, "cam_from_rig_translation": [0.0, 0.0, 0.0]}


def _model(cameras: list[str], images: list[str], points: Sequence[str]) -> dict[str, str]:
    """The three files of every model."""
    point_lines = [f"{number} {point} 0" for number, point in enumerate(points, start=1)]
    return {
        "cameras.txt": _text("CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]", cameras),
        IMAGES: _text(f"{HEADER}, then a line of POINTS2D[X Y POINT3D_ID] (none)", images),
        "points3D.txt": _text("POINT3D_ID X Y Z R G B ERROR TRACK[IMAGE_ID POINT2D_IDX] (none)", point_lines),
    }


def _camera_from_world(pose: Pose) -> Pose:
    return foreign_from_pose(pose, camera="opencv", up="-y").inverse()


def _numbers(pose: Pose) -> str:
    return " ".join(map(repr, [*quaternion_from_rotation(pose.rotation).tolist(), *pose.position.tolist()]))


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
