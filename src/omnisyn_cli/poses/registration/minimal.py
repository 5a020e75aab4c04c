"""Relative poses from five pairs of directions, the fewest that determine one.

The essential matrix lies in the four-dimensional null space of five linear equations, ``E = xX + yY + zZ + W``; the
ten cubic equations ``det E = 0`` and ``2EEᵀE − tr(EEᵀ)E = 0`` leave up to ten solutions, which are eigenvectors of a
10×10 matrix. Planes, on which eight-point methods break down, are no special case.

Source: Stewénius, Engels, Nistér, Recent developments on direct relative orientation, ISPRS 2006.
"""

from itertools import product

import numpy as np
from jaxtyping import Float

from omnisyn_cli.geometry.pose import Pose

CUBICS = ((3, 0, 0), (2, 1, 0), (2, 0, 1), (1, 2, 0), (1, 1, 1), (1, 0, 2), (0, 3, 0), (0, 2, 1), (0, 1, 2), (0, 0, 3))
BASIS = ((2, 0, 0), (1, 1, 0), (1, 0, 1), (0, 2, 0), (0, 1, 1), (0, 0, 2), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0))
"""Exponents of x, y, z: the monomials that are eliminated, and those that span what is left."""

POINTS = np.array([p for p in product(range(4), repeat=3) if sum(p) <= 3], float) - 0.75
"""Twenty places that determine a cubic polynomial in three variables."""

FROM_VALUES = np.linalg.inv(np.prod(POINTS[:, None, :] ** np.array(CUBICS + BASIS)[None], axis=2))
"""Coefficients of a cubic polynomial from its values at :data:`POINTS`."""

REAL = 1e-6
"""Imaginary part, relative to the absolute value, up to which a root counts as real."""

SINGULAR = 1e-10


def essential_candidates(
    first: Float[np.ndarray, "batch 5 3"], second: Float[np.ndarray, "batch 5 3"]
) -> Float[np.ndarray, "found 3 3"]:
    """All essential matrices of all samples, in one list, each of Frobenius norm 1.

    ``first`` and ``second`` are unit vectors with ``first · E · second = 0``.
    """
    equations = np.einsum("bni,bnj->bnij", first, second).reshape(-1, 5, 9)
    null_space = np.linalg.svd(equations)[2][:, 5:].reshape(-1, 4, 3, 3)
    coefficients = _cubic_equations(null_space)
    leading, rest = coefficients[..., :10], coefficients[..., 10:]
    is_solvable = np.abs(np.linalg.det(leading)) > SINGULAR * np.prod(np.linalg.norm(leading, axis=-1), axis=-1)
    null_space, eliminated = null_space[is_solvable], np.linalg.solve(leading[is_solvable], rest[is_solvable])
    roots, vectors = np.linalg.eig(_times_x(eliminated))
    is_real = (np.abs(roots.imag) <= REAL * np.abs(roots)) & (np.abs(vectors[:, 9]) > SINGULAR)
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
    weights = np.concatenate([POINTS, np.ones((len(POINTS), 1))], axis=1)
    e = np.einsum("pk,bkij->bpij", weights, null_space)
    square = e @ np.swapaxes(e, -1, -2)
    trace = np.trace(square, axis1=-2, axis2=-1)[..., None, None]
    values = np.concatenate(
        [np.linalg.det(e)[..., None], (2.0 * square @ e - trace * e).reshape(*e.shape[:2], 9)], axis=-1
    )
    return np.asarray(np.einsum("mp,bpq->bqm", FROM_VALUES, values))


def _times_x(eliminated: np.ndarray) -> np.ndarray:
    """The matrix that multiplies by x in the space spanned by :data:`BASIS`."""
    action = np.zeros_like(eliminated)
    action[:, :6] = -eliminated[:, :6]
    for row, column in ((6, 0), (7, 1), (8, 2), (9, 6)):
        action[:, row, column] = 1.0
    return action
