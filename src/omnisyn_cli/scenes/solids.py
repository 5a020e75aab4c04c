"""The unit shapes that scenes are made of, as triangles. Each fills the cube [-1, 1]³ as far as it can."""

from enum import IntEnum
from itertools import product

import numpy as np
from jaxtyping import Float32, Int32, Int64

SEGMENTS = 24
"""Around what is round; a radius is at most 0.9 % too short between them."""


class Shape(IntEnum):
    """Of what kind a shape is; the axes of cylinder and cone are the local y."""

    BOX = 0
    ELLIPSOID = 1
    CYLINDER = 2
    CONE = 3


PACKED_SHAPE = np.dtype([
    ("kind", "i8"), ("centre", "f8", 3), ("rotation", "f8", (3, 3)), ("half", "f8", 3), ("material", "i8", 2),
    ("tint", "f8"), ("casts_shadow", "?"), ("variation", "i8"),
])  # fmt: skip
"""One shape of a scene.

``rotation`` is world from local, ``half`` the half sizes in metres. ``material`` has the rows of the materials of the
sides and of the faces up and down (of boxes, cylinders and cones). ``tint`` is a factor on the colours, ``variation``
makes two shapes of one material differ.
"""


def _box() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    corners = np.array(list(product((-1.0, 1.0), repeat=3)))
    quads = np.array([(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)])
    return corners, quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3), np.repeat([0, 1, 2], 4)


def _lathe(radii: np.ndarray, heights: np.ndarray, axes: list[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rings around y from the bottom to the top, and the axes of what lies between them."""
    angle = 2.0 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    x, z, y = radii[:, None] * np.sin(angle), radii[:, None] * np.cos(angle), np.repeat(heights, SEGMENTS)
    ring = np.arange(len(radii) * SEGMENTS).reshape(-1, SEGMENTS)
    a, b, c, d = ring[:-1], np.roll(ring, -1, axis=1)[:-1], ring[1:], np.roll(ring, -1, axis=1)[1:]
    faces = np.stack([a, b, d, a, d, c], axis=-1).reshape(-1, 3)
    return np.stack([x.ravel(), y, z.ravel()], axis=1), faces, np.repeat(axes, 2 * SEGMENTS)


_LATITUDES = np.linspace(np.pi, 0.0, SEGMENTS // 2 + 1)

UNIT_SHAPES = {
    Shape.BOX: _box(),
    Shape.ELLIPSOID: _lathe(np.sin(_LATITUDES), np.cos(_LATITUDES), [0] * (SEGMENTS // 2)),
    Shape.CYLINDER: _lathe(np.array([0.0, 1.0, 1.0, 0.0]), np.array([-1.0, -1.0, 1.0, 1.0]), [1, 0, 1]),
    Shape.CONE: _lathe(np.array([0.0, 1.0, 0.0]), np.array([-1.0, -1.0, 1.0]), [1, 0]),
}
"""Vertices, faces and the axis of each face: the local axis that it faces, 1 up and down; 0 where it is curved."""


def triangles(
    shapes: np.ndarray,
) -> tuple[
    Float32[np.ndarray, "vertices 3"], Int32[np.ndarray, "faces 3"],
    Int64[np.ndarray, " faces"], Int64[np.ndarray, " faces"],
]:  # fmt: skip
    """Vertices (metres) and faces of records of :data:`PACKED_SHAPE`, and the shape and the axis of each face."""
    vertices, faces, owners, axes, count = [], [], [], [], 0
    for kind, (corners, corner_faces, face_axes) in UNIT_SHAPES.items():
        members = np.flatnonzero(shapes["kind"] == kind)
        of_kind = shapes[members]
        placed = (corners * of_kind["half"][:, None]) @ np.swapaxes(of_kind["rotation"], 1, 2)
        vertices.append((placed + of_kind["centre"][:, None]).reshape(-1, 3))
        first = count + len(corners) * np.arange(len(members))
        faces.append((corner_faces + first[:, None, None]).reshape(-1, 3))
        owners.append(np.repeat(members, len(corner_faces)))
        axes.append(np.tile(face_axes, len(members)))
        count += vertices[-1].shape[0]
    joined = (np.concatenate(parts) for parts in (vertices, faces, owners, axes))
    points, corners, owner, axis = joined
    return points.astype(np.float32), corners.astype(np.int32), owner, axis
