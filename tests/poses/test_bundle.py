"""Bundle adjustment: disturbed poses go back, lengths that are given stay, and the stated errors are those made."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from registration_samples import PIXEL, chain, edges_of

from omnisyn_cli.geometry.pose import Pose, rotation_angle, rotation_from_rotation_vector
from omnisyn_cli.poses.registration.bundle import Adjustment, adjust
from omnisyn_cli.poses.registration.pose_graph import Edge

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
        assert np.linalg.norm(adjusted.poses[b].position - adjusted.poses[a].position) == pytest.approx(
            length, rel=1e-2
        )


def test_stated_errors_are_those_that_repeating_shows():
    poses, ratios = chain(), []
    for seed in range(12):
        edges = edges_of(poses, PAIRS, noise=0.2 * PIXEL, seed=seed)
        adjusted = adjust(dict(enumerate(poses)), edges)
        ratios += [np.divide(errors(adjusted, poses, a, b), adjusted.relative_std(a, b)) for a, b in PAIRS]
    quadratic_mean, share_within_two = (
        np.sqrt(np.mean(np.square(ratios), axis=0)),
        np.mean(np.less(ratios, 2.0), axis=0),
    )
    assert np.all((quadratic_mean > 0.6) & (quadratic_mean < 1.4))
    assert np.all(share_within_two > 0.9)


def test_a_length_that_nothing_tells_is_not_stated_as_known():
    poses = chain()[:3]
    edges = [first_or_last(edge, k) for k, edge in enumerate(edges_of(poses, [(0, 1), (1, 2)]))]
    adjusted = adjust(dict(enumerate(poses)), edges)
    assert adjusted.relative_std(1, 2)[1] > 0.2


def first_or_last(edge: Edge, k: int) -> Edge:
    """With one half of the points, so that two pairs share none."""
    return replace(edge, matches=edge.matches.select(np.arange(k, len(edge.matches), 2)))


@pytest.mark.parametrize("in_one_place", [{2, 3}, {0, 1, 2, 3, 4}])
def test_panoramas_of_one_place_keep_one_place(in_one_place):
    poses = [Pose(pose.rotation, chain()[2].position if k in in_one_place else pose.position)
             for k, pose in enumerate(chain())]  # fmt: skip
    pairs = [(0, 1), (1, 2), (1, 3), (3, 4), (2, 3)]
    edges = edges_of(poses, pairs, noise=0.2 * PIXEL)
    edges = [
        replace(edge, estimate=replace(edge.estimate, have_same_position={edge.first, edge.second} <= in_one_place))
        for edge in edges
    ]
    adjusted = adjust(dict(enumerate(poses)), edges)
    np.testing.assert_array_equal(adjusted.poses[2].position, adjusted.poses[3].position)
    rotation, position = adjusted.relative_std(2, 3)
    assert 0.0 < rotation < np.radians(0.1)
    assert position == np.inf
