"""The large planes of a scene: façades, floors, ceilings.

Seen from a panorama a plane is a *linear* function of the direction, ``inverse_depth = normal · direction``; fitting
one is a 3×3 system.
"""

from functools import partial

import numpy as np
from jaxtyping import Float, Float32, Int

from omnisyn_cli.compute.jit import fast_kernel, kernel
from omnisyn_cli.compute.threads import run_bands

BLOCKS = (12, 32, 64)
"""Side lengths of the square windows, in pixels, that propose one plane each."""

CHUNK = 6000
ALMOST_LEVEL = 0.15


def find_planes(
    directions: Float[np.ndarray, "points 3"],
    inverse_depth: Float[np.ndarray, " points"],
    tolerance: Float[np.ndarray, " points"],
    weight: Float[np.ndarray, " points"],
    pixel: tuple[Int[np.ndarray, " points"], ...],
    up: Float[np.ndarray, " 3"],
    *,
    count: int,
    share: float,
) -> Float[np.ndarray, "planes 3"]:
    """Normals (inverse depth along them is their length) of at most ``count`` planes, best supported first.

    Args:
        directions: unit vectors.
        inverse_depth: any unit; the normals have the same.
        tolerance: how far off an inlier may be, per point, same unit.
        weight: solid angle of each point.
        pixel: row and column of each point, for windows of neighbours.
        up: unit vector; level planes are proposed by one point, upright ones by two.
        count: most planes to look for.
        share: a plane has to explain this share of the total weight.

    Source: greedy multi-model RANSAC; fixed seed, so equal inputs give equal planes.
    """
    if len(directions) < 100:
        return np.zeros((0, 3))
    rng = np.random.default_rng(0)
    proposals = np.concatenate(
        [
            *(_windows(directions, inverse_depth, tolerance, pixel, block) for block in BLOCKS),
            _level(directions, inverse_depth, up, rng),
            _upright(directions, inverse_depth, up, rng),
        ]
    )
    chosen = rng.choice(len(directions), min(CHUNK, len(directions)), replace=False)
    d, rho, tol, w = directions[chosen], inverse_depth[chosen], tolerance[chosen], weight[chosen].astype(np.float32)
    inliers = _inliers(proposals, d, rho, tol)
    support, total = w @ inliers, float(w.sum())
    planes: list[np.ndarray] = []
    while len(planes) < count and support.max() >= share * total:
        best = int(support.argmax())
        planes.append(_polish(proposals[best], d, rho, tol, w > 0))
        explained = (np.abs(d @ planes[-1] - rho) < 1.5 * tol) | (inliers[:, best] > 0)
        spent = np.flatnonzero(explained & (w > 0))
        support -= w[spent] @ inliers[spent]
        support[best] = 0.0
        w[spent] = 0.0
    return np.array(planes).reshape(-1, 3)


def _inliers(
    proposals: Float[np.ndarray, "proposals 3"],
    d: Float[np.ndarray, "points 3"],
    rho: Float[np.ndarray, " points"],
    tol: Float[np.ndarray, " points"],
) -> Float32[np.ndarray, "points proposals"]:
    """1 where the proposal explains the point; float32, which sums fast."""
    out = np.empty((len(d), len(proposals)), np.float32)
    run_bands(partial(_explain, proposals, d, rho, tol, out), len(d))
    return out


@fast_kernel()
def _explain(proposals, d, rho, tol, out, begin, end):  # type: ignore[no-untyped-def]
    for i in range(begin, end):
        x, y, z, r, t = d[i, 0], d[i, 1], d[i, 2], rho[i], tol[i]
        for k in range(len(proposals)):
            predicted = proposals[k, 0] * x + proposals[k, 1] * y + proposals[k, 2] * z
            out[i, k] = np.float32(1.0) if abs(predicted - r) < t else np.float32(0.0)


def _windows(d: np.ndarray, rho: np.ndarray, tol: np.ndarray, pixel: tuple[np.ndarray, ...], block: int) -> np.ndarray:
    """One robust fit per square window of pixels."""
    row, col = pixel[0] // block, pixel[1] // block
    _, group = np.unique(row * (col.max() + 1) + col, return_inverse=True)
    size = int(group.max()) + 1
    base = 1.0 / tol**2
    w, normal = base, np.zeros((size, 3))
    for _ in range(3):
        normal = _solve(d, rho, w, group, size)
        w = base / (1.0 + ((np.einsum("ij,ij->i", normal[group], d) - rho) / tol) ** 2)
    return normal[np.bincount(group, minlength=size) > 12]


def _solve(d: np.ndarray, rho: np.ndarray, w: np.ndarray, group: np.ndarray, size: int) -> np.ndarray:
    matrix, vector = _sums(d, rho, w, group, size)
    ridge = 1e-6 * np.trace(matrix, axis1=1, axis2=2) + 1e-12
    return np.asarray(np.linalg.solve(matrix + ridge[:, None, None] * np.eye(3), vector[..., None])[..., 0])


@kernel()
def _sums(
    d: Float[np.ndarray, "points 3"],
    rho: Float[np.ndarray, " points"],
    w: Float[np.ndarray, " points"],
    group: Int[np.ndarray, " points"],
    size: int,
) -> tuple[Float[np.ndarray, "groups 3 3"], Float[np.ndarray, "groups 3"]]:
    """Of each group, matrix and right side of the weighted least-squares fit of ``normal · direction = rho``."""
    matrix, vector = np.zeros((size, 3, 3)), np.zeros((size, 3))
    for k in range(len(d)):
        at = group[k]
        for i in range(3):
            weighted = w[k] * d[k, i]
            vector[at, i] += weighted * rho[k]
            for j in range(3):
                matrix[at, i, j] += weighted * d[k, j]
    return matrix, vector


def _level(d: np.ndarray, rho: np.ndarray, up: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    height = d @ up
    steep = np.flatnonzero(np.abs(height) > ALMOST_LEVEL)
    if len(steep) == 0:
        return np.zeros((0, 3))
    sample = rng.choice(steep, min(400, len(steep)), replace=False)
    return np.asarray((rho[sample] / height[sample])[:, None] * up)


def _upright(d: np.ndarray, rho: np.ndarray, up: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    east = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    east /= np.linalg.norm(east)
    across = np.stack([east, np.cross(up, east)])
    pair = rng.integers(len(d), size=(800, 2))
    matrix = d[pair] @ across.T
    pair, matrix = pair[np.abs(np.linalg.det(matrix)) > 0.05], matrix[np.abs(np.linalg.det(matrix)) > 0.05]
    return np.asarray(np.linalg.solve(matrix, rho[pair][..., None])[..., 0] @ across)


def _polish(normal: np.ndarray, d: np.ndarray, rho: np.ndarray, tol: np.ndarray, free: np.ndarray) -> np.ndarray:
    for _ in range(3):
        residual = (d @ normal - rho) / tol
        w = free * (np.abs(residual) < 2) / (tol**2 * (1.0 + residual**2))
        normal = _solve(d, rho, w, np.zeros(len(d), np.int64), 1)[0]
    return normal
