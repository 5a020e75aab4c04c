"""Turning a panorama: whole columns are a roll, a turn and its reverse are none, and a direction stays in the world."""

import numpy as np
import pytest
from geometry_samples import rotations

from omnisyn_cli.geometry.pose import rotation_from_heading
from omnisyn_cli.geometry.sampling import rotated_directions, rotated_image
from omnisyn_cli.geometry.sphere import angles_to_direction, direction_to_pixel, pixel_directions

SIZE = (16, 32)


def noise(height: int, width: int) -> np.ndarray:
    return np.random.default_rng(0).random((height, width, 3)).astype(np.float32)


@pytest.mark.parametrize("index", [0, 7, 60, 130, 180])
def test_both_cameras_mean_the_same_direction_of_the_world(index: int) -> None:
    source, target = rotations()[index], rotations()[-1 - index]
    in_world = rotated_directions(SIZE, source, target) @ source.T
    np.testing.assert_allclose(in_world, pixel_directions(*SIZE) @ target.T, atol=1e-12)


@pytest.mark.parametrize("columns", [0, 1, 5, 31])
def test_looking_further_to_the_right_moves_what_is_seen_to_the_left(columns: int) -> None:
    image, target = noise(*SIZE), rotation_from_heading(columns / SIZE[1] * 2 * np.pi)
    np.testing.assert_allclose(
        rotated_image(image, np.eye(3), target, SIZE), np.roll(image, -columns, axis=1), atol=1e-5
    )


def test_a_larger_panorama_is_averaged_over_areas_and_a_smaller_one_is_not() -> None:
    image = noise(64, 128)
    means = image.reshape(16, 4, 32, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(rotated_image(image, np.eye(3), np.eye(3), SIZE), means, atol=1e-5)
    np.testing.assert_allclose(rotated_image(image, np.eye(3), np.eye(3), (64, 128)), image, atol=1e-5)


def test_what_is_seen_lies_where_it_belongs() -> None:
    """A bright spot, seen by a camera that looks straight at it, is in the middle of its image."""
    image = np.zeros((64, 128, 3), np.float32)
    azimuth = 1.0
    row, col = direction_to_pixel(angles_to_direction(np.array(azimuth), np.array(np.pi / 2)), (64, 128))
    image[int(row) : int(row) + 2, round(float(col)) - 1 : round(float(col)) + 2] = 1.0
    seen = rotated_image(image, np.eye(3), rotation_from_heading(azimuth), (64, 128))[..., 0]
    assert seen.min() >= 0.0
    assert seen.max() <= 1.0
    rows, cols = np.nonzero(seen > 0.5)
    assert abs(rows.mean() - 31.5) < 0.5
    assert abs(cols.mean() - 63.5) < 0.75
