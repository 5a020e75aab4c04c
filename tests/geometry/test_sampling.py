import math

import numpy as np
import pytest
import torch
from geometry_samples import directions

from omnisyn_cli.geometry.pose import rotation_from_rotation_vector
from omnisyn_cli.geometry.sampling import grid_subsample, sample_bicubic, sample_bilinear, sample_nearest, wrap_pixel
from omnisyn_cli.geometry.sphere import direction_to_pixel, pixel_directions, pixel_to_direction

SAMPLERS = [sample_nearest, sample_bilinear, sample_bicubic]


def noise(*shape: int) -> np.ndarray:
    return np.random.default_rng(8).random(shape)


def unwrapped(image: np.ndarray, row: int, col: int) -> np.ndarray:
    """The pixel at any row and column, found by walking: over a pole, then around."""
    height, width = image.shape[:2]
    while not 0 <= row < height:
        row, col = (-1 - row, col + width // 2) if row < 0 else (2 * height - 1 - row, col + width // 2)
    return image[row, col % width]


def test_wrapped_pixels_are_found_by_walking_over_the_poles_and_around():
    image = noise(6, 8)
    row, col = (grid.ravel() for grid in np.mgrid[-6:12, -20:20])
    expected = [unwrapped(image, i, j) for i, j in zip(row, col, strict=True)]
    np.testing.assert_array_equal(image[wrap_pixel(row, col, 6, 8)], expected)


def test_pixels_beyond_a_pole_lie_on_the_same_meridian_on_the_other_side():
    """The direction through a pixel outside the image is the direction of the pixel it wraps to."""
    row, col = (grid.ravel() for grid in np.mgrid[-3:11, -4:20])
    inside = wrap_pixel(row, col, 8, 16)
    np.testing.assert_allclose(
        pixel_to_direction(1.0 * row, 1.0 * col, (8, 16)), pixel_directions(8, 16)[inside], atol=1e-14
    )


@pytest.mark.parametrize("sample", SAMPLERS)
@pytest.mark.parametrize("shape", [(8, 16), (8, 16, 3), (5, 10, 1), (2, 4, 2)])
def test_sampling_at_the_pixel_centres_returns_the_image(sample, shape):
    image = noise(*shape)
    np.testing.assert_allclose(sample(image, pixel_directions(*shape[:2])), image, atol=1e-12)


def test_bilinear_equals_brute_force_across_seam_and_poles():
    image, vectors = noise(8, 16, 3), directions()
    row, col = direction_to_pixel(vectors, (8, 16))
    expected = []
    for y, x in zip(row, col, strict=True):
        i, j = math.floor(y), math.floor(x)
        a, b = y - i, x - j
        upper = (1 - b) * unwrapped(image, i, j) + b * unwrapped(image, i, j + 1)
        lower = (1 - b) * unwrapped(image, i + 1, j) + b * unwrapped(image, i + 1, j + 1)
        expected.append((1 - a) * upper + a * lower)
    np.testing.assert_allclose(sample_bilinear(image, vectors), expected, atol=1e-12)


@pytest.mark.parametrize("sample", [sample_bilinear, sample_bicubic])
def test_interpolation_is_continuous_over_the_seam_and_the_poles(sample):
    image = noise(8, 16)
    for there, here in (
        ([1e-9, 0.2, 1.0], [-1e-9, 0.2, 1.0]),
        ([1e-9, 1.0, 0.0], [-1e-9, 1.0, 0.0]),
        ([0.0, -1.0, 1e-9], [0.0, -1.0, -1e-9]),
    ):
        a, b = sample(image, np.array([there, here]))
        assert a == pytest.approx(b, abs=1e-6)


def test_bicubic_reproduces_ramps_and_parabolas_away_from_the_wraps():
    row, col = np.mgrid[:16, :32].astype(float)
    y, x = np.random.default_rng(9).uniform([3, 3], [12, 28], (100, 2)).T
    at = pixel_to_direction(y, x, (16, 32))
    np.testing.assert_allclose(sample_bicubic(2 * row - 3 * col, at), 2 * y - 3 * x, atol=1e-9)
    np.testing.assert_allclose(sample_bicubic(row**2 + 0.5 * col**2, at), y**2 + 0.5 * x**2, atol=1e-9)


@pytest.mark.parametrize("sample", SAMPLERS)
def test_a_constant_image_is_constant(sample):
    np.testing.assert_allclose(sample(np.full((4, 8, 3), 0.7), directions()), 0.7, atol=1e-12)


@pytest.mark.parametrize("sample", SAMPLERS)
def test_rolling_the_image_and_turning_the_direction_cancel(sample):
    image, vectors = noise(8, 16, 2), directions()[:200]
    turned = vectors @ rotation_from_rotation_vector(np.array([0.0, -2 * math.pi * 3 / 16, 0.0])).T
    np.testing.assert_allclose(sample(np.roll(image, 3, axis=1), turned), sample(image, vectors), atol=1e-9)


@pytest.mark.parametrize("sample", SAMPLERS)
def test_numpy_and_torch_agree(sample):
    image, vectors = noise(8, 16, 3), directions()
    np.testing.assert_allclose(sample(torch.from_numpy(image), torch.from_numpy(vectors)), sample(image, vectors))


@pytest.mark.parametrize("sample", [sample_bilinear, sample_bicubic])
def test_gradients_are_those_of_finite_differences(sample):
    image = torch.from_numpy(noise(6, 12, 2)).requires_grad_()
    vectors = torch.tensor([[0.3, 0.4, -0.5], [0.01, -0.2, 0.9], [-0.7, 0.1, 0.33]], dtype=torch.float64)
    assert torch.autograd.gradcheck(sample, (image, vectors.requires_grad_()))


@pytest.mark.parametrize("rows", [[0, 3, 6], [1, 2, 4, 5], [5], [2, 6]])
@pytest.mark.parametrize("cols", [[0, 1, 2], [0, 2, 5], [11]])
@pytest.mark.parametrize("channels", [(), (4,)])
def test_pixels_where_rows_and_columns_cross_are_those(rows, cols, channels):
    """In equal steps and others, with and without channels, and in memory of their own, row after row."""
    image = np.random.default_rng(0).random((7, 12, *channels))
    found = grid_subsample(image, np.array(rows), np.array(cols))
    np.testing.assert_array_equal(found, [[image[row, col] for col in cols] for row in rows])
    assert found.flags.c_contiguous
