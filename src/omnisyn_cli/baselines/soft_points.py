"""Soft points: every source pixel is a disc that fades towards its rim, blended from front to back (SynSin).

A disc has one angle, that of ``radius`` target rows: it covers more columns towards the poles, wraps at the seam and
reaches over the poles. With the chord d between the centre of a pixel and that of a disc, in radii, its opacity is ``1
− d``; a pixel is ``Σ αₖ·fₖ·Π_{j<k}(1 − αⱼ)`` over the nearest points of all panoramas, the nearest first. Towards the
poles only as many pixels are points as on the same length at the equator (:func:`even_points`).

Source: Wiles et al., SynSin (CVPR 2020), section 3.2 and its programs (radius 4, exponent 1), there on a plane.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32

from omnisyn_cli.compute.jit import kernel, subkernel
from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import direction_tables, pixel_scale

POINT_RADIUS_ROWS = 4.0  # rows of the target that a disc reaches over
POINTS_PER_PIXEL = 32  # how many points a pixel is made of at most: what is behind them is worth less than 1 in 1000
GOLDEN_RATIO = 0.5 * (5.0**0.5 - 1.0)  # multiples of it, modulo 1, keep away from each other
# Least squared distance in radii: no point is quite opaque, so that gradients reach what is behind it.
MIN_DIVISOR_OPACITY = 1e-3
NO_POINT = -1  # index that says that no further point covers a pixel


@dataclass(frozen=True)
class Cloud:
    """A panorama as points."""

    features: Float32[np.ndarray, "height width channels"]  # of every pixel
    inverse_depth: Float[np.ndarray, "height width"]  # 1/metre, finite and >= 0; 0 is infinitely far
    target_from_source: Pose  # rigid transform from the panorama's camera frame to the target's
    mask: Bool[np.ndarray, "height width"] | None = None  # False where a pixel is no point


@dataclass(frozen=True)
class PointLists:
    """Which points each pixel of a target sees."""

    # per point cosine and sine of its polar angle, column and inverse depth in the target
    points: Float[np.ndarray, "points 4"]
    # per pixel the indices of the points that cover it, the nearest first, then -1
    found: Int32[np.ndarray, "rows cols most"]


def disc_angle(radius: float, rows: int) -> float:
    """Radians from the centre of a disc to its rim."""
    return radius * math.pi / rows


def even_points(height: int, width: int) -> Bool[np.ndarray, "height width"]:
    """Pixels that are points: a row's share of the equator, evenly spread, begun elsewhere in every row."""
    share = direction_tables(height, width)[0][:, None]
    begin, column = GOLDEN_RATIO * np.arange(height)[:, None] % 1.0, np.arange(width)
    return np.asarray(np.floor(begin + (column + 1) * share) > np.floor(begin + column * share))


def list_visible(
    inverse_depths: Sequence[Float[np.ndarray, "height width"]], target_from_sources: Sequence[Pose],
    size: tuple[int, int], masks: Sequence[Bool[np.ndarray, "height width"] | None] | None = None, *,
    radius: float = POINT_RADIUS_ROWS, most: int = POINTS_PER_PIXEL, threads: int | None = None,
) -> PointLists:  # fmt: skip
    """The nearest points that cover each pixel of a target of ``size = (rows, cols)``, whatever ``threads``.

    Points count on from panorama to panorama, of equals the smaller index first; none at the target's centre.
    """
    projected: list[np.ndarray] = []
    masks = masks or [None] * len(inverse_depths)
    for inverse_depth, mask, pose in zip(inverse_depths, masks, target_from_sources, strict=True):
        even = even_points(*inverse_depth.shape)
        shown = even if mask is None else even & mask
        projected.append(projected_points(inverse_depth, shown, pose, size, threads).reshape(-1, 4))
    points = np.concatenate(projected)
    order = np.argsort(-points[:, 3], kind="stable")
    order = order[points[order, 3] >= 0.0].astype(np.int32)
    found = np.empty((*size, most), np.int32)
    sin_p, cos_p, _, _ = direction_tables(*size)
    angle = disc_angle(radius, size[0])
    run_ranges(lambda begin, end: list_points(points, order, angle, sin_p, cos_p, found, begin, end), size[0], threads)
    return PointLists(points, found)


def projected_points(
    inverse_depth: np.ndarray, mask: np.ndarray, pose: Pose, size: tuple[int, int], threads: int | None
) -> np.ndarray:
    """Per point ``(cos polar, sin polar, column, inverse depth)`` in the target."""
    points = np.empty((*inverse_depth.shape, 4))
    tables = direction_tables(*inverse_depth.shape)
    rotation, translation = np.ascontiguousarray(pose.rotation), np.ascontiguousarray(pose.position)
    scale = np.array(pixel_scale(size))

    def band(begin: int, end: int) -> None:
        project_points(inverse_depth, mask, *tables, rotation, translation, scale, points, begin, end)

    run_ranges(band, len(points), threads)
    return points


def splat(
    clouds: Sequence[Cloud], size: tuple[int, int], *, radius: float = POINT_RADIUS_ROWS, most: int = POINTS_PER_PIXEL,
    threads: int | None = None,
) -> Float32[np.ndarray, "rows cols channels+1"]:  # fmt: skip
    """Features that a target sees, and last their opacity in [0, 1); discs of ``radius`` rows, ``most`` per pixel."""
    lists = list_visible(
        [cloud.inverse_depth for cloud in clouds], [cloud.target_from_source for cloud in clouds], size,
        [cloud.mask for cloud in clouds], radius=radius, most=most, threads=threads,
    )  # fmt: skip
    features = np.concatenate([cloud.features.reshape(-1, cloud.features.shape[-1]) for cloud in clouds])
    return blend(lists, features, radius=radius, threads=threads)


def blend(
    lists: PointLists, features: Float[np.ndarray, "points channels"], *, radius: float, threads: int | None = None
) -> Float32[np.ndarray, "rows cols channels+1"]:
    """:func:`splat` of points that are listed already, with the same radius."""
    rows, cols = lists.found.shape[:2]
    features = np.ascontiguousarray(features, np.float32)
    out = np.empty((rows, cols, features.shape[1] + 1), np.float32)
    sin_p, cos_p, _, _ = direction_tables(rows, cols)
    angle = disc_angle(radius, rows)

    def band(begin: int, end: int) -> None:
        composite(lists.points, lists.found, features, angle, MIN_DIVISOR_OPACITY, sin_p, cos_p, out, begin, end)

    run_ranges(band, rows, threads)
    return out


@kernel()
def project_points(rho, mask, sin_p, cos_p, sin_a, cos_a, rotation, t, scale, points, begin, end):  # type: ignore[no-untyped-def]
    """Cosine and sine of the polar angle, column and inverse depth in the target, for source rows of points.

    They are written into ``points``, ``(height, width, 4)``, for source rows from ``begin`` to before ``end``; points
    that are masked or lie at the target's centre get a negative inverse depth. ``rho`` is the inverse depth of the
    source, 1/metre, ``mask`` tells which pixels are points. ``sin_p`` and ``cos_p`` are of the polar angle per source
    row, ``sin_a`` and ``cos_a`` of the azimuth per column; ``rotation`` and ``t`` (metres) of the target camera from
    the source camera; ``scale`` is the target's, see :func:`omnisyn_cli.geometry.sphere.pixel_scale`.
    """
    width = rho.shape[1]
    for row in range(begin, end):
        sp, y = np.float64(sin_p[row]), np.float64(cos_p[row])
        for col in range(width):
            x, z, w = sp * sin_a[col], -sp * cos_a[col], np.float64(rho[row, col])
            vx = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + w * t[0]
            vy = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + w * t[1]
            vz = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + w * t[2]
            length = math.sqrt(vx * vx + vy * vy + vz * vz)
            seen = mask[row, col] and length > 1e-9
            shrink = 1.0 / length if seen else 0.0
            points[row, col, 0] = vy * shrink
            points[row, col, 1] = math.sqrt(vx * vx + vz * vz) * shrink
            points[row, col, 2] = math.atan2(vx, -vz) * scale[2] + scale[3]
            points[row, col, 3] = w * shrink if seen else -1.0


@subkernel()
def disc_rows(point, radius, height, begin, end):  # type: ignore[no-untyped-def]
    """First and last row that a disc of angle ``radius`` around a point can touch."""
    polar = math.atan2(point[1], point[0])
    scale = height / math.pi
    first = math.ceil((polar - radius) * scale - 0.5)
    last = math.floor((polar + radius) * scale - 0.5)
    return max(begin, first), min(end - 1, last)


@subkernel()
def disc_columns(point, cos_radius, sp, cp, width):  # type: ignore[no-untyped-def]
    """First and last column of a row in a disc (spherical law of cosines); all with the pole, none beside it."""
    excess = cos_radius - cp * point[0]
    ring = sp * point[1]
    if excess > ring:
        return 0, -1
    if excess <= -ring:
        return 0, width - 1
    half = math.acos(excess / ring) * (width / (2.0 * math.pi))
    return math.ceil(point[2] - half), min(math.floor(point[2] + half), math.ceil(point[2] - half) + width - 1)


@kernel()
def list_points(points, order, radius, sin_p, cos_p, found, begin, end):  # type: ignore[no-untyped-def]
    """Indices of the first points in ``order`` over each pixel of target rows; :data:`NO_POINT` after the last."""
    height, width, most = found.shape
    found[begin:end] = NO_POINT
    count = np.zeros((end - begin, width), np.int32)
    cos_radius = math.cos(radius)
    for k in range(order.shape[0]):
        point = points[order[k]]
        first, last = disc_rows(point, radius, height, begin, end)
        for row in range(first, last + 1):
            left, right = disc_columns(point, cos_radius, sin_p[row], cos_p[row], width)
            for turned in range(left, right + 1):
                col = turned % width
                here = count[row - begin, col]
                if here < most:
                    found[row, col, here] = order[k]
                    count[row - begin, col] = here + 1


@kernel()
def composite(points, found, features, radius, floor, sin_p, cos_p, out, begin, end):  # type: ignore[no-untyped-def]
    """Blend the listed points from front to back; the last channel of ``out`` gets the opacity of all together.

    ``points`` are those of :func:`project_points`; ``found`` has their indices, ``(height, width, most)``, front to
    back, :data:`NO_POINT` after the last; ``features`` are ``(points, channels)``. Discs have a ``radius`` in radians;
    ``floor`` is the least squared distance from a disc's centre over its squared radius, which bounds the opacity below
    1. ``sin_p`` and ``cos_p`` are of the polar angle per target row; rows from ``begin`` to before ``end`` of ``out``,
    ``(height, width, channels + 1)``, are written.
    """
    width, most = found.shape[1], found.shape[2]
    channels = features.shape[1]
    largest = (2.0 * math.sin(0.5 * radius)) ** 2
    for row in range(begin, end):
        for col in range(width):
            left = 1.0
            out[row, col] = 0.0
            for k in range(most):
                index = found[row, col, k]
                if index == NO_POINT:
                    break
                point = points[index]
                turn = math.cos((col - point[2]) * (2.0 * math.pi / width))
                square = (2.0 - 2.0 * (cos_p[row] * point[0] + sin_p[row] * point[1] * turn)) / largest
                alpha = 1.0 - math.sqrt(min(max(square, floor), 1.0))
                share = np.float32(left * alpha)
                left *= 1.0 - alpha
                for channel in range(channels):
                    out[row, col, channel] += share * features[index, channel]
            out[row, col, channels] = 1.0 - left
