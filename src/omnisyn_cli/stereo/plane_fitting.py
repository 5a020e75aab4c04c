"""The large planes of a scene: façades, floors, ceilings.

Seen from a panorama a plane is a *linear* function of the direction, ``inverse_depth = normal · direction``, so fitting
one is a 3×3 system. The length of a normal is the inverse distance of its plane.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int

from omnisyn_cli.compute.jit import fast_kernel, kernel
from omnisyn_cli.compute.threads import run_ranges

PROPOSAL_WINDOW_SIDES = (12, 32, 64)
"""Side lengths in pixels of the square windows that propose one plane each; chosen by eye."""

MIN_WINDOW_POINTS = 12
"""A window with no more points proposes nothing."""

LEVEL_PLANE_PROPOSALS, UPRIGHT_PLANE_PROPOSALS = 400, 800
"""Random samples: one point defines a level plane, two define an upright one."""

LEVEL_MIN_ELEVATION_SINE = 0.15
"""Sine of the elevation (9°) a point needs to propose a level plane: nearer the horizon its height is uncertain."""

MIN_PAIR_DETERMINANT = 0.05
"""Two points on (nearly) one vertical plane through the camera do not define an upright plane."""

MAX_SCORED_POINTS = 6000
"""Points that proposals are scored on, drawn at random; all of them would take long for nearly the same ranking."""

MIN_PLANE_POINTS = 100
"""With fewer points there is no plane."""

EXPLAINED_TOLERANCE_FACTOR = 1.5
"""In tolerances: points this close to a chosen plane propose and support no other one."""

OUTLIER_TOLERANCE_FACTOR = 2.0
"""In tolerances: points farther away have no weight when a chosen plane is refitted."""

ROBUST_ITERATIONS = 3
"""Of reweighted least squares."""


class PlanePoints(NamedTuple):
    """Points that planes are fitted to.

    Attributes:
        directions: unit vectors.
        inverse_depth: any unit; normals have the same.
        tolerance: distance of an inlier, same unit.
    """

    directions: Float[np.ndarray, "points 3"]
    inverse_depth: Float[np.ndarray, " points"]
    tolerance: Float[np.ndarray, " points"]

    def residual(self, normal: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " points"]:
        """How far the points are from a plane, in the unit of inverse depth."""
        return np.asarray(self.directions @ normal - self.inverse_depth)


def find_planes(
    points: PlanePoints,
    solid_angle: Float[np.ndarray, " points"],
    pixel_index: tuple[Int[np.ndarray, " points"], ...],
    up: Float[np.ndarray, " 3"],
    *,
    max_planes: int,
    min_support: float,
) -> Float[np.ndarray, "planes 3"]:
    """Normals of at most ``max_planes`` planes, best supported first.

    Args:
        points: what the planes explain.
        solid_angle: of each point: its weight.
        pixel_index: row and column of each point, for windows of neighbours.
        up: unit vector; level planes are proposed by one point, upright ones by two.
        max_planes: most planes to look for.
        min_support: a plane has to explain this share of the total solid angle.

    Source: greedy multi-model RANSAC; fixed seed, so equal inputs give equal planes.
    """
    count = len(points.directions)
    if count < MIN_PLANE_POINTS:
        return np.zeros((0, 3))
    rng = np.random.default_rng(0)
    proposals = np.concatenate(
        [
            *(_propose_by_windows(points, pixel_index, side) for side in PROPOSAL_WINDOW_SIDES),
            _propose_level(points, up, rng),
            _propose_upright(points, up, rng),
        ]
    )
    chosen = rng.choice(count, min(MAX_SCORED_POINTS, count), replace=False)
    points, weight = PlanePoints(*(values[chosen] for values in points)), solid_angle[chosen].astype(np.float32)
    inliers = _inlier_matrix(proposals, points)
    support, total = weight @ inliers, float(weight.sum())
    planes: list[np.ndarray] = []
    while len(planes) < max_planes and support.max() >= min_support * total:
        best = int(support.argmax())
        planes.append(_refit_to_inliers(proposals[best], points, weight > 0))
        is_near = np.abs(points.residual(planes[-1])) < EXPLAINED_TOLERANCE_FACTOR * points.tolerance
        explained = np.flatnonzero((is_near | (inliers[:, best] > 0)) & (weight > 0))
        support -= weight[explained] @ inliers[explained]  # each point supports one plane only
        support[best] = 0.0
        weight[explained] = 0.0
    return np.array(planes).reshape(-1, 3)


def _inlier_matrix(
    proposals: Float[np.ndarray, "proposals 3"], points: PlanePoints
) -> Float32[np.ndarray, "points proposals"]:
    """1 where the proposal explains the point; float32, so that support is a fast matrix product."""
    out = np.empty((len(points.directions), len(proposals)), np.float32)
    run_ranges(partial(_mark_inliers, proposals, points, out), len(out))
    return out


@fast_kernel()
def _mark_inliers(proposals, points, out, begin, end):  # type: ignore[no-untyped-def]
    directions, inverse_depth, tolerance = points.directions, points.inverse_depth, points.tolerance
    for i in range(begin, end):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        known, allowed = inverse_depth[i], tolerance[i]
        for k in range(len(proposals)):
            predicted = proposals[k, 0] * x + proposals[k, 1] * y + proposals[k, 2] * z
            out[i, k] = np.float32(1.0) if abs(predicted - known) < allowed else np.float32(0.0)


def _propose_by_windows(points: PlanePoints, pixel_index: tuple[np.ndarray, ...], side: int) -> np.ndarray:
    """One robust fit per square window of pixels."""
    row, col = pixel_index[0] // side, pixel_index[1] // side
    _, window = np.unique(row * (col.max() + 1) + col, return_inverse=True)
    count = int(window.max()) + 1
    base = 1.0 / points.tolerance**2
    weight, normals = base, np.zeros((count, 3))
    for _ in range(ROBUST_ITERATIONS):  # Cauchy weights: few points on another surface do not bend the plane
        normals = _fit_normals(points, weight, window, count)
        predicted = np.einsum("ij,ij->i", normals[window], points.directions)
        weight = base / (1.0 + ((predicted - points.inverse_depth) / points.tolerance) ** 2)
    return normals[np.bincount(window, minlength=count) > MIN_WINDOW_POINTS]


def _fit_normals(points: PlanePoints, weight: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Weighted least-squares normals of ``count`` groups of points."""
    matrix, vector = _normal_equations(points.directions, points.inverse_depth, weight, group, count)
    ridge = 1e-6 * np.trace(matrix, axis1=1, axis2=2) + 1e-12  # groups on a line or a point stay solvable
    return np.asarray(np.linalg.solve(matrix + ridge[:, None, None] * np.eye(3), vector[..., None])[..., 0])


@kernel()
def _normal_equations(
    directions: Float[np.ndarray, "points 3"],
    inverse_depth: Float[np.ndarray, " points"],
    weight: Float[np.ndarray, " points"],
    group: Int[np.ndarray, " points"],
    count: int,
) -> tuple[Float[np.ndarray, "groups 3 3"], Float[np.ndarray, "groups 3"]]:
    """Of each group, matrix and right side of the fit of ``normal · direction = inverse_depth``."""
    matrix, vector = np.zeros((count, 3, 3)), np.zeros((count, 3))
    for k in range(len(directions)):
        at = group[k]
        for i in range(3):
            weighted = weight[k] * directions[k, i]
            vector[at, i] += weighted * inverse_depth[k]
            for j in range(3):
                matrix[at, i, j] += weighted * directions[k, j]
    return matrix, vector


def _propose_level(points: PlanePoints, up: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Floors and ceilings: ``normal = a · up``, where one point gives a."""
    sin_elevation = points.directions @ up
    steep = np.flatnonzero(np.abs(sin_elevation) > LEVEL_MIN_ELEVATION_SINE)
    if len(steep) == 0:
        return np.zeros((0, 3))
    sample = rng.choice(steep, min(LEVEL_PLANE_PROPOSALS, len(steep)), replace=False)
    return np.asarray((points.inverse_depth[sample] / sin_elevation[sample])[:, None] * up)


def _propose_upright(points: PlanePoints, up: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Walls: the normal is horizontal, so two points give it."""
    east = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    east /= np.linalg.norm(east)
    horizontal = np.stack([east, np.cross(up, east)])
    pair = rng.integers(len(points.directions), size=(UPRIGHT_PLANE_PROPOSALS, 2))
    matrix = points.directions[pair] @ horizontal.T
    is_solvable = np.abs(np.linalg.det(matrix)) > MIN_PAIR_DETERMINANT
    pair, matrix = pair[is_solvable], matrix[is_solvable]
    return np.asarray(np.linalg.solve(matrix, points.inverse_depth[pair][..., None])[..., 0] @ horizontal)


def _refit_to_inliers(normal: np.ndarray, points: PlanePoints, is_unexplained: np.ndarray) -> np.ndarray:
    """The plane fitted to its inliers among the points that no other plane has explained."""
    for _ in range(ROBUST_ITERATIONS):
        residual = points.residual(normal) / points.tolerance
        is_inlier = np.abs(residual) < OUTLIER_TOLERANCE_FACTOR
        weight = is_unexplained * is_inlier / (points.tolerance**2 * (1.0 + residual**2))
        normal = _fit_normals(points, weight, np.zeros(len(residual), np.int64), 1)[0]
    return normal
