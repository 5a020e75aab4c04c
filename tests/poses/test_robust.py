"""Residuals and solvers; the robust estimate among wrong matches; directions and their opposites."""

from dataclasses import replace

import numpy as np
import pytest
from registration_samples import PIXEL, matches_of, random_pair, random_pose, seen, unit, world_points

from confidence_samples import generated_views
from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.geometry.sphere import UP
from omnisyn_cli.poses.registration import least_squares, robust
from omnisyn_cli.poses.registration import scan as scans
from omnisyn_cli.poses.registration.diagnosis import diagnose
from omnisyn_cli.poses.registration.features import Matches
from omnisyn_cli.poses.registration.least_squares import direction_error, refine_pose, relative_pose, rotation_error
from omnisyn_cli.poses.registration.minimal_solvers import essential_candidates, poses_of_essential
from omnisyn_cli.stereo.disparity import dense_agreement
from omnisyn_cli.types import View


@pytest.mark.parametrize("wrong", [0.0, 0.6])
@pytest.mark.parametrize("seed", range(3))
def test_the_truth_is_found_among_wrong_matches(seed, wrong):
    first, second, matches = random_pair(seed, 400, wrong=wrong)
    estimate, truth = robust.estimate_relative_pose(matches), relative_pose(first, second)
    assert rotation_error(estimate.first_from_second, truth) < 6 * estimate.uncertainty.rotation < np.radians(0.3)
    assert direction_error(estimate.first_from_second, truth) < 6 * estimate.uncertainty.direction < np.radians(1.0)
    assert abs(estimate.inliers.mean() - (1 - wrong)) < 0.1


def test_points_on_one_plane_are_enough_and_said():
    """Two rooms may have one floor covering; a dozen points of anything else tell them apart."""
    rng = np.random.default_rng(5)
    pose = Pose(rotation_from_rotation_vector(np.array([0.1, 1.0, 0.0])), np.array([1.0, 0.2, 0.3]))
    exact = seen(Pose.identity(), pose, world_points(rng, 300, "plane"))
    matches = Matches(exact.first, unit(exact.second + rng.normal(size=(300, 3)) * 0.1 * PIXEL), PIXEL)
    estimate = robust.estimate_relative_pose(matches)
    assert rotation_error(estimate.first_from_second, relative_pose(Pose.identity(), pose)) < np.radians(0.1)
    assert estimate.is_planar
    others = seen(Pose.identity(), pose, world_points(rng, 12))
    assert not robust.estimate_relative_pose(matches + others).is_planar


@pytest.mark.parametrize("metres", [0.0, 1e-3])
def test_one_place_is_recognised(metres):
    rng = np.random.default_rng(1)
    turn = rotation_from_rotation_vector(np.array([0.2, -1.4, 0.1]))
    second = Pose(turn, np.array([metres, 0.0, 0.0]))
    estimate = robust.estimate_relative_pose(matches_of(rng, Pose.identity(), second, noise=0.2 * PIXEL, wrong=0.3))
    assert estimate.have_same_position
    assert not estimate.first_from_second.position.any()
    assert rotation_error(estimate.first_from_second, second) < np.radians(0.1)


def test_one_picture_twice_is_one_place():
    """All samples of equal directions are degenerate: no essential matrix follows from them."""
    directions = unit(np.random.default_rng(3).normal(size=(200, 3)))
    estimate = robust.estimate_relative_pose(Matches(directions, directions, PIXEL))
    assert estimate.have_same_position
    assert rotation_error(estimate.first_from_second, Pose.identity()) < 1e-6


def test_noise_alone_has_no_pose():
    rng = np.random.default_rng(2)
    noise = Matches(unit(rng.normal(size=(300, 3))), unit(rng.normal(size=(300, 3))), PIXEL)
    assert robust.estimate_relative_pose(noise) is None
    assert robust.estimate_relative_pose(noise.select(np.arange(robust.MIN_MATCHES - 1))) is None
    assert robust.estimate_relative_pose(noise.select(np.arange(0))) is None


def test_equal_matches_give_equal_poses():
    matches = random_pair(3, noise=0.3 * PIXEL, wrong=0.5)[2]
    a, b = (robust.estimate_relative_pose(matches) for _ in range(2))
    np.testing.assert_array_equal(a.first_from_second.rotation, b.first_from_second.rotation)
    np.testing.assert_array_equal(a.first_from_second.position, b.first_from_second.position)


@pytest.mark.parametrize("seed", range(5))
def test_refining_brings_three_degrees_back(seed):
    rng = np.random.default_rng(seed)
    first, second = random_pose(rng), random_pose(rng)
    matches, truth = matches_of(rng, first, second, noise=0.1 * PIXEL, wrong=0.2), relative_pose(first, second)
    step = np.concatenate([unit(rng.normal(size=3)), unit(rng.normal(size=2))]) * np.radians(3.0)
    disturbed = least_squares.retract(truth, step)
    assert rotation_error(disturbed, truth) == pytest.approx(np.radians(3.0))
    refined = refine_pose(disturbed, matches, 10 * matches.tolerance)
    refined = refine_pose(refined, matches, matches.tolerance)
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
        spread = least_squares.uncertainty(pose, matches)
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
        estimate = robust.estimate_relative_pose(matches, known)
        assert direction_error(estimate.first_from_second, right) < np.radians(1.0)
    alone_found = robust.estimate_relative_pose(matches)
    assert direction_error(alone_found.first_from_second, wrong) < np.radians(1.0)


def test_upright_cameras_need_fewer_matches_that_lie_apart():
    """All that a corridor shows lies around its two ends: enough for level cameras, not for any two."""
    rng, up = np.random.default_rng(5), np.array([0.0, 1.0, 0.0])
    second = Pose(rotation_from_rotation_vector(0.7 * up), unit(np.array([0.3, 0.0, -1.0])))
    ends = np.array([0.0, 0.0, 1.0]) * rng.choice([-1.0, 1.0], (40, 1)) * rng.uniform(4.0, 12.0, (40, 1))
    right = seen(Pose.identity(), second, ends + rng.uniform(-1.2, 1.2, (40, 3)))
    wrong = unit(rng.normal(size=(2, 60, 3)))
    matches = Matches(np.concatenate([right.first, wrong[0]]), np.concatenate([right.second, wrong[1]]), PIXEL)
    estimate = robust.estimate_relative_pose(matches, verticals=robust.Verticals(up, up, are_certain=True))
    assert direction_error(estimate.first_from_second, second) < np.radians(3.0)
    kinds = [None, robust.Verticals(up, -up, are_certain=True), robust.Verticals(up, up, are_certain=False)]
    general, contradicting, level = (robust.log_false_alarms(second, matches, kind) for kind in kinds)
    assert level < general - 4.0 < contradicting - 8.0


def test_another_pose_that_fits_nearly_as_well_is_a_rival():
    """Tiles: half of the matches are those of a camera that stands one tile farther."""
    rng, way = np.random.default_rng(4), np.array([1.0, 0.0, 0.0])
    right, shifted = (Pose(np.eye(3), unit(way + np.array([0.0, 0.0, shift]))) for shift in (0.0, 0.6))
    parts = [matches_of(rng, Pose.identity(), pose, count=60, noise=1e-4) for pose in (right, shifted)]
    estimate = robust.estimate_relative_pose(parts[0] + parts[1])
    assert estimate is not None
    assert estimate.rival is not None
    errors = [direction_error(pose, right) for pose in (estimate.first_from_second, estimate.rival)]
    assert sorted(errors) == pytest.approx([0.0, direction_error(shifted, right)], abs=np.radians(0.5))
    estimate = robust.estimate_relative_pose(parts[0] + parts[1].select(np.arange(20)))
    assert estimate is not None
    assert estimate.rival is None


seeds = pytest.mark.parametrize("seed", range(8))


@seeds
def test_the_residual_is_the_angle_to_the_great_circles(seed):
    """The quadratic mean of both sides lies between them; each side by the angle to its plane."""
    rng = np.random.default_rng(seed)
    relative = relative_pose(random_pose(rng), random_pose(rng))
    matches = Matches(unit(rng.normal(size=(50, 3))), unit(rng.normal(size=(50, 3))), 0.01)
    turned = matches.second @ relative.rotation.T
    sides = []
    for seen_by_one, other in ((matches.first, turned), (turned, matches.first)):
        normal = np.cross(relative.position, other)
        sides.append(np.pi / 2 - least_squares.angle_between(normal, seen_by_one))
    low, high = np.sort(np.abs(sides), axis=0)
    found = np.abs(least_squares.epipolar_residual(relative, matches))
    assert np.all((found >= low - 1e-12) & (found <= high + 1e-12))


@seeds
def test_in_front_means_that_the_rays_meet_ahead(seed):
    """Against the two points where the rays come closest, by least squares."""
    rng = np.random.default_rng(seed)
    relative = relative_pose(random_pose(rng), random_pose(rng))
    matches = Matches(unit(rng.normal(size=(60, 3))), unit(rng.normal(size=(60, 3))), 0.01)
    # the directions are brought into one epipolar plane, so that their lines meet somewhere
    normal = unit(np.cross(relative.position, matches.first))
    turned = matches.second @ relative.rotation.T
    flat = unit(turned - np.sum(turned * normal, axis=1, keepdims=True) * normal)
    matches = Matches(matches.first, flat @ relative.rotation, 0.01)
    for ray, other, answer in zip(matches.first, flat, least_squares.is_in_front(relative, matches), strict=True):
        depths = np.linalg.lstsq(np.stack([ray, -other], axis=1), relative.position, rcond=None)[0]
        assert answer == bool((depths > 0).all())


def test_far_points_count_as_in_front_only_with_slack():
    pose = Pose(np.eye(3), np.array([0.0, 0.0, -1.0]))
    backwards = Matches(unit(np.array([[1.0, 0, 0.0]])), unit(np.array([[1.0, 0, -1e-4]])), 0.01)
    assert not least_squares.is_in_front(pose, backwards)[0]
    assert least_squares.is_in_front(pose, backwards, slack=1e-3)[0]


def essential_matrix(first_from_second: Pose) -> np.ndarray:
    """``E = [t]× R`` with ``d₁ᵀ E d₂ = 0``."""
    x, y, z = first_from_second.position
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ first_from_second.rotation


@pytest.mark.parametrize("shape", ["cloud", "plane"])
@seeds
def test_five_points_find_the_pose_even_on_a_plane(seed, shape):
    rng = np.random.default_rng(seed)
    relative = relative_pose(Pose.identity(), random_pose(rng))
    matches = seen(Pose.identity(), relative, world_points(rng, 5, shape))
    truth = essential_matrix(relative) / np.sqrt(2)
    candidates = essential_candidates(matches.first[None], matches.second[None])
    distances = [min(np.abs(e - truth).max(), np.abs(e + truth).max()) for e in candidates]
    assert min(distances) < 1e-6
    found = poses_of_essential(candidates[np.argmin(distances)])
    ahead = [pose for pose in found if least_squares.is_in_front(pose, matches).all()]
    assert len(ahead) == 1
    assert rotation_error(ahead[0], relative) < 1e-5
    assert direction_error(ahead[0], relative) < 1e-5


def test_all_candidates_are_essential_and_explain_their_sample():
    rng = np.random.default_rng(0)
    first, second = unit(rng.normal(size=(2, 40, 5, 3)))
    for k in range(40):
        for e in essential_candidates(first[k : k + 1], second[k : k + 1]):
            singular = np.linalg.svd(e)[1]
            np.testing.assert_allclose(singular, [np.sqrt(0.5), np.sqrt(0.5), 0.0], atol=1e-5)
            assert np.abs(np.einsum("ni,ij,nj->n", first[k], e, second[k])).max() < 1e-8


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
    agreed = np.flatnonzero(right.inliers)
    pose = right.first_from_second
    off = rotation_from_rotation_vector(np.radians(degrees) * unit(np.cross(pose.position, UP)))
    moved = Pose(pose.rotation, off @ pose.position)
    wrong = replace(right, first_from_second=moved, inliers=np.zeros(len(matches), bool))
    wrong.inliers[agreed[: len(agreed) // 3]] = True
    found = scans._with_right_direction(first, second, wrong, matches, None)
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
    assert robust.estimate_relative_pose(both) is not None
    for given in (second, opposite_of(second)):
        assert diagnose(first, given, both).verdict == "fits"
