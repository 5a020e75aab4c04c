"""Renders of Habitat (Matterport3D, Replica) as PanoGRF and PanSplat keep them: a folder per panorama.

``NN/{rgb.png, depth.png, rot.txt, tran.txt}``: a 3×3 camera-to-world rotation, the position of the camera in metres, in
Habitat's frame: x right, y up, −z forward, which is ours. ``depth.png`` holds 16-bit millimetres along the ray.

Source: PanSplat, ``src/dataset/dataset_mp3d.py`` (``convert_poses``); PanoGRF's data preparation.
"""

from pathlib import Path

import numpy as np

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, rotation_angle
from omnisyn_cli.poses.entries import checked_rotation
from omnisyn_cli.poses.formats.files import data_lines, entries, images_in, natural_key, numbers
from omnisyn_cli.poses.formats.model import ImportedPoses, ImportedView, ImportOptions, noted

MIN_NOTED_ROTATION = 1e-6
"""Radians; smaller rotations are rounding and get no note."""


def habitat_folders(folder: Path) -> list[Path]:
    """The folders of the single panoramas, in natural order."""
    found = [path for path in entries(folder) if (path / "rot.txt").is_file() and (path / "tran.txt").is_file()]
    return sorted(found, key=lambda path: natural_key(path.name))


def read_habitat(source: Path, options: ImportOptions) -> ImportedPoses:
    """Poses of a scene: a folder with a folder per panorama."""
    folders = habitat_folders(source) if source.is_dir() else []
    if not folders:
        raise PoseError(f"{source}: expected folders with rot.txt and tran.txt, got none; give the folder of one scene")
    views = []
    for folder in folders:
        image, depth = _panorama(folder), folder / "depth.png"
        pose, name = habitat_pose(folder, options), f"{folder.name}/{image.name}"
        views.append(ImportedView(name, pose, image, depth if depth.is_file() else None))
    notes = {
        "distances: metres": True,
        "depth: 16-bit millimetres along the ray, where there is a depth.png": True,
        "rotations: rot.txt is read as camera-to-world, as PanSplat does": (
            any(float(rotation_angle(view.pose.rotation)) > MIN_NOTED_ROTATION for view in views)
        ),
    }
    return ImportedPoses(tuple(views), noted(notes))


def habitat_pose(folder: Path, options: ImportOptions | None = None) -> Pose:
    """Where the panorama of a folder with ``rot.txt`` and ``tran.txt`` was taken; PoseError: missing or malformed."""
    rotation = checked_rotation(f"{folder / 'rot.txt'}", _values(folder / "rot.txt", 9, "a 3×3 rotation").reshape(3, 3))
    position = _values(folder / "tran.txt", 3, "a position")
    return (options or ImportOptions()).pose(Pose(rotation, position), camera="opengl", up="y")


def _values(path: Path, count: int, what: str) -> np.ndarray:
    fields = [field for _, line in data_lines(path) for field in line.replace(",", " ").split()]
    return numbers(str(path), fields, count, what)


def _panorama(folder: Path) -> Path:
    """``rgb.*``, or the only image that is not a depth map."""
    images = [path for path in images_in(folder) if not path.stem.startswith("depth")]
    named = [path for path in images if path.stem == "rgb"] or images
    if len(named) != 1:
        raise PoseError(f"{folder}: expected one panorama (rgb.png), got {len(named)} images; name it rgb.png")
    return named[0]
