"""The zenith from vertical edges: among other lines, not without any, and in a picture."""

import numpy as np
import pytest
from registration_samples import street_image, street_poses, unit

from omnisyn_cli.geometry.sphere import UP
from omnisyn_cli.poses.registration.features import grey_of
from omnisyn_cli.poses.registration.least_squares import angle_between
from omnisyn_cli.poses.registration.scan import find_lines, find_vertical


@pytest.mark.parametrize("seed", range(3))
def test_vertical_lines_are_found_among_twice_as_many_others(seed):
    rng = np.random.default_rng(seed)
    up = unit(UP + np.array([0.3, 0.0, -0.2]))
    vertical = unit(np.cross(up, rng.normal(size=(60, 3))))
    noisy = unit(vertical + rng.normal(size=vertical.shape) * np.radians(0.2))
    lines = np.concatenate([noisy, unit(rng.normal(size=(120, 3)))]) * rng.uniform(0.05, 0.3, (180, 1))
    found = find_vertical(lines)
    assert found.is_certain
    assert angle_between(found.up, up) < min(5 * found.std, np.radians(0.2))


def test_lines_that_agree_on_nothing_are_not_certain():
    lines = unit(np.random.default_rng(4).normal(size=(200, 3))) * 0.1
    assert not find_vertical(lines).is_certain
    assert not find_vertical(lines[:3]).is_certain
    np.testing.assert_array_equal(find_vertical(lines[:0]).up, UP)


def test_the_zenith_of_a_tilted_picture():
    found, up = find_vertical(find_lines(grey_of(street_image(0, (512, 1024))))), street_poses()[0].rotation.T @ UP
    assert found.is_certain
    assert angle_between(found.up, up) < np.radians(0.5)


def test_lines_where_a_panorama_may_not_be_used_do_not_count():
    grey = grey_of(street_image(0))
    assert len(find_lines(grey, np.zeros(grey.shape, bool))) == 0
