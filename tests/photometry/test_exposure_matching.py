"""Renderings are brought to one exposure, photographs are left alone, and what was cut off counts less."""

import numpy as np
import pytest

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.photometry import ExposureCurve, ExposureMatcher, equalized
from omnisyn_cli.photometry.curve import KNOTS
from omnisyn_cli.types import Rendering, View
from photometry_samples import exposed, in_eight_bits

SIZE = (32, 64)
HERE = Pose(np.eye(3), np.zeros(3))
STOP = ExposureCurve(np.ones((3, len(KNOTS))))


def picture(seed: int = 0, most: float = 0.7) -> np.ndarray:
    return (np.random.default_rng(seed).random((*SIZE, 3)) * most).astype(np.float32)


def rendering(image: np.ndarray, worth: float = 1.0) -> Rendering:
    colour = np.dstack([image, np.full(SIZE, worth, np.float32)]).astype(np.float32)
    return Rendering(np.full(SIZE, 0.2, np.float32), colour, HERE)


@pytest.mark.parametrize("t", [0.0, 0.25, 0.5, 1.0])
@pytest.mark.parametrize("threads", [1, 3])
def test_both_renderings_come_to_the_exposure_of_the_frame(t: float, threads: int) -> None:
    image = picture(most=0.6)
    first, second = rendering(image), rendering(exposed(image, 1))
    ExposureMatcher(STOP, threads)(first, second, t)
    for view in (first, second):
        np.testing.assert_allclose(view.colour[..., :3], exposed(image, t), atol=3e-3)
        assert (view.colour[..., 3] == 1).all()


def test_at_the_ends_the_photograph_there_is_not_touched() -> None:
    image = picture(most=1.2)
    for t, own in ((0.0, 0), (1.0, 1)):
        views = [rendering(image), rendering(image)]
        ExposureMatcher(STOP, 1)(views[0], views[1], t)
        np.testing.assert_array_equal(views[own].colour, rendering(image).colour)
        assert not np.array_equal(views[1 - own].colour, rendering(image).colour)


def test_highlights_that_were_cut_off_are_worth_less_once_darkened() -> None:
    """The second picture is brighter: its whites say only that it was at least that bright."""
    white = np.ones((*SIZE, 3), np.float32)
    first, second = rendering(white), rendering(white)
    ExposureMatcher(STOP, 1)(first, second, 0.5)
    assert (first.colour[..., 3] == 1).all()
    assert (second.colour[..., 3] < 0.4).all()
    assert (second.colour[..., 3] > 0).all()


def test_the_same_exposure_costs_nothing_and_changes_nothing() -> None:
    views = [rendering(picture(1)), rendering(picture(2))]
    ExposureMatcher(ExposureCurve(np.zeros((3, len(KNOTS)))), 1)(views[0], views[1], 0.3)
    for view, seed in zip(views, (1, 2), strict=True):
        np.testing.assert_array_equal(view.colour[..., :3], picture(seed))


def test_values_beyond_the_table_go_on_and_holes_stay_holes() -> None:
    image = picture()
    image[0], image[1] = 1.5, -0.1
    first, hole = rendering(image), rendering(image, worth=0.0)
    ExposureMatcher(STOP.reversed(), 1)(first, hole, 0.5)
    assert (first.colour[0, :, :3] > 1.0).all()
    assert (first.colour[1, :, :3] < 0.0).all()
    np.testing.assert_array_equal(hole.colour[..., :3], image)


@pytest.mark.parametrize("stop", [1.0, -1.0])
def test_before_depth_is_looked_for_pictures_are_exposed_alike(stop: float) -> None:
    views = View(in_eight_bits(picture(1)), HERE), View(in_eight_bits(exposed(picture(1), stop)), HERE)
    first, second = equalized(*views, threads=1)
    assert (second.image.mean() - first.image.mean()) == pytest.approx(0.0, abs=0.01)
    darker = 0 if stop > 0 else 1
    assert (first, second)[darker] is views[darker]


def test_a_picture_that_was_white_says_so_when_it_is_darkened() -> None:
    image = np.clip(picture(1) + 0.1, 0.0, 1.0)
    assert not any(view.is_cut_off for view in equalized(View(0.5 * image, HERE), View(0.7 * image, HERE), 1))
    bright = View(exposed(image, 2.0), HERE)
    assert (bright.image.max(-1) >= 1.0).mean() > 0.1
    assert [view.is_cut_off for view in equalized(View(image, HERE), bright, 1)] == [False, True]
    assert [view.is_cut_off for view in equalized(bright, View(image, HERE), 1)] == [True, False]


def test_views_alike_are_handed_on_as_they_are_and_masks_are_obeyed() -> None:
    first, second = View(picture(1), HERE), View(picture(2), HERE)
    assert all(a is b for a, b in zip(equalized(first, second, 1), (first, second), strict=True))
    dark = second.image.copy()
    dark[16:] = 0.01
    masked = View(dark, HERE, np.arange(SIZE[0])[:, None] * np.ones(SIZE) < 16)
    assert equalized(first, masked, 1)[0] is first
    assert equalized(first, View(dark, HERE), 1)[0] is not first
