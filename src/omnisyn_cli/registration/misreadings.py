"""Rotations whose numbers were misread: angles in the wrong unit or sense, quaternions in the wrong order."""

from __future__ import annotations

import math

import numpy as np

from omnisyn_cli.geometry.pose import (
    quaternion_from_rotation,
    rotation_from_heading,
    rotation_from_quaternion,
    rotation_from_rotation_vector,
    rotation_vector_from_rotation,
)
from omnisyn_cli.geometry.sphere import FORWARD, direction_to_angles

__all__ = ["angles_in_degrees", "angles_scaled", "heading_angles", "heading_reversed", "scalar_first"]

TURNS = 29
"""Full turns by which an angle of at most 180 passes when it is taken for radians."""

NO_TURN = 1e-9


def angles_in_degrees(rotation: np.ndarray) -> np.ndarray:
    """Rotations ``(n, 3, 3)`` about the same axis by what the angle may have been before it was taken for radians."""
    vector = rotation_vector_from_rotation(rotation)
    angle = float(np.linalg.norm(vector))
    if angle < NO_TURN:
        return rotation[None]
    degrees = angle + np.arange(-TURNS, TURNS + 1) * math.radians(360.0)
    degrees = degrees[np.abs(degrees) <= 180.0]
    return rotation_from_rotation_vector(np.radians(degrees)[:, None] * vector / angle)


def angles_scaled(rotation: np.ndarray) -> np.ndarray:
    """The rotation whose heading, pitch and roll in degrees are those of this one in radians."""
    return rotation_from_heading(*(math.degrees(angle) for angle in heading_angles(rotation)))


def heading_angles(rotation: np.ndarray) -> tuple[float, float, float]:
    """Heading, pitch and roll in radians; the inverse of :func:`rotation_from_heading`."""
    azimuth, polar_angle = direction_to_angles(rotation @ FORWARD)
    heading, pitch = float(azimuth), math.radians(90.0) - float(polar_angle)
    rest = rotation_vector_from_rotation(rotation_from_heading(heading, pitch).T @ rotation)
    return heading, pitch, float(rest @ FORWARD)


def heading_reversed(rotation: np.ndarray) -> np.ndarray:
    """The rotation with the heading counted the other way."""
    heading, pitch, roll = heading_angles(rotation)
    return rotation_from_heading(-heading, pitch, roll)


def scalar_first(rotation: np.ndarray) -> np.ndarray:
    """The rotation of a quaternion [x, y, z, w] that was read as [w, x, y, z]."""
    return rotation_from_quaternion(np.roll(quaternion_from_rotation(rotation), 1))
