"""Pairs with exact truth: matches without pictures, pictures of a generated street, and mistakes made on purpose."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from omnisyn_cli.geometry.pose import (
    Pose,
    quaternion_from_rotation,
    rotation_from_quaternion,
    rotation_from_rotation_vector,
    rotation_vector_from_rotation,
)
from omnisyn_cli.poses.registration.features import Matches, find_features, grey_of, match_features
from omnisyn_cli.poses.registration.least_squares import Uncertainty, relative_pose
from omnisyn_cli.poses.registration.pose_graph import Edge
from omnisyn_cli.poses.registration.robust import Estimate
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path

PIXEL = np.pi / 512


def random_pose(rng: np.random.Generator) -> Pose:
    return Pose(rotation_from_rotation_vector(rng.normal(size=3)), rng.normal(size=3) * 2)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def world_points(rng: np.random.Generator, count: int, shape: str = "cloud") -> np.ndarray:
    """Points around the origin of the first camera: anywhere, or all on one plane."""
    points = unit(rng.normal(size=(count, 3))) * np.exp(rng.uniform(0.5, 2.5, (count, 1)))
    if shape == "plane":
        points[:, 1] = -1.6
    return points


def seen(pose_first: Pose, pose_second: Pose, points: np.ndarray) -> Matches:
    """Directions to world points from both cameras."""
    return Matches(*(unit(pose.inverse().transform(points)) for pose in (pose_first, pose_second)), PIXEL)


def matches_of(
    rng: np.random.Generator, first: Pose, second: Pose, count: int = 300, noise: float = 0.0, wrong: float = 0.0
) -> Matches:
    """Matches of a pair, of which a share is wrong; ``noise`` is radians for each of two directions."""
    exact = seen(first, second, first.transform(world_points(rng, count)))
    noisy = [unit(d + rng.normal(size=d.shape) * noise) for d in (exact.first, exact.second)]
    is_wrong = rng.random(count) < wrong
    noisy[1][is_wrong] = unit(rng.normal(size=(int(is_wrong.sum()), 3)))
    return Matches(noisy[0], noisy[1], PIXEL)


def random_pair(
    seed: int, count: int = 300, noise: float = 0.2 * PIXEL, wrong: float = 0.0
) -> tuple[Pose, Pose, Matches]:
    """Two cameras anywhere and their matches."""
    rng = np.random.default_rng(seed)
    first, second = random_pose(rng), random_pose(rng)
    return first, second, matches_of(rng, first, second, count, noise, wrong)


SPACING = (0.4, 1.3, 0.7, 2.0)


def chain() -> list[Pose]:
    rng = np.random.default_rng(0)
    along = np.concatenate([[0.0], np.cumsum(SPACING)])
    return [Pose(random_pose(rng).rotation, np.array([x, 0.02 * x, 0.0])) for x in along]


def edges_of(poses: list[Pose], pairs: list[tuple[int, int]], noise: float = 0.0, seed: int = 1) -> list[Edge]:
    """Pairs that all see the same points; ``noise`` is radians of each direction, the same in all pairs."""
    rng = np.random.default_rng(seed)
    points = world_points(rng, 300)
    directions = [seen(pose, pose, points).first for pose in poses]
    directions = [unit(each + rng.normal(size=each.shape) * noise) for each in directions]
    return [
        Edge(a, b, Estimate(relative_pose(poses[a], poses[b]), np.ones(300, bool), 0.0, Uncertainty(0.0, 0.0), False),
             Matches(directions[a], directions[b], PIXEL))
        for a, b in pairs
    ]  # fmt: skip


@lru_cache(maxsize=1)
def street_poses() -> tuple[Pose, Pose]:
    """Two cameras that are tilted and look different ways, 1.9 m apart."""
    first, second = sample_path(generate_scene("street", 101), 101, 2, tilt=0.1)
    return first, second


@lru_cache(maxsize=4)
def street_image(index: int, size: tuple[int, int] = (256, 512)) -> np.ndarray:
    return render_panorama(generate_scene("street", 101), street_poses()[index], size, threads=2)[0]


@lru_cache(maxsize=1)
def street_matches() -> Matches:
    return match_features(*(find_features(grey_of(street_image(k)), threads=2) for k in range(2)))


def street_truth() -> Pose:
    return relative_pose(*street_poses())


def _inverted(pose: Pose) -> Pose:
    return Pose(pose.rotation.T, -pose.rotation.T @ pose.position)


def _with_axes(*axes: int) -> Callable[[Pose], Pose]:
    """Columns of a camera-to-world rotation are the camera's axes in the world: x, y and z are 1, 2 and 3."""
    return lambda pose: Pose(np.stack([np.sign(k) * pose.rotation[:, abs(k) - 1] for k in axes], 1), pose.position)


_opencv = _with_axes(1, -2, -3)  # y and z point the other way
_half_turned = _with_axes(-1, 2, -3)


def _mirrored(axis: int) -> Callable[[Pose], Pose]:
    def mirror(pose: Pose) -> Pose:
        quaternion = quaternion_from_rotation(pose.rotation)
        kept = quaternion[1 + axis]
        quaternion[1:] *= -1
        quaternion[1 + axis] = kept  # in a mirror, the part of an axis of rotation along the normal stays
        position = pose.position.copy()
        position[axis] *= -1
        return Pose(rotation_from_quaternion(quaternion), position)

    return mirror


def _scalar_last(pose: Pose) -> Pose:
    w, x, y, z = quaternion_from_rotation(pose.rotation)
    return Pose(rotation_from_quaternion(np.array([x, y, z, w])), pose.position)


def _degrees_taken_for_radians(pose: Pose) -> Pose:
    degrees = np.degrees(rotation_vector_from_rotation(pose.rotation))
    return Pose(rotation_from_rotation_vector(degrees), pose.position)


def _each(change: Callable[[Pose], Pose]) -> Callable[[Pose, Pose], tuple[Pose, Pose]]:
    return lambda first, second: (change(first), change(second))


# By the name of the mistake: right poses written down wrongly, spelt out differently from the corrections.
MADE: dict[str, Callable[[Pose, Pose], tuple[Pose, Pose]]] = {
    "world-to-camera": _each(_inverted), "opencv-extrinsics": _each(lambda pose: _inverted(_opencv(pose))),
    "rotation-transposed": _each(lambda pose: Pose(pose.rotation.T, pose.position)),
    "translation-for-position": _each(lambda pose: Pose(pose.rotation, -pose.rotation.T @ pose.position)),
    "images-swapped": lambda first, second: (second, first), "opencv-axes": _each(_opencv),
    "centre-at-edge": _each(_half_turned), "second-centre-at-edge": lambda first, second: (first, _half_turned(second)),
    "z-up-camera": _each(_with_axes(1, -3, 2)), "mirrored-x": _each(_mirrored(0)), "mirrored-y": _each(_mirrored(1)),
    "mirrored-z": _each(_mirrored(2)),
    "position-yz-swapped": _each(lambda pose: Pose(pose.rotation, pose.position[[0, 2, 1]])),
    "position-x-mirrored": _each(lambda pose: Pose(pose.rotation, pose.position * [-1, 1, 1])),
    "position-negated": _each(lambda pose: Pose(pose.rotation, -pose.position)),
    "quaternion-order": _each(_scalar_last), "degrees-for-radians": _each(_degrees_taken_for_radians),
}  # fmt: skip
