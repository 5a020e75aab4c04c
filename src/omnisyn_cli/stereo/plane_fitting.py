"""The large planes of a scene: façades, floors, ceilings.

Seen from a panorama a plane is a *linear* function of the direction, ``inverse_depth = normal · direction``, so fitting
one is a 3×3 system. The length of a normal is the inverse distance of its plane. Points of both cameras are fitted
together, so both choose among the same planes.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from omnisyn_cli.compute.arrays import zeros
from omnisyn_cli.compute.jit import fast_kernel, kernel
from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.stereo.rectify import HALF_TURN_ABOUT_Z

# Side lengths in pixels of the square windows that propose one plane each; chosen by eye.
PROPOSAL_WINDOW_SIDES = (12, 32, 64)
MIN_WINDOW_POINTS = 12  # a window with no more points proposes nothing
# Random samples: one point defines a level plane, two define an upright one.
HORIZONTAL_PLANE_PROPOSALS, VERTICAL_PLANE_PROPOSALS = 400, 800
# Sine of the elevation (9°) a point needs to propose a level plane: nearer the horizon its height is uncertain.
LEVEL_MIN_ELEVATION_SINE = 0.15
# Two points on (nearly) one vertical plane through the camera do not define an upright plane.
MIN_PAIR_DETERMINANT = 0.05
# Points that proposals are scored on, drawn at random; all of them would take long for nearly the same ranking.
MAX_SCORED_POINTS = 6000
MIN_PLANE_POINTS = 100  # with fewer points there is no plane
EXPLAINED_TOLERANCE_FACTOR = 1.5  # in tolerances: points this close to a chosen plane propose and support no other one
OUTLIER_TOLERANCE_FACTOR = 2.0  # in tolerances: points farther away have no weight when a chosen plane is refitted
ROBUST_ITERATIONS = 3  # of reweighted least squares
SECOND_CAMERA = np.array([0.0, 1.0, 0.0])  # in the frame of the first one, in baselines
# In 1/baselines and in baselines: farther planes are infinity, and nearer ones pass through the second camera.
MIN_INVERSE_DISTANCE, MIN_SECOND_DISTANCE = 1e-6, 1e-3


class PlanePoints(NamedTuple):
    """Points that one camera of a rectified pair sees, in the frame in which it is the first one."""

    directions: Float[np.ndarray, "points 3"]  # unit vectors
    inverse_depth: Float[np.ndarray, " points"]  # 1/baselines
    tolerance: Float[np.ndarray, " points"]  # the distance of an inlier, likewise
    solid_angle: Float[np.ndarray, " points"]  # weighs a point
    # its pixel, for windows of neighbours
    row: Int[np.ndarray, " points"]
    col: Int[np.ndarray, " points"]


class PlaneEquations(NamedTuple):
    """One linear equation ``normal · ray = inverse_depth`` for each point of both cameras, in the first one's frame."""

    rays: Float[np.ndarray, "points 3"]  # directions; of the second camera ``direction + inverse_depth · camera``
    inverse_depth: Float[np.ndarray, " points"]  # from the camera that sees the point
    tolerance: Float[np.ndarray, " points"]  # see :class:`PlanePoints`
    is_second: Bool[np.ndarray, " points"]

    @staticmethod
    def of(first: PlanePoints, second: PlanePoints) -> "PlaneEquations":
        """Those of both cameras; the second camera is at :data:`SECOND_CAMERA`."""
        from_second = second.directions @ HALF_TURN_ABOUT_Z + second.inverse_depth[:, None] * SECOND_CAMERA
        return PlaneEquations(
            np.concatenate([first.directions, from_second]),
            np.concatenate([first.inverse_depth, second.inverse_depth]),
            np.concatenate([first.tolerance, second.tolerance]),
            np.repeat([False, True], [len(first.directions), len(second.directions)]),
        )

    def subset(self, chosen: Int[np.ndarray, " subset"]) -> "PlaneEquations":
        """Some of them."""
        return PlaneEquations(*(values[chosen] for values in self))

    def scaled_tolerance(self, normal: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " points"]:
        """Tolerance of the equation of each point: it shrinks as the plane comes near the second camera."""
        distance_share = max(abs(1.0 - float(normal @ SECOND_CAMERA)), 1e-9)  # from the second camera over the first
        return np.asarray(np.where(self.is_second, distance_share, 1.0) * self.tolerance)


def are_near(
    normal: Float[np.ndarray, " 3"], other: Float[np.ndarray, " 3"], min_cosine: float, distance_factor: float = np.inf
) -> bool:
    """Whether two planes are nearly parallel, and neither is farther by the factor than the other one."""
    lengths = np.linalg.norm(normal), np.linalg.norm(other)
    is_parallel = normal @ other > min_cosine * lengths[0] * lengths[1]
    return bool(is_parallel and max(lengths) < distance_factor * min(lengths))


def planes_from_second(normals: Float[np.ndarray, "planes 3"]) -> Float[np.ndarray, "planes 3"]:
    """Planes as the second camera sees them, in the frame of the reversed pair.

    NaN for a plane that is behind that camera, passes through it or is infinitely far. The rule is its own inverse.
    """
    inverse_distance = np.linalg.norm(normals, axis=-1, keepdims=True)
    unit = normals / np.maximum(inverse_distance, MIN_INVERSE_DISTANCE)
    distance = 1.0 / np.maximum(inverse_distance, MIN_INVERSE_DISTANCE) - (unit @ SECOND_CAMERA)[..., None]
    is_seen = (inverse_distance >= MIN_INVERSE_DISTANCE) & (distance > MIN_SECOND_DISTANCE)
    return np.where(is_seen, unit @ HALF_TURN_ABOUT_Z / np.where(is_seen, distance, 1.0), np.nan)


def find_planes(
    points: tuple[PlanePoints, PlanePoints], up: Float[np.ndarray, " 3"], *, max_planes: int, min_support: float
) -> Float[np.ndarray, "planes 3"]:
    """Normals of at most ``max_planes`` planes in the frame of the first camera, best supported first.

    The planes explain points as either camera sees them: each at least ``min_support`` of the total solid angle. Level
    ones, across the unit vector ``up``, are proposed by one point, upright ones by two.

    Source: greedy multi-model RANSAC; fixed seed, so equal inputs give equal planes.
    """
    equations, solid_angle = PlaneEquations.of(*points), np.concatenate([each.solid_angle for each in points])
    count = len(solid_angle)
    if count < MIN_PLANE_POINTS:
        return np.zeros((0, 3))
    rng = np.random.default_rng(0)
    of_second = planes_from_second(_propose_planes(points[1], HALF_TURN_ABOUT_Z @ up, rng))
    proposals = np.concatenate([_propose_planes(points[0], up, rng), of_second[np.isfinite(of_second).all(axis=-1)]])
    chosen = rng.choice(count, min(MAX_SCORED_POINTS, count), replace=False)
    equations, weight = equations.subset(chosen), solid_angle[chosen].astype(np.float64)
    inliers = _inlier_matrix(proposals, equations)
    support, total = _support(inliers, weight), float(weight.sum())
    planes: list[np.ndarray] = []
    while len(planes) < max_planes and support.max() >= min_support * total:
        best = int(support.argmax())
        planes.append(fit_to_inliers(proposals[best], equations, weight > 0))
        residual = equations.rays @ planes[-1] - equations.inverse_depth
        is_near = np.abs(residual) < EXPLAINED_TOLERANCE_FACTOR * equations.scaled_tolerance(planes[-1])
        is_explained = is_near | inliers[:, best]
        support -= _support(inliers, weight * is_explained)  # each point supports one plane only
        support[best] = 0.0
        weight[is_explained] = 0.0
    return np.array(planes).reshape(-1, 3)


def _propose_planes(points: PlanePoints, up: np.ndarray, rng: np.random.Generator) -> Float[np.ndarray, "proposals 3"]:
    """Planes that points of one camera propose, in its frame."""
    if len(points.directions) == 0:
        return np.zeros((0, 3))
    by_windows = [_propose_by_windows(points, side) for side in PROPOSAL_WINDOW_SIDES]
    return np.concatenate([*by_windows, _propose_horizontal(points, up, rng), _propose_vertical(points, up, rng)])


def _inlier_matrix(
    proposals: Float[np.ndarray, "proposals 3"], equations: PlaneEquations
) -> Bool[np.ndarray, "points proposals"]:
    """Which proposals explain which points."""
    out = np.empty((len(equations.rays), len(proposals)), np.bool_)
    # A plane behind the second camera explains nothing that it sees.
    distance_share = np.stack([np.ones(len(proposals)), np.maximum(1.0 - proposals @ SECOND_CAMERA, 0.0)])
    run_ranges(partial(_mark_inliers, np.ascontiguousarray(proposals.T), distance_share, equations, out), len(out))
    return out


@fast_kernel()
def _mark_inliers(proposals, distance_share, equations, out, begin, end):  # type: ignore[no-untyped-def]
    rays, inverse_depth, tolerance = equations.rays, equations.inverse_depth, equations.tolerance
    x, y, z = proposals[0], proposals[1], proposals[2]
    for i in range(begin, end):
        ray, known, allowed = rays[i], inverse_depth[i], tolerance[i]
        share, explained = distance_share[1 if equations.is_second[i] else 0], out[i]
        for k in range(np.uint64(len(explained))):
            predicted = x[k] * ray[0] + y[k] * ray[1] + z[k] * ray[2]
            explained[k] = abs(predicted - known) < allowed * share[k]


def _support(
    inliers: Bool[np.ndarray, "points proposals"], weight: Float[np.ndarray, " points"]
) -> Float[np.ndarray, " proposals"]:
    """Total weight of the points that each proposal explains."""
    support = np.zeros(inliers.shape[1])
    as_numbers = inliers.view(np.uint8)  # a product vectorises, a choice does not
    run_ranges(partial(_add_weights, as_numbers, weight, support), len(support))
    return support


@kernel()
def _add_weights(inliers, weight, support, begin, end):  # type: ignore[no-untyped-def]
    chosen = support[begin:end]
    for i in range(len(weight)):
        explained = inliers[i, begin:end]
        if weight[i] > 0:
            for k in range(np.uint64(len(chosen))):
                chosen[k] += weight[i] * np.float64(explained[k])


def _propose_by_windows(points: PlanePoints, side: int) -> np.ndarray:
    """One robust fit per square window of pixels."""
    row, col = points.row // side, points.col // side
    _, window = np.unique(row * (col.max() + 1) + col, return_inverse=True)
    count = int(window.max()) + 1
    base = 1.0 / points.tolerance**2
    weight, normals = base, np.zeros((count, 3))
    for _ in range(ROBUST_ITERATIONS):  # Cauchy weights: few points on another surface do not bend the plane
        normals = _fit_normals(points.directions, points.inverse_depth, weight, window, count)
        predicted = np.einsum("ij,ij->i", normals[window], points.directions)
        weight = base / (1.0 + ((predicted - points.inverse_depth) / points.tolerance) ** 2)
    return normals[np.bincount(window, minlength=count) > MIN_WINDOW_POINTS]


def _fit_normals(
    rays: np.ndarray, inverse_depth: np.ndarray, weight: np.ndarray, group: np.ndarray, count: int,
    stiffness: np.ndarray | float = 0.0,
) -> np.ndarray:  # fmt: skip
    """Weighted least-squares normals of ``count`` groups of points."""
    matrix, vector = _normal_equations(rays, inverse_depth, weight, group, count)
    ridge = 1e-6 * np.trace(matrix, axis1=1, axis2=2) + 1e-12  # groups on a line or a point stay solvable
    matrix += ridge[:, None, None] * np.eye(3) + stiffness
    return np.asarray(np.linalg.solve(matrix, vector[..., None])[..., 0])


@kernel()
def _normal_equations(directions, inverse_depth, weight, group, count):  # type: ignore[no-untyped-def]
    """Of each group, matrix (3, 3) and right side (3) of the fit of ``normal · direction = inverse_depth``."""
    matrix, vector = zeros((count, 3, 3), np.float64), zeros((count, 3), np.float64)
    for k in range(len(directions)):
        at = group[k]
        for i in range(3):
            weighted = weight[k] * directions[k, i]
            vector[at, i] += weighted * inverse_depth[k]
            for j in range(3):
                matrix[at, i, j] += weighted * directions[k, j]
    return matrix, vector


def _propose_horizontal(points: PlanePoints, up: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Floors and ceilings: ``normal = a · up``, where one point gives a."""
    sin_elevation = points.directions @ up
    steep = np.flatnonzero(np.abs(sin_elevation) > LEVEL_MIN_ELEVATION_SINE)
    if len(steep) == 0:
        return np.zeros((0, 3))
    sample = rng.choice(steep, min(HORIZONTAL_PLANE_PROPOSALS, len(steep)), replace=False)
    return np.asarray((points.inverse_depth[sample] / sin_elevation[sample])[:, None] * up)


def _propose_vertical(points: PlanePoints, up: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Walls: the normal is horizontal, so two points give it."""
    east = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    east /= np.linalg.norm(east)
    horizontal = np.stack([east, np.cross(up, east)])
    pair = rng.integers(len(points.directions), size=(VERTICAL_PLANE_PROPOSALS, 2))
    matrix = points.directions[pair] @ horizontal.T
    is_solvable = np.abs(np.linalg.det(matrix)) > MIN_PAIR_DETERMINANT
    pair, matrix = pair[is_solvable], matrix[is_solvable]
    return np.asarray(np.linalg.solve(matrix, points.inverse_depth[pair][..., None])[..., 0] @ horizontal)


def fit_to_inliers(
    normal: Float[np.ndarray, " 3"], equations: PlaneEquations, is_usable: Bool[np.ndarray, " points"],
    stiffness: Float[np.ndarray, "3 3"] | float = 0.0,
) -> Float[np.ndarray, " 3"]:  # fmt: skip
    """The plane fitted to those of the usable points that a plane explains.

    ``stiffness`` adds ``normal · stiffness · normal`` to the squared residuals, in tolerances of points.
    """
    group = np.zeros(len(is_usable), np.int64)
    for _ in range(ROBUST_ITERATIONS):
        scaled_tolerance = equations.scaled_tolerance(normal)
        residual = (equations.rays @ normal - equations.inverse_depth) / scaled_tolerance
        is_inlier = is_usable & (np.abs(residual) < OUTLIER_TOLERANCE_FACTOR)
        weight = is_inlier / (scaled_tolerance**2 * (1.0 + residual**2))
        normal = _fit_normals(equations.rays, equations.inverse_depth, weight, group, 1, stiffness)[0]
    return normal
