"""Metrics against their definitions."""

import math

import numpy as np
import pytest

from omnisyn_cli.metrics import psnr, row_weights, ws_psnr


@pytest.mark.parametrize("error", [1.0, 0.1, 0.003])
def test_of_a_constant_error_both_are_the_same(error: float) -> None:
    truth = np.random.default_rng(0).random((16, 32, 3))
    assert psnr(truth + error, truth) == pytest.approx(-20 * math.log10(error))
    assert ws_psnr(truth + error, truth) == pytest.approx(-20 * math.log10(error))


def test_the_same_picture_is_infinitely_close() -> None:
    assert ws_psnr(np.ones((4, 8, 3)), np.ones((4, 8, 3))) == math.inf


def test_agrees_with_the_definition_pixel_by_pixel() -> None:
    rng = np.random.default_rng(1)
    image, truth = rng.random((6, 12, 3)), rng.random((6, 12, 3))
    total = weight_sum = 0.0
    for row in range(6):
        for col in range(12):
            weight = math.cos((row + 0.5 - 3) * math.pi / 6)
            total += weight * ((image[row, col] - truth[row, col]) ** 2).mean()
            weight_sum += weight
    assert ws_psnr(image, truth) == pytest.approx(-10 * math.log10(total / weight_sum))


def test_an_error_at_the_pole_counts_less_than_one_at_the_horizon() -> None:
    truth = np.zeros((8, 16, 3))
    pole, horizon = truth.copy(), truth.copy()
    pole[0], horizon[4] = 1.0, 1.0
    assert ws_psnr(pole, truth) > ws_psnr(horizon, truth)
    assert (np.diff(row_weights(8)[:4]) > 0).all()


def test_other_sizes_are_refused() -> None:
    with pytest.raises(ValueError, match="one size"):
        psnr(np.zeros((4, 8, 3)), np.zeros((2, 4, 3)))
