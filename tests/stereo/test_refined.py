"""Completion and refinement around a network; functions with known answers stand in for it."""

from dataclasses import replace

import numpy as np
import pytest

from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.stereo.matching_estimator import MatchingDepthEstimator, MatchingOptions
from omnisyn_cli.stereo.refined_estimator import RefinedDepthEstimator
from omnisyn_cli.stereo.stereo_features import COMPLETION_CHANNEL_COUNT, StereoFeatures, completion_channels
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


def features(position, rotation, other_position, other_rotation):
    baseline = np.linalg.norm(other_position - position)
    inverse_depth, image = inside_a_ball(position, rotation)
    everywhere = np.ones(SIZE, bool)
    motion = Pose(other_rotation, other_position).inverse() @ Pose(rotation, position)
    return StereoFeatures(
        image=image,
        matched=inverse_depth * baseline,
        left_right_consistent=everywhere,
        sky=~everywhere,
        filled=inverse_depth * baseline,
        usable=everywhere,
        second_from_first=Pose(motion.rotation, motion.position / baseline),
        up=rotation[1],
    )


@pytest.fixture
def both():
    origin, upright = np.zeros(3), np.eye(3)
    return features(origin, upright, OFFSET, TURN), features(OFFSET, TURN, origin, upright)


def test_true_depth_shows_the_same_point_in_both_panoramas_and_no_contradiction(both):
    channels = completion_channels(*both)
    assert channels.shape == (COMPLETION_CHANNEL_COUNT, *SIZE)
    assert channels.dtype == np.float32
    inner = slice(3, -3)  # bilinear interpolation is coarse next to the poles
    for warped in (channels[8:11], channels[11:14]):
        np.testing.assert_allclose(warped[:, inner], channels[:3, inner], atol=0.02)
    assert np.abs(channels[14]).max() < 0.05
    assert (channels[15] == 1).all()


def test_where_the_other_panorama_sees_farther_the_difference_is_positive(both):
    first, second = both
    channels = completion_channels(first, replace(second, filled=0.25 * second.filled))
    assert (channels[14] > 0.2).all()


def test_motion_and_elevation_are_channels(both):
    channels = completion_channels(*both)
    directions = pixel_directions(*SIZE)
    np.testing.assert_allclose(channels[16], directions @ (OFFSET / np.linalg.norm(OFFSET)), atol=1e-6)
    np.testing.assert_allclose(channels[17], directions[..., 1], atol=1e-6)
    turned = completion_channels(both[1], both[0])
    np.testing.assert_allclose(turned[17], directions @ TURN[1], atol=1e-6)


def test_an_estimate_that_the_other_panorama_looks_through_loses_its_confidence(monkeypatch, both):
    matching = MatchingDepthEstimator(MatchingOptions(size=(64, 128)), threads=1)
    monkeypatch.setattr(MatchingDepthEstimator, "features", lambda *_: both)
    views = [View(both[0].image, Pose.identity()), View(both[1].image, Pose(TURN, OFFSET))]

    def true(channels):
        return channels[3] ** 2, np.ones(SIZE, np.float32)

    def half_of_the_first_too_near(channels):
        inverse_depth = channels[3] ** 2
        if np.allclose(channels[:3], np.moveaxis(both[0].image, -1, 0)):
            inverse_depth[:, :32] *= 3.0
        return inverse_depth, np.ones(SIZE, np.float32)

    baseline = np.linalg.norm(OFFSET)
    for estimate, known in zip(RefinedDepthEstimator(matching, true, 64)(*views), both, strict=True):
        np.testing.assert_allclose(estimate.inverse_depth, known.filled / baseline, rtol=1e-5)
        assert estimate.confidence.min() > 0.8
    wrong = RefinedDepthEstimator(matching, half_of_the_first_too_near, 64)(*views)[0]
    assert wrong.confidence[8:-8, :24].mean() < 0.5 < wrong.confidence[8:-8, 40:56].mean()


def test_without_a_network_the_estimate_is_that_of_one_that_repeats_the_filled_map(monkeypatch, both):
    """But for the median that smooths a network's answers where stereo is not valid: here it is valid everywhere."""
    monkeypatch.setattr(MatchingDepthEstimator, "features", lambda *_: both)
    first, second = (
        View(one.image, pose) for one, pose in zip(both, (Pose.identity(), Pose(TURN, OFFSET)), strict=True)
    )

    def repeats(channels):
        return channels[3] ** 2, np.maximum(channels[5], channels[6])

    estimators = [RefinedDepthEstimator(MatchingDepthEstimator(MatchingOptions(size=SIZE)), each, SIZE[0])
                  for each in (None, repeats)]  # fmt: skip
    for alone, repeated in zip(*(estimator(first, second) for estimator in estimators), strict=True):
        np.testing.assert_allclose(alone.inverse_depth, repeated.inverse_depth, rtol=1e-5)
        np.testing.assert_allclose(alone.confidence, repeated.confidence, rtol=1e-5, atol=1e-6)
        assert alone.confidence.mean() > 0.9


def test_estimates_have_the_last_size_that_the_pictures_have_pixels_for(monkeypatch, both):
    matching = MatchingDepthEstimator(MatchingOptions(size=(64, 128)), threads=1)
    monkeypatch.setattr(MatchingDepthEstimator, "features", lambda *_: both)

    def true(channels):
        return channels[3] ** 2, np.ones(SIZE, np.float32)

    views = [View(both[0].image, Pose.identity()), View(both[1].image, Pose(TURN, OFFSET))]
    for estimate, position, rotation in zip(
        RefinedDepthEstimator(matching, true, 256)(*views), (np.zeros(3), OFFSET), (np.eye(3), TURN), strict=True
    ):
        assert estimate.inverse_depth.shape == estimate.confidence.shape == (64, 128)
        truth = inside_a_ball(position, rotation)[0].repeat(2, axis=0).repeat(2, axis=1)
        assert np.isclose(estimate.inverse_depth, truth, rtol=0.1).mean() > 0.95


def test_panoramas_of_one_place_have_nothing_to_refine():
    def never(channels):
        raise AssertionError

    matching = MatchingDepthEstimator(MatchingOptions(size=(64, 128)), threads=1)
    view = View(np.zeros((64, 128, 3), np.float32), Pose.identity())
    for estimate in RefinedDepthEstimator(matching, never, 64)(view, view):
        assert not estimate.inverse_depth.any()
        assert not estimate.confidence.any()
