"""Completion around a network that is a function with known answers; depth measured again at full size."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from stereo_samples import OPENINGS, SIZE, room

from omnisyn_cli.geometry.pose import Pose, rotation_from_heading, rotation_from_rotation_vector
from omnisyn_cli.geometry.resize import resize_area
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.stereo.depth_sizes import matching_rows, refinement_sizes
from omnisyn_cli.stereo.matching_estimator import MatchingDepthEstimator, MatchingOptions
from omnisyn_cli.stereo.refined_estimator import RefinedDepthEstimator, refine_depth_at_size
from omnisyn_cli.stereo.stereo_features import COMPLETION_CHANNEL_COUNT, StereoFeatures, completion_channels
from omnisyn_cli.types import View

BALL_SIZE = (32, 64)
RADIUS = 3.0
OFFSET = np.array([0.3, 0.2, -0.9])
TURN = rotation_from_rotation_vector(np.array([0.1, 0.7, -0.2]))


def inside_a_ball(position, rotation):
    """Inverse depth of a ball around the origin, and a picture that says which point of it is seen."""
    directions = pixel_directions(*BALL_SIZE) @ rotation.T
    along = directions @ position
    distance = -along + np.sqrt(along**2 + RADIUS**2 - position @ position)
    points = position + distance[..., None] * directions
    return 1.0 / distance, (0.5 + 0.5 * points / RADIUS).astype(np.float32)


def features(position, rotation, other_position, other_rotation):
    baseline = np.linalg.norm(other_position - position)
    inverse_depth, image = inside_a_ball(position, rotation)
    everywhere = np.ones(BALL_SIZE, bool)
    motion = Pose(other_rotation, other_position).inverse() @ Pose(rotation, position)
    return StereoFeatures(
        image=image, matched=inverse_depth * baseline, left_right_consistent=everywhere, sky=~everywhere,
        filled=inverse_depth * baseline, usable=everywhere, up=rotation[1],
        second_from_first=Pose(motion.rotation, motion.position / baseline),
    )  # fmt: skip


@pytest.fixture
def both():
    origin, upright = np.zeros(3), np.eye(3)
    return features(origin, upright, OFFSET, TURN), features(OFFSET, TURN, origin, upright)


def test_true_depth_shows_the_same_point_in_both_panoramas_and_no_contradiction(both):
    channels = completion_channels(*both)
    assert channels.shape == (COMPLETION_CHANNEL_COUNT, *BALL_SIZE)
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
    directions = pixel_directions(*BALL_SIZE)
    np.testing.assert_allclose(channels[16], directions @ (OFFSET / np.linalg.norm(OFFSET)), atol=1e-6)
    np.testing.assert_allclose(channels[17], directions[..., 1], atol=1e-6)
    turned = completion_channels(both[1], both[0])
    np.testing.assert_allclose(turned[17], directions @ TURN[1], atol=1e-6)


MATCHING = MatchingDepthEstimator(MatchingOptions(size=(64, 128)), threads=1)


def true(channels):
    """What a network says that repeats the filled map and is sure of it."""
    return channels[3] ** 2, np.ones(BALL_SIZE, np.float32)


@pytest.fixture
def views(monkeypatch, both):
    """The two panoramas, for matching that has found the truth."""
    monkeypatch.setattr(MatchingDepthEstimator, "features", lambda *_: both)
    return View(both[0].image, Pose.identity()), View(both[1].image, Pose(TURN, OFFSET))


def test_an_estimate_that_the_other_panorama_looks_through_loses_its_confidence(views, both):
    def half_of_the_first_too_near(channels):
        inverse_depth, confidence = true(channels)
        if np.allclose(channels[:3], np.moveaxis(both[0].image, -1, 0)):
            inverse_depth[:, :32] *= 3.0
        return inverse_depth, confidence

    for estimate, known in zip(RefinedDepthEstimator(MATCHING, true, 64)(*views), both, strict=True):
        np.testing.assert_allclose(estimate.inverse_depth, known.filled / np.linalg.norm(OFFSET), rtol=1e-5)
        assert estimate.confidence.min() > 0.8
    wrong = RefinedDepthEstimator(MATCHING, half_of_the_first_too_near, 64)(*views)[0]
    assert wrong.confidence[8:-8, :24].mean() < 0.5 < wrong.confidence[8:-8, 40:56].mean()


def test_without_a_network_the_estimate_is_that_of_one_that_repeats_the_filled_map(views):
    """But for the median that smooths a network's answers where stereo is not valid: here it is valid everywhere."""

    def repeats(channels):
        return channels[3] ** 2, np.maximum(channels[5], channels[6])

    estimators = [RefinedDepthEstimator(MatchingDepthEstimator(MatchingOptions(size=BALL_SIZE)), each, BALL_SIZE[0])
                  for each in (None, repeats)]  # fmt: skip
    for alone, repeated in zip(*(estimator(*views) for estimator in estimators), strict=True):
        np.testing.assert_allclose(alone.inverse_depth, repeated.inverse_depth, rtol=1e-5)
        np.testing.assert_allclose(alone.confidence, repeated.confidence, rtol=1e-5, atol=1e-6)
        assert alone.confidence.mean() > 0.9


def test_estimates_have_the_last_size_that_the_pictures_have_pixels_for(views):
    for estimate, view in zip(RefinedDepthEstimator(MATCHING, true, 256)(*views), views, strict=True):
        assert estimate.inverse_depth.shape == estimate.confidence.shape == (64, 128)
        truth = inside_a_ball(view.pose.position, view.pose.rotation)[0].repeat(2, axis=0).repeat(2, axis=1)
        assert np.isclose(estimate.inverse_depth, truth, rtol=0.1).mean() > 0.95


def test_panoramas_of_one_place_have_nothing_to_refine():
    view = View(np.zeros((64, 128, 3), np.float32), Pose.identity())
    for estimate in RefinedDepthEstimator(MATCHING, Mock(side_effect=AssertionError), 64)(view, view):
        assert not estimate.inverse_depth.any()
        assert not estimate.confidence.any()


OPTIONS = MatchingOptions()
STEP = 4
SMALL = (SIZE[0] // STEP, SIZE[1] // STEP)


def coarse_room(factor=1.0):
    """Both views, their true inverse depth in 1/baselines, and coarse maps of it times a factor."""
    rooms = room(Pose.identity()), room(OPENINGS["oblique and turned"])
    baseline = np.linalg.norm(OPENINGS["oblique and turned"].position)
    truths = [truth * baseline for _, truth in rooms]
    maps = tuple((resize_area(factor * t, SMALL), np.full(SMALL, 0.5, np.float32)) for t in truths)
    return [view for view, _ in rooms], truths, maps


def error(found, truth):
    return np.median(np.abs(found / truth - 1.0))


def test_maps_that_are_a_little_wrong_are_measured_again():
    views, truths, maps = coarse_room(factor=1.06)
    for (exact, confidence), (coarse, _), truth in zip(
        refine_depth_at_size(views, maps, SIZE, OPTIONS), maps, truths, strict=True
    ):
        assert exact.shape == confidence.shape == SIZE
        assert exact.dtype == confidence.dtype == np.float32
        enlarged = coarse.repeat(STEP, axis=0).repeat(STEP, axis=1)
        assert error(exact, truth) < 0.01 < 0.05 < error(enlarged, truth)
        assert (confidence == np.float32(0.8)).mean() > 0.7
        assert set(np.unique(confidence)) <= {np.float32(0.5), np.float32(0.8)}


def test_swapping_the_panoramas_swaps_the_answers():
    views, _, maps = coarse_room()
    forward = refine_depth_at_size(views, maps, SIZE, OPTIONS)
    swapped = refine_depth_at_size(views[::-1], maps[::-1], SIZE, OPTIONS)[::-1]
    for (one, _), (other, _) in zip(forward, swapped, strict=True):
        assert np.isclose(one, other, rtol=1e-3).mean() > 0.99


def test_nothing_is_found_that_is_no_surface_around():
    """All depth is given four times too near: the truth lies in no range, or is no surface that is known."""
    views, truths, maps = coarse_room(factor=4.0)
    for (found, _), truth in zip(refine_depth_at_size(views, maps, SIZE, OPTIONS), truths, strict=True):
        assert (found > 2.0 * truth).mean() > 0.99


def test_without_texture_maps_stay_as_they_were():
    views, truths, maps = coarse_room()
    blank = [replace(view, image=np.full_like(view.image, 0.5)) for view in views]
    for (found, confidence), truth in zip(refine_depth_at_size(blank, maps, SIZE, OPTIONS), truths, strict=True):
        assert np.isclose(found, truth, rtol=0.1).mean() > 0.95
        assert (confidence == 0.5).mean() > 0.95  # the rest lies next to the other epipole


def test_a_masked_pixel_is_not_measured():
    views, _, maps = coarse_room()
    mask = np.ones(SIZE, bool)
    mask[:, 100:150] = False
    (_, confidence), (_, other) = refine_depth_at_size((replace(views[0], mask=mask), views[1]), maps, SIZE, OPTIONS)
    assert (confidence[:, 102:148] == 0.5).all()
    assert (other == np.float32(0.8)).mean() > 0.5


def test_rolling_the_columns_of_the_pictures_rolls_the_answers():
    views, _, maps = coarse_room()
    columns = SIZE[1] // 4
    turn = rotation_from_heading(-2.0 * np.pi * columns / SIZE[1])
    rolled = [View(np.roll(v.image, columns, axis=1), Pose(v.pose.rotation @ turn, v.pose.position)) for v in views]
    maps_rolled = tuple((np.roll(a, columns // STEP, axis=1), b) for a, b in maps)
    before = refine_depth_at_size(views, maps, SIZE, OPTIONS)
    after = refine_depth_at_size(rolled, maps_rolled, SIZE, OPTIONS)
    for (one, _), (other, _) in zip(before, after, strict=True):
        assert np.isclose(np.roll(one, columns, axis=1), other, rtol=0.01).mean() > 0.97


@pytest.mark.parametrize(
    ("rows", "image_rows", "heights"),
    [(384, 512, [192]), (512, 64, [256]), (1024, 512, [256, 512]), (2048, 256, [256, 512]),
     (2048, 512, [256, 512, 1024])],
)  # fmt: skip
def test_sizes_double_up_to_what_is_wanted_and_what_the_pictures_have(rows, image_rows, heights):
    assert refinement_sizes(rows, image_rows) == tuple((height, 2 * height) for height in heights)
    assert matching_rows(rows) == 2 * heights[0]
