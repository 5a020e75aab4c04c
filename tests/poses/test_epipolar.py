"""Residuals and cheirality against their definitions; the five-point solver against the truth."""

import numpy as np
import pytest
from registration_samples import matches_of, random_pose, seen, unit, world_points

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.poses.registration.features import Matches
from omnisyn_cli.poses.registration.least_squares import (
    angle_between,
    direction_error,
    epipolar_residual,
    is_in_front,
    relative_pose,
    rotation_error,
)
from omnisyn_cli.poses.registration.minimal_solvers import essential_candidates, poses_of_essential

seeds = pytest.mark.parametrize("seed", range(8))


@seeds
def test_exact_matches_have_no_residual_and_lie_in_front(seed):
    rng = np.random.default_rng(seed)
    first, second = random_pose(rng), random_pose(rng)
    relative, matches = relative_pose(first, second), matches_of(rng, first, second)
    assert np.abs(epipolar_residual(relative, matches)).max() < 1e-12
    assert is_in_front(relative, matches).all()
    behind = Pose(relative.rotation, -relative.position)
    assert np.abs(epipolar_residual(behind, matches)).max() < 1e-12
    assert not is_in_front(behind, matches).any()


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
        sides.append(np.pi / 2 - angle_between(normal, seen_by_one))
    low, high = np.sort(np.abs(sides), axis=0)
    found = np.abs(epipolar_residual(relative, matches))
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
    for ray, other, answer in zip(matches.first, flat, is_in_front(relative, matches), strict=True):
        depths = np.linalg.lstsq(np.stack([ray, -other], axis=1), relative.position, rcond=None)[0]
        assert answer == bool((depths > 0).all())


def test_far_points_count_as_in_front_only_with_slack():
    pose = Pose(np.eye(3), np.array([0.0, 0.0, -1.0]))
    backwards = Matches(unit(np.array([[1.0, 0, 0.0]])), unit(np.array([[1.0, 0, -1e-4]])), 0.01)
    assert not is_in_front(pose, backwards)[0]
    assert is_in_front(pose, backwards, slack=1e-3)[0]


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
    ahead = [p for p in poses_of_essential(candidates[np.argmin(distances)]) if is_in_front(p, matches).all()]
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
