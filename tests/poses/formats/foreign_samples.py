"""Poses written as other programs write them, without any code of the package, and points in their worlds."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO
import pytest

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import direction_to_pixel
from omnisyn_cli.poses.formats import import_poses
from omnisyn_cli.poses.formats.files import ImportedPoses, ImportOptions

SIZE = (512, 1024)  # ``(height, width)`` in which pixels are compared; no such image exists.
PIXELS = 1e-6  # That formulas may differ by.


def axis_angle(vector: Any) -> tuple[np.ndarray, np.ndarray]:
    """Matrix (Rodrigues) and quaternion ``[w, x, y, z]`` of a rotation vector."""
    angle = float(np.linalg.norm(vector))
    x, y, z = axis = np.asarray(vector, float) / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    return matrix, np.array([math.cos(angle / 2), *(math.sin(angle / 2) * axis)])


def samples(count: int, seed: int = 0) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Rotation vectors, positions and points of the world, all different."""
    rng = np.random.default_rng(seed)
    return [(rng.normal(size=3), rng.normal(size=3) * 3, rng.normal(size=3) * 10) for _ in range(count)]


def write_images(
    folder: Path, names: list[str], size: tuple[int, int] = (16, 32), picture: np.ndarray | None = None, **tags: Any
) -> list[Path]:
    """Panoramas with tags, grey unless there is a picture, in folders that are made."""
    paths, picture = [], np.full((*size, 3), 128, np.uint8) if picture is None else picture
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        spec = OpenImageIO.ImageSpec(picture.shape[1], picture.shape[0], 3, "uint8")
        for key, value in tags.items():
            spec.attribute(key, *value) if isinstance(value, tuple) else spec.attribute(key, value)
        writer = OpenImageIO.ImageOutput.create(str(path))
        assert writer.open(str(path), spec)
        assert writer.write_image(picture)
        assert writer.close()
        paths.append(path)
    return paths


def write_text(path: Path, *lines: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def write_json(path: Path, document: Any) -> Path:
    return write_text(path, json.dumps(document))


def row(*values: Any) -> str:
    """Numbers with all their digits."""
    return " ".join(repr(float(value)) for part in values for value in np.ravel(part))


def imported(*sources: Path, expected: str, **options: Any) -> ImportedPoses:
    """What ``auto`` reads, which has to be the format that was expected."""
    name, result = import_poses(sources, "auto", ImportOptions(**options))
    assert name == expected
    return result


def refuse(message: str, *sources: Path, name: str = "auto", **options: Any) -> None:
    """Expect that an import is refused in one line with these words."""
    with pytest.raises(PoseError, match=message) as caught:
        import_poses(sources, name, ImportOptions(**options))
    assert "\n" not in str(caught.value)


def check_views(result: ImportedPoses, turns: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
    """Each view sees the point of its sample where a camera of OpenCV with that turn and translation does."""
    for view, (turn, shift), (_, _, point) in zip(result.views, turns, samples(len(turns)), strict=True):
        np.testing.assert_allclose(our_pixel(view.pose, y_down(point)), opencv_pixel(turn @ point + shift), atol=PIXELS)


def world_to_camera(count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Matrices and translations, where the samples are of poses from the world to the camera."""
    return [(axis_angle(turn)[0], shift) for turn, shift, _ in samples(count)]


def camera_to_world(count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """The same, where the samples are of places of cameras and of their axes in the world."""
    return [(turn.T, -turn.T @ place) for turn, place in world_to_camera(count)]


def our_pixel(pose: Pose, point: np.ndarray) -> np.ndarray:
    """``(row, col)`` indices of a point of our world in a panorama of :data:`SIZE`."""
    return np.array(direction_to_pixel(pose.inverse().transform(point), SIZE))


def opencv_pixel(point: np.ndarray) -> np.ndarray:
    """``(row, col)`` in COLMAP's EQUIRECTANGULAR: x right, y down, z forward, counted from the corner of the image."""
    x, y, z = point
    height, width = SIZE
    horizontal = (math.atan2(x, z) / (2 * math.pi) + 0.5) * width
    vertical = (0.5 - math.atan2(-y, math.hypot(x, z)) / math.pi) * height
    return np.array([vertical - 0.5, horizontal - 0.5])


def y_down(point: np.ndarray) -> np.ndarray:
    """A point of a world with x right, y down, z forward, in ours."""
    x, y, z = point
    return np.array([x, -y, -z])


def z_up(point: np.ndarray) -> np.ndarray:
    """A point of a world with x east, y north, z up, in ours."""
    x, y, z = point
    return np.array([x, z, -y])
