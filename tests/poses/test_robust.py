"""The robust estimate: truth among wrong matches, degenerate pairs, repeatability, honest uncertainties."""

import numpy as np
import pytest
from registration_samples import PIXEL, matches_of, random_pose, seen, unit, world_points

from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.poses.registration.features import Matches
from omnisyn_cli.poses.registration.least_squares import (
    direction_error,
    refine_pose,
    relative_pose,
    retract,
    rotation_error,
    uncertainty,
)
from omnisyn_cli.poses.registration.robust import (
    MIN_MATCHES,
    Verticals,
    estimate_relative_pose,
    inlier_threshold,
    log_false_alarms,
)


@pytest.mark.parametrize("wrong", [0.0, 0.6])
@pytest.mark.parametrize("seed", range(3))
def test_the_truth_is_found_among_wrong_matches(seed, wrong):
    rng = np.random.default_rng(seed)
    first, second = random_pose(rng), random_pose(rng)
    matches = matches_of(rng, first, second, 400, noise=0.2 * PIXEL, wrong=wrong)
    estimate, truth = estimate_relative_pose(matches), relative_pose(first, second)
    assert estimate is not None
    assert rotation_error(estimate.first_from_second, truth) < 6 * estimate.uncertainty.rotation < np.radians(0.3)
    assert direction_error(estimate.first_from_second, truth) < 6 * estimate.uncertainty.direction < np.radians(1.0)
    assert abs(estimate.inliers.mean() - (1 - wrong)) < 0.1


def test_points_on_one_plane_are_enough():
    rng = np.random.default_rng(5)
    pose = Pose(rotation_from_rotation_vector(np.array([0.1, 1.0, 0.0])), np.array([1.0, 0.2, 0.3]))
    exact = seen(Pose.identity(), pose, world_points(rng, 300, "plane"))
    matches = Matches(exact.first, unit(exact.second + rng.normal(size=(300, 3)) * 0.1 * PIXEL), PIXEL)
    estimate = estimate_relative_pose(matches)
    assert estimate is not None
    assert rotation_error(estimate.first_from_second, relative_pose(Pose.identity(), pose)) < np.radians(0.1)


@pytest.mark.parametrize("metres", [0.0, 1e-3])
def test_one_place_is_recognised(metres):
    rng = np.random.default_rng(1)
    turn = rotation_from_rotation_vector(np.array([0.2, -1.4, 0.1]))
    second = Pose(turn, np.array([metres, 0.0, 0.0]))
    estimate = estimate_relative_pose(matches_of(rng, Pose.identity(), second, noise=0.2 * PIXEL, wrong=0.3))
    assert estimate is not None
    assert estimate.have_same_position
    assert not estimate.first_from_second.position.any()
    assert rotation_error(estimate.first_from_second, second) < np.radians(0.1)


def test_one_picture_twice_is_one_place():
    """All samples of equal directions are degenerate: no essential matrix follows from them."""
    directions = unit(np.random.default_rng(3).normal(size=(200, 3)))
    estimate = estimate_relative_pose(Matches(directions, directions, PIXEL))
    assert estimate is not None
    assert estimate.have_same_position
    assert rotation_error(estimate.first_from_second, Pose.identity()) < 1e-6


def test_noise_alone_has_no_pose():
    rng = np.random.default_rng(2)
    noise = Matches(unit(rng.normal(size=(300, 3))), unit(rng.normal(size=(300, 3))), PIXEL)
    assert estimate_relative_pose(noise) is None
    assert estimate_relative_pose(noise.select(np.arange(MIN_MATCHES - 1))) is None
    assert estimate_relative_pose(noise.select(np.arange(0))) is None


def test_equal_matches_give_equal_poses():
    rng = np.random.default_rng(3)
    matches = matches_of(rng, random_pose(rng), random_pose(rng), noise=0.3 * PIXEL, wrong=0.5)
    a, b = estimate_relative_pose(matches), estimate_relative_pose(matches)
    assert a is not None
    assert b is not None
    np.testing.assert_array_equal(a.first_from_second.rotation, b.first_from_second.rotation)
    np.testing.assert_array_equal(a.first_from_second.position, b.first_from_second.position)


@pytest.mark.parametrize("seed", range(5))
def test_refining_brings_three_degrees_back(seed):
    rng = np.random.default_rng(seed)
    first, second = random_pose(rng), random_pose(rng)
    matches, truth = matches_of(rng, first, second, noise=0.1 * PIXEL, wrong=0.2), relative_pose(first, second)
    step = np.concatenate([unit(rng.normal(size=3)), unit(rng.normal(size=2))]) * np.radians(3.0)
    disturbed = retract(truth, step)
    assert rotation_error(disturbed, truth) == pytest.approx(np.radians(3.0))
    refined = refine_pose(disturbed, matches, 10 * inlier_threshold(matches))
    refined = refine_pose(refined, matches, inlier_threshold(matches))
    assert rotation_error(refined, truth) < np.radians(0.05)
    assert direction_error(refined, truth) < np.radians(0.3)


def test_the_uncertainty_is_what_repeating_shows():
    """Errors of forty repetitions scatter as widely as the stated standard deviation says, within a factor of two."""
    rng = np.random.default_rng(4)
    first, second = random_pose(rng), random_pose(rng)
    truth, errors, stated = relative_pose(first, second), [], []
    for _ in range(40):
        matches = matches_of(rng, first, second, 200, noise=0.3 * PIXEL)
        pose = refine_pose(truth, matches, 5 * PIXEL)
        errors.append([rotation_error(pose, truth), direction_error(pose, truth)])
        spread = uncertainty(pose, matches)
        stated.append([spread.rotation, spread.direction])
    ratio = np.sqrt(np.mean(np.square(errors), axis=0)) / np.mean(stated, axis=0)
    assert np.all((ratio > 0.5) & (ratio < 2.0))


def test_a_known_pose_wins_that_is_less_likely_by_chance():
    """Repeated doors: few matches that lie apart agree with a wrong pose, more in crowds with the right one."""
    rng = np.random.default_rng(2)
    right, wrong = (Pose(np.eye(3), np.array(direction)) for direction in ([1.0, 0.0, 0.0], [0.0, 0.0, -1.0]))
    middles = unit(rng.normal(size=(12, 3)))
    crowds = (middles[:, None] + rng.uniform(-0.1, 0.1, (12, 8, 3))).reshape(-1, 3) * 3.0
    alone = unit(rng.normal(size=(40, 3))) * 3.0
    parts = [seen(Pose.identity(), pose, points) for pose, points in ((right, crowds), (wrong, alone))]
    matches = Matches(*(np.concatenate([getattr(part, end) for part in parts]) for end in ("first", "second")), PIXEL)
    for known in ((right,), (wrong, right)):
        estimate = estimate_relative_pose(matches, known)
        assert estimate is not None
        assert direction_error(estimate.first_from_second, right) < np.radians(1.0)
    alone_found = estimate_relative_pose(matches)
    assert alone_found is not None
    assert direction_error(alone_found.first_from_second, wrong) < np.radians(1.0)


def test_upright_cameras_need_fewer_matches_that_lie_apart():
    """All that a corridor shows lies around its two ends: enough for level cameras, not for any two."""
    rng, up = np.random.default_rng(5), np.array([0.0, 1.0, 0.0])
    second = Pose(rotation_from_rotation_vector(0.7 * up), unit(np.array([0.3, 0.0, -1.0])))
    ends = np.array([0.0, 0.0, 1.0]) * rng.choice([-1.0, 1.0], (40, 1)) * rng.uniform(4.0, 12.0, (40, 1))
    right = seen(Pose.identity(), second, ends + rng.uniform(-1.2, 1.2, (40, 3)))
    wrong = unit(rng.normal(size=(2, 60, 3)))
    matches = Matches(np.concatenate([right.first, wrong[0]]), np.concatenate([right.second, wrong[1]]), PIXEL)
    estimate = estimate_relative_pose(matches, verticals=Verticals(up, up, are_certain=True))
    assert direction_error(estimate.first_from_second, second) < np.radians(3.0)
    kinds = [None, Verticals(up, -up, are_certain=True), Verticals(up, up, are_certain=False)]
    general, contradicting, level = (log_false_alarms(second, matches, kind) for kind in kinds)
    assert level < general - 4.0 < contradicting - 8.0
