import math

import numpy as np
import pytest
import torch
from geometry_samples import poses

from omnisyn_cli.geometry import sweep
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import angles_to_direction, direction_to_angles, pixel_directions

BASELINES = [(0, 0, -1), (0, 0, 3), (2, 0, 0), (0, 1, 0), (0, -5, 0), (1, 2, -0.3), (1e-4, 2, 0), (0.2, -1e-8, 0)]


def pair(baseline: tuple[float, float, float]) -> tuple[Pose, Pose]:
    """Two poses with rotations of their own, a baseline apart."""
    rotation, position = poses().rotation, np.array([3.0, -1.0, 2.0])
    return Pose(rotation[0], position), Pose(rotation[1], position + np.array(baseline, float))


@pytest.mark.parametrize("frame", [sweep.epipole_frame, sweep.forward_frame])
@pytest.mark.parametrize("baseline", BASELINES)
class TestFrames:
    def test_are_rigid_shared_and_leave_the_positions_alone(self, frame, baseline):
        first, second = pair(baseline)
        turned_first, turned_second, metres = frame(first, second)
        assert metres == pytest.approx(np.linalg.norm(baseline))
        assert (turned_first.position == first.position).all()
        assert (turned_second.position == second.position).all()
        assert (turned_first.rotation == turned_second.rotation).all()
        np.testing.assert_allclose(turned_first.rotation.T @ turned_first.rotation, np.eye(3), atol=1e-12)
        assert np.linalg.det(turned_first.rotation) == pytest.approx(1.0)

    def test_see_the_second_camera_at_a_fixed_direction(self, frame, baseline):
        first, second, metres = frame(*pair(baseline))
        expected = [0, 1, 0] if frame is sweep.epipole_frame else [0, 0, -1]
        np.testing.assert_allclose((first.inverse() @ second).position / metres, expected, atol=1e-12)

    def test_do_not_depend_on_how_the_cameras_were_held(self, frame, baseline):
        first, second = pair(baseline)
        level = frame(Pose(np.eye(3), first.position), Pose(np.eye(3), second.position))[0]
        np.testing.assert_array_equal(frame(first, second)[0].rotation, level.rotation)


@pytest.mark.parametrize("baseline", [(0, 0, -1), (2, 0, 0), (1, 2, -0.3)])
def test_the_ground_lies_at_the_image_centre_of_the_epipole_frame(baseline):
    first = sweep.epipole_frame(*pair(baseline))[0]
    azimuth, _ = direction_to_angles(first.rotation.T @ np.array([0.0, -1.0, 0.0]))
    assert azimuth == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("baseline", BASELINES)
def test_matches_lie_on_one_meridian_moved_down_by_the_parallax(baseline):
    first, second, metres = sweep.epipole_frame(*pair(baseline))
    directions = pixel_directions(12, 24)
    inverse_depth = np.random.default_rng(10).uniform(0.0, 0.9 / metres, directions.shape[:2])
    azimuth, polar_angle = direction_to_angles(directions)
    moved = sweep.sweep_directions(directions, inverse_depth, second.inverse() @ first)
    moved_azimuth, moved_polar_angle = direction_to_angles(moved)
    parallax = sweep.parallax_from_inverse_depth(polar_angle, inverse_depth, metres)
    np.testing.assert_allclose(moved_azimuth, azimuth, atol=1e-7)
    np.testing.assert_allclose(moved_polar_angle, polar_angle + parallax, atol=1e-9)


def test_equal_positions_are_refused():
    first, second = pair((0, 0, 0))
    with pytest.raises(ValueError, match="different positions"):
        sweep.epipole_frame(first, second)


class TestParallax:
    def test_law_of_sines_equals_triangulation_by_least_squares(self):
        rng = np.random.default_rng(11)
        for polar_angle, depth, baseline in rng.uniform([0.2, 0.5, 0.1], [2.8, 50.0, 2.0], (50, 3)):
            point = depth * angles_to_direction(np.float64(0.4), polar_angle)
            second = np.array([0.0, baseline, 0.0])
            towards = (point - second) / np.linalg.norm(point - second)
            parallax = direction_to_angles(towards)[1] - polar_angle
            rays = np.stack([point / depth, -towards], axis=-1)
            triangulated = np.linalg.lstsq(rays, second, rcond=None)[0][0]
            found = sweep.inverse_depth_from_parallax(polar_angle, parallax, baseline)
            assert 1 / found == pytest.approx(triangulated, rel=1e-6)

    def test_infinity_does_not_move_and_the_epipoles_do_not_either(self):
        polar_angle = np.linspace(0, math.pi, 9)
        np.testing.assert_array_equal(sweep.parallax_from_inverse_depth(polar_angle, 0 * polar_angle), 0.0)
        np.testing.assert_allclose(
            sweep.parallax_from_inverse_depth(np.array([0.0, math.pi]), np.array([0.5, 0.5])), 0, atol=1e-15
        )

    def test_rays_that_never_meet_are_infinitely_near_and_no_parallax_is_infinitely_far(self):
        found = sweep.inverse_depth_from_parallax(np.array([2.0, 3.0, math.pi]), np.array([1.2, 1.0, 0.0]))
        assert found.tolist() == [math.inf, math.inf, 0.0]

    def test_numpy_and_torch_agree(self):
        polar_angle, inverse_depth = np.linspace(0.1, 3, 20), np.linspace(0, 2, 20)
        expected = sweep.parallax_from_inverse_depth(polar_angle, inverse_depth)
        found = sweep.parallax_from_inverse_depth(torch.from_numpy(polar_angle), torch.from_numpy(inverse_depth))
        np.testing.assert_allclose(found, expected)


def test_sweeping_infinity_is_a_rotation_and_torch_agrees():
    directions, transform = pixel_directions(4, 8), Pose(poses().rotation[0], np.array([1.0, 2.0, 3.0]))
    far = sweep.sweep_directions(directions, np.zeros((4, 8)), transform)
    np.testing.assert_allclose(far, directions @ transform.rotation.T)
    near = sweep.sweep_directions(directions, np.full((4, 8), 0.5), transform)
    np.testing.assert_allclose(near, transform.transform(2.0 * directions) / 2.0)
    as_torch = sweep.sweep_directions(
        torch.from_numpy(directions), torch.full((4, 8), 0.5, dtype=torch.float64), transform
    )
    np.testing.assert_allclose(as_torch, near)
