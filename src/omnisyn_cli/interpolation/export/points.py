"""The pixels of a surface as points, and as flat discs that lie in it (Gaussian splats)."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from omnisyn_cli.geometry.pose import Pose, quaternion_from_rotation
from omnisyn_cli.geometry.sampling import sample_bilinear
from omnisyn_cli.geometry.sphere import direction_tables, normalize, pixel_directions, pixel_scale, pixel_to_direction
from omnisyn_cli.render.mesh import Mesh
from omnisyn_cli.render.quad_blocks import BOTTOM, LEFT, TOP

DISC_RADIUS_SHARE, DISC_THICKNESS_SHARE = 0.55, 0.01
"""Standard deviation of a disc, in distances of its neighbours: four of them cover what lies between to 90 %. And its
thickness, in its radius. Half way through a warehouse radii of 0.5 and 0.55 are best (24.6 dB, 0.6 has 24.1), and 0.5
lets twice as much through."""

MIN_COSINE = 0.25
"""Between a surface's normal and the line of sight: what is seen at a smaller angle gets no longer discs."""

DISC_OPACITY = 0.99
ZEROTH_HARMONIC = 0.28209479177387814
"""The constant spherical harmonic, √(1/4π): colours are stored as what lies above one half, divided by it."""


@dataclass(frozen=True)
class Points:
    """Points of one or more panoramas in one world: metres, RGB, the confidence of their distances in [0, 1].

    Normals have length one and look towards the panorama. A radius is the standard deviations of a disc, in metres,
    along its first and second axis; a turn a quaternion w, x, y, z: world from disc, whose third axis is the normal.
    """

    position: Float[np.ndarray, "points 3"]
    colour: UInt8[np.ndarray, "points 3"]
    confidence: Float[np.ndarray, " points"]
    normal: Float[np.ndarray, "points 3"]
    radius: Float[np.ndarray, "points 2"]
    turn: Float[np.ndarray, "points 4"]

    def __len__(self) -> int:
        return len(self.position)


def joined(parts: Sequence[Points]) -> Points:
    """All points of several parts."""
    return Points(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Points)))


def points_of(
    mesh: Mesh, confidence: Float[np.ndarray, "height width"], picture: UInt8[np.ndarray, "rows cols 3"], pose: Pose,
    stride: int, farthest: float = np.inf,
) -> Points:  # fmt: skip
    """Points of a panorama, as dense on the sphere everywhere: fewer columns towards the poles.

    The confidence has the mesh's size, the picture any; the pose is that of the panorama in the world of the points.
    Points are ``stride`` pixels of the mesh apart. What is infinitely far, ``farthest`` metres or more away, or without
    a surface, is left out.
    """
    height, width = mesh.size
    row, col = _places(height, width, stride)
    rho = mesh.inverse_depth[row, col]
    kept = (rho > 0) & (rho * farthest > 1)
    row, col, rho = row[kept], col[kept], rho[kept].astype(np.float64)
    direction = pixel_to_direction(row, col, mesh.size)
    colour = _colours(picture, direction, max(height // stride, 1))
    normal = _normals(mesh)[row, col]
    turn, cosine = _facing(direction, normal)
    across = DISC_RADIUS_SHARE * stride / pixel_scale(mesh.size)[0] / rho
    radius = np.stack([across / np.maximum(cosine, MIN_COSINE), across], -1)
    return Points(
        pose.transform(direction / rho[:, None]), colour, confidence[row, col], normal @ pose.rotation.T, radius,
        quaternion_from_rotation(pose.rotation @ turn),
    )  # fmt: skip


def _colours(
    picture: UInt8[np.ndarray, "rows cols 3"], direction: Float[np.ndarray, "points 3"], rows: int
) -> UInt8[np.ndarray, "points 3"]:
    """What a panorama shows in some directions once it is reduced to so many rows, if it has more."""
    if len(picture) > rows:
        picture = np.asarray(cv2.resize(picture, (2 * rows, rows), interpolation=cv2.INTER_AREA))
    return np.asarray(np.rint(sample_bilinear(picture.astype(np.float32), direction)), np.uint8)


def _places(height: int, width: int, stride: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of vertices that are ``stride`` pixels of the equator apart, everywhere."""
    rows = np.arange(min(stride // 2, height - 1), height, stride)
    count = np.maximum(np.rint(width * direction_tables(height, width)[0][rows] / stride), 1).astype(np.int64)
    row = np.repeat(rows, count)
    step = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    return row, (2 * step + 1) * width // (2 * np.repeat(count, count))


def _normals(mesh: Mesh) -> Float[np.ndarray, "height width 3"]:
    """Unit normals towards the centre, of the neighbours that no cut separates; the line of sight where there are none.

    Of two neighbours on one line the one whose distance differs less counts.
    """
    rho = mesh.inverse_depth
    directions = pixel_directions(*mesh.size)
    points = directions / np.where(rho > 0, rho, 1.0)[..., None]
    beside, below = np.zeros(mesh.size, bool), np.zeros(mesh.size, bool)
    beside[:-1] = (mesh.quads & TOP) == 0
    beside[-1] = (mesh.quads[-1] & BOTTOM) == 0
    below[:-1] = (mesh.quads & LEFT) == 0
    present = rho > 0
    lines = []
    for axis, is_joined in ((1, beside), (0, below)):
        ahead = np.where(is_joined & present & np.roll(present, -1, axis), np.abs(np.roll(rho, -1, axis) - rho), np.inf)
        behind = np.roll(ahead, 1, axis)
        step = np.roll(points, -1, axis) - points
        chosen = np.where((ahead <= behind)[..., None], step, np.roll(step, 1, axis))
        lines.append(np.where(np.isfinite(np.minimum(ahead, behind))[..., None], chosen, 0.0))
    normal = np.asarray(normalize(np.cross(lines[0], lines[1])))
    normal = np.where((normal * directions).sum(-1, keepdims=True) > 0, -normal, normal)
    return np.where((normal == 0).all(-1, keepdims=True), -directions, normal)


def _facing(direction: np.ndarray, normal: np.ndarray) -> tuple[Float[np.ndarray, "points 3 3"], np.ndarray]:
    """Axes of discs, as columns: along the slope, across it, the normal; and the cosine of the angle it is seen at."""
    cosine = -(direction * normal).sum(-1)
    slope = direction + cosine[:, None] * normal
    flat = np.linalg.norm(slope, axis=1) < 1e-6
    least = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    slope = np.where(flat[:, None], least - (least * normal).sum(-1, keepdims=True) * normal, slope)
    along = np.asarray(normalize(slope))
    return np.stack([along, np.cross(normal, along), normal], -1), cosine


def ply_points(points: Points) -> np.ndarray:
    """Vertices of a PLY file: x, y, z, red, green, blue, confidence, nx, ny, nz."""
    return _structured({
        **_named(("x", "y", "z"), points.position, "<f4"), **_named(("nx", "ny", "nz"), points.normal, "<f4"),
        **_named(("red", "green", "blue"), points.colour, "u1"), "confidence": (points.confidence, "<f4"),
    })  # fmt: skip


def ply_splats(points: Points) -> np.ndarray:
    """Vertices of a PLY file as the authors of 3D Gaussian splatting write it, with colours of degree 0.

    Source: Kerbl et al., 3D Gaussian Splatting for Real-Time Radiance Field Layer, 2023; their ``save_ply``.
    """
    thin = DISC_THICKNESS_SHARE * points.radius[:, 1:]
    return _structured({
        **_named(("x", "y", "z"), points.position, "<f4"), **_named(("nx", "ny", "nz"), points.normal, "<f4"),
        **_named(("f_dc_0", "f_dc_1", "f_dc_2"), (points.colour / 255.0 - 0.5) / ZEROTH_HARMONIC, "<f4"),
        "opacity": (np.full(len(points), np.log(DISC_OPACITY / (1.0 - DISC_OPACITY))), "<f4"),
        **_named(("scale_0", "scale_1", "scale_2"), np.log(np.concatenate([points.radius, thin], axis=1)), "<f4"),
        **_named(("rot_0", "rot_1", "rot_2", "rot_3"), points.turn, "<f4"),
    })  # fmt: skip


def _named(names: tuple[str, ...], columns: np.ndarray, kind: str) -> dict[str, tuple[np.ndarray, str]]:
    return {name: (columns[:, k], kind) for k, name in enumerate(names)}


def _structured(columns: dict[str, tuple[np.ndarray, str]]) -> np.ndarray:
    """A record for each point."""
    kinds = [(name, kind) for name, (_, kind) in columns.items()]
    return np.rec.fromarrays([values for values, _ in columns.values()], dtype=kinds)
