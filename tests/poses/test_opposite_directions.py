"""Repeated things support a direction and its opposite: dense matching and the given pose decide."""

from dataclasses import replace

import numpy as np
import pytest
from registration_samples import PIXEL, matches_of, unit

from confidence_samples import generated_views
from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.geometry.sphere import UP
from omnisyn_cli.poses.registration import scan as scans
from omnisyn_cli.poses.registration.diagnosis import diagnose
from omnisyn_cli.poses.registration.features import Matches
from omnisyn_cli.poses.registration.robust import estimate_relative_pose
from omnisyn_cli.stereo.dense_agreement import dense_agreement
from omnisyn_cli.types import View


def opposite_of(pose: Pose) -> Pose:
    return Pose(pose.rotation, -pose.position)


@pytest.fixture(scope="module")
def room() -> tuple[View, View]:
    first, _, last = generated_views("room", 104, 1.0, (256, 512))
    return first, last


def test_pictures_agree_better_with_the_true_direction(room: tuple[View, View]) -> None:
    pose = room[0].pose.inverse() @ room[1].pose
    assert dense_agreement(*room, pose) > 1.5 * dense_agreement(*room, opposite_of(pose))


@pytest.mark.parametrize("degrees", [180.0, 120.0])
def test_an_estimate_of_a_direction_to_the_other_side_is_replaced(room: tuple[View, View], degrees: float) -> None:
    first, second = (scans.scan_panorama(view.image) for view in room)
    right, matches = scans.register_pair(first, second)
    assert right is not None
    agreed = np.flatnonzero(right.inliers)
    pose = right.first_from_second
    off = rotation_from_rotation_vector(np.radians(degrees) * unit(np.cross(pose.position, UP)))
    moved = Pose(pose.rotation, off @ pose.position)
    wrong = replace(right, first_from_second=moved, inliers=np.zeros(len(matches), bool))
    wrong.inliers[agreed[: len(agreed) // 3]] = True
    found = scans._with_right_direction(first, second, wrong, matches, None)
    assert found is not None
    assert found.first_from_second.position @ pose.position > np.cos(np.radians(2.0))
    assert scans._with_right_direction(first, second, right, matches, None) is right


def test_poses_are_not_blamed_where_as_many_matches_agree_with_them() -> None:
    """Half of the matches are of repeated things, displaced the other way, and a few more than the others."""
    rng = np.random.default_rng(3)
    first, second = Pose.identity(), Pose(np.eye(3), np.array([1.0, 0.0, 0.0]))
    right, repeated = (matches_of(rng, first, pose, count=40, noise=1e-4) for pose in (second, opposite_of(second)))
    both = Matches(
        np.concatenate([right.first, repeated.first]), np.concatenate([right.second, repeated.second]), PIXEL
    )
    assert estimate_relative_pose(both) is not None
    for given in (second, opposite_of(second)):
        assert diagnose(first, given, both).verdict == "fits"
