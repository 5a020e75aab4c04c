"""Axes of other programs: which way their cameras look and which way their worlds have up, taken to ours and back.

Every format says camera-to-world or its inverse, in axes of its own. A pose of ours is
``ours_from_world · world_from_camera · camera_from_ours`` with one matrix for the world and one for the camera, both
rotations: what is left-handed (ZInD) is mirrored by its own reader.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, nearest_rotation, rotation_from_quaternion, rotation_taking

__all__ = [
    "CAMERA_AXES",
    "WORLD_UP",
    "checked_quaternion",
    "checked_rotation",
    "foreign_from_pose",
    "leveled",
    "pose_from_foreign",
]

UNIT_TOLERANCE = 1e-3
"""How far from unit length a quaternion, and from orthonormal a matrix, may be written."""

CAMERA_AXES = {
    "opengl": np.eye(3),
    "opencv": np.diag([1.0, -1.0, -1.0]),
    "flu": np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
}
"""``camera_from_ours``: opengl x right, y up, −z forward (ours); opencv x right, y down, z forward; flu x forward,
y left, z up (ROS bodies)."""

WORLD_UP = {
    "y": np.eye(3),
    "-y": np.diag([1.0, -1.0, -1.0]),
    "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "-z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}
"""``ours_from_world`` by the world's axis that points up; x stays x. With z up, y (north) becomes −z."""


def pose_from_foreign(
    world_from_camera: Float[np.ndarray, "3 3"], position: Float[np.ndarray, " 3"], *, camera: str, up: str
) -> Pose:
    """Our pose of a camera-to-world rotation and an optical centre in the axes ``camera`` and ``up`` name."""
    ours_from_world = WORLD_UP[up]
    return Pose(ours_from_world @ world_from_camera @ CAMERA_AXES[camera], ours_from_world @ position)


def foreign_from_pose(pose: Pose, *, camera: str, up: str) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    """Camera-to-world rotation and optical centre in other axes: the inverse of :func:`pose_from_foreign`."""
    world_from_ours = WORLD_UP[up].T
    return world_from_ours @ pose.rotation @ CAMERA_AXES[camera].T, world_from_ours @ pose.position


def leveled(poses: Sequence[Pose]) -> list[Pose]:
    """The same poses in a world whose y axis is the mean of the cameras' own: level where cameras were held level.

    Raises:
        PoseError: the cameras' up directions cancel each other out.
    """
    mean_up = np.mean([pose.rotation[:, 1] for pose in poses], axis=0)
    length = float(np.linalg.norm(mean_up))
    if length < UNIT_TOLERANCE:
        raise PoseError("expected cameras held roughly upright, got directions that cancel out; choose --up by axis")
    turn = Pose(rotation_taking(mean_up / length, np.array([0.0, 1.0, 0.0])), np.zeros(3))
    return [turn @ pose for pose in poses]


def checked_rotation(where: str, matrix: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """The rotation that a matrix of limited precision stands for.

    Raises:
        PoseError: scale, shear, a mirror image, NaN; ``where`` begins the message.
    """
    deviation = float(np.abs(matrix.T @ matrix - np.eye(3)).max())
    if not deviation <= UNIT_TOLERANCE:
        raise PoseError(
            f"{where}: expected a rotation (RᵀR = 1 within {UNIT_TOLERANCE:g}), got a deviation of {deviation:.3g}; "
            "check the format, or remove scale and shear"
        )
    if np.linalg.det(matrix) < 0:
        raise PoseError(f"{where}: expected a rotation (determinant +1), got a mirror image (−1); check the format")
    return nearest_rotation(matrix)


def checked_quaternion(where: str, quaternion: Float[np.ndarray, " 4"]) -> Float[np.ndarray, "3 3"]:
    """Rotation matrix of a quaternion ``[w, x, y, z]`` of about unit length.

    Raises:
        PoseError: another length; ``where`` begins the message.
    """
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1.0) <= UNIT_TOLERANCE:
        raise PoseError(f"{where}: expected a unit quaternion, got length {length:.6g}; check the order of the columns")
    return rotation_from_quaternion(quaternion)
