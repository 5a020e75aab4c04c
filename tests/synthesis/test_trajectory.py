"""The camera's way passes through every panorama, without a jump, at the speed that was asked for."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from omnisyn_cli.geometry.pose import rotation_angle, slerp
from omnisyn_cli.synthesis.trajectory import EASES, HEADINGS, Waypoint, path_length, plan_path
from synthesis_samples import posed

CORNER = [posed((0, 1, 0), 0.3), posed((0, 1.5, -3), 1.0, 0.2, 0.1), posed((4, 1.5, -3), -1.0)]
WITH_STOPS = [CORNER[0], posed((0, 1, 0), 1.2), CORNER[1], CORNER[2], posed((4, 1.5, -3), 2.0)]
BACK = [posed((0, 0, 0)), posed((0, 0, -2), 0.5), posed((0, 0, 0), 1.0)]
TURN_ONLY = [posed((1, 2, 3), 0.0), posed((1, 2, 3), 2.0)]
VERTICAL = [posed((0, 0, 0), 0.4), posed((0, 3, 0), 0.9)]
CHAINS = {"corner": CORNER, "stops": WITH_STOPS, "there and back": BACK, "turn": TURN_ONLY, "vertical": VERTICAL}
positions = arrays(float, st.tuples(st.integers(2, 5), st.just(3)), elements=st.floats(-5, 5, width=16))


def steps(path: list[Waypoint]) -> np.ndarray:
    places = np.array([waypoint.pose.position for waypoint in path])
    return np.linalg.norm(np.diff(places, axis=0), axis=1)


def turns(path: list[Waypoint]) -> np.ndarray:
    rotations = np.array([waypoint.pose.rotation for waypoint in path])
    return rotation_angle(np.swapaxes(rotations[:-1], -1, -2) @ rotations[1:])


def frames_at_panoramas(path: list[Waypoint]) -> list[Waypoint]:
    return [waypoint for waypoint in path if waypoint.t in (0.0, 1.0)]


def looks_along(waypoint: Waypoint) -> np.ndarray:
    return waypoint.pose.rotation @ (0, 0, -1)


@pytest.mark.parametrize("ease", EASES)
@pytest.mark.parametrize("chain", CHAINS)
def test_one_frame_is_exactly_on_every_panorama(chain: str, ease: str) -> None:
    poses = CHAINS[chain]
    for frames in (len(poses), len(poses) + 1, 30, 97):
        path = plan_path(poses, frames, ease=ease)
        assert len(path) == frames
        shown = frames_at_panoramas(path)
        assert [waypoint.segment + waypoint.t for waypoint in shown] == list(range(len(poses)))
        for waypoint, pose in zip(shown, poses, strict=True):
            np.testing.assert_array_equal(waypoint.pose.position, pose.position)
            np.testing.assert_array_equal(waypoint.pose.rotation, pose.rotation)


@settings(max_examples=40, deadline=None)
@given(positions, st.sampled_from(EASES), st.integers(0, 40))
def test_any_chain_gives_an_ascending_way_through_all_panoramas(places: np.ndarray, ease: str, more: int) -> None:
    poses = [posed(place) for place in places]
    path = plan_path(poses, len(poses) + more, ease=ease)
    where = np.array([waypoint.segment + waypoint.t for waypoint in path])
    assert (np.diff(where) > 0).all()
    assert all(0 <= waypoint.segment < len(poses) - 1 and 0 <= waypoint.t <= 1 for waypoint in path)
    assert set(range(len(poses))) <= set(where)


def test_segments_far_shorter_than_a_step_still_get_their_frames() -> None:
    poses = [posed((x, 0, 0)) for x in (0, 10, 10.001, 10.002)]
    for frames in (4, 5, 50):
        assert len(frames_at_panoramas(plan_path(poses, frames))) == 4


def test_linear_is_constant_speed_within_half_a_frame() -> None:
    for frames in (10, 31, 200):
        path = plan_path(CORNER, frames)
        walked = np.concatenate([[0], np.cumsum(steps(path))])
        step = path_length(CORNER) / (frames - 1)
        np.testing.assert_allclose(walked, np.arange(frames) * step, atol=0.5 * step + 1e-9)
        for segment in range(2):
            inside = [w for w in path if w.segment == segment]
            np.testing.assert_allclose(np.diff(steps(inside)), 0, atol=1e-9)


def test_smooth_starts_and_ends_at_rest_and_keeps_the_middle() -> None:
    path = plan_path([posed((0, 0, 0)), posed((0, 0, -1))], 101, ease="smooth")
    moved = steps(path)
    assert moved[0] < 0.04 * moved.max()
    assert moved[-1] < 0.04 * moved.max()
    np.testing.assert_allclose(moved, moved[::-1], atol=1e-12)
    assert moved.argmax() in (49, 50)
    np.testing.assert_allclose(moved.max() * 100, 1.5, rtol=1e-3)
    assert path[50].t == pytest.approx(0.5)


@pytest.mark.parametrize("heading", HEADINGS)
@pytest.mark.parametrize("chain", CHAINS)
def test_nothing_jumps(chain: str, heading: str) -> None:
    """Halving the time between frames halves the largest step and the largest turn: both are continuous."""
    poses = CHAINS[chain]
    coarse, fine = (plan_path(poses, 40 * k + 1, heading=heading) for k in (1, 4))
    assert steps(fine).max() <= 0.3 * steps(coarse).max() + 1e-9
    assert turns(fine).max() <= 0.3 * turns(coarse).max() + 1e-6
    assert turns(coarse).max() < 0.5


def test_headings_mean_what_they_say() -> None:
    frames = {heading: plan_path(CORNER, 41, heading=heading) for heading in HEADINGS}
    for first, travel in zip(frames["first"], frames["travel"], strict=True):
        np.testing.assert_array_equal(first.pose.position, travel.pose.position)
    for waypoint in frames["fixed"]:
        np.testing.assert_array_equal(waypoint.pose.rotation, np.eye(3))
    for waypoint in frames["first"]:
        np.testing.assert_array_equal(waypoint.pose.rotation, CORNER[0].rotation)
    for waypoint in frames["panoramas"]:
        first, second = CORNER[waypoint.segment], CORNER[waypoint.segment + 1]
        between = slerp(first.rotation, second.rotation, waypoint.t)
        np.testing.assert_allclose(waypoint.pose.rotation, between, atol=1e-12)


def test_travel_looks_along_the_way_level_and_half_way_at_a_corner() -> None:
    path = plan_path(CORNER, 101, heading="travel")
    for waypoint in path:
        np.testing.assert_allclose(waypoint.pose.rotation @ (0, 1, 0), (0, 1, 0), atol=1e-9)
    np.testing.assert_allclose(looks_along(path[0]), (0, 0, -1), atol=1e-9)
    np.testing.assert_allclose(looks_along(path[-1]), (1, 0, 0), atol=1e-9)
    corner = next(w for w in path if w.segment + w.t == 1.0)
    np.testing.assert_allclose(looks_along(corner), np.array((1, 0, -1)) / np.sqrt(2), atol=1e-9)
    rightward = np.array([looks_along(w)[0] for w in path])
    assert (np.diff(rightward) >= -1e-12).all()


def test_travel_back_turns_about_the_vertical() -> None:
    path = plan_path(BACK, 101, heading="travel")
    np.testing.assert_allclose(looks_along(path[0]), (0, 0, -1), atol=1e-9)
    np.testing.assert_allclose(looks_along(path[-1]), (0, 0, 1), atol=1e-9)
    for waypoint in path:
        np.testing.assert_allclose(waypoint.pose.rotation @ (0, 1, 0), (0, 1, 0), atol=1e-9)


def test_travel_borrows_a_direction_where_there_is_none() -> None:
    up_then_east = [posed((0, 0, 0)), posed((0, 2, 0)), posed((3, 2, 0))]
    np.testing.assert_allclose(looks_along(plan_path(up_then_east, 9, heading="travel")[0]), (1, 0, 0), atol=1e-9)
    lift = plan_path(VERTICAL, 9, heading="travel")
    np.testing.assert_array_equal(lift[0].pose.rotation, VERTICAL[0].rotation)


def test_a_turn_in_place_takes_its_time() -> None:
    path = plan_path(TURN_ONLY, 11)
    np.testing.assert_allclose(steps(path), 0, atol=1e-12)
    np.testing.assert_allclose(turns(path), 0.2, atol=1e-9)
    path = plan_path(WITH_STOPS, 401)
    standing = sum(waypoint.segment == 0 for waypoint in path)
    assert 0.2 < standing / len(path) < 0.3


def test_the_order_of_the_panoramas_is_the_direction_of_the_way() -> None:
    there, back = plan_path(CORNER, 25), plan_path(CORNER[::-1], 25)
    for a, b in zip(there, back[::-1], strict=True):
        assert a.pose.almost_equals(b.pose, metres=1e-9, radians=1e-7)


def test_length_is_the_sum_of_the_segments() -> None:
    assert path_length(CORNER) == pytest.approx(np.hypot(3, 0.5) + 4)
    assert path_length(TURN_ONLY) == 0


def test_too_few_panoramas_or_frames_are_refused() -> None:
    with pytest.raises(ValueError, match="two panoramas, got 1"):
        plan_path(CORNER[:1], 5)
    with pytest.raises(ValueError, match=r"per panorama \(3\), got 2"):
        plan_path(CORNER, 2)


def test_poses_are_rigid() -> None:
    for heading in HEADINGS:
        for waypoint in plan_path(WITH_STOPS, 33, heading=heading):
            rotation = waypoint.pose.rotation
            np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
            assert np.linalg.det(rotation) == pytest.approx(1)
