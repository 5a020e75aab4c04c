"""Random and singular directions, rotations and poses that the geometry tests share."""

import math

import numpy as np

from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector

POLES = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
AXES = np.concatenate([np.eye(3), -np.eye(3)])


def directions(count: int = 200) -> np.ndarray:
    """Unit vectors: anywhere, close to the poles, close to the seam, and exactly on the axes."""
    rng = np.random.default_rng(0)
    anywhere = rng.normal(size=(count, 3))
    near_poles = POLES[rng.integers(0, 2, count)] + 1e-7 * rng.normal(size=(count, 3))
    near_seam = np.array([0.0, 0.0, 1.0]) + rng.normal(size=(count, 3)) * [1e-9, 1.0, 0.1]
    vectors = np.concatenate([anywhere, near_poles, near_seam, AXES])
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def rotations(count: int = 60) -> np.ndarray:
    """Rotations by any angle, by almost nothing, by almost and exactly half a turn, and not at all."""
    rng = np.random.default_rng(1)
    axes = rng.normal(size=(4, count, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    angles = np.concatenate([rng.uniform(0, math.pi, count), 10.0 ** rng.uniform(-12, -4, count)])
    vectors = axes[:2].reshape(-1, 3) * angles[:, None]
    half_turns = np.concatenate([axes[2] * math.pi, axes[3] * (math.pi - 1e-9), AXES * math.pi])
    return rotation_from_rotation_vector(np.concatenate([vectors, half_turns, np.zeros((1, 3))]))


def poses(count: int = 60) -> Pose:
    """One batch of poses with the rotations of :func:`rotations`."""
    rotation = rotations(count)
    return Pose(rotation, np.random.default_rng(2).normal(scale=5.0, size=(len(rotation), 3)))
