"""Habitat renders of Matterport3D and Replica as PanoGRF makes and PanSplat reads them.

``SCENE/NN/{rgb.png, depth.png, rot.txt, tran.txt}``, the views NN in the order of their names. What is assumed (from
PanSplat's ``src/dataset/dataset_mp3d.py``): ``rot.txt`` is the 3×3 rotation and ``tran.txt`` the position of
camera-to-world in metres, axes x right, y up, −z forward, the image centre looks along −z. ``depth.png`` may be
missing; it is a 16-bit PNG of Euclidean distances in millimetres, 0 where the scan has a hole.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from omnisyn_cli.errors import PoseError
from omnisyn_cli.evaluation.datasets.scene import Scene, SceneFrame, SceneSource
from omnisyn_cli.geometry.pose import Pose, nearest_rotation

__all__ = ["find_scenes"]

POSITION, ROTATION = "tran.txt", "rot.txt"

UNIT_TOLERANCE = 1e-3
"""How far from orthonormal a matrix may be written."""


def find_scenes(folder: Path) -> list[SceneSource]:
    """The scenes of a folder, or the folder itself as one scene; none where nothing has this layout."""
    if any(folder.glob(f"*/{POSITION}")):
        name = folder.resolve().name
        return [SceneSource(name, partial(_read, name, folder))]
    scenes = sorted({path.parents[1] for path in folder.glob(f"*/*/{POSITION}")})
    return [SceneSource(scene.name, partial(_read, scene.name, scene)) for scene in scenes]


def _read(name: str, folder: Path) -> Scene:
    views = sorted(path.parent for path in folder.glob(f"*/{POSITION}"))
    return Scene(name, tuple(_frame(view) for view in views))


def _frame(view: Path) -> SceneFrame:
    depth = view / "depth.png"
    pose = Pose(_rotation(view / ROTATION), _numbers(view / POSITION, (3,)))
    return SceneFrame(view.name, view / "rgb.png", pose, depth if depth.is_file() else None, has_holes=True)


def _rotation(path: Path) -> np.ndarray:
    matrix = _numbers(path, (3, 3))
    deviation = float(np.abs(matrix.T @ matrix - np.eye(3)).max())
    if deviation > UNIT_TOLERANCE or np.linalg.det(matrix) < 0:
        raise PoseError(
            f"{path}: expected a rotation (RᵀR = 1, determinant +1), got a deviation of {deviation:.3g} and "
            f"determinant {np.linalg.det(matrix):.3g}; repair the file"
        )
    return nearest_rotation(matrix)


def _numbers(path: Path, shape: tuple[int, ...]) -> np.ndarray:
    try:
        numbers = np.array(path.read_text(encoding="utf-8").split(), np.float64)
    except (OSError, ValueError) as error:
        raise PoseError(f"{path}: expected numbers, got '{error}'; repair the file") from error
    if numbers.size != np.prod(shape) or not np.isfinite(numbers).all():
        raise PoseError(f"{path}: expected {np.prod(shape)} finite numbers, got {numbers.size}; repair the file")
    return numbers.reshape(shape)
