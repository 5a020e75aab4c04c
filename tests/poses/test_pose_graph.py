"""Sets of panoramas: scale, rotations, who is placed, an order; then bundle adjustment and its stated errors."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from registration_samples import PIXEL, chain, edges_of, unit

from omnisyn_cli.geometry.pose import Pose, rotation_angle, rotation_from_rotation_vector
from omnisyn_cli.geometry.sphere import UP
from omnisyn_cli.poses.registration import pose_graph
from omnisyn_cli.poses.registration.bundle import Adjustment, adjust


@pytest.mark.parametrize("noise", [0.0, 0.2 * PIXEL])
def test_lengths_along_a_chain_follow_from_shared_points(noise):
    poses, pairs = chain(), [(0, 1), (1, 2), (2, 3), (3, 4)]
    edges = edges_of(poses, pairs, noise)
    lengths, scale_of = pose_graph.baseline_lengths(edges, {})
    assert not scale_of.any()
    true = np.array([np.linalg.norm(poses[b].position - poses[a].position) for a, b in pairs])
    np.testing.assert_allclose(lengths / lengths.mean(), true / true.mean(), rtol=1e-3 if noise == 0.0 else 0.03)
    np.testing.assert_allclose(pose_graph.baseline_lengths(edges, {(1, 2): true[1]})[0][1], true[1], rtol=1e-3)


@pytest.mark.parametrize(("wrong", "is_told"), [(0.45, True), (0.7, False)])
def test_points_that_say_anything_do_not_tell_a_ratio(wrong, is_told):
    """Equal bays of a facade match along it: the pose stays, and the distances of their points mean nothing."""
    poses = chain()
    first, second = edges_of(poses, [(0, 1), (1, 2)])
    pose, count = second.estimate.first_from_second, int(wrong * len(second.matches))
    away = np.exp(np.random.default_rng(2).uniform(0.0, 4.0, count))[:, None]  # in baselines
    bent = unit(pose.inverse().transform(second.matches.first[:count] * away))
    matches = replace(second.matches, second=np.concatenate([bent, second.matches.second[count:]]))
    lengths, scale_of = pose_graph.baseline_lengths([first, replace(second, matches=matches)], {})
    assert (scale_of[0] == scale_of[1]) == is_told
    if is_told:
        true = [np.linalg.norm(poses[k + 1].position - poses[k].position) for k in (0, 1)]
        np.testing.assert_allclose(lengths[0] / lengths[1], true[0] / true[1], rtol=0.02)


def test_a_set_is_placed_as_it_stands():
    poses = chain()
    edges = edges_of(poses, [(0, 1), (1, 2), (2, 3), (3, 4), (0, 2), (1, 3), (2, 4)])
    rotations = pose_graph.average_rotations(edges, range(5))
    given = {(0, 1): float(np.linalg.norm(poses[1].position))}
    found = pose_graph.positions_of(edges, *pose_graph.baseline_lengths(edges, given), rotations)
    for k in range(5):
        assert rotation_angle((poses[0].rotation.T @ poses[k].rotation).T @ rotations[k]) < 1e-6
        np.testing.assert_allclose(found[k], poses[0].rotation.T @ poses[k].position, atol=5e-3)


def test_directions_tell_the_scale_of_pairs_that_share_no_points():
    poses = [*chain(), Pose(np.eye(3), np.array([1.0, 0.5, 2.0]))]
    parts = [((0, 1), (1, 2)), ((2, 5), (4, 5)), ((0, 5),)]
    edges = [edge for seed, part in enumerate(parts) for edge in edges_of(poses[:6], list(part), seed=seed)]
    edges += edges_of(poses, [(2, 3), (3, 4)], seed=0)
    rotations = pose_graph.average_rotations(edges, range(6))
    lengths, scale_of = pose_graph.baseline_lengths(edges, {})
    assert len({*scale_of.tolist()}) == 3
    found = np.stack([*pose_graph.positions_of(edges, lengths, scale_of, rotations).values()])
    true = np.stack([poses[0].rotation.T @ pose.position for pose in poses])
    np.testing.assert_allclose(found / np.linalg.norm(found[5]), true / np.linalg.norm(true[5]), atol=0.01)
    assert pose_graph.is_worthwhile((1, 5), edges, 6)
    assert pose_graph.is_worthwhile((0, 6), edges, 7)
    assert not pose_graph.is_worthwhile((0, 5), edges, 6)
    assert not pose_graph.is_worthwhile((1, 3), edges, 6)


def test_a_pair_that_contradicts_the_others_is_dropped():
    """A room that looks alike from two sides: it is half turned, and all its matches agree."""
    poses, pairs = chain(), [(0, 1), (1, 2), (2, 3), (3, 4), (0, 2), (1, 3), (2, 4)]
    *right, wrong = edges_of(poses, [*pairs, (0, 4)])
    half_turned = Pose(rotation_from_rotation_vector(np.pi * UP), np.zeros(3)) @ wrong.estimate.first_from_second
    wrong = replace(wrong, estimate=replace(wrong.estimate, first_from_second=half_turned))
    rotations = pose_graph.average_rotations([*right, wrong], range(5))
    assert pose_graph.consistent_edges([*right, wrong], rotations) == right
    for k in range(5):
        assert rotation_angle((poses[0].rotation.T @ poses[k].rotation).T @ rotations[k]) < np.radians(0.01)


@pytest.mark.parametrize("is_ordered", [True, False])
@pytest.mark.parametrize("shift", [-1.0, 0.3, None])
def test_a_pair_that_is_shifted_along_repeated_tiles_is_dropped(shift, is_ordered):
    """It is not turned, and its matches agree; it stands on the other side, nearer, or seems to be in one place."""
    poses, pairs = chain(), [(0, 1), (1, 2), (2, 3), (3, 4), (0, 2), (2, 4)]
    right, moved = edges_of(poses, pairs), [*poses[:4], replace(poses[4], position=(shift or 1.0) * poses[4].position)]
    (wrong,) = edges_of(moved, [(0, 4)])
    if shift is None:
        turn = Pose(wrong.estimate.first_from_second.rotation, np.zeros(3))
        wrong = replace(wrong, estimate=replace(wrong.estimate, first_from_second=turn, have_same_position=True))
    rotations = pose_graph.average_rotations([*right, wrong], range(5))
    assert pose_graph.agreeing_edges([wrong, *right], rotations, is_ordered=is_ordered) == right
    assert pose_graph.agreeing_edges(right, rotations, is_ordered=is_ordered) == right


@pytest.mark.parametrize("culprit", range(3))
def test_of_pairs_that_contradict_the_one_with_matches_for_the_right_pose_is_dropped(culprit):
    """Three pairs in a ring: each could be the shifted one, if the right matches of that were not still there."""
    poses, pairs = chain(), [(0, 1), (1, 2), (0, 2)]
    edges, moved = edges_of(poses, pairs), list(poses)
    second = pairs[culprit][1]
    moved[second] = replace(poses[second], position=poses[second].position + np.array([0.4, 0.0, 0.9]))
    (wrong,) = edges_of(moved, [pairs[culprit]])
    right = [edge for edge in edges if edge is not edges[culprit]]
    edges[culprit] = replace(wrong, others=edges[culprit].matches)
    assert pose_graph.agreeing_edges(edges, pose_graph.average_rotations(edges, range(3)), is_ordered=False) == right


def test_who_is_connected_with_nobody_is_not_placed():
    assert pose_graph.placed_panoramas(edges_of(chain(), [(1, 2), (2, 4)]), 5) == [1, 2, 4]
    assert pose_graph.placed_panoramas([], 3) == [0]


def test_the_order_of_an_unordered_line_is_found():
    poses, order = chain(), [3, 0, 4, 1, 2]
    shuffled = {order[k]: pose.position for k, pose in enumerate(poses)}
    assert pose_graph.shortest_path(shuffled, []) in (order, order[::-1])


PAIRS = [(0, 1), (1, 2), (2, 3), (3, 4), (0, 2)]


def disturbed(poses: Sequence[Pose], rng: np.random.Generator) -> dict[int, Pose]:
    """All but the first turned by a degree and moved by a tenth of a metre."""
    turns = [rotation_from_rotation_vector(rng.normal(size=3) * np.radians(0.6)) for _ in poses]
    moved = [
        Pose(turn @ pose.rotation, pose.position + rng.normal(size=3) * 0.06)
        for turn, pose in zip(turns, poses, strict=True)
    ]
    return dict(enumerate([poses[0], *moved[1:]]))


def errors(adjusted: Adjustment, poses: Sequence[Pose], first: int, second: int) -> tuple[float, float]:
    """Radians of rotation, and share of the distance, of the second pose as the first camera sees it."""
    found, true = (p[first].inverse() @ p[second] for p in (adjusted.poses, poses))
    scale = path_length(poses) / path_length(adjusted.poses)
    off = np.linalg.norm(scale * found.position - true.position) / np.linalg.norm(true.position)
    return float(rotation_angle(found.rotation.T @ true.rotation)), float(off)


def path_length(poses: Sequence[Pose] | dict[int, Pose]) -> float:
    return float(sum(np.linalg.norm(poses[b].position - poses[a].position) for a, b in PAIRS))


def test_disturbed_poses_go_back():
    poses = chain()
    adjusted = adjust(disturbed(poses, np.random.default_rng(0)), edges_of(poses, PAIRS))
    for k in range(1, 5):
        assert max(errors(adjusted, poses, 0, k)) < 1e-5
    np.testing.assert_array_equal(adjusted.poses[0].rotation, poses[0].rotation)


def test_given_lengths_stay():
    poses = chain()
    edges = edges_of(poses, PAIRS, noise=0.2 * PIXEL)
    adjusted = adjust(disturbed(poses, np.random.default_rng(0)), edges, {(1, 2): 1.0, (2, 3): 0.8})
    for (a, b), length in (((1, 2), 1.0), ((2, 3), 0.8)):
        found = np.linalg.norm(adjusted.poses[b].position - adjusted.poses[a].position)
        assert found == pytest.approx(length, rel=1e-2)


def test_stated_errors_are_those_that_repeating_shows():
    poses, ratios = chain(), []
    for seed in range(12):
        edges = edges_of(poses, PAIRS, noise=0.2 * PIXEL, seed=seed)
        adjusted = adjust(dict(enumerate(poses)), edges)
        ratios += [np.divide(errors(adjusted, poses, a, b), adjusted.relative_std(a, b)) for a, b in PAIRS]
    quadratic_mean = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert np.all((quadratic_mean > 0.6) & (quadratic_mean < 1.4))
    assert np.all(np.mean(np.less(ratios, 2.0), axis=0) > 0.9)


def test_a_length_that_nothing_tells_is_not_stated_as_known():
    poses = chain()[:3]
    edges = [  # each with one half of the points, so that the pairs share none
        replace(edge, matches=edge.matches.select(np.arange(k, len(edge.matches), 2)))
        for k, edge in enumerate(edges_of(poses, [(0, 1), (1, 2)]))
    ]
    assert adjust(dict(enumerate(poses)), edges).relative_std(1, 2)[1] > 0.2


@pytest.mark.parametrize("in_one_place", [{2, 3}, {0, 1, 2, 3, 4}])
def test_panoramas_of_one_place_keep_one_place(in_one_place):
    poses = [Pose(pose.rotation, chain()[2].position if k in in_one_place else pose.position)
             for k, pose in enumerate(chain())]  # fmt: skip
    pairs = [(0, 1), (1, 2), (1, 3), (3, 4), (2, 3)]
    edges = [
        replace(edge, estimate=replace(edge.estimate, have_same_position={edge.first, edge.second} <= in_one_place))
        for edge in edges_of(poses, pairs, noise=0.2 * PIXEL)
    ]
    adjusted = adjust(dict(enumerate(poses)), edges)
    np.testing.assert_array_equal(adjusted.poses[2].position, adjusted.poses[3].position)
    rotation, position = adjusted.relative_std(2, 3)
    assert 0.0 < rotation < np.radians(0.1)
    assert position == np.inf
