"""Metrics of pictures against their definitions, and errors by kind of pixel: parts of a whole."""

import math

import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from omnisyn_cli.evaluation.metrics.image import end_masks, end_psnr, kind_figures, lrce, psnr, ssim, ws_psnr, ws_ssim
from omnisyn_cli.geometry.sphere import row_weights


def pair(height: int = 24, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """A picture with structure and a noisy copy."""
    rng = np.random.default_rng(seed)
    truth = np.cumsum(np.cumsum(rng.normal(size=(height, 2 * height, 3)), axis=0), axis=1)
    truth = (truth - truth.min()) / (truth.max() - truth.min())
    return np.clip(truth + 0.1 * rng.normal(size=truth.shape), 0, 1), truth


@pytest.mark.parametrize("error", [1.0, 0.1, 0.003])
def test_of_a_constant_error_both_are_the_same(error):
    truth = np.random.default_rng(0).random((16, 32, 3))
    assert psnr(truth + error, truth) == pytest.approx(-20 * math.log10(error))
    assert ws_psnr(truth + error, truth) == pytest.approx(-20 * math.log10(error))


def test_the_same_picture_is_infinitely_close():
    assert ws_psnr(np.ones((4, 8, 3)), np.ones((4, 8, 3))) == math.inf
    _, truth = pair()
    assert ssim(truth, truth) == pytest.approx(1.0, abs=1e-12)
    assert ws_ssim(truth, truth) == pytest.approx(1.0, abs=1e-12)
    assert lrce(truth, truth) == 0.0


def test_errors_at_an_end_of_the_picture_count_there_alone_and_all_alike():
    truth = np.random.default_rng(2).random((32, 64, 3))
    image = truth.copy()
    image[-4:, :32] += 0.2  # half of the bottom eighth
    assert end_psnr(image, truth, is_bottom=True) == pytest.approx(-10 * math.log10(0.2**2 / 2))
    assert end_psnr(image, truth, is_bottom=False) == math.inf
    assert end_psnr(image[::-1], truth[::-1], is_bottom=False) == end_psnr(image, truth, is_bottom=True)
    image[:-4] = 0.0
    assert end_psnr(image, truth, is_bottom=True) == pytest.approx(-10 * math.log10(0.2**2 / 2))
    assert end_psnr(truth[:4] + 0.1, truth[:4], is_bottom=True) == pytest.approx(20)  # at least one row


def test_ws_psnr_agrees_with_the_definition_pixel_by_pixel():
    rng = np.random.default_rng(1)
    image, truth = rng.random((6, 12, 3)), rng.random((6, 12, 3))
    total = weight_sum = 0.0
    for row in range(6):
        for col in range(12):
            weight = math.cos((row + 0.5 - 3) * math.pi / 6)
            total += weight * ((image[row, col] - truth[row, col]) ** 2).mean()
            weight_sum += weight
    assert ws_psnr(image, truth) == pytest.approx(-10 * math.log10(total / weight_sum))


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_psnr_and_ssim_agree_with_scikit_image(dtype):
    image, truth = (picture.astype(dtype) for picture in pair(40))
    assert psnr(image, truth) == pytest.approx(peak_signal_noise_ratio(truth, image, data_range=1), abs=1e-6)
    reference = structural_similarity(
        image.astype(np.float64), truth.astype(np.float64),
        gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1, channel_axis=-1,
    )  # fmt: skip
    assert ssim(image, truth) == pytest.approx(reference, abs=1e-6)
    assert 0.1 < reference < 0.95


def test_ws_ssim_agrees_with_the_definition_pixel_by_pixel():
    """Windows go on behind the seam, and over a pole half a turn away."""
    image, truth = pair(12)
    window = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    window = np.outer(window, window) / window.sum() ** 2
    total = weight_sum = 0.0
    for row in range(12):
        weight = math.sin((row + 0.5) * math.pi / 12)
        weight_sum += weight * 24
        for col in range(24):
            total += weight * np.mean([similarity(image[..., c], truth[..., c], window, row, col) for c in range(3)])
    assert ws_ssim(image, truth) == pytest.approx(total / weight_sum, abs=1e-9)


def similarity(image: np.ndarray, truth: np.ndarray, window: np.ndarray, row: int, col: int) -> float:
    x, y = around(image, row, col), around(truth, row, col)
    mean_x, mean_y = (window * x).sum(), (window * y).sum()
    var_x, var_y = (window * (x - mean_x) ** 2).sum(), (window * (y - mean_y) ** 2).sum()
    covariance = (window * (x - mean_x) * (y - mean_y)).sum()
    c1, c2 = 0.01**2, 0.03**2
    return ((2 * mean_x * mean_y + c1) * (2 * covariance + c2)) / ((mean_x**2 + mean_y**2 + c1) * (var_x + var_y + c2))


def around(channel: np.ndarray, row: int, col: int) -> np.ndarray:
    """The 11×11 pixels around one of a panorama."""
    height, width = channel.shape
    patch = np.empty((11, 11))
    for i in range(11):
        for j in range(11):
            r, c = row + i - 5, col + j - 5
            if r < 0:
                r, c = -1 - r, c + width // 2
            elif r >= height:
                r, c = 2 * height - 1 - r, c + width // 2
            patch[i, j] = channel[r, c % width]
    return patch


def test_turning_the_panorama_changes_nothing():
    image, truth = pair(16)
    for metric in (ws_psnr, ws_ssim):
        turned = metric(np.roll(image, 7, axis=1), np.roll(truth, 7, axis=1))
        upside_down = metric(image[::-1, ::-1], truth[::-1, ::-1])
        assert turned == pytest.approx(metric(image, truth))
        assert upside_down == pytest.approx(metric(image, truth))


def test_an_error_at_the_pole_counts_less_than_one_at_the_horizon():
    _, truth = pair(32)
    pole, horizon = truth.copy(), truth.copy()
    pole[0], horizon[16] = 1.0 - pole[0], 1.0 - horizon[16]
    assert ws_psnr(pole, truth) > ws_psnr(horizon, truth) + 3
    assert ws_ssim(pole, truth) > ws_ssim(horizon, truth)


def test_the_seam_counts_where_its_step_is_not_the_true_one():
    _, truth = pair()
    assert lrce(truth + 0.2, truth) == pytest.approx(0.0, abs=1e-12), "a constant error is no seam"
    torn = truth.copy()
    torn[:, 0] += 0.3
    assert lrce(torn, truth) == pytest.approx(0.3)
    torn[:, -1] -= 0.1
    assert lrce(torn, truth) == pytest.approx(0.4)
    assert lrce(np.roll(torn, 5, axis=1), np.roll(truth, 5, axis=1)) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("metric", [psnr, ws_psnr, ssim, ws_ssim, lrce])
def test_other_sizes_are_refused(metric):
    with pytest.raises(ValueError, match="one size"):
        metric(np.zeros((16, 32, 3)), np.zeros((12, 24, 3)))


@pytest.mark.parametrize("metric", [ssim, ws_ssim])
def test_pictures_smaller_than_the_window_are_refused(metric):
    with pytest.raises(ValueError, match="at least 11×11 pixels, got 20×10"):
        metric(np.zeros((10, 20, 3)), np.zeros((10, 20, 3)))


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
