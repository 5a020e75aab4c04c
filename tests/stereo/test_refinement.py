"""A room of known depth, given at a quarter of the size, measured again at full size."""

from dataclasses import replace

import numpy as np
import pytest
from stereo_samples import OPENINGS, SIZE, room

from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.geometry.resize import resize_area
from omnisyn_cli.stereo.depth_sizes import matching_rows, refinement_sizes
from omnisyn_cli.stereo.matching_estimator import MatchingOptions
from omnisyn_cli.stereo.refined_estimator import refine_depth_at_size
from omnisyn_cli.types import View

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
    [
        (384, 512, [192]),
        (512, 64, [256]),
        (1024, 512, [256, 512]),
        (2048, 256, [256, 512]),
        (2048, 512, [256, 512, 1024]),
    ],
)
def test_sizes_double_up_to_what_is_wanted_and_what_the_pictures_have(rows, image_rows, heights):
    assert refinement_sizes(rows, image_rows) == tuple((height, 2 * height) for height in heights)
    assert matching_rows(rows) == 2 * heights[0]
