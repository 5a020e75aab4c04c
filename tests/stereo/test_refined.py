"""Refinement around a network: here functions whose answers are known stand in for it."""

from dataclasses import replace

import numpy as np
import pytest

from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.stereo.evidence import PLANES, Evidence, evidence_planes
from omnisyn_cli.stereo.matching import MatchingDepthEstimator, MatchingOptions
from omnisyn_cli.stereo.refined import RefinedDepthEstimator
from omnisyn_cli.types import View

SIZE = (32, 64)
RADIUS = 3.0
OFFSET = np.array([0.3, 0.2, -0.9])
TURN = rotation_from_rotation_vector(np.array([0.1, 0.7, -0.2]))


def inside_a_ball(position, rotation):
    """Inverse depth of a ball around the origin, and a picture that says which point of it is seen."""
    directions = pixel_directions(*SIZE) @ rotation.T
    along = directions @ position
    distance = -along + np.sqrt(along**2 + RADIUS**2 - position @ position)
    points = position + distance[..., None] * directions
    return 1.0 / distance, (0.5 + 0.5 * points / RADIUS).astype(np.float32)


def evidence(position, rotation, other_position, other_rotation):
    baseline = np.linalg.norm(other_position - position)
    inverse_depth, image = inside_a_ball(position, rotation)
    everywhere = np.ones(SIZE, bool)
    motion = Pose(other_rotation, other_position).inverse() @ Pose(rotation, position)
    return Evidence(
        image=image,
        matched=inverse_depth * baseline,
        agreed=everywhere,
        sky=~everywhere,
        filled=inverse_depth * baseline,
        usable=everywhere,
        second_from_first=Pose(motion.rotation, motion.position / baseline),
        up=rotation[1],
    )


@pytest.fixture
def both():
    origin, upright = np.zeros(3), np.eye(3)
    return evidence(origin, upright, OFFSET, TURN), evidence(OFFSET, TURN, origin, upright)


def test_true_depth_shows_the_same_point_in_both_panoramas_and_no_contradiction(both):
    planes = evidence_planes(*both)
    assert planes.shape == (PLANES, *SIZE)
    assert planes.dtype == np.float32
    inner = slice(3, -3)  # bilinear interpolation is coarse next to the poles
    for warped in (planes[8:11], planes[11:14]):
        np.testing.assert_allclose(warped[:, inner], planes[:3, inner], atol=0.02)
    assert np.abs(planes[14]).max() < 0.05
    assert (planes[15] == 1).all()


def test_where_the_other_panorama_sees_farther_the_difference_is_positive(both):
    first, second = both
    planes = evidence_planes(first, replace(second, filled=0.25 * second.filled))
    assert (planes[14] > 0.2).all()


def test_motion_and_elevation_are_told(both):
    planes = evidence_planes(*both)
    directions = pixel_directions(*SIZE)
    np.testing.assert_allclose(planes[16], directions @ (OFFSET / np.linalg.norm(OFFSET)), atol=1e-6)
    np.testing.assert_allclose(planes[17], directions[..., 1], atol=1e-6)
    turned = evidence_planes(both[1], both[0])
    np.testing.assert_allclose(turned[17], directions @ TURN[1], atol=1e-6)


def test_an_estimate_that_the_other_panorama_looks_through_loses_its_confidence(monkeypatch, both):
    matching = MatchingDepthEstimator(MatchingOptions(size=(64, 128)), threads=1)
    monkeypatch.setattr(MatchingDepthEstimator, "evidence", lambda *_: both)
    views = [View(both[0].image, Pose.identity()), View(both[1].image, Pose(TURN, OFFSET))]

    def true(planes):
        return planes[3] ** 2, np.ones(SIZE, np.float32)

    def half_of_the_first_too_near(planes):
        inverse_depth = planes[3] ** 2
        if np.allclose(planes[:3], np.moveaxis(both[0].image, -1, 0)):
            inverse_depth[:, :32] *= 3.0
        return inverse_depth, np.ones(SIZE, np.float32)

    baseline = np.linalg.norm(OFFSET)
    for estimate, known in zip(RefinedDepthEstimator(matching, true)(*views), both, strict=True):
        np.testing.assert_allclose(estimate.inverse_depth, known.filled / baseline, rtol=1e-5)
        assert estimate.confidence.min() > 0.8
    wrong = RefinedDepthEstimator(matching, half_of_the_first_too_near)(*views)[0]
    assert wrong.confidence[8:-8, :24].mean() < 0.5 < wrong.confidence[8:-8, 40:56].mean()


def test_a_larger_size_adds_what_it_is_sure_of_where_it_means_the_same_surface(monkeypatch, both):
    """Columns in three parts: the sizes agree; contradict each other; only the smaller one is sure."""
    third, offset = np.arange(SIZE[1]) * 3 // SIZE[1], np.linalg.norm(OFFSET)
    double = (2 * SIZE[0], 2 * SIZE[1])
    larger = tuple(
        replace(
            each,
            filled=enlarged(each.filled * np.choose(third, [1.05, 1.5, 1.05])),
            agreed=enlarged(np.broadcast_to(third < 2, SIZE)),
            sky=np.zeros(double, bool),
            usable=np.ones(double, bool),
        )
        for each in both
    )
    small, large = (MatchingDepthEstimator(MatchingOptions(size=(n, 2 * n)), threads=1) for n in (64, 128))
    monkeypatch.setattr(MatchingDepthEstimator, "evidence", lambda self, *_: both if self is small else larger)

    def told(planes):
        return planes[3] ** 2, np.full(SIZE, 0.5, np.float32)

    views = [View(both[0].image, Pose.identity()), View(both[1].image, Pose(TURN, OFFSET))]
    estimate = RefinedDepthEstimator(small, told, fine=large)(*views)[0]
    before = enlarged(RefinedDepthEstimator(small, told)(*views)[0].inverse_depth)
    expected = np.where(np.repeat(third, 2) == 0, larger[0].filled / offset, before)
    np.testing.assert_allclose(estimate.inverse_depth, expected, rtol=1e-5)
    assert estimate.confidence[:, : SIZE[1] // 2].max() == pytest.approx(0.8, abs=0.01)
    assert estimate.confidence[:, SIZE[1] :].max() <= 0.51


def enlarged(values):
    return values.repeat(2, axis=0).repeat(2, axis=1)


def test_panoramas_of_one_place_have_nothing_to_refine():
    def never(planes):
        raise AssertionError

    matching = MatchingDepthEstimator(MatchingOptions(size=(64, 128)), threads=1)
    view = View(np.zeros((64, 128, 3), np.float32), Pose.identity())
    for estimate in RefinedDepthEstimator(matching, never)(view, view):
        assert not estimate.inverse_depth.any()
        assert not estimate.confidence.any()
