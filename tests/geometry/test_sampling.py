"""What is read between pixels, over the seam and the poles, by OpenCV too; borders, regions and turned panoramas."""

import math
from functools import partial

import cv2
import numpy as np
import pytest
import torch
from geometry_samples import directions, rotations

from omnisyn_cli.geometry import sampling
from omnisyn_cli.geometry.pose import rotation_from_heading, rotation_from_rotation_vector
from omnisyn_cli.geometry.regions import connected_regions
from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.geometry.sphere import angles_to_direction, direction_to_pixel, pixel_directions, pixel_to_direction

SIZE = (16, 32)
SAMPLERS = [sampling.sample_nearest, sampling.sample_bilinear, sampling.sample_bicubic]


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
    np.testing.assert_array_equal(image[sampling.wrap_pixel(row, col, 6, 8)], expected)


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
    np.testing.assert_allclose(sampling.sample_bilinear(image, vectors), expected, atol=1e-12)


@pytest.mark.parametrize("sample", [sampling.sample_bilinear, sampling.sample_bicubic])
def test_interpolation_is_continuous_over_the_seam_and_the_poles(sample):
    image = noise(8, 16)
    ways, off = np.array([[0, 0.2, 1.0], [0, 1.0, 0], [0, -1.0, 0]]), 1e-9 * np.array([[1, 0, 0], [1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(sample(image, ways + off), sample(image, ways - off), atol=1e-6)


def test_bicubic_reproduces_ramps_and_parabolas_away_from_the_wraps():
    row, col = np.mgrid[:16, :32].astype(float)
    y, x = np.random.default_rng(9).uniform([3, 3], [12, 28], (100, 2)).T
    at = pixel_to_direction(y, x, (16, 32))
    np.testing.assert_allclose(sampling.sample_bicubic(2 * row - 3 * col, at), 2 * y - 3 * x, atol=1e-9)
    np.testing.assert_allclose(sampling.sample_bicubic(row**2 + 0.5 * col**2, at), y**2 + 0.5 * x**2, atol=1e-9)


@pytest.mark.parametrize("sample", SAMPLERS)
def test_rolling_the_image_and_turning_the_direction_cancel(sample):
    image, vectors = noise(8, 16, 2), directions()[:200]
    turned = vectors @ rotation_from_rotation_vector(np.array([0.0, -2 * math.pi * 3 / 16, 0.0])).T
    np.testing.assert_allclose(sample(np.roll(image, 3, axis=1), turned), sample(image, vectors), atol=1e-9)


@pytest.mark.parametrize("sample", SAMPLERS)
def test_numpy_and_torch_agree(sample):
    image, vectors = noise(8, 16, 3), directions()
    np.testing.assert_allclose(sample(torch.from_numpy(image), torch.from_numpy(vectors)), sample(image, vectors))


@pytest.mark.parametrize("sample", [sampling.sample_bilinear, sampling.sample_bicubic])
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
    found = sampling.grid_subsample(image, np.array(rows), np.array(cols))
    np.testing.assert_array_equal(found, [[image[row, col] for col in cols] for row in rows])
    assert found.flags.c_contiguous


@pytest.mark.parametrize("shape", [(6, 8), (4, 10, 3)])
@pytest.mark.parametrize("border", [0, 1, 4])
def test_a_border_is_found_by_walking_over_the_poles_and_around(shape, border):
    image = noise(*shape)
    height, width = shape[:2]
    bordered = sampling.add_border(image, border)
    assert bordered.shape[:2] == (height + 2 * border, width + 2 * border)
    for row, col in np.ndindex(bordered.shape[:2]):
        np.testing.assert_array_equal(bordered[row, col], unwrapped(image, row - border, col - border))


@pytest.mark.parametrize("shape", [(6, 8), (4, 10, 3)])
@pytest.mark.parametrize("columns", [0, 1, 4, 25])
def test_added_columns_are_those_of_the_other_side(shape, columns):
    image = noise(*shape)
    expected = image[:, np.arange(-columns, shape[1] + columns) % shape[1]]
    np.testing.assert_array_equal(sampling.add_columns(image, columns), expected)


@pytest.mark.parametrize("turn", [1, 5, 11])
def test_a_turned_image_is_filtered_as_if_it_were_not_turned(turn):
    image, blur = noise(8, 16, 3), partial(cv2.blur, ksize=(5, 3))
    there = sampling.filter_across_seam(blur, np.roll(image, turn, axis=1), 2)
    np.testing.assert_allclose(there, np.roll(sampling.filter_across_seam(blur, image, 2), turn, axis=1), atol=1e-12)
    assert np.abs(blur(image)[:, 0] - sampling.filter_across_seam(blur, image, 2)[:, 0]).max() > 0.01


def test_an_image_that_needs_nothing_from_over_the_seam_is_filtered_as_it_is():
    image = noise(4, 6)
    np.testing.assert_array_equal(sampling.filter_across_seam(np.negative, image, 0), -image)


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
        np.testing.assert_array_equal(sampling.window_max(image, reach)[row, col], window.max(axis=(0, 1)))
        np.testing.assert_array_equal(sampling.window_min(image, reach)[row, col], window.min(axis=(0, 1)))


@pytest.mark.parametrize(("is_diagonal", "count"), [(True, 1), (False, 3)])
def test_corners_join_regions_only_where_they_are_asked_to(is_diagonal: bool, count: int) -> None:
    mask = np.zeros((4, 6), bool)
    mask[[0, 1, 2], [5, 0, 1]] = True  # a diagonal across the seam
    assert len(np.unique(connected_regions(mask, is_diagonal=is_diagonal)[mask])) == count


@pytest.mark.parametrize("is_diagonal", [True, False])
def test_turning_changes_no_region(is_diagonal: bool) -> None:
    rng = np.random.default_rng(2)
    for share in (0.2, 0.4, 0.6):
        mask = rng.random((30, 50)) < share
        found = connected_regions(mask, is_diagonal=is_diagonal)
        turned = np.roll(connected_regions(np.roll(mask, 17, axis=1), is_diagonal=is_diagonal), -17, axis=1)
        assert ((found > 0) == mask).all()
        pairs = np.unique(np.stack([found[mask], turned[mask]]), axis=1)
        assert len(pairs[0]) == len(np.unique(pairs[0])) == len(np.unique(pairs[1]))


@pytest.mark.parametrize("index", [0, 7, 60, 130, 180])
def test_both_cameras_mean_the_same_direction_of_the_world(index: int) -> None:
    source, target = rotations()[index], rotations()[-1 - index]
    in_world = sampling.rotated_directions(SIZE, source, target) @ source.T
    np.testing.assert_allclose(in_world, pixel_directions(*SIZE) @ target.T, atol=1e-12)


@pytest.mark.parametrize("columns", [0, 1, 5, 31])
def test_looking_further_to_the_right_moves_what_is_seen_to_the_left(columns: int) -> None:
    image, target = noise(*SIZE, 3), rotation_from_heading(columns / SIZE[1] * 2 * np.pi)
    found = sampling.rotated_image(image, np.eye(3), target, SIZE)
    np.testing.assert_allclose(found, np.roll(image, -columns, axis=1), atol=1e-5)


def test_a_larger_panorama_is_averaged_over_areas_and_a_smaller_one_is_not() -> None:
    image = noise(64, 128, 3)
    means = image.reshape(16, 4, 32, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(sampling.rotated_image(image, np.eye(3), np.eye(3), SIZE), means, atol=1e-5)
    np.testing.assert_allclose(sampling.rotated_image(image, np.eye(3), np.eye(3), (64, 128)), image, atol=1e-5)


def test_what_is_seen_lies_where_it_belongs() -> None:
    """A bright spot, seen by a camera that looks straight at it, is in the middle of its image."""
    image = np.zeros((64, 128, 3), np.float32)
    azimuth = 1.0
    row, col = direction_to_pixel(angles_to_direction(np.array(azimuth), np.array(np.pi / 2)), (64, 128))
    image[int(row) : int(row) + 2, round(float(col)) - 1 : round(float(col)) + 2] = 1.0
    seen = sampling.rotated_image(image, np.eye(3), rotation_from_heading(azimuth), (64, 128))[..., 0]
    assert seen.min() >= 0.0
    assert seen.max() <= 1.0
    rows, cols = np.nonzero(seen > 0.5)
    assert abs(rows.mean() - 31.5) < 0.5
    assert abs(cols.mean() - 63.5) < 0.75


REMAP_SIZE = (24, 48)
POLES_AND_SEAM = [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1e-9, 0.3, 1.0]]


def looked_directions() -> np.ndarray:
    """Random ones, of any length, with the singular ones."""
    free = np.random.default_rng(0).normal(size=(40 * 50 - len(POLES_AND_SEAM), 3))
    return np.concatenate([free, POLES_AND_SEAM]).reshape(40, 50, 3)


def smooth(channels: int) -> np.ndarray:
    """A picture of the sphere whose neighbouring pixels differ little, over the seam and the poles as well."""
    waves = np.random.default_rng(1).normal(size=(3, channels))
    return np.sin(2.0 * pixel_directions(*REMAP_SIZE) @ waves).astype(np.float32)


@pytest.mark.parametrize("channels", [1, 3])
def test_interpolation_is_that_of_the_plain_form(channels: int) -> None:
    image, looked = smooth(channels), RemapTable.for_directions(looked_directions(), REMAP_SIZE)
    pairs = ((looked.bilinear, sampling.sample_bilinear, 0.02), (looked.bicubic, sampling.sample_bicubic, 0.05))
    for read, plain, tolerance in pairs:
        found = read(image).reshape(40, 50, channels)
        np.testing.assert_allclose(found, plain(image, looked_directions()), atol=tolerance)


def test_the_nearest_pixel_is_that_of_the_plain_form() -> None:
    """But for places within a thirtieth of a pixel of the line between two."""
    image = np.arange(REMAP_SIZE[0] * REMAP_SIZE[1], dtype=np.float32).reshape(REMAP_SIZE)
    found = RemapTable.for_directions(looked_directions(), REMAP_SIZE).nearest(image)
    assert (found == sampling.sample_nearest(image, looked_directions())).mean() > 0.9


def test_a_mask_stays_one() -> None:
    mask, looked = smooth(1).reshape(REMAP_SIZE) > 0.5, RemapTable.for_directions(looked_directions(), REMAP_SIZE)
    found = looked.nearest(mask)
    assert found.dtype == np.bool_
    np.testing.assert_array_equal(found, looked.nearest(mask.astype(np.float32)) > 0)


def test_at_its_own_pixels_an_image_is_itself() -> None:
    image, looked = smooth(3), RemapTable.for_directions(7.0 * pixel_directions(*REMAP_SIZE), REMAP_SIZE)
    for read in (looked.nearest, looked.bilinear, looked.bicubic):
        np.testing.assert_allclose(read(image), image, atol=1e-5)
