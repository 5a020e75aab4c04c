"""Renderings are brought to one exposure, photographs are left alone, and what was cut off counts less."""

import numpy as np
import pytest

from omnisyn_cli.fusion.photometry import ExposureCurve, ExposureMatcher, darken_to_match, rough_exposure_curve
from omnisyn_cli.fusion.photometry.exposure_curve import KNOTS
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.types import Layer, View
from photometry_samples import exposed, in_eight_bits

SIZE = (32, 64)
HERE = Pose(np.eye(3), np.zeros(3))
STOP = ExposureCurve(np.ones((3, len(KNOTS))))


def picture(seed: int = 0, most: float = 0.7) -> np.ndarray:
    return (np.random.default_rng(seed).random((*SIZE, 3)) * most).astype(np.float32)


def rendering(image: np.ndarray, weight: float = 1.0) -> Layer:
    colour = np.dstack([image, np.full(SIZE, weight, np.float32)]).astype(np.float32)
    return Layer.from_arrays(np.full(SIZE, 0.2, np.float32), colour, HERE)


@pytest.mark.parametrize("t", [0.0, 0.25, 0.5, 1.0])
def test_both_renderings_come_to_the_exposure_of_the_frame(t: float) -> None:
    image = picture(most=0.6)
    for view in ExposureMatcher(STOP)(rendering(image), rendering(exposed(image, 1)), t):
        np.testing.assert_allclose(view.colour[..., :3], exposed(image, t), atol=3e-3)
        assert (view.colour[..., 3] == 1).all()


def test_colours_are_exposed_wherever_they_are_asked_for_and_the_rendering_is_left_alone() -> None:
    image, out = picture(), np.empty((5, SIZE[1], 4), np.float32)
    plain = rendering(image)
    first, _ = ExposureMatcher(STOP)(plain, rendering(image), 0.5)
    first.colour_rows(7, 12, out)
    np.testing.assert_array_equal(out, first.colour[7:12])
    rows, cols = np.array([0, 3, 31]), np.array([1, 2, 60])
    np.testing.assert_array_equal(first.subsampled_colours(rows, cols), first.colour[np.ix_(rows, cols)])
    np.testing.assert_array_equal(plain.colour[..., :3], image)


def test_at_the_ends_the_photograph_there_is_not_touched() -> None:
    image = picture(most=1.2)
    for t, own in ((0.0, 0), (1.0, 1)):
        views = ExposureMatcher(STOP)(rendering(image), rendering(image), t)
        np.testing.assert_array_equal(views[own].colour, rendering(image).colour)
        assert not np.array_equal(views[1 - own].colour, rendering(image).colour)


def test_highlights_that_were_cut_off_weigh_less_once_darkened() -> None:
    """The second picture is brighter: its whites say only that it was at least that bright."""
    white = np.ones((*SIZE, 3), np.float32)
    first, second = ExposureMatcher(STOP)(rendering(white), rendering(white), 0.5)
    assert (first.colour[..., 3] == 1).all()
    assert (second.colour[..., 3] < 0.4).all()
    assert (second.colour[..., 3] > 0).all()


def test_the_same_exposure_costs_nothing_and_changes_nothing() -> None:
    views = [rendering(picture(1)), rendering(picture(2))]
    found = ExposureMatcher(ExposureCurve(np.zeros((3, len(KNOTS)))))(views[0], views[1], 0.3)
    assert all(one is other for one, other in zip(found, views, strict=True))


def test_values_beyond_the_table_go_on_and_holes_stay_holes() -> None:
    image = picture()
    image[0], image[1] = 1.5, -0.1
    first, hole = ExposureMatcher(STOP.reversed())(rendering(image), rendering(image, weight=0.0), 0.5)
    assert (first.colour[0, :, :3] > 1.0).all()
    assert (first.colour[1, :, :3] < 0.0).all()
    np.testing.assert_array_equal(hole.colour[..., :3], image)


def alike(first: View, second: View) -> tuple[View, View]:
    return darken_to_match(first, second, rough_exposure_curve(first, second), threads=1)


@pytest.mark.parametrize("stop", [1.0, -1.0])
def test_before_depth_is_looked_for_pictures_are_exposed_alike(stop: float) -> None:
    views = View(in_eight_bits(picture(1)), HERE), View(in_eight_bits(exposed(picture(1), stop)), HERE)
    first, second = alike(*views)
    assert (second.image.mean() - first.image.mean()) == pytest.approx(0.0, abs=0.01)
    darker = 0 if stop > 0 else 1
    assert (first, second)[darker] is views[darker]


def test_a_picture_that_was_white_says_so_when_it_is_darkened() -> None:
    image = np.clip(picture(1) + 0.1, 0.0, 1.0)
    assert not any(view.is_clipped for view in alike(View(0.5 * image, HERE), View(0.7 * image, HERE)))
    bright = View(exposed(image, 2.0), HERE)
    assert (bright.image.max(-1) >= 1.0).mean() > 0.1
    assert [view.is_clipped for view in alike(View(image, HERE), bright)] == [False, True]
    assert [view.is_clipped for view in alike(bright, View(image, HERE))] == [True, False]


def test_views_alike_are_handed_on_as_they_are_and_masks_are_obeyed() -> None:
    first, second = View(picture(1), HERE), View(picture(2), HERE)
    assert all(a is b for a, b in zip(alike(first, second), (first, second), strict=True))
    dark = second.image.copy()
    dark[16:] = 0.01
    masked = View(dark, HERE, np.arange(SIZE[0])[:, None] * np.ones(SIZE) < 16)
    assert alike(first, masked)[0] is first
    assert alike(first, View(dark, HERE))[0] is not first
