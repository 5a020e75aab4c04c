"""Epipolar geometry on the sphere: what two directions say about where two panoramas were taken.

``first_from_second`` is the pose of the second camera in the frame of the first one; ``x₁ = R·x₂ + t``. Pictures tell
the direction of t but not its length, so t is a unit vector here: the direction in which the first panorama sees the
second camera. Two directions of one point fulfil ``d₁ · (t × R·d₂) = 0``.

Source: Hartley and Zisserman, Multiple View Geometry, chapter 9, with directions in place of pixels.
"""

import math

import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.geometry.pose import Pose, rotation_angle
from omnisyn_cli.geometry.sphere import normalize
from omnisyn_cli.poses.registration.features import Matches

STRAIGHT = 1e-12
"""Squared sine below which directions have no plane in common but all."""


def relative_pose(first: Pose, second: Pose) -> Pose:
    """``first_from_second`` with a unit vector between the cameras, or zero where they stand in one place."""
    pose = first.inverse() @ second
    return Pose(pose.rotation, np.asarray(normalize(pose.position)))


def epipolar_residual(first_from_second: Pose, matches: Matches) -> Float[np.ndarray, " n"]:
    """Signed angle in radians between each direction and the great circle that the other one gives it.

    The sine of the angle is taken as the quadratic mean of both sides, which is √2 times the first-order (Sampson)
    distance to the nearest pair of directions that fits; it stays bounded at the epipoles.
    """
    turned = matches.second @ first_from_second.rotation.T
    plane_of_second = np.cross(first_from_second.position, turned)
    plane_of_first = np.cross(matches.first, first_from_second.position)
    triple = np.einsum("ni,ni->n", matches.first, plane_of_second)
    squared = 0.5 * (np.sum(plane_of_second**2, axis=1) + np.sum(plane_of_first**2, axis=1))
    sine = triple / np.sqrt(np.where(squared > STRAIGHT, squared, 1.0))
    return np.asarray(np.arcsin(sine.clip(-1.0, 1.0)))


def is_in_front(first_from_second: Pose, matches: Matches, slack: float = 0.0) -> Bool[np.ndarray, " n"]:
    """Whether both cameras see each point where it is, not behind their backs (cheirality).

    With θ₁ and θ₂ the angles that the two directions make with t, a point in front has θ₂ > θ₁. Points that moved by
    less than ``slack`` radians are far away and count as in front.
    """
    t = first_from_second.position
    turned = matches.second @ first_from_second.rotation.T
    normal = np.cross(matches.first, turned)
    squared = np.sum(normal**2, axis=1)
    along_first = np.einsum("ni,ni->n", np.cross(t, turned), normal)
    along_second = np.einsum("ni,ni->n", np.cross(t, matches.first), normal)
    is_far = (squared <= math.sin(slack) ** 2) & (np.einsum("ni,ni->n", matches.first, turned) > 0)
    return np.asarray(((along_first > 0) & (along_second > 0)) | is_far)


def angle_between(a: Float[np.ndarray, "*batch 3"], b: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
    """Angle in radians between vectors of any length; exact for small ones."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1)))


def rotation_error(pose: Pose, truth: Pose) -> float:
    """Radians between the rotations of two relative poses."""
    return float(rotation_angle(truth.rotation.T @ pose.rotation))


def direction_error(pose: Pose, truth: Pose) -> float:
    """Radians between the directions to the second camera of two relative poses."""
    return float(angle_between(pose.position, truth.position))
