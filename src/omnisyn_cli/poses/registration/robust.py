"""The relative pose of two panoramas from matches of which many are wrong.

Samples of five matches give hypotheses; those that most matches agree with are refined (:mod:`.least_squares`), and so
is a pose that is already known. Random numbers come from a fixed seed: equal matches give equal poses. That the cameras
stand in one place, so that the baseline has no direction, is recognised by a pure rotation explaining as many matches.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.geometry.pose import Pose, nearest_rotation
from omnisyn_cli.geometry.sphere import FORWARD
from omnisyn_cli.poses.registration.features import Matches
from omnisyn_cli.poses.registration.least_squares import (
    Uncertainty,
    angle_between,
    epipolar_residual,
    is_in_front,
    refine_pose,
    uncertainty,
)

CUBICS = ((3, 0, 0), (2, 1, 0), (2, 0, 1), (1, 2, 0), (1, 1, 1), (1, 0, 2), (0, 3, 0), (0, 2, 1), (0, 1, 2), (0, 0, 3))
BASIS = ((2, 0, 0), (1, 1, 0), (1, 0, 1), (0, 2, 0), (0, 1, 1), (0, 0, 2), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0))
"""Exponents of x, y, z: the monomials that are eliminated, and the basis of the quotient ring."""

SAMPLE_POINTS = np.array([p for p in product(range(4), repeat=3) if sum(p) <= 3], float) - 0.75
"""Twenty points (x, y, z) that determine a cubic polynomial in three variables."""

COEFFICIENTS_FROM_VALUES = np.linalg.inv(np.prod(SAMPLE_POINTS[:, None, :] ** np.array(CUBICS + BASIS)[None], axis=2))
"""Coefficients of a cubic polynomial from its values at :data:`SAMPLE_POINTS`."""

MAX_IMAGINARY_PART = 1e-6
"""Imaginary part, relative to the absolute value, up to which a root counts as real."""

MIN_RELATIVE_DETERMINANT = 1e-10
"""Determinant, relative to the lengths of its rows, below which a sample is degenerate."""


def essential_candidates(
    first: Float[np.ndarray, "batch 5 3"], second: Float[np.ndarray, "batch 5 3"]
) -> Float[np.ndarray, "found 3 3"]:
    """All essential matrices of all samples, in one list, each of Frobenius norm 1.

    ``first`` and ``second`` are unit vectors with ``first · E · second = 0``. E lies in the four-dimensional null space
    of five linear equations, ``E = xX + yY + zZ + W``; the ten cubic equations ``det E = 0`` and
    ``2EEᵀE − tr(EEᵀ)E = 0`` leave up to ten solutions, which are eigenvectors of a 10×10 matrix. Planes, on which
    eight-point methods break down, are no special case.

    Source: Stewénius, Engels, Nistér, Recent developments on direct relative orientation, ISPRS 2006.
    """
    equations = np.einsum("bni,bnj->bnij", first, second).reshape(-1, 5, 9)
    null_space = np.linalg.svd(equations)[2][:, 5:].reshape(-1, 4, 3, 3)
    coefficients = _cubic_equations(null_space)
    leading, rest = coefficients[..., :10], coefficients[..., 10:]
    is_solvable = np.abs(np.linalg.det(leading)) > MIN_RELATIVE_DETERMINANT * np.prod(
        np.linalg.norm(leading, axis=-1), axis=-1
    )
    null_space, eliminated = null_space[is_solvable], np.linalg.solve(leading[is_solvable], rest[is_solvable])
    roots, vectors = np.linalg.eig(_action_matrix(eliminated))
    is_real = (np.abs(roots.imag) <= MAX_IMAGINARY_PART * np.abs(roots)) & (
        np.abs(vectors[:, 9]) > MIN_RELATIVE_DETERMINANT
    )
    sample, which = np.nonzero(is_real)
    weights = (vectors[sample, 6:, which] / vectors[sample, 9, which][:, None]).real
    essential = np.einsum("nk,nkij->nij", weights, null_space[sample])
    return np.asarray(essential / np.linalg.norm(essential, axis=(1, 2), keepdims=True))


def poses_of_essential(essential: Float[np.ndarray, "3 3"]) -> list[Pose]:
    """The four relative poses with that essential matrix (up to its sign); translations have length 1.

    Source: Hartley and Zisserman, section 9.6.2.
    """
    u, _, vt = np.linalg.svd(essential)
    u, vt = u * np.sign(np.linalg.det(u)), vt * np.sign(np.linalg.det(vt))
    quarter_turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return [Pose(u @ turn @ vt, sign * u[:, 2]) for turn in (quarter_turn, quarter_turn.T) for sign in (1.0, -1.0)]


def _cubic_equations(null_space: np.ndarray) -> np.ndarray:
    """Coefficients ``(batch, 10, 20)`` of the ten equations, from their values at twenty points."""
    weights = np.concatenate([SAMPLE_POINTS, np.ones((len(SAMPLE_POINTS), 1))], axis=1)
    e = np.einsum("pk,bkij->bpij", weights, null_space)
    square = e @ np.swapaxes(e, -1, -2)
    trace = np.trace(square, axis1=-2, axis2=-1)[..., None, None]
    values = np.concatenate(
        [np.linalg.det(e)[..., None], (2.0 * square @ e - trace * e).reshape(*e.shape[:2], 9)], axis=-1
    )
    return np.asarray(np.einsum("mp,bpq->bqm", COEFFICIENTS_FROM_VALUES, values))


def _action_matrix(eliminated: np.ndarray) -> np.ndarray:
    """The matrix that multiplies by x in the space spanned by :data:`BASIS`."""
    action = np.zeros_like(eliminated)
    action[:, :6] = -eliminated[:, :6]
    for row, column in ((6, 0), (7, 1), (8, 2), (9, 6)):
        action[:, row, column] = 1.0
    return action


MIN_INLIERS = 24
"""Matches that have to agree with a pose at least; fewer may agree by chance."""

STRAIGHT_AHEAD = Pose(np.eye(3), FORWARD)

MIN_INLIER_SHARE = 0.08
"""Share of all matches that have to agree with a pose at least."""

INLIER_THRESHOLD_PIXELS = 1.0
"""Pixels (of the searched image) from its epipolar circle within which a match is an inlier."""

SAMPLES_PER_BATCH, MAX_BATCHES = 300, 30
"""Samples of five matches that are drawn at once, and how many times at most."""

CONFIDENCE = 0.9999
"""Probability that a sample without a wrong match was among those drawn."""

HYPOTHESES_PER_CHUNK = 256
"""Hypotheses that are scored at once, which bounds memory."""

REFINED_HYPOTHESES = 5
"""Hypotheses that are refined."""

MIN_ROTATION_ONLY_SHARE = 0.9
"""Inliers of a pure rotation per inlier of the full pose from which on the cameras stand in one place."""

MAX_DIRECTION_STD = 0.2
"""Radians; a baseline direction with a larger standard deviation counts as unknown."""


@dataclass(frozen=True)
class Estimate:
    """What the matches say about a pair.

    Attributes:
        first_from_second: relative pose; its position has length 1, or is zero where ``have_same_position``.
        inliers: ``(n,)`` the matches that agree with it.
        residual: their median angle to the epipolar circles, or to the rotated directions if in place; radians.
        uncertainty: of rotation and direction.
        have_same_position: the panoramas were taken (nearly) from one place; there is no direction.
    """

    first_from_second: Pose
    inliers: Bool[np.ndarray, " n"]
    residual: float
    uncertainty: Uncertainty
    have_same_position: bool


def estimate_relative_pose(matches: Matches, known: Sequence[Pose] = ()) -> Estimate | None:
    """The relative pose that most matches agree with, or None if too few agree with any.

    ``known`` are relative poses with a position of length 1 that compete with what is found.

    Source: Fischler and Bolles, Random sample consensus, 1981; Torr and Zisserman, MLESAC, 2000 (truncated squares).
    """
    if len(matches) < MIN_INLIERS:
        return None
    scale = inlier_threshold(matches)
    pose = _best_pose(matches, known, scale)
    inliers = support_mask(pose, matches, scale)
    rotation = _best_rotation(matches, scale)
    turned = _rotation_residual(rotation, matches)
    count, in_place = int(inliers.sum()), int((turned < scale).sum())
    if max(count, in_place) < max(MIN_INLIERS, MIN_INLIER_SHARE * len(matches)):
        return None
    agreed = matches.select(inliers)
    spread = uncertainty(pose, agreed) if count else Uncertainty(np.inf, np.inf)
    if in_place >= MIN_ROTATION_ONLY_SHARE * count or spread.direction > MAX_DIRECTION_STD:
        return _in_place(rotation, turned, scale)
    residual = float(np.median(np.abs(epipolar_residual(pose, agreed))))
    return Estimate(pose, inliers, residual, spread, have_same_position=False)


def inlier_threshold(matches: Matches) -> float:
    """Radians within which a match agrees with a pose."""
    return INLIER_THRESHOLD_PIXELS * matches.pixel


def support_mask(first_from_second: Pose, matches: Matches, scale: float) -> Bool[np.ndarray, " n"]:
    """Matches near their epipolar circles with a point in front of both cameras."""
    is_near = np.abs(epipolar_residual(first_from_second, matches)) < scale
    return np.asarray(is_near & is_in_front(first_from_second, matches, scale))


def _in_place(rotation: np.ndarray, turned: np.ndarray, scale: float) -> Estimate:
    inliers = turned < scale
    residual = float(np.median(turned[inliers]))
    spread = Uncertainty(residual / np.sqrt(inliers.sum()), np.inf)
    return Estimate(Pose(rotation, np.zeros(3)), inliers, residual, spread, have_same_position=True)


def _best_pose(matches: Matches, known: Sequence[Pose], scale: float) -> Pose:
    hypotheses = (poses_of_essential(essential) for essential in _essential_hypotheses(matches, scale))
    in_front = (max(poses, key=lambda pose: support_mask(pose, matches, scale).sum()) for poses in hypotheses)
    starts = [*known, *in_front]
    starts = starts or [STRAIGHT_AHEAD]  # one picture twice: all samples are degenerate
    refined = [refine_pose(start, matches, scale) for start in starts]
    costs = [_pose_cost(pose, matches, scale) for pose in refined]
    return refined[int(np.argmin(costs))]


def _essential_hypotheses(matches: Matches, scale: float) -> Float[np.ndarray, "k 3 3"]:
    """The best :data:`REFINED_HYPOTHESES` essential matrices of random samples, best first."""
    rng, needed, drawn = np.random.default_rng(0), np.inf, 0
    best, costs = np.zeros((0, 3, 3)), np.zeros(0)
    pairs = ((matches.first, matches.second), (matches.first, matches.first), (matches.second, matches.second))
    products = tuple(np.einsum("ni,nj->ijn", a, b).reshape(9, -1) for a, b in pairs)  # residuals are linear in them
    while drawn < min(needed, SAMPLES_PER_BATCH * MAX_BATCHES):
        sample = np.stack([rng.choice(len(matches), 5, replace=False) for _ in range(SAMPLES_PER_BATCH)])
        drawn += SAMPLES_PER_BATCH
        found = essential_candidates(matches.first[sample], matches.second[sample])
        best, costs = np.concatenate([best, found]), np.concatenate([costs, _costs(found, products, scale)])
        order = np.argsort(costs, kind="stable")[:REFINED_HYPOTHESES]
        best, costs = best[order], costs[order]
        share = 1.0 - costs[0] / len(matches) if len(costs) else 0.0
        # samples until one of five right matches was drawn with that probability (Fischler and Bolles)
        needed = np.log(1.0 - CONFIDENCE) / np.log1p(-min(max(share, 1e-3) ** 5, 1.0 - 1e-9))
    return best


def _costs(essential: np.ndarray, products: tuple[np.ndarray, ...], scale: float) -> np.ndarray:
    """Truncated squared residuals in units of ``scale``, summed over the matches; 0 is best, n is worst."""
    first_second, first_first, second_second = products
    costs = []
    for begin in range(0, len(essential), HYPOTHESES_PER_CHUNK):
        e = essential[begin : begin + HYPOTHESES_PER_CHUNK]
        triple = e.reshape(-1, 9) @ first_second
        along_first = (e @ np.swapaxes(e, 1, 2)).reshape(-1, 9) @ first_first
        along_second = (np.swapaxes(e, 1, 2) @ e).reshape(-1, 9) @ second_second
        squared = triple**2 / np.maximum(0.5 * (along_first + along_second), 1e-12)
        costs.append(np.minimum(squared / scale**2, 1.0).sum(axis=1))
    return np.concatenate(costs) if costs else np.zeros(0)


def _pose_cost(pose: Pose, matches: Matches, scale: float) -> float:
    squared = np.minimum((epipolar_residual(pose, matches) / scale) ** 2, 1.0)
    return float(np.where(is_in_front(pose, matches, scale), squared, 1.0).sum())


def _best_rotation(matches: Matches, scale: float) -> Float[np.ndarray, "3 3"]:
    """The rotation that takes most second directions to first ones, by samples of two matches."""
    sample = np.random.default_rng(1).integers(len(matches), size=(SAMPLES_PER_BATCH, 2))
    frames = [_frames(directions[sample]) for directions in (matches.first, matches.second)]
    candidates = np.concatenate([nearest_rotation(frames[0] @ np.swapaxes(frames[1], 1, 2)), np.eye(3)[None]])
    products = np.einsum("ni,nj->ijn", matches.first, matches.second).reshape(9, -1)
    squared_chords = 2.0 - 2.0 * candidates.reshape(-1, 9) @ products
    rotation = candidates[int(np.argmin(np.minimum(squared_chords / scale**2, 1.0).sum(axis=1)))]
    for _ in range(5):  # reweighted with the same kernel as `refine_pose`
        weight = 1.0 / (1.0 + (_rotation_residual(rotation, matches) / scale) ** 2) ** 2
        rotation = nearest_rotation(np.einsum("n,ni,nj->ij", weight, matches.first, matches.second))
    return np.asarray(rotation)


def _frames(pairs: np.ndarray) -> np.ndarray:
    """``(batch, 3, 3)`` whose columns are two directions and what is orthogonal to both."""
    return np.stack([pairs[:, 0], pairs[:, 1], np.cross(pairs[:, 0], pairs[:, 1])], axis=2)


def _rotation_residual(rotation: np.ndarray, matches: Matches) -> np.ndarray:
    return angle_between(matches.first, matches.second @ rotation.T)
