"""OpenCV reads what the plain, readable form reads."""

import numpy as np
import pytest

from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.geometry.sampling import sample_bicubic, sample_bilinear, sample_nearest
from omnisyn_cli.geometry.sphere import pixel_directions

SIZE = (24, 48)
POLES_AND_SEAM = [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1e-9, 0.3, 1.0]]


def directions() -> np.ndarray:
    """Random ones, of any length, with the singular ones."""
    free = np.random.default_rng(0).normal(size=(40 * 50 - len(POLES_AND_SEAM), 3))
    return np.concatenate([free, POLES_AND_SEAM]).reshape(40, 50, 3)


def smooth(channels: int) -> np.ndarray:
    """A picture of the sphere whose neighbouring pixels differ little, over the seam and the poles as well."""
    waves = np.random.default_rng(1).normal(size=(3, channels))
    return np.sin(2.0 * pixel_directions(*SIZE) @ waves).astype(np.float32)


@pytest.mark.parametrize("channels", [1, 3])
def test_interpolation_is_that_of_the_plain_form(channels: int) -> None:
    image, looked = smooth(channels), RemapTable.for_directions(directions(), SIZE)
    pairs = ((looked.bilinear, sample_bilinear, 0.02), (looked.bicubic, sample_bicubic, 0.05))
    for read, plain, tolerance in pairs:
        np.testing.assert_allclose(read(image).reshape(40, 50, channels), plain(image, directions()), atol=tolerance)


def test_the_nearest_pixel_is_that_of_the_plain_form() -> None:
    """But for places within a thirtieth of a pixel of the line between two."""
    image = np.arange(SIZE[0] * SIZE[1], dtype=np.float32).reshape(SIZE)
    is_same = RemapTable.for_directions(directions(), SIZE).nearest(image) == sample_nearest(image, directions())
    assert is_same.mean() > 0.9


def test_a_mask_stays_one() -> None:
    mask, looked = smooth(1).reshape(SIZE) > 0.5, RemapTable.for_directions(directions(), SIZE)
    found = looked.nearest(mask)
    assert found.dtype == np.bool_
    np.testing.assert_array_equal(found, looked.nearest(mask.astype(np.float32)) > 0)


def test_at_its_own_pixels_an_image_is_itself() -> None:
    image, looked = smooth(3), RemapTable.for_directions(7.0 * pixel_directions(*SIZE), SIZE)
    for read in (looked.nearest, looked.bilinear, looked.bicubic):
        np.testing.assert_allclose(read(image), image, atol=1e-5)
