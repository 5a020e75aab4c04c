"""Errors by kind of pixel: parts of a whole, weighted as the whole is."""

import math

import numpy as np
import pytest

from omnisyn_cli.evaluation.metrics.image import end_masks, end_psnr, kind_figures, ws_psnr
from omnisyn_cli.geometry.sphere import row_weights

SIZE = (24, 48)


def pictures() -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    rng = np.random.default_rng(3)
    truth, number = rng.random((*SIZE, 3)), rng.integers(0, 3, SIZE)
    image = np.clip(truth + 0.05 * (1 + number[..., None]) * rng.normal(size=truth.shape), 0, 1)
    return image, truth, {str(k): number == k for k in range(3)}


def test_kinds_that_are_all_make_the_whole():
    image, truth, kinds = pictures()
    figures = kind_figures(image, truth, kinds)
    assert sum(figures["area"].values()) == pytest.approx(1.0)
    assert sum(figures["error"].values()) == pytest.approx(1.0)
    total = sum(figures["area"][kind] * 10 ** (-figures["psnr"][kind] / 10) for kind in kinds)
    assert -10 * math.log10(total) == pytest.approx(ws_psnr(image, truth))
    everything = kind_figures(image, truth, {"all": np.ones(SIZE, bool)})
    assert everything == {"psnr": {"all": pytest.approx(ws_psnr(image, truth))}, "area": {"all": pytest.approx(1.0)},
                          "error": {"all": pytest.approx(1.0)}}  # fmt: skip


def test_a_kind_is_weighted_by_solid_angle():
    truth = np.zeros((*SIZE, 3))
    image, half = truth.copy(), np.zeros(SIZE, bool)
    half[:, :24] = True
    image[3, :24], image[12, :24] = 0.1, 0.2
    weights = row_weights(SIZE[0]) / row_weights(SIZE[0]).sum()
    figures = kind_figures(image, truth, {"half": half, "other": ~half, "none": np.zeros(SIZE, bool)})
    expected = 0.01 * weights[3] + 0.04 * weights[12]
    assert figures["psnr"] == {"half": pytest.approx(-10 * math.log10(expected)), "other": math.inf}
    assert figures["area"] == {"half": pytest.approx(0.5), "other": pytest.approx(0.5)}
    assert figures["error"] == {"half": pytest.approx(1.0), "other": 0.0}


def test_equal_pictures_have_no_error_to_share():
    _, truth, kinds = pictures()
    assert set(kind_figures(truth, truth, kinds)["error"].values()) == {0.0}


@pytest.mark.parametrize("height", [2, 8, 31])
def test_the_ends_are_eighths_of_the_rows(height):
    ends, rng = end_masks((height, 2 * height)), np.random.default_rng(4)
    truth = rng.random((height, 2 * height, 3))
    for kind, is_bottom in (("top", False), ("bottom", True)):
        image = truth + 0.1 * np.where(ends[kind], 0.0, 1.0)[..., None]
        assert end_psnr(image, truth, is_bottom=is_bottom) == math.inf
        assert ends[kind].sum() == 2 * height * max(1, height // 8)
