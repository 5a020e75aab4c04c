"""Features on pictures: over the poles and the seam, within a fraction of a pixel, where they may be, repeatable."""

import numpy as np
import pytest
from registration_samples import street_image, street_matches, street_truth

from omnisyn_cli.geometry.pose import rotation_from_rotation_vector
from omnisyn_cli.geometry.sampling import sample_bicubic
from omnisyn_cli.geometry.sphere import direction_to_pixel, pixel_directions
from omnisyn_cli.poses.registration.features import find_features, match_features
from omnisyn_cli.poses.registration.least_squares import angle_between, direction_error, rotation_error
from omnisyn_cli.poses.registration.robust import estimate_relative_pose


@pytest.mark.parametrize("vector", [(0.0, 1.0, 0.0), (1.5, 0.3, -0.4)], ids=["yaw", "poles on the horizon"])
def test_turned_pictures_match_as_they_were_turned(vector):
    image, rotation = street_image(0), rotation_from_rotation_vector(np.array(vector))
    turned = sample_bicubic(image, pixel_directions(*image.shape[:2]) @ rotation.T)
    matches = match_features(find_features(image), find_features(turned))
    off = matches.first - matches.second @ rotation.T
    pixels = angle_between(matches.first, matches.second @ rotation.T) / matches.pixel
    assert len(matches) > 200
    assert np.median(pixels) < 0.25
    right = pixels < 1.0
    assert right.mean() > 0.9
    assert np.abs(off[right].mean(axis=0)).max() / matches.pixel < 0.05  # no bias of a part of a pixel
    cap = np.abs(matches.first[right][:, 1]) > np.cos(np.radians(30))
    seam = np.abs(direction_to_pixel(matches.first[right], image.shape[:2])[1] - image.shape[1] / 2) > 246
    assert cap.sum() >= 3
    assert seam.sum() >= 3


def test_a_mask_keeps_features_away():
    image = street_image(0)
    usable = np.zeros(image.shape[:2], bool)
    usable[:, 100:300] = True
    row, col = direction_to_pixel(find_features(image, usable).direction, usable.shape)
    assert len(row) > 50
    assert col.min() >= 99.5
    assert col.max() <= 299.5


def test_the_number_of_threads_changes_nothing():
    one, two = find_features(street_image(0), threads=1), find_features(street_image(0), threads=2)
    np.testing.assert_array_equal(one.direction, two.direction)
    np.testing.assert_array_equal(one.descriptor, two.descriptor)


def test_an_empty_picture_has_no_matches():
    nothing = find_features(np.full((64, 128, 3), 0.5))
    assert nothing.direction.shape == (0, 3)
    assert len(match_features(nothing, find_features(street_image(0)))) == 0


def test_the_pose_of_a_generated_pair_is_found():
    """Cameras that are tilted and look different ways, exact truth."""
    estimate = estimate_relative_pose(street_matches())
    assert estimate is not None
    assert rotation_error(estimate.first_from_second, street_truth()) < np.radians(0.15)
    assert direction_error(estimate.first_from_second, street_truth()) < np.radians(0.5)
