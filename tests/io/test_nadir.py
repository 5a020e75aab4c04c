"""The cap around straight down, against its definition and its share of the sphere."""

import numpy as np
import pytest

from omnisyn_cli.geometry.sphere import pixel_directions, solid_angles
from omnisyn_cli.io.images import outside_nadir


@pytest.mark.parametrize("degrees", [5.0, 20.0, 45.0, 89.0])
@pytest.mark.parametrize("size", [(64, 128), (33, 66)])
def test_it_holds_the_pixels_within_the_angle(degrees, size):
    down = np.array([0.0, -1.0, 0.0])
    angle = np.degrees(np.arccos(np.clip(pixel_directions(*size) @ down, -1, 1)))
    np.testing.assert_array_equal(outside_nadir(size, np.radians(degrees)), angle >= degrees)


def test_its_share_of_the_sphere_is_that_of_a_cap():
    inside = ~outside_nadir((512, 1024), np.radians(30.0))
    share = solid_angles(512, 1024)[inside].sum() / (4 * np.pi)
    np.testing.assert_allclose(share, (1 - np.cos(np.radians(30.0))) / 2, rtol=0.01)
    assert inside[-1].all()


def test_an_angle_of_zero_leaves_everything():
    assert outside_nadir((8, 16), 0.0).all()
