"""Planes found by a sweep: the second image is warped onto each plane of a family and compared with the first one.

Windows that face the camera do not match on the ground between two distant cameras, where each image foreshortens it
differently. Windows that lie on the swept plane do. Gravity is known, so horizontal planes need one parameter only.

A plane counts if both panoramas find it. Planes are found one after the other: what one explains proposes no other.
Each is then measured: its pixels are matched a row to either side, and a plane is fitted to where they match best.

Source: Gallup et al., Real-time plane-sweeping stereo with multiple sweeping directions, CVPR 2007.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple, TypeVar

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8, UInt64

from omnisyn_cli.compute.arrays import empty
from omnisyn_cli.compute.jit import inlined, kernel
from omnisyn_cli.compute.threads import at_most, both, run_ranges
from omnisyn_cli.compute.trigonometry import atan2_fast
from omnisyn_cli.geometry.sampling import filter_across_seam
from omnisyn_cli.stereo.costs import census_transform, is_textured, luminance_of, surface_cost
from omnisyn_cli.stereo.plane_fitting import (
    PlaneEquations,
    PlanePoints,
    are_near,
    find_planes,
    fit_to_inliers,
    planes_from_second,
)
from omnisyn_cli.stereo.rectify import HALF_TURN_ABOUT_Z, EpipolarGrid, RectifiedPair

T = TypeVar("T")
# Half of the rows of a pair are swept, but no fewer than these. All rows find the same planes in four times the time.
MIN_SWEEP_ROWS = 64
# Of swept planes from the first camera, in baselines. Farther ones are matched well enough by upright windows.
NEAREST_PLANE_BASELINES, FARTHEST_PLANE_BASELINES = 0.08, 4.0
SWEEP_STEPS = 64  # planes between these distances: each is 6 % farther than the one before
# Sine of the angle (8°) between a ray and a plane: rays that graze it more closely are not compared.
MIN_INCIDENCE_SINE = 0.14
GOOD_COST = 0.28  # a pixel speaks for a plane by what its cost is below this. Unrelated windows have a cost of about 1.
EXPLAINED_COST = 0.2  # a pixel with a lower cost is explained by the plane and speaks for no other one
# As ``colour_weight`` and ``colour_truncation`` of matching; less of the first, because exposures may differ.
SWEEP_COLOUR_WEIGHT, SWEEP_COLOUR_TRUNCATION = 0.3, 0.1
# Ratio of the mean brightness of two panoramas from which on exposures differ, not only what the cameras see.
MIN_EXPOSURE_GAIN = 1.25
MAX_SWEPT_PLANES = 6  # per pair; the next ones explained less than a hundredth of the sphere on generated scenes
# Steps of the sweep to either side of a plane that propose no other one: its own flank, 26 % nearer or farther.
PEAK_HALF_WIDTH = 4
# The same for planes that have been fitted: nearer to one before it, a plane has moved onto that one.
FLANK_DISTANCE_FACTOR = 1.26
MIN_PEAK_RATIO = 2.0  # least score of a plane over the median of all distances of its direction, in both panoramas
# Least score of a plane above that median, as a share of the textured sphere that it explains perfectly.
MIN_PEAK_EXCESS = 0.002
# Of a plane to its pixels in the swept images, where a row is 1.4°, and then in the pair.
COARSE_FIT_COUNT, FINE_FIT_COUNT = 4, 1
# Sloping ground is fitted to the level planes that fit best in windows of 9×9 pixels. Their mean score has to be 0.04
# (level windows hardly match on a slope), and a twentieth of them has to agree.
SLOPE_WINDOW, MIN_SLOPE_SCORE, MIN_SLOPE_SUPPORT = 9, 0.04, 0.05
# Cosine of the greatest angle (20°) between a plane and the axis that it was found along: ground slopes less.
MIN_SLOPE_COSINE = 0.94
COST_WINDOW = 5  # side in pixels of the window in which costs are averaged before the best row is taken


@dataclass(frozen=True)
class SweepDirection:
    """One image of a pair that planes are compared in, with the other one that is warped onto them."""

    pair: RectifiedPair

    @cached_property
    def census(self) -> UInt64[np.ndarray, "height width"]:
        """Signatures of the first image."""
        return census_transform(luminance_of(self.pair.first))

    @cached_property
    def textured_area(self) -> Float32[np.ndarray, "height width"]:
        """Share of each textured pixel in their total solid angle; 0 without texture and where a mask is."""
        weight = np.sin(self.pair.grid.polar_angle) * (is_textured(self.pair.first) & self.pair.first_usable)
        return np.asarray(weight / max(float(weight.sum()), 1e-9), np.float32)

    def disparity(self, normals: Float[np.ndarray, "planes 3"]) -> Float32[np.ndarray, "height width"]:
        """Rows for the nearest of some planes; −1 where no ray meets one steeply enough and where is no texture."""
        grid, disparity = self.pair.grid, np.empty(self.pair.size, np.float32)
        least = MIN_INCIDENCE_SINE * np.linalg.norm(normals, axis=-1)
        fill = partial(_plane_disparity_rows, grid.directions, grid.polar_angle, self.textured_area > 0, normals, least)
        run_ranges(partial(fill, disparity), len(disparity))
        return disparity

    def cost(self, disparity: Float32[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width"]:
        """Matching cost of a surface; 1 where its disparity is negative."""
        cost = surface_cost(
            self.pair.first, self.census, self.pair.second, self.pair.second_usable, disparity,
            SWEEP_COLOUR_WEIGHT, SWEEP_COLOUR_TRUNCATION,
        )  # fmt: skip
        if self.pair.prior is not None:
            cost = cost + self.pair.prior.cost(disparity)
        return np.asarray(np.minimum(cost, np.float32(1.0)))

    def matched_points(self, normal: Float[np.ndarray, " 3"]) -> PlanePoints:
        """Points near a plane: where pixels match best that it shows, up to a row and a half to either side."""
        grid = self.pair.grid
        disparity = self.disparity(normal[None])
        average = partial(cv2.blur, ksize=(COST_WINDOW, COST_WINDOW))
        costs = [
            filter_across_seam(average, self.cost(np.where(disparity >= 0, np.maximum(disparity + rows, 0.0), -1.0)),
                               COST_WINDOW)
            for rows in (np.float32(-1.0), np.float32(0.0), np.float32(1.0))
        ]  # fmt: skip
        row, col = np.nonzero((disparity >= 0) & (np.minimum(costs[1], np.minimum(costs[0], costs[2])) < GOOD_COST))
        before, at, after = (cost[row, col] for cost in costs)
        curvature = before - 2.0 * at + after
        vertex = 0.5 * (before - after) / np.where(curvature > 0, curvature, np.inf)
        is_inside = (at <= before) & (at <= after)
        offset = np.where(is_inside, vertex, np.where(before < after, -1.0, 1.0))
        found = np.maximum(disparity[row, col] + offset, 0.0)
        inverse_depth, tolerance = grid.inverse_depth(found, row), grid.inverse_depth_per_row(found, row)
        return PlanePoints(grid.directions[row, col], inverse_depth, tolerance, self.textured_area[row, col], row, col)


Directions = tuple[SweepDirection, SweepDirection]


def plane_disparity(grid: EpipolarGrid, normal: Float[np.ndarray, " 3"]) -> Float32[np.ndarray, "height width"]:
    """Rows for one plane at every pixel; −1 where it is behind the camera."""
    disparity = np.empty(grid.directions.shape[:2], np.float32)
    everywhere, least = np.ones(disparity.shape, bool), np.zeros(1)
    fill = partial(_plane_disparity_rows, grid.directions, grid.polar_angle, everywhere, normal[None], least, disparity)
    run_ranges(fill, len(disparity))
    return disparity


@kernel()
def _plane_disparity_rows(  # type: ignore[no-untyped-def]
    directions, polar_angle, is_compared, normals, least, disparity, begin, end
):
    """Fills some rows of ``disparity``, see :meth:`SweepDirection.disparity`; −1 where ``is_compared`` is not set.

    ``least`` is the inverse depth of each plane where rays graze it.
    """
    height, width = disparity.shape
    nearest = empty(width, np.float64)
    for row in range(begin, end):
        sine, cosine = math.sin(polar_angle[row, 0]), math.cos(polar_angle[row, 0])
        nearest[:] = -1.0
        for k in range(len(normals)):
            _keep_nearest(directions[row], normals[k, 0], normals[k, 1], normals[k, 2], least[k], nearest)
        for col in range(np.uint64(width)):
            shift = nearest[col]
            parallax = atan2_fast(np.float32(shift * sine), np.float32(1.0 - shift * cosine))
            is_seen = shift >= 0 and is_compared[row, col]
            disparity[row, col] = parallax * np.float32(height / math.pi) if is_seen else np.float32(-1.0)


@inlined()
def _keep_nearest(directions, x, y, z, least, nearest):  # type: ignore[no-untyped-def]
    for col in range(np.uint64(len(nearest))):
        inverse_depth = x * directions[col, 0] + y * directions[col, 1] + z * directions[col, 2]
        nearest[col] = inverse_depth if inverse_depth > least and inverse_depth > nearest[col] else nearest[col]


def _for_both_directions(directions: Directions, work: Callable[[int, SweepDirection], T]) -> tuple[T, T]:
    """``work`` on both images at the same time: a thread each, as small images are not worth sharing."""

    def alone(which: int) -> T:
        with at_most(1):
            return work(which, directions[which])

    return both(partial(alone, 0), partial(alone, 1))


def sweep_planes(
    directions: tuple[Directions, Directions], axes: Float[np.ndarray, "axes 3"]
) -> Float[np.ndarray, "planes 3"]:
    """Planes across some axes, on either side of the cameras, that both panoramas see; best supported first.

    Each is a normal in the frame of the pair, as long as the inverse distance of its plane from the first camera
    (1/baselines). Directions are those of :func:`sweep_directions`. Axes are unit vectors, up first: floors and
    ceilings are across it, walls across level ones.
    """
    found = _greedy_planes(directions[0], axes)
    fitted = [fit_plane(directions, normal) for normal in found]
    planes: list[np.ndarray] = []
    for before, after in zip(found, fitted, strict=True):
        is_same = are_near(before, after, MIN_SLOPE_COSINE) and np.linalg.norm(after) < 1.0 / NEAREST_PLANE_BASELINES
        if is_same and not any(are_near(after, plane, MIN_SLOPE_COSINE, FLANK_DISTANCE_FACTOR) for plane in planes):
            planes.append(after)
    return np.array(planes).reshape(-1, 3)


def sweep_directions(pair: RectifiedPair) -> tuple[Directions, Directions]:
    """The images that are swept, and those that planes are then fitted in, at equal exposure."""
    pair = _at_equal_exposure(pair)
    rows = max(pair.size[0] // 2, min(MIN_SWEEP_ROWS, pair.size[0]))
    small = pair.resized((rows, 2 * rows))
    return (
        (SweepDirection(small), SweepDirection(small.reversed())),
        (SweepDirection(pair), SweepDirection(pair.reversed())),
    )


def _at_equal_exposure(pair: RectifiedPair) -> RectifiedPair:
    """The pair with the second image as bright as the first one, if they differ by more than two places do."""
    weight = np.sin(pair.grid.polar_angle)[..., None]
    means = [
        (image * weight * usable[..., None]).sum(axis=(0, 1)) / max(float((weight[..., 0] * usable).sum()), 1e-9)
        for image, usable in ((pair.first, pair.first_usable), (pair.second, pair.second_usable))
    ]
    gain = np.maximum(means[0], 1e-3) / np.maximum(means[1], 1e-3)
    if abs(math.log(float(gain.mean()))) < math.log(MIN_EXPOSURE_GAIN):
        return pair
    return replace(pair, second=np.minimum(pair.second * gain, 1.0).astype(np.float32))


@dataclass(frozen=True)
class AxisSweep:
    """How well each pixel fits planes across an axis: those behind the camera where it looks back, else those ahead."""

    directions: Directions
    axis: Float[np.ndarray, " 3"]  # a unit vector in the frame of the pair
    distances: Float[np.ndarray, " distances"]  # of the planes from the first camera, in baselines
    scores: UInt8[np.ndarray, "2 distances pixels"]  # 255 times ``1 − cost / GOOD_COST``, at least 0

    @staticmethod
    def of(directions: Directions, axis: Float[np.ndarray, " 3"]) -> "AxisSweep":
        """The sweep of both images along an axis."""
        distances = np.geomspace(NEAREST_PLANE_BASELINES, FARTHEST_PLANE_BASELINES, SWEEP_STEPS)

        def scores(which: int, direction: SweepDirection) -> UInt8[np.ndarray, "distances pixels"]:
            found = np.empty((len(distances), direction.textured_area.size), np.uint8)
            for k, distance in enumerate(distances):
                normals = np.stack([-axis, axis]) / distance
                # A plane that the second camera does not see is NaN and met by no ray.
                found[k] = 255.0 * _scores(direction, planes_from_second(normals) if which else normals).ravel()
            return found

        return AxisSweep(directions, axis, distances, np.stack(_for_both_directions(directions, scores)))

    def half(self, side: int) -> list[Bool[np.ndarray, " pixels"]]:
        """The pixels of both images that look against the axis (0) or along it (1)."""
        axes = self.axis, HALF_TURN_ABOUT_Z @ self.axis
        pairs = zip(self.directions, axes, strict=True)
        return [((2 * side - 1) * (each.pair.grid.directions @ axis) > 0).ravel() for each, axis in pairs]

    def support(self, side: int) -> Float[np.ndarray, "2 distances"]:
        """Share of the textured sphere that each plane on a side explains, in both images."""
        areas = [each.textured_area.ravel() * mask for each, mask in zip(self.directions, self.half(side), strict=True)]
        return np.stack([_weighted_sum(scores, area) for scores, area in zip(self.scores, areas, strict=True)])

    def winning_points(self, which: int) -> PlanePoints:
        """Every textured pixel that looks against the axis at the distance that fits best around it, within a step."""
        direction = self.directions[which]
        grid = direction.pair.grid
        scores = np.ascontiguousarray(self.scores[which].reshape(-1, *direction.pair.size).transpose(1, 2, 0))
        average = partial(cv2.blur, ksize=(SLOPE_WINDOW, SLOPE_WINDOW))
        around = filter_across_seam(average, scores, SLOPE_WINDOW)
        row, col = np.nonzero((around.max(axis=-1) > 255 * MIN_SLOPE_SCORE) & (direction.textured_area > 0))
        down = -self.axis / self.distances[:, None]
        inverse_distance = np.linalg.norm(planes_from_second(down) if which else down, axis=-1)
        best = inverse_distance[around[row, col].argmax(axis=-1)]
        inverse_depth = -grid.sin_elevation[row, col] * best
        is_below = inverse_depth > MIN_INCIDENCE_SINE * best
        row, col, inverse_depth = row[is_below], col[is_below], inverse_depth[is_below]
        tolerance = inverse_depth * (self.distances[1] / self.distances[0] - 1.0)
        area = direction.textured_area[row, col].astype(float)
        return PlanePoints(grid.directions[row, col], inverse_depth, tolerance, area, row, col)


def _scores(direction: SweepDirection, normals: Float[np.ndarray, "planes 3"]) -> Float[np.ndarray, "height width"]:
    """How well each pixel fits the nearest of some planes, in [0, 1]."""
    return np.asarray(np.maximum(1.0 - direction.cost(direction.disparity(normals)) / GOOD_COST, 0.0))


class HalfSweep(NamedTuple):
    """The planes of a sweep on one side of the cameras."""

    sweep: AxisSweep
    side: int  # 0 where pixels look against the axis, 1 along it
    mask: list[Bool[np.ndarray, " pixels"]]  # the pixels of both images that do
    support: Float[np.ndarray, "2 distances"]  # what each plane explains of what is not explained yet
    is_candidate: Bool[np.ndarray, " distances"]  # which may still be found

    def remove(self, which: int, pixels: Int[np.ndarray, " pixels"], weight: Float[np.ndarray, " pixels"]) -> None:
        """Pixels of one image that have been explained."""
        chosen = self.mask[which][pixels]
        self.support[which] -= _weighted_sum(self.sweep.scores[which][:, pixels[chosen]], weight[chosen])


def _weighted_sum(scores: np.ndarray, weight: np.ndarray) -> Float[np.ndarray, " distances"]:
    # einsum sums in one order, whatever the number of threads; a matrix product does not
    return np.asarray(np.einsum("dp,p->d", scores, weight) / 255.0)


def _greedy_planes(directions: Directions, axes: np.ndarray) -> list[np.ndarray]:
    """The planes that explain most, one after the other, each of what those before it leave unexplained."""
    sweeps = [AxisSweep.of(directions, axis) for axis in axes]
    weights = [direction.textured_area.ravel().copy() for direction in directions]
    halves = [
        HalfSweep(sweep, side, sweep.half(side), sweep.support(side), np.ones(len(sweep.distances), bool))
        for sweep in sweeps
        for side in (0, 1)
    ]
    found: list[np.ndarray] = []
    while len(found) < MAX_SWEPT_PLANES:
        peaks = [_peak(half.support * half.is_candidate) for half in halves]
        excess, at, best = max((*peak, k) for k, peak in enumerate(peaks))
        if excess < MIN_PEAK_EXCESS:
            break
        sweep, side, mask, _, is_candidate = halves[best]
        found.append((2 * side - 1) * sweep.axis / sweep.distances[at])
        is_candidate[max(at - PEAK_HALF_WIDTH, 0) : at + PEAK_HALF_WIDTH + 1] = False
        for which, weight in enumerate(weights):
            scores = sweep.scores[which, at - 1 : at + 2].max(axis=0)
            explained = np.flatnonzero((weight > 0) & mask[which] & (scores > 255 * (1.0 - EXPLAINED_COST / GOOD_COST)))
            for half in halves:
                half.remove(which, explained, weight[explained])
            weight[explained] = 0.0
    has_floor = any(are_near(-axes[0], normal, MIN_SLOPE_COSINE) for normal in found)
    return found if has_floor else [*_sloped_ground(sweeps[0]), *found]


def _peak(support: Float[np.ndarray, "2 distances"]) -> tuple[float, int]:
    """Excess over the median and index of the best distance; an excess of 0 if there is no peak.

    Of both panoramas the worse one counts. A maximum at either end of the sweep is none.
    """
    excess, is_significant = significant_support(support)
    at = int(excess.argmax())
    return float(excess[at]) if is_significant[at] and at not in (0, len(excess) - 1) else 0.0, at


def significant_support(
    support: Float[np.ndarray, "2 distances"],
) -> tuple[Float[np.ndarray, " distances"], Bool[np.ndarray, " distances"]]:
    """Support above the median of all distances, in the worse panorama, and where it is enough for a plane."""
    median = np.median(support, axis=1, keepdims=True)
    excess, ratio = (support - median).min(axis=0), (support / np.maximum(median, 1e-4)).min(axis=0)
    return excess, (excess >= MIN_PEAK_EXCESS) & (ratio >= MIN_PEAK_RATIO)


def _sloped_ground(sweep: AxisSweep) -> list[np.ndarray]:
    """Ground that slopes too much to be a peak of level planes, fitted to the best level plane of each pixel."""
    up = sweep.axis
    points = sweep.winning_points(0), sweep.winning_points(1)
    median = np.median(sweep.support(0), axis=1)
    for proposal in find_planes(points, up, max_planes=MAX_SWEPT_PLANES, min_support=MIN_SLOPE_SUPPORT):
        normal = _fit(sweep.directions, proposal, COARSE_FIT_COUNT)
        seen = normal[None], planes_from_second(normal[None])
        support = [
            float((_scores(direction, each) * direction.textured_area).sum())
            for direction, each in zip(sweep.directions, seen, strict=True)
        ]
        excess, ratio = min(support - median), min(support / np.maximum(median, 1e-4))
        if are_near(-up, normal, MIN_SLOPE_COSINE) and excess > MIN_PEAK_EXCESS and ratio > MIN_PEAK_RATIO:
            return [normal]
    return []


def fit_plane(
    directions: tuple[Directions, Directions], normal: Float[np.ndarray, " 3"],
    stiffness: Float[np.ndarray, "3 3"] | float = 0.0,
) -> Float[np.ndarray, " 3"]:  # fmt: skip
    """A plane of a sweep measured, first in the images that were swept and then in those of the pair.

    Directions are those of :func:`sweep_directions`, and the plane is as :func:`sweep_planes` returns it. For
    ``stiffness`` see :func:`omnisyn_cli.stereo.plane_fitting.fit_to_inliers`.
    """
    coarse, fine = directions
    return _fit(fine, _fit(coarse, normal, COARSE_FIT_COUNT, stiffness), FINE_FIT_COUNT, stiffness)


def _fit(
    directions: Directions, normal: np.ndarray, times: int, stiffness: np.ndarray | float = 0.0
) -> Float[np.ndarray, " 3"]:
    """The plane fitted again and again to where the pixels of both panoramas match best that it shows."""
    for _ in range(times):
        seen = normal, planes_from_second(normal[None])[0]
        points = _for_both_directions(directions, lambda which, each: each.matched_points(seen[which]))  # noqa: B023
        equations = PlaneEquations.of(*points)
        normal = fit_to_inliers(normal, equations, np.ones(len(equations.rays), bool), stiffness)
    return normal
