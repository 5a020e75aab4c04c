"""A hall with exact distances: the inside of a ball whose wall is painted with a smooth pattern."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.geometry.sphere import pixel_directions, solid_angles
from omnisyn_cli.io import read_depth, write_depth, write_image
from omnisyn_cli.poses.file import PosedPanorama, write_poses
from omnisyn_cli.types import DepthEstimate, View

RADIUS = 4.0
SIZE = (64, 128)
WAVES = np.array([[1.7, 0.4, -0.9], [-0.5, 1.3, 1.1], [0.8, -1.1, 1.4]])
PHASES = np.array([0.3, 1.1, 2.0])


def posed(position: Sequence[float], heading: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> Pose:
    return Pose(rotation_from_heading(heading, pitch, roll), np.array(position, float))


def distance_to_wall(pose: Pose, size: tuple[int, int]) -> np.ndarray:
    """The positive root of |position + s·direction| = RADIUS."""
    along = world_directions(pose, size) @ pose.position
    return -along + np.sqrt(along**2 + RADIUS**2 - pose.position @ pose.position)


def world_directions(pose: Pose, size: tuple[int, int]) -> np.ndarray:
    return pixel_directions(*size) @ pose.rotation.T


def hall_image(pose: Pose, size: tuple[int, int] = SIZE) -> np.ndarray:
    """What a panorama at ``pose`` shows: (height, width, 3) in [0.1, 0.9]."""
    seen = pose.position + distance_to_wall(pose, size)[..., None] * world_directions(pose, size)
    return (0.5 + 0.4 * np.sin(seen @ WAVES.T + PHASES)).astype(np.float32)


def hall_view(pose: Pose, size: tuple[int, int] = SIZE, mask: np.ndarray | None = None) -> View:
    inverse_depth = (1.0 / distance_to_wall(pose, size)).astype(np.float32)
    return View(hall_image(pose, size), pose, mask, DepthEstimate(inverse_depth, np.ones_like(inverse_depth)))


def ws_psnr(image: np.ndarray, truth: np.ndarray) -> float:
    weight = solid_angles(*truth.shape[:2])
    squared = ((image - truth) ** 2).mean(axis=-1)
    return float(-10 * np.log10(max((weight * squared).sum() / weight.sum(), 1e-20)))


def as_bytes(image: np.ndarray) -> np.ndarray:
    return np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)


def write_mask(path: Path, row: int) -> Path:
    """A mask for panoramas of the hall that is black from a row on."""
    usable = np.full((*SIZE, 3), 255, np.uint8)
    usable[row:] = 0
    write_image(path, usable)
    return path


def open_to_the_sky(folder: Path, rows: int, count: int = 2) -> None:
    """Take the wall away from depth files above a row."""
    for index in range(count):
        depth = np.array(read_depth(folder / f"p{index}_depth.exr"))
        depth[:rows] = np.inf
        write_depth(folder / f"p{index}_depth.exr", depth)


def write_hall(
    folder: Path, poses: Sequence[Pose], size: tuple[int, int] = SIZE, suffix: str = ".png", *, with_depth: bool = True
) -> list[Path]:
    """Panoramas ``p0.png``, ``p1.png`` … (8 bits), their depth and ``poses.json``; paths of the panoramas."""
    images, entries = [], {}
    for index, pose in enumerate(poses):
        image, depth = folder / f"p{index}{suffix}", folder / f"p{index}_depth.exr"
        write_image(image, as_bytes(hall_image(pose, size)))
        if with_depth:
            write_depth(depth, distance_to_wall(pose, size))
        entries[image.name] = PosedPanorama(pose, depth if with_depth else None)
        images.append(image)
    write_poses(folder / "poses.json", entries)
    return images
