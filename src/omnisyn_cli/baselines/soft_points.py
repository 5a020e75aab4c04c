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

from omnisyn_cli.baselines.soft_point_kernels import composite, list_points, project_points
from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import direction_tables, pixel_scale

POINT_RADIUS_ROWS = 4.0  # rows of the target that a disc reaches over
POINTS_PER_PIXEL = 32  # how many points a pixel is made of at most: what is behind them is worth less than 1 in 1000
GOLDEN_RATIO = 0.5 * (5.0**0.5 - 1.0)  # multiples of it, modulo 1, keep away from each other
# Least squared distance in radii: no point is quite opaque, so that gradients reach what is behind it.
MIN_DIVISOR_OPACITY = 1e-3


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

    Points count on from panorama to panorama, the smaller index first of equally near ones; none at the target's
    centre.
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
