"""Training data from panoramas that have depth already: pairs of any data set as scenes of a pool.

What is written is what :mod:`omnisyn_cli.training.data` describes, with two views; inverse depth is NaN where the truth
is not known (holes of a scan, masked pixels), and nothing is taught there.
"""

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import sample_nearest, turned_directions, turned_image
from omnisyn_cli.geometry.sphere import UP
from omnisyn_cli.geometry.sweep import epipole_frame
from omnisyn_cli.io.outputs import write_errors
from omnisyn_cli.training.data import PoolScene, save_scene
from omnisyn_cli.types import View

__all__ = ["add_pair", "pair_path"]


def pair_path(folder: Path, scene: str, first: str, second: str) -> Path:
    """Where a pair of a data set lies in a pool; characters that not every system has in names become ``_``."""
    return folder / (re.sub(r"[^\w.-]+", "_", f"{scene}-{first}-{second}") + ".npz")


def add_pair(path: Path, first: View, second: View, size: tuple[int, int]) -> None:
    """Write a pair into a pool.

    Raises:
        InputError: as :func:`pool_scene`.
        WriteError: the disk is full, or the folder cannot be made.
    """
    scene = pool_scene(first, second, size)
    with write_errors(path):
        save_scene(path, scene)


def pool_scene(first: View, second: View, size: tuple[int, int]) -> PoolScene:
    """Both panoramas and their depth in the epipole frame of the pair.

    Args:
        first: a panorama with known depth, at sizes of their own.
        second: another.
        size: height and width of the pool, 1:2.

    Raises:
        InputError: a panorama has no depth, or both are at one place.
    """
    if first.known_depth is None or second.known_depth is None:
        raise InputError("expected true depth of both panoramas of a training pair, got none; leave the pair out")
    if np.array_equal(first.pose.position, second.pose.position):
        raise InputError("expected two panoramas from different places, got one place; leave the pair out")
    frame, _, baseline = epipole_frame(first.pose, second.pose)
    shown = [_turned(view, frame, size) for view in (first, second)]
    images, inverse_depths = (np.stack(column) for column in zip(*shown, strict=True))
    return PoolScene(images, inverse_depths, np.array([0.0, baseline], np.float32), frame.rotation.T @ UP)


def _turned(view: View, frame: Pose, size: tuple[int, int]) -> tuple[np.ndarray, Float[np.ndarray, "height width"]]:
    """Colours (uint8) and inverse depth of a panorama as a camera held like ``frame`` would have taken it."""
    colours = turned_image(view.image, view.pose.rotation, frame.rotation, size)
    directions = turned_directions(size, view.pose.rotation, frame.rotation)
    return (colours * 255.0 + 0.5).astype(np.uint8), _known_inverse_depth(view, directions)


def _known_inverse_depth(view: View, directions: np.ndarray) -> np.ndarray:
    """The nearest pixel's, as a mean of two surfaces lies on neither; NaN where it is not known."""
    if view.known_depth is None:
        return np.full(directions.shape[:2], np.nan, np.float32)
    inverse_depth = sample_nearest(view.known_depth.inverse_depth.astype(np.float32), directions)
    is_known = sample_nearest(view.known_depth.confidence, directions) > 0
    if view.mask is not None:
        is_known = is_known & (sample_nearest(view.mask.astype(np.float32), directions) > 0)
    return np.asarray(np.where(is_known, inverse_depth, np.float32(np.nan)), np.float32)
