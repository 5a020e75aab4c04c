"""Colours of errors and of depth, against matplotlib's tables of the same colour maps."""

import matplotlib
import numpy as np
import pytest

from omnisyn_cli.evaluation.visualization import (
    ERROR_SCALE,
    KIND_COLOURS,
    KIND_MIN_BRIGHTNESS,
    error_map,
    kind_map,
    turbo,
)


def expected(name: str, share: np.ndarray) -> np.ndarray:
    return np.rint(255 * matplotlib.colormaps[name](np.rint(255 * share).astype(int))[..., :3])


def test_errors_have_the_inferno_colours_up_to_the_scale():
    share = np.linspace(0, 1, 64).reshape(4, 16)
    truth = np.full((4, 16, 3), 0.5)
    signs = np.where(np.arange(16) % 2 == 0, 1, -1)[None, :]
    image = truth + (share * signs * ERROR_SCALE)[..., None]
    coloured = error_map(image, truth)
    assert coloured.dtype == np.uint8
    assert np.abs(coloured - expected("inferno", share)).max() <= 3
    assert error_map(truth, truth).max() <= 4, "black"


def test_the_error_is_the_mean_of_the_channels_and_ends_at_the_scale():
    truth = np.zeros((2, 4, 3))
    one_channel = truth + np.array([3 * ERROR_SCALE / 2, 0.0, 0.0])
    all_channels = truth + ERROR_SCALE / 2
    assert np.array_equal(error_map(one_channel, truth), error_map(all_channels, truth))
    assert np.array_equal(error_map(truth + 1.0, truth), error_map(truth + ERROR_SCALE, truth))
    with pytest.raises(ValueError, match="one size"):
        error_map(truth, truth[:1])


def test_errors_by_kind_have_the_colour_of_their_kind_and_are_the_brighter_the_larger():
    truth = np.zeros((1, 8, 3))
    image = truth + np.repeat([0.0, ERROR_SCALE], 4)[None, :, None]
    columns = np.arange(8)[None] % 4
    shown = kind_map(image, truth, {kind: columns == k for k, kind in enumerate(KIND_COLOURS)})
    colours = np.array(list(KIND_COLOURS.values()))
    np.testing.assert_allclose(shown[0, :4], KIND_MIN_BRIGHTNESS * colours, atol=0.5)
    np.testing.assert_array_equal(shown[0, 4:], colours)
    with pytest.raises(ValueError, match="one size"):
        kind_map(truth, truth[:, :4], {})


def test_depth_has_the_turbo_colours_of_the_root():
    inverse_depth = np.linspace(0, 2, 64).reshape(4, 16)
    coloured = turbo(inverse_depth, largest=2.0)
    assert coloured.dtype == np.uint8
    assert np.abs(coloured - expected("turbo", np.sqrt(inverse_depth / 2))).max() <= 3
    assert np.array_equal(turbo(inverse_depth * 7, largest=14.0), coloured)


def test_near_is_red_far_is_blue_and_unknown_is_black():
    near, far, negative, unknown = turbo(np.array([[1.0, 0.0, -1.0, np.nan]]), largest=1.0)[0]
    assert near[0] > 2 * near[2] > 0 or near[2] == 0
    assert far[2] > far[1]
    assert not negative.any()
    assert not unknown.any()


def test_without_a_largest_value_a_few_stray_pixels_change_nothing():
    inverse_depth = np.full((20, 40), 0.25)
    stray = inverse_depth.copy()
    stray[0, :4] = [100.0, np.inf, np.nan, -3.0]
    assert np.array_equal(turbo(stray)[1:], turbo(inverse_depth)[1:])
    assert np.array_equal(turbo(inverse_depth), turbo(4 * inverse_depth))


def test_a_sky_alone_is_far():
    assert np.array_equal(turbo(np.zeros((2, 4))), turbo(np.zeros((2, 4)), largest=1.0))
