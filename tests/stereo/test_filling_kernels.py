"""Planes fitted around pixels are those of numpy's solver."""

import numpy as np
import pytest

from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.stereo.filling import fitted_values, normal_equations

FALLBACK_WEIGHT, TILT_RIDGE = 1e-3, 0.05
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
DIRECTIONS = pixel_directions(8, 16)


def solved(sums: np.ndarray, fallback: np.ndarray) -> np.ndarray:
    """The same with matrices."""
    matrix = np.empty((*fallback.shape, 3, 3))
    for k, (i, j) in enumerate(PAIRS):
        matrix[..., i, j] = matrix[..., j, i] = sums[..., k]
    amount = np.trace(matrix, axis1=-2, axis2=-1)[..., None, None]
    along = DIRECTIONS[..., :, None] * DIRECTIONS[..., None, :]
    matrix += FALLBACK_WEIGHT * along + (TILT_RIDGE * amount + 1e-9) * (np.eye(3) - along)
    vector = sums[..., 6:] + FALLBACK_WEIGHT * fallback[..., None] * DIRECTIONS
    return (np.linalg.solve(matrix, vector[..., None])[..., 0] * DIRECTIONS).sum(axis=-1)


@pytest.mark.parametrize("share", [0.0, 0.05, 1.0])
def test_a_fit_is_that_of_the_solver(share: float) -> None:
    """Nothing known, little and everything, summed over all pixels and over each alone."""
    rng = np.random.default_rng(7)
    values, fallback = rng.random((2, 8, 16))
    weight = rng.random((8, 16)) * (rng.random((8, 16)) < share)
    own = normal_equations(values, weight, DIRECTIONS)
    everywhere = np.broadcast_to(own.sum(axis=(0, 1)), own.shape)
    for sums in (own, np.ascontiguousarray(everywhere)):
        found = fitted_values(sums, fallback, DIRECTIONS, FALLBACK_WEIGHT, TILT_RIDGE)
        np.testing.assert_allclose(found, solved(sums.astype(np.float64), fallback), rtol=1e-6, atol=1e-9)
    if share == 0.0:
        np.testing.assert_allclose(found, fallback, rtol=1e-9)


def test_a_plane_is_found_from_all_of_its_pixels() -> None:
    values, weight = DIRECTIONS @ np.array([0.3, -0.2, 0.5]), np.ones((8, 16))
    sums = normal_equations(values, weight, DIRECTIONS)
    np.testing.assert_allclose(sums[..., 6:], values[..., None] * DIRECTIONS, rtol=1e-6)
    everywhere = np.ascontiguousarray(np.broadcast_to(sums.sum(axis=(0, 1)), sums.shape))
    found = fitted_values(everywhere, np.zeros((8, 16)), DIRECTIONS, 1e-9, 0.0)
    np.testing.assert_allclose(found, values, atol=1e-6)
