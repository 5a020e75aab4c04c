"""Filling a pool: procedural scenes made by worker processes, and the pairs of any data set with depth.

Poses of photographs have small errors: each is rotated by a fraction of a degree that its pose does not say. Inverse
depth is NaN where the truth is not known (holes of a scan, masked pixels); nothing is learned there.
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
from jaxtyping import Float

from omnisyn_cli.compute.processes import spawn_context
from omnisyn_cli.errors import InputError, OmnisynError
from omnisyn_cli.evaluation.datasets.sources import Pair, SceneFrame, SceneSource
from omnisyn_cli.geometry.pose import Pose, at_same_position, rotation_from_rotation_vector
from omnisyn_cli.geometry.sampling import rotated_directions, rotated_image, sample_nearest
from omnisyn_cli.io import read_photographs
from omnisyn_cli.io.outputs import make_folder
from omnisyn_cli.scenes import Photos, Scene, generate_scene, pack_photos, render_panorama, sample_path
from omnisyn_cli.scenes.paths import random_rotation
from omnisyn_cli.training.data import Walk, load_walk, walk_views
from omnisyn_cli.types import DepthEstimate, View

PATH_STOPS = 9  # Positions along a path that views are drawn from; the ends are always taken


@dataclass(frozen=True)
class SceneConfig:
    """The scenes of a pool, of any kind."""

    size: tuple[int, int] = (256, 512)  # ``(height, width)`` of what is stored
    kinds: tuple[str, ...] = ("room", "street", "home")  # of scenes, in turn by seed
    pose_error_share: float = 0.3  # of scenes with pose errors
    pose_error_radians: float = 0.002  # standard deviation of these errors
    textures: str | None = None  # folder of photographs that become materials; None leaves all of them procedural
    # deviations of pitch and roll to draw one of, radians, of photographs; each has a heading of its own
    tilts: tuple[float, ...] = (0.0, 0.0, 0.0, 0.02, 0.02, 0.1)

    def scene(self, seed: int, stops: int, kind: str | None = None) -> tuple[Scene, list[Pose]] | None:
        """A seed's scene, of its kind or ``kind``, and places on a straight way; None if there is no room for one."""
        scene = generate_scene(kind or self.kinds[seed % len(self.kinds)], seed, _packed_photos(self.textures))
        try:
            return scene, sample_path(scene, seed, stops)
        except ValueError:
            return None

    def pose_error(self, rng: np.random.Generator) -> float:
        """Standard deviation of the pose errors of a scene, radians."""
        return self.pose_error_radians if rng.random() < self.pose_error_share else 0.0


@lru_cache(maxsize=1)
def photographs(folder: str | None) -> list[np.ndarray]:
    """Those of a folder, read once in a process; InputError: there are none, or one of them cannot be read."""
    return [] if folder is None else read_photographs(Path(folder))


@lru_cache(maxsize=1)
def _packed_photos(folder: str | None) -> Photos | None:
    return None if folder is None else pack_photos(photographs(folder))


def make_scene_files(
    folder: Path, seeds: range, make: Callable[[Path, int], Path | None], *, workers: int = 1
) -> Iterator[Path]:
    """Make missing scenes in worker processes; yields finished files. ``make`` writes a seed's, or returns None.

    OutputPathError: no folder can be made; WriteError: no space; OmnisynError: a killed worker. Finished scenes stay.
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


def noisy_pose(pose: Pose, error: float, rng: np.random.Generator) -> Pose:
    """A pose as it is said to be, wrong by rotations of a standard deviation in radians."""
    return Pose(pose.rotation @ rotation_from_rotation_vector(error * rng.standard_normal(3)), pose.position)


def take_photograph(
    scene: Scene, position: Float[np.ndarray, " 3"], tilt: float, error: float, rng: np.random.Generator,
    size: tuple[int, int], depth_size: tuple[int, int], *, supersample: int,
) -> View:  # fmt: skip
    """A panorama taken by hand, ``tilt`` as in :func:`random_rotation`; inverse depth at the centre of each pixel."""
    pose = Pose(random_rotation(rng, tilt), position)
    image, depth = render_panorama(scene, pose, size, supersample=supersample, threads=1)
    if depth_size != size:
        _, depth = render_panorama(scene, pose, depth_size, supersample=1, threads=1)
    known = DepthEstimate((1.0 / depth).astype(np.float32), np.ones(depth_size, np.float32))
    return View(np.asarray(image, np.float32), noisy_pose(pose, error, rng), known_depth=known)


def pair_path(folder: Path, scene: str, first: str, second: str) -> Path:
    """Where a pair of a data set lies in a pool; characters that not every system has in names become ``_``."""
    return folder / (re.sub(r"[^\w.-]+", "_", f"{scene}-{first}-{second}") + ".npz")


def walk_source(file: Path) -> SceneSource:
    """A walk as a scene: its views have their numbers as names, and lie in one file."""
    return SceneSource(
        file.stem, lambda: (SceneFrame(str(k), file, view.pose) for k, view in enumerate(walk_views(load_walk(file))))
    )


def pair_of_walk(pair: Pair) -> list[View]:
    """The views of a pair of such a scene."""
    views = walk_views(load_walk(pair.first.image))
    return [views[int(end.name)] for end in (pair.first, pair.second)]


def walk_of_views(views: Sequence[View], size: tuple[int, int]) -> Walk:
    """Panoramas along a line and their known depth, turned upright; InputError: no depth, or both ends at one place."""
    first = views[0].pose
    if at_same_position(first, views[-1].pose):
        raise InputError("expected two panoramas from different places, got one place; leave the pair out")
    images, depths = zip(*(_upright(view, size) for view in views), strict=True)
    return walk_of(images, depths, [view.pose.position - first.position for view in views])


def walk_of(
    images: Sequence[np.ndarray], inverse_depths: Sequence[np.ndarray], positions: Sequence[np.ndarray],
    *, is_mesh: bool = False,
) -> Walk:  # fmt: skip
    """As it is stored: images are rounded to eight bits, inverse depth to half precision."""
    colours = [(np.clip(image, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8) for image in images]
    half = np.stack(inverse_depths).astype(np.float16)
    return Walk(np.stack(colours), half, np.stack(positions).astype(np.float32), is_mesh)


def _upright(view: View, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Colours, and the nearest pixel's inverse depth, as a mean of two surfaces lies on neither; NaN: not known."""
    if view.known_depth is None:
        raise InputError("expected true depth of both panoramas of a training pair, got none; leave the pair out")
    directions = rotated_directions(size, view.pose.rotation, np.eye(3))
    known = np.where(view.known_depth.confidence > 0, view.known_depth.inverse_depth, np.nan)
    inverse_depth = sample_nearest(known, directions)
    if view.mask is not None:
        is_shown = sample_nearest(view.mask.astype(np.float32), directions) > 0
        inverse_depth = np.where(is_shown, inverse_depth, np.nan)
    return rotated_image(view.image, view.pose.rotation, np.eye(3), size), inverse_depth
