"""Soft surfaces for pairs that cannot be relied on: whole things in about the right place instead of torn ones.

Where depth is wrong, a sharp mesh tears the photographs into pieces that nobody has seen. A viewer forgives softness
and dissolves. So where the photographs do not confirm depth, both views get one common surface in its place: a smooth
one around the point half way, that a ray from there meets once. It follows what is confirmed and is continued between.
Around every direction a plane is fitted to it, so walls and floors stay straight. Things in front of them do not count.
Both photographs lie on it, so what is wrong with it is seen as a dissolve between two whole pictures.

It costs accuracy where depth was right after all: 0.4 to 3.4 dB on five generated rooms that score 0.16 to 0.3, 1.0 to
1.3 dB on three pairs of a corridor that score as much, 3 dB on seven yards, whose trees bend. So only pairs of next to
no confidence are softened, and only in places with a ceiling (docs/confidence.md).
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Float32, Int

from omnisyn_cli.fusion.confidence import compare_windows
from omnisyn_cli.geometry.pose import at_same_position, distance_between
from omnisyn_cli.geometry.sampling import filter_across_seam, sample_bilinear
from omnisyn_cli.geometry.sphere import UP, direction_to_pixel, normalize, pixel_directions, solid_angles
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.synthesis.consistency import CrossCheck, resized_to
from omnisyn_cli.types import DepthEstimate, Layer, View

# Score of a pair from which on it is not softened. Two real restaurants, which soft surfaces make whole again, have 0
# and 0.06.
MAX_SOFT_SCORE = 0.1
UNCUT = Cut(None, None)  # soft surfaces have no steps that stand for silhouettes
SURFACE_GRID = (32, 64)  # rows and columns of directions that planes are fitted around: 5.6 degrees each
# Rows and columns at which depth is read for the surface, and at which the surface is read for depth.
SAMPLE_GRID, RAY_GRID = (256, 512), (128, 256)

# Standard deviations of the windows that planes are fitted in, and their weights. Chosen by eye: at two thirds, windows
# of real rooms look wavy.
PLANE_WINDOWS_DEG, PLANE_WINDOW_WEIGHTS = (11.25, 22.5), (1.0, 0.1)

# Of the windows whose mean distance counts where nothing nearer is confirmed. A plane fitted so widely would pass
# behind the camera.
DISTANCE_WINDOWS_DEG, DISTANCE_WINDOW_WEIGHTS = (45.0, 112.5), (0.01, 1e-4)

# Errors in the logarithm of distance from which on depth hardly counts, from fit to fit: things in front of a wall, and
# what is seen through its windows.
OUTLIER_SCALES = (1.0, 0.5, 0.25, 0.25)
TILT_RIDGE = 0.004  # weight against planes that are tilted, relative to that of the depth around

# Reliability from which on depth stays as it is, and up to which the common surface takes its place. Chosen by eye on
# two real restaurants and a generated home: at 0.6 and 0.25 pieces remain, at 1.3 and 0.7 whole floors are lost.
KEPT_RELIABILITY, REPLACED_RELIABILITY = 0.9, 0.4
# Likeness of windows that confirms nothing, and how much more confirms all. Set by hand.
MIN_LIKENESS, LIKENESS_RANGE = 0.1, 0.5
# Standard deviation of grey values up to which a window is judged by colour, and how much more is by structure.
MIN_CONTRAST, CONTRAST_RANGE = 0.02, 0.04
# Difference of mean grey values in a window without contrast that confirms nothing. Set by hand.
MAX_COLOUR_DIFFERENCE = 0.12
UNSEEN_RELIABILITY = 0.6  # share of its confidence that depth keeps where the other view does not show the place
# In 1/baselines, added to the inverse distance that weights are divided by: near depth is less exact than far.
SAMPLE_OFFSET = 0.1
MIN_SAMPLE_WEIGHT = 1e-4  # of depth that nothing confirms: it counts only where nothing else is known
# Distances from the middle between which the surface is; the cameras stand at 0.5.
NEAREST_SURFACE_BASELINES, FARTHEST_SURFACE_BASELINES = 0.3, 1e3
SOFT_CONFIDENCE = 0.15  # confidence of soft depth: too little to hide the other view's surface (fusion/blend_rule.py)
# Inverse depth of the surface seen from a camera, in 1/(half baseline), between which it is looked for.
INVERSE_DEPTH_RANGE = (1e-3, 20.0)
BISECTIONS = 22  # halvings of that range: each leaves half of its logarithm, 10 / 2^22 in the end
# A place has a ceiling if this share of what lies higher above the horizon is nearer than so many baselines, as far as
# the other view confirms that: where pairs fail, the sky gets near depth as well. Two restaurants have 0.28 and 0.47, a
# corridor 0.38, five pairs of a campus at most 0.21.
MIN_CEILING_DEG, MAX_CEILING_BASELINES, MIN_CEILING_SHARE = 30.0, 10.0, 0.25

Depths = tuple[DepthEstimate, DepthEstimate]
Reliabilities = list[Float32[np.ndarray, "height width"]]


def soft_depths(views: tuple[View, View], depths: Depths, check: CrossCheck) -> Depths | None:
    """Depth of soft surfaces for a pair that scores next to nothing, at two places with a ceiling; None for others."""
    if check.confidence.score >= MAX_SOFT_SCORE or at_same_position(views[0].pose, views[1].pose):
        return None
    known = reliabilities(depths, check)
    return soften_pair(views, depths, known) if is_enclosed(views, depths, known) else None


def is_enclosed(views: tuple[View, View], depths: Depths, reliability: Reliabilities) -> bool:
    """Whether two views stand under a ceiling, so that a smooth surface around them can stand for the place."""
    baseline = distance_between(views[0].pose, views[1].pose)
    shares = []
    for view, depth, known in zip(views, depths, reliability, strict=True):
        size = depth.inverse_depth.shape
        height = pixel_directions(*size) @ view.pose.rotation.T @ UP
        above = solid_angles(*size) * (height > np.sin(np.radians(MIN_CEILING_DEG)))
        is_near = depth.inverse_depth * baseline * MAX_CEILING_BASELINES > 1.0
        shares.append(float((above * is_near * known).sum() / above.sum()))
    return min(shares) > MIN_CEILING_SHARE


def soften_pair(views: tuple[View, View], depths: Depths, reliability: Reliabilities) -> Depths:
    """The depth of both views, at two places, on a common smooth surface where the photographs do not confirm it."""
    surface = _common_surface(views, depths, reliability)
    first, second = (
        _softened(depth, known, _inverse_depth_of(surface, view, _middle(views)))
        for view, depth, known in zip(views, depths, reliability, strict=True)
    )
    return first, second


def _middle(views: tuple[View, View]) -> Float[np.ndarray, " 3"]:
    return np.asarray(0.5 * (views[0].pose.position + views[1].pose.position))


def reliabilities(depths: Depths, check: CrossCheck) -> Reliabilities:
    """How far each view's depth is confirmed by the other view, in [0, 1], at the size of the depth."""
    return [_reliability(depth, *layers) for depth, layers in zip(depths, check.crossed, strict=True)]


def _reliability(depth: DepthEstimate, photo: Layer, other: Layer) -> Float32[np.ndarray, "height width"]:
    windows = compare_windows(photo, other)
    structure = np.clip((windows.likeness - MIN_LIKENESS) / LIKENESS_RANGE, 0.0, 1.0)
    colour = np.clip(1.5 * (1.0 - windows.difference / MAX_COLOUR_DIFFERENCE), 0.0, 1.0)
    by_structure = np.clip((windows.contrast - MIN_CONTRAST) / CONTRAST_RANGE, 0.0, 1.0)
    confirmed = by_structure * structure + (1.0 - by_structure) * colour
    share = windows.seen * confirmed + (1.0 - windows.seen) * UNSEEN_RELIABILITY
    size = depth.confidence.shape
    return np.asarray(depth.confidence * resized_to(share.astype(np.float32), size, cv2.INTER_LINEAR), np.float32)


class SurfaceSamples(NamedTuple):
    """Points that a surface follows: unit vectors from the middle of two views, 1/baselines from there, and weights."""

    direction: Float32[np.ndarray, "samples 3"]
    inverse_distance: Float[np.ndarray, " samples"]
    weight: Float[np.ndarray, " samples"]


def _common_surface(
    views: tuple[View, View], depths: Depths, reliability: Reliabilities
) -> Float32[np.ndarray, "rows cols 3"]:
    """A smooth surface around the middle of two views: the plane that is fitted around every direction."""
    direction, inverse_distance, weight = _surface_samples(views, depths, reliability)
    row, col = (np.round(index).astype(np.intp) for index in direction_to_pixel(direction, SURFACE_GRID))
    cell = np.asarray(np.clip(row, 0, SURFACE_GRID[0] - 1) * SURFACE_GRID[1] + col % SURFACE_GRID[1])
    weight = weight / (inverse_distance + SAMPLE_OFFSET)
    sizes = (PLANE_WINDOWS_DEG, PLANE_WINDOW_WEIGHTS), (DISTANCE_WINDOWS_DEG, DISTANCE_WINDOW_WEIGHTS)
    windows = [_window_weights(*each) for each in sizes]
    # as long as the inverse distance in 1/baselines
    normals = _fit_planes(SurfaceSamples(direction, inverse_distance, weight), cell, *windows)
    for scale in OUTLIER_SCALES:  # again without what is far from them
        fitted = np.maximum((normals[cell] * direction).sum(axis=-1), 1.0 / FARTHEST_SURFACE_BASELINES)
        error = np.log(fitted / inverse_distance) / scale
        robust = SurfaceSamples(direction, inverse_distance, weight / (1.0 + error**2) ** 2)
        normals = _fit_planes(robust, cell, *windows)
    return np.asarray(normals.reshape(*SURFACE_GRID, 3), np.float32)


def _surface_samples(views: tuple[View, View], depths: Depths, reliability: Reliabilities) -> SurfaceSamples:
    """The points that both views see, each by its reliability."""
    middle, baseline = _middle(views), distance_between(views[0].pose, views[1].pose)
    samples = []
    for view, depth, known in zip(views, depths, reliability, strict=True):
        inverse_depth = resized_to(depth.inverse_depth, SAMPLE_GRID, cv2.INTER_NEAREST)
        weight = resized_to(known, SAMPLE_GRID, cv2.INTER_AREA) ** 2 + MIN_SAMPLE_WEIGHT
        rays = pixel_directions(*SAMPLE_GRID) @ view.pose.rotation.T
        away = 1.0 / np.maximum(inverse_depth, 1.0 / (FARTHEST_SURFACE_BASELINES * baseline))
        points = (rays * away[..., None] + (view.pose.position - middle)).reshape(-1, 3)
        distance = np.maximum(np.linalg.norm(points, axis=-1), NEAREST_SURFACE_BASELINES * baseline)
        area = (weight * solid_angles(*SAMPLE_GRID)).ravel()
        samples.append((normalize(points).astype(np.float32), baseline / distance, area))
    return SurfaceSamples(*(np.concatenate(each) for each in zip(*samples, strict=True)))


def _fit_planes(
    samples: SurfaceSamples, cell: Int[np.ndarray, " samples"],
    plane_window: Float32[np.ndarray, "cells cells"], distance_window: Float32[np.ndarray, "cells cells"],
) -> Float[np.ndarray, "cells 3"]:  # fmt: skip
    """Weighted least squares around every cell, by how much planes and how much mean distances of other cells count."""
    direction, inverse_distance, weight = samples
    centres = pixel_directions(*SURFACE_GRID).reshape(-1, 3)

    def sums(values: np.ndarray) -> Float[np.ndarray, " cells"]:
        return np.bincount(cell, values, len(centres))

    upper = np.triu_indices(3)
    products = np.stack([sums(weight * direction[:, i] * direction[:, j]) for i, j in zip(*upper, strict=True)], axis=1)
    right = plane_window @ np.stack([sums(weight * inverse_distance * along) for along in direction.T], axis=1)
    distances = np.stack([sums(weight), sums(weight * inverse_distance)], axis=1)
    known, wide = plane_window @ distances, distance_window @ distances
    matrix = wide[:, 0, None, None] * centres[:, :, None] * centres[:, None, :]
    matrix[:, upper[0], upper[1]] += plane_window @ products
    matrix[:, upper[1], upper[0]] = matrix[:, upper[0], upper[1]]
    weights, weighted = (known + wide).T
    right += (wide[:, 1] + TILT_RIDGE * weighted)[:, None] * centres
    ridge = (TILT_RIDGE * weights)[:, None, None] * np.eye(3)
    return np.asarray(np.linalg.solve(matrix + ridge, right[..., None])[..., 0])


def _window_weights(sigmas_deg: Sequence[float], shares: Sequence[float]) -> Float32[np.ndarray, "cells cells"]:
    """How much every cell counts around every other one."""
    centres = pixel_directions(*SURFACE_GRID).reshape(-1, 3).astype(np.float32)
    away = np.clip(1.0 - centres @ centres.T, 0.0, 2.0)
    variances = np.square(np.radians(sigmas_deg))
    weights = sum(share / v * np.exp(-away / v) for share, v in zip(shares, variances, strict=True))
    return np.asarray(weights, np.float32)


def _inverse_depth_of(surface: np.ndarray, view: View, middle: np.ndarray) -> Float32[np.ndarray, "rows cols"]:
    """Inverse depth, 1/metre, at which the rays of a view leave the surface; by bisection of its logarithm."""
    start = view.pose.position - middle
    half_baseline = float(np.linalg.norm(start))
    rays = pixel_directions(*RAY_GRID) @ view.pose.rotation.T
    far, near = (np.full(RAY_GRID, end / half_baseline) for end in INVERSE_DEPTH_RANGE)
    for _ in range(BISECTIONS):
        tried = np.sqrt(far * near)
        points = rays / tried[..., None] + start
        distance = np.linalg.norm(points, axis=-1)
        towards = points / distance[..., None]
        inverse_distance = np.clip(
            (sample_bilinear(surface, towards) * towards).sum(axis=-1),
            1.0 / FARTHEST_SURFACE_BASELINES, 1.0 / NEAREST_SURFACE_BASELINES,
        )  # fmt: skip
        is_inside = distance * inverse_distance < 2.0 * half_baseline
        far, near = np.where(is_inside, far, tried), np.where(is_inside, tried, near)
    return np.asarray(np.sqrt(far * near), np.float32)


def _softened(depth: DepthEstimate, reliability: np.ndarray, soft: np.ndarray) -> DepthEstimate:
    """Depth where it is reliable, and a soft surface elsewhere, mixed in the square root of inverse depth."""
    height, width = depth.inverse_depth.shape
    lacking = KEPT_RELIABILITY - _blurred(reliability, width / 80.0)
    x = np.clip(lacking / (KEPT_RELIABILITY - REPLACED_RELIABILITY), 0.0, 1.0)
    share = _blurred(x * x * (3.0 - 2.0 * x), width / 160.0)
    soft_sqrt_rho = np.sqrt(resized_to(soft, (height, width), cv2.INTER_LINEAR))
    sqrt_rho = (1.0 - share) * np.sqrt(np.maximum(depth.inverse_depth, 0.0)) + share * soft_sqrt_rho
    confidence = (1.0 - share) * depth.confidence + share * SOFT_CONFIDENCE
    return replace(depth, inverse_depth=np.asarray(sqrt_rho**2, np.float32), confidence=confidence.astype(np.float32))


def _blurred(values: np.ndarray, sigma: float) -> Float32[np.ndarray, "height width"]:
    """Smoothed by a Gaussian, ``sigma`` in pixels, across the seam."""
    border = min(int(3 * sigma) + 1, values.shape[1] // 2)
    blur = partial(cv2.GaussianBlur, ksize=(0, 0), sigmaX=sigma)
    return np.asarray(filter_across_seam(blur, values.astype(np.float32), border))
