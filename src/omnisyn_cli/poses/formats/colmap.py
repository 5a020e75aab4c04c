"""COLMAP models: poses of panoramas, and of rigs of virtual pinhole cameras that were cut out of panoramas.

World-to-camera quaternions ``QW QX QY QZ`` and translations in OpenCV axes (x right, y down, z forward); a camera of
model ``EQUIRECTANGULAR`` (parameters w, h) sees a direction at ``x = (atan2(dx, dz) / 2π + ½)·w``,
``y = (½ − atan2(−dy, hypot(dx, dz)) / π)·h`` with pixel centres at ½: our panorama. The world has neither a scale nor a
fixed orientation; after most reconstructions y points down.

``panorama_sfm.py``, which comes with COLMAP, cuts every panorama into faces without roll, the images ``PREFIX/NAME`` of
a rig in one place. The first is the rig's reference and looks at the column of the panorama's centre, up or down.

Source: COLMAP documentation, "Output Format"; ``src/colmap/sensor/models.h``; ``python/examples/panorama_sfm.py``.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, quaternion_from_rotation
from omnisyn_cli.io.documents import listed
from omnisyn_cli.poses.formats.colmap_model import HEADER, IMAGES, Model, read_model
from omnisyn_cli.poses.formats.files import ImportedPoses, ImportOptions, find_view, foreign_from_pose, noted

# Sine of the angle by which the faces of a panorama may roll: they are cut without any, and written exactly.
MAX_LEVEL_ERROR = 1e-3
# Second singular value of the faces' x axes, for one face; less, and they do not tell which way is up.
MIN_AXES_SPREAD = 0.1


def read_colmap(source: Path, options: ImportOptions) -> ImportedPoses:
    """Poses of the panoramas of a model: its folder, or one of its files."""
    model = read_model(source)
    panoramas = [image for image in model.images.values() if model.is_panorama(image)]
    posed = [(image.where, image.name, image.camera_from_world) for image in panoramas]
    whole = list(_cut_panoramas(model))
    folders = [folder for place in [*model.path.parents][:3] for folder in (place, place / "images")]
    views = [
        find_view(where, name, options.pose(pose.inverse(), camera="opencv", up="-y"), folders, options)
        for where, name, pose in (*posed, *whole)
    ]
    faces = {name for _, name, _ in whole}
    others = [image.name for image in model.images.values() if not model.is_panorama(image)]
    skipped = [name for name in others if name.partition("/")[2] not in faces]
    if not views:
        raise PoseError(
            f"{model.path}: expected images of an EQUIRECTANGULAR camera or of a rig cut from panoramas, got "
            f"{len(skipped)} of others and no panorama; only panoramas can be used"
        )
    notes = {
        "distances: COLMAP knows no scale, they are in its own units and taken as metres": True,
        "world: y is taken to point down, as after most reconstructions; --up says otherwise": options.up is None,
        "cameras: no cameras.txt, all images are taken as equirectangular panoramas": not model.models,
        f"panoramas: {len(whole)} put together from the faces of a rig, whose first camera is taken to look at the "
        "column of their centres": whole,
        f"left out: {listed(skipped)}, whose cameras are not EQUIRECTANGULAR": skipped,
    }
    return ImportedPoses(tuple(views), noted(notes), is_metric=False)


def _cut_panoramas(model: Model) -> Iterator[tuple[str, str, Pose]]:
    """Where it is written, name and panorama-from-world of every panorama that a rig's images were cut from."""
    for frame in model.frames.values():
        images = [model.images[number] for number in frame.images if number in model.images]
        if not images or any(model.is_panorama(image) for image in images) or frame.rig not in model.rigs:
            continue
        names = {image.name.partition("/")[2] for image in images}
        panorama_from_rig = _panorama_from_rig(model.rigs[frame.rig])
        if panorama_from_rig is not None and len(names) == 1 and "" not in names:
            yield images[0].where, names.pop(), panorama_from_rig @ frame.rig_from_world


def _panorama_from_rig(rig: Mapping[int, Pose]) -> Pose | None:
    """The turn from the reference to the panorama; None where cameras roll, stand apart, or do not tell what is up."""
    turns = np.stack([pose.rotation for pose in rig.values()])
    offsets = np.stack([pose.position for pose in rig.values()])
    _, spread, axes = np.linalg.svd(turns[:, 0])  # x axes, level without roll: the vertical is orthogonal to all
    is_level = len(turns) > 1 and spread[1] > MIN_AXES_SPREAD and (len(spread) < 3 or spread[2] < MAX_LEVEL_ERROR)
    if not is_level or offsets.any():
        return None
    down = axes[2] * np.sign(axes[2] @ turns[:, 1].sum(axis=0))
    right = np.cross(down, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return Pose(np.stack([right, down, np.cross(right, down)]), np.zeros(3))


def colmap_files(
    poses: Mapping[str, Pose], sizes: Mapping[str, tuple[int, int]], points: Sequence[str] = ()
) -> dict[str, str]:
    """``cameras.txt``, ``images.txt`` and ``points3D.txt`` by name.

    World-from-camera poses and sizes ``(height, width)`` are by image, points ``X Y Z R G B`` in COLMAP's world.
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

    The five files of the model, and ``rig_config.json``. The image ``NAME`` of a face is called ``FACE/NAME``, and has
    as many rows as its ``side``. Poses are world-from-camera, faces rig-from-face in COLMAP's camera axes; the first is
    the reference and unturned. Points: see :func:`colmap_files`.
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
    rig_line = " ".join([f"1 {len(faces)} CAMERA 1", *sensors])
    of_frame = "NUM_DATA_IDS DATA_IDS[SENSOR_TYPE SENSOR_ID DATA_ID]"
    sensor = "SENSORS[TYPE SENSOR_ID HAS_POSE QW QX QY QZ TX TY TZ]"
    return {
        **_model(camera_lines, image_lines, points),
        "rigs.txt": _text(f"RIG_ID NUM_SENSORS REF_SENSOR_TYPE REF_SENSOR_ID {sensor}", [rig_line]),
        "frames.txt": _text(f"FRAME_ID RIG_ID RIG_FROM_WORLD[QW QX QY QZ TX TY TZ] {of_frame}", frame_lines),
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
