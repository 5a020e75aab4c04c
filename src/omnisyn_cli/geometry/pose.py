"""Rigid poses: where a panorama was taken and how it was held.

A :class:`Pose` takes vectors of the camera's frame to the world: ``x_world = rotation · x_camera + position``.
Frames stand in the names: ``a_from_b`` takes coordinates in b to coordinates in a; ``a_from_c = a_from_b @ b_from_c``.
Axes are those of :mod:`omnisyn_cli.geometry.sphere`; angles are radians, lengths metres, arrays float64.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

SAME_POSITION_METRES = 1e-6  # panoramas closer than this were taken from one position: no survey is so exact
SMALL_ANGLE = 1e-8  # below this (radians) sin(x)/x is 1 in float64, as x²/6 is below its rounding error

# Of the ellipsoid of WGS84: metres from its centre to the equator, and 2f − f² of its flattening f.
SEMI_MAJOR_AXIS, ECCENTRICITY_SQUARED = 6378137.0, (2.0 - 1.0 / 298.257223563) / 298.257223563

Rotations = Float[np.ndarray, "*#batch 3 3"]


@dataclass(frozen=True)
class Pose:
    """Camera-to-world transform."""

    rotation: Float[np.ndarray, "*batch 3 3"]  # orthonormal, determinant +1
    position: Float[np.ndarray, "*batch 3"]  # optical centre in the world, metres

    @staticmethod
    def identity() -> "Pose":
        """The pose of a camera at the origin that looks along −z."""
        return Pose(np.eye(3), np.zeros(3))

    def __matmul__(self, other: "Pose") -> "Pose":
        """``a_from_c = a_from_b @ b_from_c``."""
        return Pose(self.rotation @ other.rotation, self.transform(other.position))

    def inverse(self) -> "Pose":
        """``b_from_a`` of ``a_from_b``."""
        transposed = np.swapaxes(self.rotation, -1, -2)
        return Pose(transposed, -np.squeeze(transposed @ self.position[..., None], -1))

    def transform(self, points: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*moved 3"]:
        """Points taken from the camera's frame to the world; their batch axes broadcast against the pose's."""
        return np.asarray(np.squeeze(self.rotation @ points[..., None], -1) + self.position)

    def almost_equals(self, other: "Pose", *, metres: float = 1e-9, radians: float = 1e-9) -> bool:
        """Whether both poses agree everywhere within the given tolerances."""
        moved = np.linalg.norm(self.position - other.position, axis=-1)
        turned = rotation_angle(np.swapaxes(self.rotation, -1, -2) @ other.rotation)
        return bool(np.all(moved <= metres) and np.all(turned <= radians))


def distance_between(first: Pose, second: Pose) -> float:
    """Metres from one camera to the other."""
    return float(np.linalg.norm(second.position - first.position))


def at_same_position(first: Pose, second: Pose) -> bool:
    """Whether two panoramas were taken from one position, within :data:`SAME_POSITION_METRES`: no parallax."""
    return distance_between(first, second) <= SAME_POSITION_METRES


def rotation_from_quaternion(quaternion: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 3 3"]:
    """Rotation matrix of a quaternion ``[w, x, y, z]`` of any length but zero (it is normalised)."""
    w, x, y, z = np.moveaxis(quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True), -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_from_rotation(rotation: Float[np.ndarray, "*batch 3 3"]) -> Float[np.ndarray, "*batch 4"]:
    """Unit ``[w, x, y, z]``, w >= 0: the longest column of ``4·q·qᵀ``, so that no rotation angle is special."""
    m = rotation
    m00, m11, m22 = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    x, y, z = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    rows = (
        (1 + m00 + m11 + m22, x, y, z), (x, 1 + m00 - m11 - m22, xy, xz),
        (y, xy, 1 - m00 + m11 - m22, yz), (z, xz, yz, 1 - m00 - m11 + m22),
    )  # fmt: skip
    outer = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    longest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    column = np.take_along_axis(outer, longest[..., None, None], axis=-2)[..., 0, :]
    quaternion: np.ndarray = column / np.linalg.norm(column, axis=-1, keepdims=True)
    return np.where(quaternion[..., :1] < 0, -quaternion, quaternion)


def rotation_from_rotation_vector(vector: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3 3"]:
    """Rotation by ``|vector|`` radians about ``vector`` (the exponential map)."""
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    half = 0.5 * angle
    is_small = angle < SMALL_ANGLE
    sine_over_angle = np.where(is_small, 0.5, np.sin(half) / np.where(is_small, 1.0, angle))
    return rotation_from_quaternion(np.concatenate([np.cos(half), vector * sine_over_angle], axis=-1))


def rotation_vector_from_rotation(rotation: Float[np.ndarray, "*batch 3 3"]) -> Float[np.ndarray, "*batch 3"]:
    """The rotation vector with an angle in [0, π] (the logarithm); at exactly π either axis is a right answer."""
    quaternion = quaternion_from_rotation(rotation)
    sine = np.linalg.norm(quaternion[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, quaternion[..., :1])
    is_small = sine < SMALL_ANGLE
    return np.asarray(quaternion[..., 1:] * np.where(is_small, 2.0, angle / np.where(is_small, 1.0, sine)))


def rotation_angle(rotation: Float[np.ndarray, "*batch 3 3"]) -> Float[np.ndarray, "*batch"]:
    """Angle of a rotation in radians, in [0, π]."""
    return np.asarray(np.linalg.norm(rotation_vector_from_rotation(rotation), axis=-1))


def slerp(first: Rotations, second: Rotations, t: float | Float[np.ndarray, "*#batch"]) -> Rotations:
    """The rotation a share ``t`` of the shortest way from ``first`` to ``second``; exact at 0 and 1."""
    share = np.asarray(t)[..., None]
    turn = rotation_vector_from_rotation(np.swapaxes(first, -1, -2) @ second)
    between = first @ rotation_from_rotation_vector(share * turn)
    return np.where(share[..., None] == 0, first, np.where(share[..., None] == 1, second, between))


def interpolate_pose(first: Pose, second: Pose, t: float) -> Pose:
    """Straight line in position, shortest turn in rotation; exact at 0 and 1."""
    position = (1.0 - t) * first.position + t * second.position
    return Pose(slerp(first.rotation, second.rotation, t), position)


def rotation_from_heading(heading: float, pitch: float = 0.0, roll: float = 0.0) -> Float[np.ndarray, "3 3"]:
    """World-from-camera rotation of a compass heading of the image centre (all radians); x east, y up, −z north.

    ``heading`` is clockwise from north seen from above, ``pitch`` lifts the centre above the horizon, ``roll`` turns
    the camera clockwise about its line of sight. Source: GPano XMP ``PoseHeadingDegrees`` and its like.
    """
    vectors = np.array([[0.0, -heading, 0.0], [pitch, 0.0, 0.0], [0.0, 0.0, -roll]])
    about_up, about_right, about_forward = map(rotation_from_rotation_vector, vectors)
    return np.asarray(about_up @ about_right @ about_forward)


def heading_from_rotation(rotation: Float[np.ndarray, "3 3"]) -> tuple[float, float, float]:
    """The inverse of :func:`rotation_from_heading`, heading in [0, 2π); rounding decides straight up and down."""
    forward = -rotation[:, 2]
    heading = math.atan2(forward[0], -forward[2])
    pitch = math.asin(min(max(float(forward[1]), -1.0), 1.0))
    about_forward = rotation_from_heading(heading, pitch).T @ rotation
    roll = math.atan2(about_forward[0, 1], about_forward[0, 0])
    return heading % math.tau, pitch, roll


def enu_from_geographic(
    latitude: float, longitude: float, altitude: float, origin: tuple[float, float, float]
) -> Float[np.ndarray, " 3"]:
    """East, north and up in metres of a WGS84 position seen from ``origin`` (latitude, longitude, altitude).

    Degrees and metres; earth-centred on the way, so that it holds at the poles and across the date line. Source: WGS84;
    the Navipedia article "Transformations between ECEF and ENU coordinates".
    """
    return np.asarray(enu_axes(*origin[:2]) @ (ecef_position(latitude, longitude, altitude) - ecef_position(*origin)))


def enu_axes(latitude: float, longitude: float) -> Float[np.ndarray, "3 3"]:
    """East, north and up at a place in degrees, as rows in earth-centred axes."""
    phi, lam = math.radians(latitude), math.radians(longitude)
    sin_phi, cos_phi, sin_lam, cos_lam = math.sin(phi), math.cos(phi), math.sin(lam), math.cos(lam)
    east, north = [-sin_lam, cos_lam, 0.0], [-sin_phi * cos_lam, -sin_phi * sin_lam, cos_phi]
    up = [cos_phi * cos_lam, cos_phi * sin_lam, sin_phi]
    return np.array([east, north, up])


def ecef_position(latitude: float, longitude: float, altitude: float) -> Float[np.ndarray, " 3"]:
    """Earth-centred metres of a WGS84 position in degrees and metres."""
    phi, lam = math.radians(latitude), math.radians(longitude)
    normal = SEMI_MAJOR_AXIS / math.sqrt(1.0 - ECCENTRICITY_SQUARED * math.sin(phi) ** 2)
    ring = (normal + altitude) * math.cos(phi)
    return np.array(
        [ring * math.cos(lam), ring * math.sin(lam), (normal * (1.0 - ECCENTRICITY_SQUARED) + altitude) * math.sin(phi)]
    )


def geographic_from_ecef(position: Float[np.ndarray, " 3"]) -> tuple[float, float, float]:
    """Latitude and longitude in degrees and altitude in metres: the inverse of :func:`ecef_position` near the earth."""
    x, y, z = position.tolist()
    ring, phi = math.hypot(x, y), math.atan2(z, math.hypot(x, y))
    for _ in range(8):  # each takes the error to a 150th of what it was
        normal = SEMI_MAJOR_AXIS / math.sqrt(1.0 - ECCENTRICITY_SQUARED * math.sin(phi) ** 2)
        phi = math.atan2(z + ECCENTRICITY_SQUARED * normal * math.sin(phi), ring)
    altitude = ring * math.cos(phi) + z * math.sin(phi) - SEMI_MAJOR_AXIS**2 / normal
    return math.degrees(phi), math.degrees(math.atan2(y, x)), altitude


def enu_from_ecef(origin: tuple[float, float, float]) -> Pose:
    """From earth-centred axes to the local ones of an origin: x east, y north, z up."""
    axes = enu_axes(*origin[:2])
    return Pose(axes, -axes @ ecef_position(*origin))


def nearest_rotation(matrix: Float[np.ndarray, "*batch 3 3"]) -> Float[np.ndarray, "*batch 3 3"]:
    """The rotation closest to a matrix that is nearly one (orthogonal Procrustes)."""
    u, _, vt = np.linalg.svd(matrix)
    sign = np.linalg.det(u @ vt)
    u[..., :, -1] *= sign[..., None]
    return np.asarray(u @ vt)


def rotation_taking(source: Float[np.ndarray, " 3"], target: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """The smallest rotation from one unit vector to another; of opposite ones about one fixed orthogonal axis."""
    axis, cosine = np.cross(source, target), float(np.dot(source, target))
    sine = float(np.linalg.norm(axis))
    if sine < SMALL_ANGLE:
        if cosine > 0:
            return np.eye(3)
        axis = np.cross(source, np.eye(3)[np.argmin(np.abs(source))])
        return rotation_from_rotation_vector(axis / np.linalg.norm(axis) * math.pi)
    return rotation_from_rotation_vector(axis / sine * math.atan2(sine, cosine))
