"""A rendered room written in the layouts that data sets have, and a check by warping one view into another."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.geometry.sampling import sample_bilinear, sample_nearest
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.io import write_depth, write_image
from omnisyn_cli.poses.file import PosedPanorama, write_poses
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path
from synthesis_samples import as_bytes

SIZE = (64, 128)
HEADINGS = (0.0, 0.5, 2.0)
METRES_PER_DEGREE = 111_320.0


@dataclass(frozen=True)
class Shot:
    """One panorama of the room: what it shows, how far that is, and where it was taken."""

    image: np.ndarray
    depth: np.ndarray
    pose: Pose


@lru_cache
def shots(pitch: float = 0.0) -> tuple[Shot, ...]:
    """Three panoramas along 0.8 m, facing different ways."""
    scene = generate_scene("room", 3)
    made = []
    for heading, place in zip(HEADINGS, sample_path(scene, 3, len(HEADINGS), baseline=0.8, vertical=0.0), strict=True):
        pose = Pose(rotation_from_heading(heading, pitch * heading, -pitch * heading), place.position)
        made.append(Shot(*render_panorama(scene, pose, SIZE, supersample=2, threads=1), pose))
    return tuple(made)


def write_millimetres(path: Path, depth: np.ndarray) -> None:
    cv2.imwrite(str(path), np.rint(np.minimum(np.where(np.isinf(depth), 0, depth) * 1000, 65535)).astype(np.uint16))


def write_own(folder: Path, taken: Sequence[Shot]) -> None:
    folder.mkdir()
    entries = {}
    for index, shot in enumerate(taken):
        write_image(folder / f"{index}.png", as_bytes(shot.image))
        write_depth(folder / f"{index}.exr", shot.depth)
        entries[f"{index}.png"] = PosedPanorama(shot.pose, folder / f"{index}.exr")
    write_poses(folder / "poses.json", entries)


def write_habitat(folder: Path, taken: Sequence[Shot]) -> None:
    for index, shot in enumerate(taken):
        view = folder / f"{index:02d}"
        view.mkdir(parents=True)
        write_image(view / "rgb.png", as_bytes(shot.image))
        write_millimetres(view / "depth.png", shot.depth)
        np.savetxt(view / "rot.txt", shot.pose.rotation)
        np.savetxt(view / "tran.txt", shot.pose.position)


def write_carla(
    run: Path, taken: Sequence[Shot], angles: Sequence[tuple[float, float, float]], unit: float = 1
) -> None:
    """``angles`` are yaw, pitch and roll in radians; ``unit`` is the length of one unit of location in metres."""
    for name in ("rgb", "depth"):
        (run / name).mkdir(parents=True)
    entries = []
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    face_axis = (pixel_directions(*SIZE) @ axes.T).max(axis=-1)
    for index, (shot, (yaw, pitch, roll)) in enumerate(zip(taken, angles, strict=True)):
        x, y, z = shot.pose.position
        frame = 100 + 7 * index
        entries.append(
            {
                "frame": frame,
                "location": {"x": -z / unit, "y": x / unit, "z": y / unit},
                "rotation": {"yaw": math.degrees(yaw), "pitch": math.degrees(pitch), "roll": math.degrees(roll)},
                "latitude": -z / METRES_PER_DEGREE, "longitude": x / METRES_PER_DEGREE, "altitude": y,
            }
        )  # fmt: skip
        write_image(run / "rgb" / f"{frame}.png", as_bytes(shot.image))
        write_millimetres(run / "depth" / f"{frame}.png", shot.depth * face_axis)
    entries.append({**entries[0], "frame": 999})  # its pictures were not kept
    (run / "gnss_data.json").write_text(json.dumps(entries))


def write_zind(tour: Path, taken: Sequence[Shot], scale: float | None = 2.5, room_scale: float = 0.4) -> None:
    """All in one room with two parts; coordinates of the floor are (−x, −z) metres over ``scale``."""
    (tour / "panos").mkdir(parents=True)
    parts: dict[str, dict[str, object]] = {"partial_room_00": {}, "partial_room_01": {}}
    for index, (shot, heading) in enumerate(zip(taken, HEADINGS, strict=True)):
        image = f"panos/floor_01_partial_room_00_pano_{index}.jpg"
        write_image(tour / image, as_bytes(shot.image))
        x, y, z = shot.pose.position / (scale or 1.0)
        parts[f"partial_room_{index % 2:02d}"][f"pano_{index + 9}"] = {
            "image_path": image, "camera_height": y / room_scale, "label": "room", "is_primary": True,
            "floor_plan_transformation": {
                "translation": [-x, -z], "rotation": math.degrees(heading), "scale": room_scale
            },
        }  # fmt: skip
    closet = {"partial_room_02": {"pano_1": next(iter(parts["partial_room_00"].values()))}}
    tour_data = {
        "scale_meters_per_coordinate": {"floor_01": scale},
        "merger": {"floor_01": {"complete_room_01": parts, "complete_room_02": closet}},
        "redraw": {},
    }
    (tour / "zind_data.json").write_text(json.dumps(tour_data))


def warping_error(
    first: np.ndarray, inverse_depth: np.ndarray, second: np.ndarray, truth: np.ndarray, pose: Pose
) -> float:
    """Mean absolute difference of the first view and the second one read where the first one's points are in it.

    Args:
        first, second: pictures.
        inverse_depth: of the first view.
        truth: depth of the second view, which tells what it sees.
        pose: second from first.
    """
    points = pixel_directions(*inverse_depth.shape) / np.maximum(inverse_depth, 1e-6)[..., None]
    seen = pose.transform(points)
    distance = np.linalg.norm(seen, axis=-1)
    visible = np.abs(sample_nearest(truth, seen) / distance - 1) < 0.03
    assert visible.mean() > 0.5
    return float(np.abs(sample_bilinear(second, seen) - first)[visible].mean())
