"""Filling a pool: procedural scenes rendered straight into the epipole frame, by worker processes.

Two photographs differ by more than colour: how far apart they were taken, and small errors of the poses. Each view is
rotated by a fraction of a degree that its pose does not say. Pairs of any data set with depth become scenes of a pool
as well. Inverse depth is NaN where the truth is not known (holes of a scan, masked pixels); nothing is learned there.
"""

import os
import re
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32

from omnisyn_cli.compute.processes import spawn_context
from omnisyn_cli.errors import InputError, OmnisynError
from omnisyn_cli.geometry.pose import (
    Pose,
    at_same_position,
    distance_between,
    rotation_from_heading,
    rotation_from_rotation_vector,
)
from omnisyn_cli.geometry.sampling import rotated_directions, rotated_image, sample_nearest
from omnisyn_cli.geometry.sphere import UP
from omnisyn_cli.geometry.sweep import epipole_frame
from omnisyn_cli.io import read_photographs
from omnisyn_cli.io.outputs import make_folder, write_errors
from omnisyn_cli.scenes import Photos, Scene, generate_scene, pack_photos, render_panorama, render_views, sample_path
from omnisyn_cli.training.data import TrainingScene, save_scene
from omnisyn_cli.types import View

PATH_STOPS = 9
"""Positions along a path that views are drawn from; the ends are always taken."""


@dataclass(frozen=True)
class SceneConfig:
    """The scenes of a pool, of any kind.

    Attributes:
        size: ``(height, width)`` of what is stored.
        kinds: of scenes, in turn by seed.
        turned: share of scenes with pose errors.
        pose_error_radians: standard deviation of these errors.
        textures: folder of photographs that become materials; None leaves all of them procedural.
    """

    size: tuple[int, int] = (256, 512)
    kinds: tuple[str, ...] = ("room", "street", "home")
    pose_error_share: float = 0.3
    pose_error_radians: float = 0.002
    textures: str | None = None

    def scene(self, seed: int, stops: int) -> tuple[Scene, list[Pose]] | None:
        """The scene of a seed, and places on a straight way through it; None if it has no room for one."""
        scene = generate_scene(self.kinds[seed % len(self.kinds)], seed, _load_photos(self.textures))
        try:
            return scene, sample_path(scene, seed, stops)
        except ValueError:
            return None

    def pose_error(self, rng: np.random.Generator) -> float:
        """Standard deviation of the pose errors of a scene, radians."""
        return self.pose_error_radians if rng.random() < self.pose_error_share else 0.0


@dataclass(frozen=True)
class TiltedConfig(SceneConfig):
    """Scenes that are photographed with cameras held nearly upright, with a heading of their own.

    Attributes:
        tilts: standard deviations of pitch and roll that a scene draws one of, radians.
    """

    tilts: tuple[float, ...] = (0.0, 0.0, 0.0, 0.02, 0.02, 0.1)


@dataclass(frozen=True)
class LineSceneConfig(SceneConfig):
    """How a pool is rendered.

    Attributes:
        views: per scene; n views make n·(n−1) training pairs.
        supersample: colour samples per pixel along each axis.
    """

    pose_error_radians: float = 0.0015
    views: int = 3
    supersample: int = 2


@lru_cache(maxsize=1)
def _load_photos(folder: str | None) -> Photos | None:
    """The photographs of a folder, read once in a process.

    Raises InputError: there are none, or one of them cannot be read.
    """
    return None if folder is None else pack_photos(read_photographs(Path(folder)))


def _render_along(scene: Scene, path: Sequence[Pose], seed: int, config: LineSceneConfig) -> TrainingScene:
    rng = np.random.default_rng([7, seed])
    between = np.sort(rng.choice(np.arange(1, PATH_STOPS - 1), config.views - 2, replace=False))
    chosen = [path[0], *(path[i] for i in between), path[-1]]
    frame = epipole_frame(path[0], path[-1])[0].rotation
    spread = config.pose_error(rng)
    images, depths = [], []
    for pose in chosen:
        pose_error_share = rotation_from_rotation_vector(spread * rng.standard_normal(3)) @ frame
        image, depth = render_views(
            scene, pose_error_share, pose.position[None], config.size, supersample=config.supersample, threads=1
        )
        images.append((image[0] * 255.0 + 0.5).astype(np.uint8))
        depths.append(depth[0])
    along = [float(np.linalg.norm(pose.position - chosen[0].position)) for pose in chosen]
    return TrainingScene(np.stack(images), 1.0 / np.stack(depths), np.array(along, dtype=np.float32), frame.T @ UP)


def make_scene_files(
    folder: Path, seeds: range, make: Callable[[Path, int], Path | None], *, workers: int = 1
) -> Iterator[Path]:
    """Make the scenes that are not there yet, in worker processes that give way to everything else.

    Yields each file as it is finished, in any order. Seeds whose scene has no room for a path are skipped.

    Args:
        folder: of the pool.
        seeds: of the scenes.
        make: writes the file of a seed, or returns None where there is no room; a function that can be pickled.
        workers: processes.

    Raises:
        OutputPathError: the folder cannot be made.
        WriteError: a file cannot be written; the scenes that have not been begun are left out then.
        OmnisynError: a worker was killed, as it is where memory runs out; the scenes that are finished stay.
    """
    make_folder(folder, "a pool")
    missing = [seed for seed in seeds if not scene_path(folder, seed).exists()]
    with ProcessPoolExecutor(workers, mp_context=spawn_context(), initializer=_lower_priority) as executor:
        futures = [executor.submit(make, folder, seed) for seed in missing]
        try:
            for future in as_completed(futures):
                path = future.result()
                if path is not None:
                    yield path
        except BrokenProcessPool as error:
            raise OmnisynError(
                f"{folder}: expected worker processes to live, got one that was killed; start the command again to go "
                "on, and if memory ran out take fewer workers"
            ) from error
        finally:
            executor.shutdown(cancel_futures=True)  # an error or Ctrl-C does not wait for all that is left


def scene_path(folder: Path, seed: int) -> Path:
    """Where the scene of a seed lies in a pool."""
    return folder / f"{seed:08d}.npz"


def _lower_priority() -> None:
    if hasattr(os, "nice"):
        os.nice(19)


def render_line_scene(folder: Path, seed: int, config: LineSceneConfig) -> Path | None:
    """Render the scene of a seed, seen from a few positions along a line, into a pool; None if it has no room for one.

    Equal seeds make equal files.
    """
    found = config.scene(seed, PATH_STOPS)
    if found is None:
        return None
    file = scene_path(folder, seed)
    save_scene(file, _render_along(*found, seed, config))
    return file


def random_rotation(rng: np.random.Generator, tilt: float) -> Float[np.ndarray, "3 3"]:
    """How a camera is held with any heading, and pitch and roll of a standard deviation in radians."""
    return rotation_from_heading(rng.uniform(-np.pi, np.pi), rng.normal(0.0, tilt), rng.normal(0.0, tilt))


def noisy_pose(pose: Pose, error: float, rng: np.random.Generator) -> Pose:
    """A pose as it is said to be, wrong by rotations of a standard deviation in radians."""
    return Pose(pose.rotation @ rotation_from_rotation_vector(error * rng.standard_normal(3)), pose.position)


def take_photograph(
    scene: Scene, position: Float[np.ndarray, " 3"], tilt: float, error: float, rng: np.random.Generator,
    size: tuple[int, int], depth_size: tuple[int, int],
) -> tuple[Float32[np.ndarray, "height width 3"], Float[np.ndarray, "rows cols"], Pose]:  # fmt: skip
    """A panorama taken by hand: colours, inverse depth at the centre of each pixel, and the pose it is said to have.

    Args:
        scene: what is photographed.
        position: of the camera.
        tilt: see :func:`random_rotation`.
        error: see :func:`noisy_pose`.
        rng: random numbers.
        size: height and width of the picture.
        depth_size: those of the inverse depth.
    """
    pose = Pose(random_rotation(rng, tilt), position)
    image, _ = render_panorama(scene, pose, size, supersample=2, threads=1)
    _, depth = render_panorama(scene, pose, depth_size, supersample=1, threads=1)
    return np.asarray(image, np.float32), 1.0 / depth, noisy_pose(pose, error, rng)


def pair_path(folder: Path, scene: str, first: str, second: str) -> Path:
    """Where a pair of a data set lies in a pool; characters that not every system has in names become ``_``."""
    return folder / (re.sub(r"[^\w.-]+", "_", f"{scene}-{first}-{second}") + ".npz")


def add_views(path: Path, views: Sequence[View], size: tuple[int, int]) -> None:
    """Write a pair, or more views on one line, into a pool.

    Raises:
        InputError: as :func:`scene_from_views`.
        WriteError: the disk is full, or the folder cannot be made.
    """
    scene = scene_from_views(views, size)
    with write_errors(path):
        save_scene(path, scene)


def scene_from_views(views: Sequence[View], size: tuple[int, int]) -> TrainingScene:
    """Panoramas and their depth in the epipole frame of the first and the last.

    Args:
        views: two, or more on one straight line and in its order, with known depth and sizes of their own.
        size: height and width of the pool, 1:2.

    Raises InputError: a panorama has no depth, or the ends are at one place.
    """
    first, last = views[0].pose, views[-1].pose
    if any(view.known_depth is None for view in views):
        raise InputError("expected true depth of both panoramas of a training pair, got none; leave the pair out")
    if at_same_position(first, last):
        raise InputError("expected two panoramas from different places, got one place; leave the pair out")
    frame = epipole_frame(first, last)[0].rotation
    shown = [_rotate_view(view, frame, size) for view in views]
    images, inverse_depths = (np.stack(column) for column in zip(*shown, strict=True))
    along = [distance_between(first, view.pose) for view in views]
    return TrainingScene(images, inverse_depths, np.array(along, np.float32), frame.T @ UP)


def _rotate_view(
    view: View, frame: Float[np.ndarray, "3 3"], size: tuple[int, int]
) -> tuple[np.ndarray, Float[np.ndarray, "height width"]]:
    """Colours (uint8) and inverse depth of a panorama as a camera held like ``frame`` would have taken it."""
    colours = rotated_image(view.image, view.pose.rotation, frame, size)
    directions = rotated_directions(size, view.pose.rotation, frame)
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
