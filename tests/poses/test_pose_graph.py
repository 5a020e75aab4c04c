"""Sets of panoramas: scale from shared points, averaged rotations, who is placed, and an order for walking."""

import numpy as np
import pytest
from registration_samples import PIXEL, random_pose, seen, unit, world_points

from omnisyn_cli.geometry.pose import Pose, rotation_angle
from omnisyn_cli.poses.registration.features import Matches
from omnisyn_cli.poses.registration.least_squares import Uncertainty, relative_pose
from omnisyn_cli.poses.registration.pose_graph import (
    Edge,
    average_rotations,
    baseline_lengths,
    placed_panoramas,
    positions_of,
    shortest_path,
)
from omnisyn_cli.poses.registration.robust import Estimate

SPACING = (0.4, 1.3, 0.7, 2.0)


def chain() -> list[Pose]:
    rng = np.random.default_rng(0)
    along = np.concatenate([[0.0], np.cumsum(SPACING)])
    return [Pose(random_pose(rng).rotation, np.array([x, 0.02 * x, 0.0])) for x in along]


def edges_of(poses: list[Pose], pairs: list[tuple[int, int]], noise: float = 0.0) -> list[Edge]:
    """Pairs that all see the same points; ``noise`` is radians of each direction, the same in all pairs."""
    rng = np.random.default_rng(1)
    points = world_points(rng, 300)
    directions = [seen(pose, pose, points).first for pose in poses]
    directions = [unit(each + rng.normal(size=each.shape) * noise) for each in directions]
    return [
        Edge(a, b, Estimate(relative_pose(poses[a], poses[b]), np.ones(300, bool), 0.0, Uncertainty(0.0, 0.0), False),
             Matches(directions[a], directions[b], PIXEL))
        for a, b in pairs
    ]  # fmt: skip


@pytest.mark.parametrize("noise", [0.0, 0.2 * PIXEL])
def test_lengths_along_a_chain_follow_from_shared_points(noise):
    poses, pairs = chain(), [(0, 1), (1, 2), (2, 3), (3, 4)]
    edges = edges_of(poses, pairs, noise)
    lengths, is_told = baseline_lengths(edges, {})
    assert is_told.all()
    true = np.array([np.linalg.norm(poses[b].position - poses[a].position) for a, b in pairs])
    np.testing.assert_allclose(lengths / lengths.mean(), true / true.mean(), rtol=1e-3 if noise == 0.0 else 0.03)
    np.testing.assert_allclose(baseline_lengths(edges, {(1, 2): true[1]})[0][1], true[1], rtol=1e-3)


def test_a_set_is_placed_as_it_stands():
    poses = chain()
    edges = edges_of(poses, [(0, 1), (1, 2), (2, 3), (3, 4), (0, 2), (1, 3), (2, 4)])
    rotations = average_rotations(edges, range(5))
    given = {(0, 1): float(np.linalg.norm(poses[1].position))}
    found = positions_of(edges, *baseline_lengths(edges, given), rotations)
    for k in range(5):
        assert rotation_angle((poses[0].rotation.T @ poses[k].rotation).T @ rotations[k]) < 1e-6
        np.testing.assert_allclose(found[k], poses[0].rotation.T @ poses[k].position, atol=5e-3)


def test_who_is_connected_with_nobody_is_not_placed():
    assert placed_panoramas(edges_of(chain(), [(1, 2), (2, 4)]), 5) == [1, 2, 4]
    assert placed_panoramas([], 3) == [0]


def test_the_order_of_an_unordered_line_is_found():
    poses, order = chain(), [3, 0, 4, 1, 2]
    shuffled = {order[k]: pose.position for k, pose in enumerate(poses)}
    assert shortest_path(shuffled, []) in (order, order[::-1])
