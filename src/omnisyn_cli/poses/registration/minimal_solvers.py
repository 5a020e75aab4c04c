"""Relative poses from the fewest matches that determine one: five, or fewer between upright cameras.

Each match gives one equation in the essential matrix, which has five degrees of freedom. Where gravity is known in both
cameras, only the turn about it and the direction of the baseline are left: three, or two at one height.
"""

import math
from itertools import product

import numpy as np
from jaxtyping import Float

from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.geometry.sphere import UP

CUBICS = ((3, 0, 0), (2, 1, 0), (2, 0, 1), (1, 2, 0), (1, 1, 1), (1, 0, 2), (0, 3, 0), (0, 2, 1), (0, 1, 2), (0, 0, 3))
BASIS = ((2, 0, 0), (1, 1, 0), (1, 0, 1), (0, 2, 0), (0, 1, 1), (0, 0, 2), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0))
"""Exponents of x, y, z: the monomials that are eliminated, and the basis of the quotient ring."""

# Twenty points (x, y, z) that determine a cubic polynomial in three variables.
SAMPLE_POINTS = np.array([p for p in product(range(4), repeat=3) if sum(p) <= 3], float) - 0.75
# Coefficients of a cubic polynomial from its values at :data:`SAMPLE_POINTS`.
COEFFICIENTS_FROM_VALUES = np.linalg.inv(np.prod(SAMPLE_POINTS[:, None, :] ** np.array(CUBICS + BASIS)[None], axis=2))
MAX_IMAGINARY_PART = 1e-6  # Imaginary part, relative to the absolute value, up to which a root counts as real
MIN_RELATIVE_DETERMINANT = 1e-10  # Determinant, relative to the lengths of its rows, below which a sample is degenerate


def essential_candidates(
    first: Float[np.ndarray, "batch 5 3"], second: Float[np.ndarray, "batch 5 3"]
) -> Float[np.ndarray, "found 3 3"]:
    """All essential matrices of all samples, in one list, each of Frobenius norm 1.

    ``first`` and ``second`` are unit vectors with ``first · E · second = 0``. E lies in the four-dimensional null space
    of five linear equations, ``E = xX + yY + zZ + W``; ten cubic ones, ``det E = 0`` and ``2EEᵀE − tr(EEᵀ)E = 0``,
    leave up to ten solutions, eigenvectors of a 10×10 matrix. Planes are no special case. Source: Stewénius, Engels,
    Nistér, Recent developments on direct relative orientation, ISPRS 2006.
    """
    equations = np.einsum("bni,bnj->bnij", first, second).reshape(-1, 5, 9)
    null_space = np.linalg.svd(equations)[2][:, 5:].reshape(-1, 4, 3, 3)
    coefficients = _cubic_equations(null_space)
    leading, rest = coefficients[..., :10], coefficients[..., 10:]
    scale = np.prod(np.linalg.norm(leading, axis=-1), axis=-1)
    is_solvable = np.abs(np.linalg.det(leading)) > MIN_RELATIVE_DETERMINANT * scale
    null_space, eliminated = null_space[is_solvable], np.linalg.solve(leading[is_solvable], rest[is_solvable])
    action = np.zeros_like(eliminated)  # multiplies by x in the space spanned by :data:`BASIS`
    action[:, :6] = -eliminated[:, :6]
    for row, column in ((6, 0), (7, 1), (8, 2), (9, 6)):
        action[:, row, column] = 1.0
    roots, vectors = np.linalg.eig(action)
    is_real = np.abs(roots.imag) <= MAX_IMAGINARY_PART * np.abs(roots)
    sample, which = np.nonzero(is_real & (np.abs(vectors[:, 9]) > MIN_RELATIVE_DETERMINANT))
    weights = (vectors[sample, 6:, which] / vectors[sample, 9, which][:, None]).real
    essential = np.einsum("nk,nkij->nij", weights, null_space[sample])
    return np.asarray(essential / np.linalg.norm(essential, axis=(1, 2), keepdims=True))


def poses_of_essential(essential: Float[np.ndarray, "3 3"]) -> list[Pose]:
    """The four relative poses of ±E, with positions of length 1. Source: Hartley and Zisserman, section 9.6.2."""
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
    traces = (2.0 * square @ e - trace * e).reshape(*e.shape[:2], 9)
    values = np.concatenate([np.linalg.det(e)[..., None], traces], axis=-1)
    return np.asarray(np.einsum("mp,bpq->bqm", COEFFICIENTS_FROM_VALUES, values))


MAX_MODULUS_ERROR = 1e-4  # Distance of a root from the unit circle up to which it counts as a turn

# Radians; a trigonometric polynomial of degree 2 follows from its values there.
TURNS = math.radians(72.0) * np.arange(5)


def upright_essential_candidates(
    first: Float[np.ndarray, "batch n 3"], second: Float[np.ndarray, "batch n 3"]
) -> Float[np.ndarray, "found 3 3"]:
    """All essential matrices of samples of matches between upright cameras, each of Frobenius norm 1.

    Of each sample ``first`` and ``second`` hold three unit vectors as rows, y up; or two if both cameras are at one
    height. At the right turn the epipolar planes share a line, the baseline: the determinant of their normals vanishes.
    A level baseline lies in the horizontal plane too. The determinant is a trigonometric polynomial of the turn of
    degree 2 (of two matches 1), so there are up to four solutions (two). Source: Fraundorfer, Tanskanen, Pollefeys, A
    minimal case solution to the calibrated relative pose problem for the case of two known orientation angles, 2010.
    """
    values = np.linalg.det(_plane_normals(first[:, None], second[:, None], _turns_about_up(TURNS)))
    degree = first.shape[1] - 1
    coefficients = np.fft.fft(values, axis=1)[:, np.arange(degree, -degree - 1, -1)]  # from e^2ia to e^-2ia
    is_solvable = np.abs(coefficients[:, 0]) > MIN_RELATIVE_DETERMINANT * np.abs(coefficients).max(axis=1)
    first, second, coefficients = first[is_solvable], second[is_solvable], coefficients[is_solvable]
    companion = np.zeros((len(coefficients), 2 * degree, 2 * degree), complex)
    companion[:, np.arange(1, 2 * degree), np.arange(2 * degree - 1)] = 1.0
    companion[:, 0] = -coefficients[:, 1:] / coefficients[:, :1]
    roots = np.linalg.eigvals(companion)
    sample, which = np.nonzero(np.abs(np.abs(roots) - 1.0) < MAX_MODULUS_ERROR)
    rotation = _turns_about_up(np.angle(roots[sample, which]))
    baseline = np.linalg.svd(_plane_normals(first[sample], second[sample], rotation))[2][:, 2]
    return np.asarray(np.cross(baseline[:, None, :], np.swapaxes(rotation, 1, 2)).swapaxes(1, 2) / math.sqrt(2.0))


def _plane_normals(first: np.ndarray, second: np.ndarray, rotation: np.ndarray) -> Float[np.ndarray, "*batch 3 3"]:
    """Those of epipolar planes, as rows; of two matches also that of the horizontal plane."""
    normals = np.cross(first, second @ np.swapaxes(rotation, -1, -2))
    return np.concatenate([normals, np.broadcast_to(UP, normals.shape)], axis=-2)[..., :3, :]


def _turns_about_up(angle: np.ndarray) -> Float[np.ndarray, "n 3 3"]:
    return rotation_from_rotation_vector(np.stack([np.zeros_like(angle), angle, np.zeros_like(angle)], axis=-1))
