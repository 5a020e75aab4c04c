"""The pose that an entry of ``poses.json`` means, of either kind; see :mod:`omnisyn_cli.io.poses`."""

from __future__ import annotations

import math

import numpy as np

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import (
    Pose,
    enu_from_geographic,
    nearest_rotation,
    rotation_from_heading,
    rotation_from_quaternion,
)
from omnisyn_cli.io.pose_models import GeographicEntry, RigidEntry

__all__ = ["origin_of", "pose_of", "rigid_rotation"]

UNIT_TOLERANCE = 1e-3
"""How far from unit length a quaternion, and from orthonormal a matrix, may be written."""

POSITION_TOLERANCE = 1e-6


def pose_of(entry: RigidEntry | GeographicEntry, where: str, origin: tuple[float, float, float] | None) -> Pose:
    """Camera-to-world, metres.

    Args:
        entry: with keys and numbers of the right kinds.
        where: what errors call it.
        origin: latitude, longitude and altitude of the world's; None for those of the entry.

    Raises:
        PoseError: no pose, two of them, or none that is rigid.
    """
    if isinstance(entry, RigidEntry):
        return _rigid_pose(where, entry)
    return _geographic_pose(entry, origin or origin_of(entry))


def origin_of(entry: GeographicEntry) -> tuple[float, float, float]:
    """Latitude and longitude in degrees and altitude in metres: where a world may begin."""
    return entry.latitude, entry.longitude, entry.altitude


def _geographic_pose(entry: GeographicEntry, origin: tuple[float, float, float]) -> Pose:
    """Pose in the world with x east, y up, −z north at ``origin``.

    Headings are taken as if north were the same everywhere, which is right within arc seconds over a walk.
    """
    east, north, up = enu_from_geographic(entry.latitude, entry.longitude, entry.altitude, origin)
    angles = (math.radians(angle) for angle in (entry.heading, entry.pitch, entry.roll))
    return Pose(rotation_from_heading(*angles), np.array([east, up, -north]))


def _rigid_pose(where: str, entry: RigidEntry) -> Pose:
    if (entry.rotation is None) == (entry.matrix is None):
        found = "both" if entry.rotation else "neither"
        raise PoseError(f"{where}: expected either rotation or matrix, got {found}; write one of them")
    if entry.matrix is not None:
        return _matrix_pose(where, np.array(entry.matrix), entry.position)
    quaternion = np.array(entry.rotation)
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1) > UNIT_TOLERANCE:
        raise PoseError(
            f"{where}.rotation: expected a unit quaternion [w, x, y, z], got length {length:.6g}; "
            "divide it by its length"
        )
    return Pose(rotation_from_quaternion(quaternion), _position(where, entry.position))


def _position(where: str, position: list[float] | None) -> np.ndarray:
    if position is None:
        raise PoseError(f"{where}: expected the key 'position', got none; add it as [x, y, z] in metres")
    return np.array(position, float)


def _matrix_pose(where: str, matrix: np.ndarray, position: list[float] | None) -> Pose:
    """Pose of a 3×3 rotation with a position, or of a 4×4 transform."""
    if len(matrix) == 4:
        if np.abs(matrix[3] - (0, 0, 0, 1)).max() > POSITION_TOLERANCE:
            raise PoseError(
                f"{where}.matrix: expected a last row [0, 0, 0, 1], got {matrix[3].tolist()}; "
                "write it row by row, not transposed"
            )
        translation = matrix[:3, 3]
        if position is not None and np.abs(translation - position).max() > POSITION_TOLERANCE:
            raise PoseError(
                f"{where}: expected position to agree with the 4×4 matrix, got {position} and "
                f"{translation.tolist()}; remove position"
            )
        position = translation.tolist()
    return Pose(rigid_rotation(where, matrix[:3, :3]), _position(where, position))


def rigid_rotation(where: str, matrix: np.ndarray) -> np.ndarray:
    """The rotation closest to a 3×3 matrix that is nearly one.

    Raises:
        PoseError: the matrix scales, shears or mirrors.
    """
    deviation = float(np.abs(matrix.T @ matrix - np.eye(3)).max())
    if not deviation <= UNIT_TOLERANCE:
        raise PoseError(
            f"{where}.matrix: expected a rigid rotation (RᵀR = 1 within {UNIT_TOLERANCE:g}), got a deviation of "
            f"{deviation:.3g}; remove scale and shear"
        )
    if np.linalg.det(matrix) < 0:
        raise PoseError(
            f"{where}.matrix: expected a rotation (determinant +1), got a mirror image (−1); the axes are x right, "
            "y up, −z forward: flip two axes, not one"
        )
    return np.asarray(nearest_rotation(matrix), float)
