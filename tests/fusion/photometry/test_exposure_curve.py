"""The gain between two pictures is found through noise and moved things; renderings are brought to one exposure."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omnisyn_cli.fusion import exposure_curve
from omnisyn_cli.fusion.photometry import ExposureMatcher, darken_to_match, rough_exposure_curve
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.types import Layer, View
from photometry_samples import exposed, in_eight_bits, linear
from photometry_samples import stored as stored_by_definition

COUNT = 40_000


def colours(seed: int = 0, most: float = 1.0) -> np.ndarray:
    return in_eight_bits(np.random.default_rng(seed).random((COUNT, 3)) * most)


def constant(*stops: float) -> exposure_curve.ExposureCurve:
    return exposure_curve.ExposureCurve(np.repeat(np.array(stops)[:, None], len(exposure_curve.KNOTS), axis=1))


def looked_up(table: np.ndarray, image: np.ndarray) -> np.ndarray:
    at = np.linspace(0, 1, table.shape[1])
    return np.stack([np.interp(image[:, k], at, table[k]) for k in range(3)], axis=-1)


@given(st.floats(0, 4))
def test_light_and_stored_values_follow_the_standard_and_there_is_a_way_back(value: float) -> None:
    x = np.array([value])
    np.testing.assert_allclose(exposure_curve.srgb_to_linear(x), linear(x), rtol=1e-9)
    np.testing.assert_allclose(exposure_curve.linear_to_srgb(x), stored_by_definition(x), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(exposure_curve.linear_to_srgb(exposure_curve.srgb_to_linear(x)), x, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("stops", [(1, 1, 1), (-1, -1, -1), (0.3, 0.3, 0.3), (0.4, 0.0, -0.3), (-2, -2.2, -1.9)])
def test_an_exposure_and_a_white_balance_are_found(stops: tuple[float, float, float]) -> None:
    first = colours()
    curve = exposure_curve.estimate_curve(first, in_eight_bits(exposed(first, stops)), np.ones(COUNT))
    np.testing.assert_allclose(curve.gain[:, 2:], np.repeat(np.array(stops)[:, None], 4, axis=1), atol=0.05)


@settings(max_examples=10, deadline=None)
@given(st.sampled_from([-1.5, -0.8, -0.4, 0.4, 0.7, 1.0, 1.5]), st.integers(0, 99))
def test_a_third_of_the_places_may_show_something_else_and_all_be_noisy(stop: float, seed: int) -> None:
    rng, first = np.random.default_rng(seed), colours(seed)
    second = np.clip(exposed(first, stop) + rng.normal(0, 0.02, first.shape), 0, 1).astype(np.float32)
    moved = rng.random(COUNT) < 0.3
    second[moved] = rng.random((moved.sum(), 3))
    curve = exposure_curve.estimate_curve(first, second, np.ones(COUNT))
    middle = curve.gain[:, (exposure_curve.KNOTS > -5) & (exposure_curve.KNOTS < -0.9)]
    np.testing.assert_allclose(middle, stop, atol=0.15)


def test_another_tone_curve_is_followed() -> None:
    first = colours()
    second = in_eight_bits(0.85 * first**1.3)
    curve = exposure_curve.estimate_curve(first, second, np.ones(COUNT))
    bright = first[((first > 0.25) & (first < 0.9)).all(axis=1)]
    np.testing.assert_allclose(looked_up(curve.table(1.0, of_second=False), bright), 0.85 * bright**1.3, atol=0.03)


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_pictures_exposed_alike_are_left_alone(noise: float) -> None:
    first = colours()
    second = np.clip(first + np.random.default_rng(1).normal(0, noise, first.shape), 0, 1).astype(np.float32)
    assert exposure_curve.estimate_curve(first, second, np.ones(COUNT)).is_identity


def test_pictures_of_different_things_are_left_alone() -> None:
    first = colours()
    for second in (colours(7), 1 - first, np.zeros_like(first), np.ones_like(first)):
        assert exposure_curve.estimate_curve(first, second, np.ones(COUNT)).is_identity


def test_a_curve_that_fits_samples_of_different_places_is_not_confirmed() -> None:
    """Samples that have nothing in common but their brightness have a curve; true ones have it in both halves."""
    first, weight = colours(most=0.5), np.ones(COUNT)
    second = exposed(colours(1, most=0.5), 2.0)
    assert not exposure_curve.estimate_curve(first, second, weight).is_identity
    assert exposure_curve.cross_validated_curve([(first, second, weight)] * 2).is_identity
    first = colours()
    true = (first, in_eight_bits(exposed(first, 0.5)), weight)
    np.testing.assert_allclose(exposure_curve.cross_validated_curve([true, true]).gain[:, 3], 0.5, atol=0.05)
    assert exposure_curve.cross_validated_curve([true, (first, first, weight)]).is_identity
    assert exposure_curve.cross_validated_curve([tuple(x[:0] for x in true)] * 2).is_identity


def test_without_samples_or_weight_nothing_changes() -> None:
    assert exposure_curve.estimate_curve(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)).is_identity
    first = colours()
    assert exposure_curve.estimate_curve(first, exposed(first, 1), np.zeros(COUNT)).is_identity


def test_weight_is_a_number_of_samples() -> None:
    """Half of the places a stop brighter, half as they were: the heavier half decides."""
    first, half = colours(), np.arange(COUNT) % 2 == 0
    second = np.where(half[:, None], exposed(first, 1), first)
    heavy = exposure_curve.estimate_curve(first, second, np.where(half, 3.0, 1.0))
    np.testing.assert_allclose(heavy.gain[:, 2:5], 1.0, atol=0.1)
    assert exposure_curve.estimate_curve(first, second, np.where(half, 1.0, 9.0)).is_identity


def test_exchanging_the_pictures_reverses_the_curve() -> None:
    first, second = colours(), in_eight_bits(exposed(colours(), (0.8, 0.5, 0.9)))
    there, back = (exposure_curve.estimate_curve(a, b, np.ones(COUNT)) for a, b in ((first, second), (second, first)))
    np.testing.assert_allclose(there.gain, back.reversed().gain, atol=0.02)


@pytest.mark.parametrize("t", [0.0, 0.3, 0.5, 1.0])
def test_along_the_way_light_is_multiplied_by_the_power_of_two_of_the_share(t: float) -> None:
    """The definition: gain 2^(t·stops) in linear light, white cut off; from either picture the same."""
    curve, image = constant(1.0, -0.5, 0.25), colours(most=0.7)
    expected = exposed(image, np.array([1.0, -0.5, 0.25]) * t)
    np.testing.assert_allclose(looked_up(curve.table(t, of_second=False), image), expected, atol=2e-3)
    second = exposed(image, (1.0, -0.5, 0.25))
    whole = (second < 0.999).all(axis=1)
    np.testing.assert_allclose(looked_up(curve.table(t, of_second=True), second[whole]), expected[whole], atol=2e-3)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-3, 3), min_size=6, max_size=6), st.floats(0, 1))
def test_tables_rise_from_black_to_white_at_most_and_both_pictures_meet(gain: list[float], t: float) -> None:
    steep = np.array(gain)
    steps = np.clip(np.diff(steep) / np.diff(exposure_curve.KNOTS), -1.5, 1.5) * np.diff(exposure_curve.KNOTS)
    curve = exposure_curve.ExposureCurve(np.tile(np.concatenate([steep[:1], steep[0] + np.cumsum(steps)]), (3, 1)))
    for of_second in (False, True):
        table = curve.table(t, of_second=of_second)
        assert (np.diff(table, axis=1) >= 0).all()
        assert (table[:, 0] == 0).all()
        assert table.max() <= 1
        np.testing.assert_array_equal(table, curve.reversed().table(1 - t, of_second=not of_second))
    image = colours()[:100]
    across = looked_up(curve.table(1.0, of_second=False), image)
    whole = (across < 0.98).all(axis=1) & (across > 0.02).all(axis=1) & (image > 0.02).all(axis=1)
    direct = looked_up(curve.table(t, of_second=False), image)
    np.testing.assert_allclose(looked_up(curve.table(t, of_second=True), across)[whole], direct[whole], atol=0.03)


@pytest.mark.parametrize("of_second", [False, True])
def test_at_its_own_end_a_picture_is_what_it_was(of_second: bool) -> None:
    table = constant(1.0, 1.0, 1.0).table(float(of_second), of_second=of_second)
    np.testing.assert_array_equal(table, np.tile(np.linspace(0, 1, table.shape[1], dtype=np.float32), (3, 1)))


@pytest.mark.parametrize("stop", [1.0, -1.0, 0.5])
def test_before_anything_matches_a_gain_is_found_from_all_values(stop: float) -> None:
    first, other = colours(1, 0.6), colours(2, 0.6)
    curve = exposure_curve.estimate_gain(first, exposed(other, stop))
    np.testing.assert_allclose(curve.gain, stop, atol=0.06)
    assert exposure_curve.estimate_gain(first, other).is_identity


SIZE = (32, 64)
HERE = Pose(np.eye(3), np.zeros(3))
STOP = exposure_curve.ExposureCurve(np.ones((3, len(exposure_curve.KNOTS))))


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
    found = ExposureMatcher(exposure_curve.ExposureCurve(np.zeros((3, len(exposure_curve.KNOTS)))))(
        views[0], views[1], 0.3
    )
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
