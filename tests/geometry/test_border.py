"""What is added around an image is what the sphere shows there."""

import cv2
import numpy as np
import pytest
from test_sampling import noise, unwrapped

from omnisyn_cli.geometry.sampling import add_border, add_columns, filter_across_seam, window_max, window_min


@pytest.mark.parametrize("shape", [(6, 8), (4, 10, 3)])
@pytest.mark.parametrize("border", [0, 1, 4])
def test_a_border_is_found_by_walking_over_the_poles_and_around(shape, border):
    image = noise(*shape)
    height, width = shape[:2]
    bordered = add_border(image, border)
    assert bordered.shape[:2] == (height + 2 * border, width + 2 * border)
    for row, col in np.ndindex(bordered.shape[:2]):
        np.testing.assert_array_equal(bordered[row, col], unwrapped(image, row - border, col - border))


@pytest.mark.parametrize("shape", [(6, 8), (4, 10, 3)])
@pytest.mark.parametrize("columns", [0, 1, 4, 25])
def test_added_columns_are_those_of_the_other_side(shape, columns):
    image = noise(*shape)
    expected = image[:, np.arange(-columns, shape[1] + columns) % shape[1]]
    np.testing.assert_array_equal(add_columns(image, columns), expected)


@pytest.mark.parametrize("turn", [1, 5, 11])
def test_a_turned_image_is_filtered_as_if_it_were_not_turned(turn):
    image = noise(8, 16, 3)

    def blur(wide: np.ndarray) -> np.ndarray:
        return cv2.blur(wide, (5, 3))

    there = filter_across_seam(blur, np.roll(image, turn, axis=1), 2)
    np.testing.assert_allclose(there, np.roll(filter_across_seam(blur, image, 2), turn, axis=1), atol=1e-12)
    assert np.abs(blur(image)[:, 0] - filter_across_seam(blur, image, 2)[:, 0]).max() > 0.01


def test_an_image_that_needs_nothing_from_over_the_seam_is_filtered_as_it_is():
    image = noise(4, 6)
    np.testing.assert_array_equal(filter_across_seam(np.negative, image, 0), -image)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32, np.float64])
@pytest.mark.parametrize("shape", [(6, 12), (5, 10, 3)])
@pytest.mark.parametrize("reach", [0, 1, 3])
def test_window_extremes_equal_brute_force_across_the_seam(dtype, shape, reach):
    """Beyond the poles nothing counts, however large or small values are."""
    image = (200.0 * noise(*shape) + 20.0).astype(dtype)
    height, width = shape[:2]
    for row, col in np.ndindex(height, width):
        rows = slice(max(row - reach, 0), row + reach + 1)
        window = image[rows][:, np.arange(col - reach, col + reach + 1) % width]
        np.testing.assert_array_equal(window_max(image, reach)[row, col], window.max(axis=(0, 1)))
        np.testing.assert_array_equal(window_min(image, reach)[row, col], window.min(axis=(0, 1)))
