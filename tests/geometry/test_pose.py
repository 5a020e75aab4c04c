import math

import numpy as np
import pytest
from geometry_samples import AXES, directions, poses, rotations

from omnisyn_cli.geometry.pose import (
    SAME_POSITION_METRES,
    Pose,
    at_same_position,
    enu_from_geographic,
    interpolate_pose,
    nearest_rotation,
    quaternion_from_rotation,
    rotation_angle,
    rotation_from_heading,
    rotation_from_quaternion,
    rotation_from_rotation_vector,
    rotation_taking,
    rotation_vector_from_rotation,
    slerp,
)

NORTH, EAST, UP = np.array([0.0, 0, -1]), np.array([1.0, 0, 0]), np.array([0.0, 1, 0])
FORWARD, RIGHT = NORTH, EAST


class TestGroup:
    def test_a_pose_and_its_inverse_cancel(self):
        pose, identity = poses(), Pose.identity()
        assert (pose @ pose.inverse()).almost_equals(identity, metres=1e-12, radians=1e-7)
        assert (pose.inverse() @ pose).almost_equals(identity, metres=1e-12, radians=1e-7)

    def test_composition_is_one_transform_after_the_other(self):
        a, b = poses(), poses()
        b = Pose(b.rotation[::-1], b.position[::-1])
        points = np.random.default_rng(5).normal(size=a.position.shape)
        np.testing.assert_allclose((a @ b).transform(points), a.transform(b.transform(points)), atol=1e-12)

    def test_transforming_the_origin_gives_the_position(self):
        pose = poses()
        np.testing.assert_array_equal(pose.transform(np.zeros_like(pose.position)), pose.position)


@pytest.mark.parametrize(("distance", "is_same"), [(0.0, True), (0.5, True), (2.0, False)])
def test_panoramas_are_at_one_position_within_a_tolerance_however_they_are_turned(distance, is_same):
    first = Pose(np.eye(3), np.array([3.0, -2.0, 1.0]))
    second = Pose(rotations()[5], first.position + distance * SAME_POSITION_METRES * np.array([0.6, 0.0, -0.8]))
    assert at_same_position(first, second) == at_same_position(second, first) == is_same


class TestRotations:
    def test_are_rigid(self):
        rotation = rotations()
        squared = rotation @ np.swapaxes(rotation, -1, -2)
        np.testing.assert_allclose(squared, np.broadcast_to(np.eye(3), rotation.shape), atol=1e-14)
        np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-14)

    def test_quaternions_round_trip_near_every_singularity(self):
        rotation = rotations()
        quaternion = quaternion_from_rotation(rotation)
        np.testing.assert_allclose(np.linalg.norm(quaternion, axis=-1), 1.0, atol=1e-15)
        assert (quaternion[:, 0] >= 0).all()
        np.testing.assert_allclose(rotation_from_quaternion(quaternion), rotation, atol=1e-14)

    def test_quaternions_need_no_length_and_no_sign(self):
        quaternion = np.random.default_rng(6).normal(size=(50, 4))
        expected = rotation_from_quaternion(quaternion)
        np.testing.assert_allclose(rotation_from_quaternion(-7.5 * quaternion), expected, atol=1e-14)

    def test_quaternions_are_scalar_first(self):
        quarter_turn_left = np.array([math.cos(math.pi / 4), 0.0, math.sin(math.pi / 4), 0.0])
        np.testing.assert_allclose(rotation_from_quaternion(quarter_turn_left) @ FORWARD, -RIGHT, atol=1e-15)

    def test_rotation_vectors_round_trip_near_every_singularity(self):
        rotation = rotations()
        vector = rotation_vector_from_rotation(rotation)
        np.testing.assert_allclose(rotation_from_rotation_vector(vector), rotation, atol=1e-8)
        assert (np.linalg.norm(vector, axis=-1) <= math.pi + 1e-12).all()

    def test_tiny_rotation_vectors_keep_their_digits(self):
        vector = np.array([1e-9, -2e-12, 3e-5])
        found = rotation_vector_from_rotation(rotation_from_rotation_vector(vector))
        np.testing.assert_allclose(found, vector, rtol=1e-6, atol=1e-17)

    def test_the_angle_is_that_of_the_trace(self):
        rotation = rotations()
        from_trace = np.arccos(np.clip((np.trace(rotation, axis1=-2, axis2=-1) - 1) / 2, -1, 1))
        np.testing.assert_allclose(rotation_angle(rotation), from_trace, atol=1e-6)

    def test_rotation_taking_takes_any_direction_to_any_other_by_the_smallest_turn(self):
        vectors = np.concatenate([directions(20), AXES])
        for source, target in zip(vectors, np.roll(vectors, 5, axis=0), strict=True):
            rotation = rotation_taking(source, target)
            np.testing.assert_allclose(rotation @ source, target, atol=1e-7)
            assert rotation_angle(rotation) == pytest.approx(np.arccos(np.clip(source @ target, -1, 1)), abs=1e-6)

    @pytest.mark.parametrize("axis", AXES)
    def test_rotation_taking_turns_opposite_vectors_by_half_a_turn(self, axis):
        rotation = rotation_taking(axis, -axis)
        np.testing.assert_allclose(rotation @ axis, -axis, atol=1e-15)
        assert rotation_angle(rotation) == pytest.approx(math.pi)

    def test_nearest_rotation_of_a_noisy_rotation_is_close_and_rigid(self):
        rotation = rotations()
        found = nearest_rotation(rotation + 1e-4 * np.random.default_rng(7).normal(size=rotation.shape))
        np.testing.assert_allclose(np.linalg.det(found), 1.0, atol=1e-12)
        np.testing.assert_allclose(found, rotation, atol=1e-3)

    def test_nearest_rotation_never_mirrors(self):
        found = nearest_rotation(np.diag([1.0, 1.0, -1e-3]))
        assert np.linalg.det(found) == pytest.approx(1.0)


class TestInterpolation:
    def test_ends_are_exact(self):
        rotation = rotations()
        first, second = Pose(rotation, np.zeros((len(rotation), 3))), Pose(rotation[::-1], np.ones((len(rotation), 3)))
        for t, end in ((0, first), (1, second), (0.0, first), (1.0, second)):
            pose = interpolate_pose(first, second, t)
            assert (pose.rotation == end.rotation).all()
            assert (pose.position == end.position).all()

    def test_turns_at_constant_speed_the_shortest_way(self):
        first, second = rotations()[:100], np.roll(rotations(), 3, axis=0)[:100]
        whole = rotation_angle(np.swapaxes(first, -1, -2) @ second)
        part = rotation_angle(np.swapaxes(first, -1, -2) @ slerp(first, second, 0.25))
        np.testing.assert_allclose(part, whole / 4, atol=1e-7)

    def test_many_shares_at_once_are_one_after_the_other(self):
        first, second = rotations()[:2]
        shares = np.array([0.0, 0.1, 0.5, 1.0 - 1e-9, 1.0])
        found = slerp(first, second, shares)
        for rotation, share in zip(found, shares, strict=True):
            np.testing.assert_array_equal(rotation, slerp(first, second, float(share)))
        pairs = slerp(rotations()[:5], rotations()[5:10], shares)
        for index, share in enumerate(shares):
            one = slerp(rotations()[index], rotations()[5 + index], float(share))
            np.testing.assert_allclose(pairs[index], one, atol=1e-15)

    def test_is_the_same_from_either_end(self):
        first = rotation_from_rotation_vector(np.array([0.3, -0.2, 1.0]))
        second = rotation_from_rotation_vector(np.array([-1.0, 0.5, 0.2]))
        np.testing.assert_allclose(slerp(first, second, 0.3), slerp(second, first, 0.7), atol=1e-14)

    def test_moves_on_a_straight_line(self):
        pose = interpolate_pose(Pose.identity(), Pose(np.eye(3), np.array([4.0, 8.0, -2.0])), 0.25)
        np.testing.assert_allclose(pose.position, [1.0, 2.0, -0.5])


class TestHeading:
    @pytest.mark.parametrize(
        ("angles", "direction"),
        [((0,), NORTH), ((90,), EAST), ((180,), -NORTH), ((270,), -EAST), ((90, 30), 0.75**0.5 * EAST + 0.5 * UP)],
    )
    def test_is_a_compass_and_pitch_looks_up(self, angles, direction):
        np.testing.assert_allclose(rotation_from_heading(*np.radians(angles)) @ FORWARD, direction, atol=1e-15)

    def test_roll_turns_clockwise_and_keeps_the_line_of_sight(self):
        rotation = rotation_from_heading(0.4, 0.2, math.radians(90))
        level = rotation_from_heading(0.4, 0.2)
        np.testing.assert_allclose(rotation @ FORWARD, level @ FORWARD, atol=1e-15)
        np.testing.assert_allclose(rotation @ UP, level @ RIGHT, atol=1e-15)


class TestGeographic:
    def test_one_degree_of_latitude_is_111_kilometres_north(self):
        east, north, up = enu_from_geographic(48.5, 11.0, 0.0, (47.5, 11.0, 0.0))
        assert east == pytest.approx(0.0, abs=1e-6)
        assert north == pytest.approx(111_190, rel=1e-3)
        assert up == pytest.approx(-(north**2) / 2 / 6.37e6, rel=1e-2)

    def test_one_degree_of_longitude_shrinks_with_the_cosine_of_latitude(self):
        at_equator = enu_from_geographic(0.0, 1.0, 0.0, (0.0, 0.0, 0.0))[0]
        at_sixty = enu_from_geographic(60.0, 1.0, 0.0, (60.0, 0.0, 0.0))[0]
        assert at_equator == pytest.approx(111_320, rel=1e-4)
        assert at_sixty / at_equator == pytest.approx(0.5, rel=5e-3)

    @pytest.mark.parametrize(
        ("place", "origin", "expected", "tolerance"),
        [((10.0, 20.0, 25.0), (10.0, 20.0, 5.0), [0, 0, 20], 1e-8),
         ((89.9999, 180.0, 0.0), (89.9999, 0.0, 0.0), [0, 22.34, 0], 0.01)],
    )  # fmt: skip
    def test_altitude_is_up_and_the_pole_a_place_like_any_other(self, place, origin, expected, tolerance):
        np.testing.assert_allclose(enu_from_geographic(*place, origin), expected, atol=tolerance)

    def test_the_date_line_is_no_line(self):
        across = enu_from_geographic(10.0, -179.9999, 3.0, (10.0, 179.9999, 3.0))
        elsewhere = enu_from_geographic(10.0, 0.0001, 3.0, (10.0, -0.0001, 3.0))
        np.testing.assert_allclose(across, elsewhere, atol=1e-6)
        assert 0 < across[0] < 25
