"""Surfaces, cuts and poses that the renderer's tests share, and the closed forms they are compared with."""

import math

import numpy as np

from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.pipeline.renderers import RENDERERS
from omnisyn_cli.render.mesh import Cut, Mesh, Triangles
from omnisyn_cli.render.renderer import RendererInputs
from omnisyn_cli.render.shade import Shader, make_confidence_map
from omnisyn_cli.render.texture import Texture

WHOLE = Cut(relative=None)
CUTS = {
    "whole": WHOLE, "default": Cut(), "coarse": Cut(relative=0.4), "metres": Cut(relative=None, metres=2.0),
    "everywhere": Cut(relative=1e-9),
}  # fmt: skip


def shade(
    inverse_depth: np.ndarray, mesh: Mesh, texture: Texture, target_from_source: Pose, threads: int | None = None
) -> np.ndarray:
    """Colour of what a target sees of a mesh, and alpha times its confidence."""
    shader = Shader((inverse_depth.shape[0], inverse_depth.shape[1]), threads)
    return shader(inverse_depth, make_confidence_map(mesh, texture), texture, target_from_source)


def noise(height: int, width: int) -> np.ndarray:
    return np.random.default_rng(20).random((height, width, 3)).astype(np.float32)


def rough(height: int, width: int, seed: int = 0) -> np.ndarray:
    """Inverse depths with large steps everywhere, a third of them at infinity."""
    rng = np.random.default_rng(seed)
    return (rng.uniform(0.05, 0.5, (height, width)) * (rng.random((height, width)) > 1 / 3)).astype(np.float32)


def smooth(height: int, width: int, seed: int = 0) -> np.ndarray:
    """A star-shaped surface between 1/0.4 and 1/0.2 metres: seen from near its middle it has no silhouettes."""
    waves = np.random.default_rng(seed).normal(size=(3, 3))
    directions = pixel_directions(height, width)
    return (0.3 + 0.033 * np.sin(directions @ waves).sum(axis=-1)).astype(np.float32)


def sphere(centre: np.ndarray, radius: float, directions: np.ndarray) -> np.ndarray:
    """Inverse distance to the inside of a sphere, from the origin along unit vectors."""
    along = directions @ centre
    return 1.0 / (along + np.sqrt(along**2 + radius**2 - centre @ centre))


def turn(*vector: float) -> np.ndarray:
    """The rotation of a rotation vector."""
    return rotation_from_rotation_vector(np.array(vector, float))


def moved(*position: float, rotation: np.ndarray | None = None) -> Pose:
    """Target from source."""
    return Pose(np.eye(3) if rotation is None else rotation, np.array(position, float))


def random_pose(seed: int, distance: float) -> Pose:
    """Turned by any angle and moved by ``distance``."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=3)
    return Pose(turn(*rng.normal(size=3) * 1.5), direction / np.linalg.norm(direction) * distance)


POSES = {
    "identity": Pose.identity(), "forward": moved(0.0, 0.0, 1.0), "up": moved(0.0, -1.5, 0.0),
    "down and half round": moved(0.0, 1.0, 0.0, rotation=turn(0.0, math.pi, 0.0)),
    "upside down": moved(0.3, 0.0, 0.2, rotation=turn(math.pi, 0.0, 0.0)),
    "poles on the horizon": moved(0.0, 0.5, 0.5, rotation=turn(math.pi / 2, 0.0, 0.0)), "any": random_pose(3, 0.7),
    "outside": random_pose(4, 12.0),
}  # fmt: skip


def is_unambiguous(triangles: Triangles, pose: Pose, size: tuple[int, int], margin: float = 1e-5) -> np.ndarray:
    """Pixels whose rays pass the edges of all front faces by more than ``margin`` radians, with one nearest surface."""
    rays = pixel_directions(*size).reshape(-1, 3)
    corners = triangles.direction @ pose.rotation.T + triangles.inverse_depth[..., None] * pose.position
    edges = np.cross(np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1))
    determinant = (corners[:, 0] * edges[:, 0]).sum(-1)
    front = determinant > -1e-12
    rho, edges, determinant = triangles.inverse_depth[front], edges[front], determinant[front]
    length = np.linalg.norm(edges, axis=-1)
    distance = np.einsum("px,fcx->pfc", rays, edges) / np.maximum(length, 1e-12)
    at_an_edge = (np.abs(distance.min(axis=-1)) <= margin).any(axis=-1)
    planes = np.einsum("fcx,fc->fx", edges, rho) / np.maximum(determinant, 1e-12)[:, None]
    seen = np.where((distance >= 0).all(axis=-1), rays @ planes.T, -1.0)
    first, second = -np.sort(-seen, axis=-1)[:, :2].T
    return (~at_an_edge & ((second < 0) | (first - second > margin))).reshape(size)


def make_renderer(name, *inputs, **more):
    return RENDERERS[name].load()(RendererInputs(*inputs, **more))
