"""What SynSin learns from: a picture from one place, and the panoramas that it is to be made of.

Samples come from pools of scenes (:mod:`omnisyn_cli.training.data`), turned upright, looking anywhere.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.geometry.sampling import sample_nearest, turned_directions, turned_image
from omnisyn_cli.training.data import PoolScene, load_scene

LEVEL = 1e-3
"""Least length of the horizontal part of a way for it to be a direction."""


@dataclass(frozen=True)
class ViewSample:
    """One picture and what it is made of; all panoramas are upright and held alike.

    Attributes:
        images: of the panoramas, RGB in [0, 1].
        roots: of their true inverse depths, m^-½; NaN where they are not known.
        target_from_sources: where the panoramas are, seen from the target.
        truth: what is to be seen.
    """

    images: Float[Tensor, "views 3 height width"]
    roots: Float[Tensor, "views 1 height width"]
    target_from_sources: tuple[Pose, ...]
    truth: Float[Tensor, "3 height width"]


def draw_views(pool: list[Path], rng: np.random.Generator, count: int, size: tuple[int, int]) -> list[ViewSample]:
    """Samples of random scenes with one panorama and with two, in turn; turned, mirrored and tinted at random."""
    drawn = []
    for index in range(count):
        scene = load_scene(pool[rng.integers(len(pool))])
        target, sources = _chosen(len(scene.along), 1 + index % 2, rng)
        sample = view_sample(scene, target, sources, size, heading=rng.uniform(-np.pi, np.pi))
        drawn.append(_varied(sample, rng))
    return drawn


def _chosen(views: int, wanted: int, rng: np.random.Generator) -> tuple[int, tuple[int, ...]]:
    """A target between two panoramas, or beside one; scenes of two views have nothing between."""
    if wanted == 2 and views > 2:
        first, target, second = (int(k) for k in np.sort(rng.choice(views, 3, replace=False)))
        return target, (first, second)
    near = int(rng.integers(views - 1))
    return (near, (near + 1,)) if rng.random() < 0.5 else (near + 1, (near,))


def view_sample(
    scene: PoolScene, target: int, sources: tuple[int, ...], size: tuple[int, int], *, heading: float = 0.0
) -> ViewSample:
    """A sample of a scene.

    Args:
        scene: views along a line.
        target: index of the view that is to be made.
        sources: those of the views that it is made of.
        size: height and width of all pictures.
        heading: that all panoramas are turned by, radians; at 0 they look along the line.
    """
    held = _upright(scene.up.astype(np.float64)) @ rotation_from_heading(heading)
    own = np.eye(3)

    def colours(view: int) -> np.ndarray:
        shown = turned_image(scene.images[view].astype(np.float32) / np.float32(255.0), own, held, size)
        return np.ascontiguousarray(shown.transpose(2, 0, 1), np.float32)

    directions = turned_directions(size, own, held)
    roots = [np.sqrt(sample_nearest(scene.inverse_depth[view], directions))[None] for view in sources]
    along = scene.along.astype(np.float64)
    moved = [held.T @ np.array([0.0, along[view] - along[target], 0.0]) for view in sources]
    return ViewSample(
        images=torch.from_numpy(np.stack([colours(view) for view in sources])),
        roots=torch.from_numpy(np.stack(roots).astype(np.float32)),
        target_from_sources=tuple(Pose(np.eye(3), offset) for offset in moved),
        truth=torch.from_numpy(colours(target)),
    )


def _upright(up: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Pool from upright: the frame in which ``up`` is up and the line, if it leads anywhere, straight ahead."""
    ahead = np.array([0.0, 1.0, 0.0]) - up[1] * up
    if np.linalg.norm(ahead) < LEVEL:
        ahead = np.cross(up, np.array([1.0, 0.0, 0.0]))
    ahead = ahead / np.linalg.norm(ahead)
    return np.stack([np.cross(ahead, up), up, -ahead], axis=-1)


def _varied(sample: ViewSample, rng: np.random.Generator) -> ViewSample:
    """All pictures lit and tinted alike, and mirrored or not."""
    tint = torch.from_numpy((rng.uniform(0.7, 1.1) * rng.uniform(0.93, 1.07, (3, 1, 1))).astype(np.float32))
    gamma = float(rng.uniform(0.8, 1.25))
    images, truth = ((tint * x.clamp(min=1e-4) ** gamma).clamp(max=1.0) for x in (sample.images, sample.truth))
    roots, poses = sample.roots, sample.target_from_sources
    if rng.random() < 0.5:
        images, roots, truth = images.flip(-1), roots.flip(-1), truth.flip(-1)
        mirror = np.array([-1.0, 1.0, 1.0])
        poses = tuple(Pose(pose.rotation, mirror * pose.position) for pose in poses)
    return ViewSample(images, roots, poses, truth)
