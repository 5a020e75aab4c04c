"""Metrics of depth against their definition, pixel by pixel, and what is known of its errors."""

import math
from collections import defaultdict

import numpy as np
import pytest

from omnisyn_cli.evaluation.metrics import depth
from omnisyn_cli.evaluation.metrics.depth import depth_metrics, scored_pixels
from omnisyn_cli.geometry.sphere import row_weights

HEIGHT = 8


def depths(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Estimate and truth in metres; the truth is sometimes out of range, infinite or unknown, the estimate infinite."""
    rng = np.random.default_rng(seed)
    truth = np.exp(rng.uniform(math.log(0.5), math.log(80), (HEIGHT, 2 * HEIGHT)))
    estimate = truth * np.exp(rng.normal(scale=0.2, size=truth.shape))
    truth.flat[:4] = [np.inf, np.nan, 1.0, 50.0]
    estimate.flat[4:6] = np.inf
    truth.flat[4:6] = [3.0, 49.0]
    return estimate, truth


def by_the_definition(estimate: np.ndarray, truth: np.ndarray, *, weighted: bool) -> dict[str, float]:
    terms: defaultdict[str, float] = defaultdict(float)
    total = 0.0
    for row, col in np.ndindex(truth.shape):
        p, g = estimate[row, col], truth[row, col]
        if not 1.0 < g < 50.0:
            continue
        weight = math.sin((row + 0.5) * math.pi / HEIGHT) if weighted else 1.0
        total += weight
        near = min(p, 100.0)
        ratio = max(p / g, g / p)
        values = {
            "imae": abs(1 / p - 1 / g), "irmse": (1 / p - 1 / g) ** 2,
            "mae": abs(near - g), "rmse": (near - g) ** 2, "abs_rel": abs(near - g) / g,
            "delta_105": ratio < 1.05, "delta_110": ratio < 1.10, "delta_125": ratio < 1.25,
            "delta_125_squared": ratio < 1.25**2, "delta_125_cubed": ratio < 1.25**3,
        }  # fmt: skip
        for name, value in values.items():
            terms[name] += weight * value
    means = {name: value / total for name, value in terms.items()}
    return means | {name: math.sqrt(means[name]) for name in ("irmse", "rmse")}


@pytest.mark.parametrize("weighted", [False, True])
def test_agrees_with_the_definition_pixel_by_pixel(weighted):
    estimate, truth = depths()
    result = depth_metrics(1 / estimate, 1 / truth, weighted=weighted)
    assert result == pytest.approx(by_the_definition(estimate, truth, weighted=weighted), rel=1e-12)
    assert result != pytest.approx(by_the_definition(estimate, truth, weighted=not weighted), rel=1e-3)
    assert 0.1 < result["delta_105"] < result["delta_110"] < result["delta_125"] < result["delta_125_squared"] < 1


def test_the_truth_has_no_error():
    _, truth = depths()
    exact = depth_metrics(np.nan_to_num(1 / truth), 1 / truth, weighted=True)
    assert exact == pytest.approx({name: float(name.startswith("delta")) for name in exact}, abs=1e-12)


def test_an_infinite_estimate_is_wrong_but_finite():
    """In 1/m its error is the truth itself; in metres it counts as the far bound of 100 m; no ratio is small enough."""
    truth = np.full((HEIGHT, 2 * HEIGHT), 10.0)
    result = depth_metrics(np.zeros_like(truth), 1 / truth, weighted=False)
    assert result == pytest.approx(
        {"imae": 0.1, "irmse": 0.1, "mae": 90, "rmse": 90, "abs_rel": 9}
        | dict.fromkeys(("delta_105", "delta_110", "delta_125", "delta_125_squared", "delta_125_cubed"), 0.0)
    )


def test_what_is_not_scored_does_not_matter():
    """Every metric has the same mask: nothing outside of it changes any figure, however wrong."""
    estimate, truth = depths()
    spoiled = np.where(scored_pixels(1 / truth), 1 / estimate, np.nan)
    assert depth_metrics(spoiled, 1 / truth, weighted=True) == depth_metrics(1 / estimate, 1 / truth, weighted=True)
    assert scored_pixels(1 / truth).ravel()[:6].tolist() == [False, False, False, False, True, True]


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -0.01])
def test_an_estimate_that_is_no_inverse_depth_is_refused(wrong):
    truth = np.full((4, 8), 0.2)
    estimate = truth.copy()
    estimate[1, 1] = wrong
    with pytest.raises(ValueError, match="finite inverse depth"):
        depth_metrics(estimate, truth, weighted=False)


def test_other_sizes_are_refused():
    with pytest.raises(ValueError, match="one size"):
        depth_metrics(np.ones((4, 8)), np.ones((8, 16)), weighted=True)


SIZE = (16, 32)


def truth_and_estimate(seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    truth = rng.uniform(0.03, 0.9, SIZE)
    return truth, truth * np.exp(rng.normal(0.0, 0.1, SIZE))


def test_the_unsure_area_is_weighted_by_solid_angle_and_scored_where_depth_is():
    truth, estimate = truth_and_estimate()
    truth[2], truth[5] = np.nan, 1.5
    sure = np.random.default_rng(1).random(SIZE) < 0.6
    figures = depth.left_right_metrics(estimate, truth, sure)
    sums = {True: [0.0, 0.0], False: [0.0, 0.0]}
    for row, weight in enumerate(row_weights(SIZE[0])):
        if row not in (2, 5):
            for col in range(SIZE[1]):
                p, g = 1 / estimate[row, col], 1 / truth[row, col]
                sums[bool(sure[row, col])][0] += weight
                sums[bool(sure[row, col])][1] += weight * (max(p / g, g / p) < 1.05)
    assert figures["unsure_area"] == pytest.approx(sums[False][0] / (sums[False][0] + sums[True][0]))
    assert figures["within_5_unsure"] == pytest.approx(sums[False][1] / sums[False][0])
    assert figures["within_5_sure"] == pytest.approx(sums[True][1] / sums[True][0])


def test_where_all_is_sure_nothing_is_said_about_the_unsure_area():
    truth, _ = truth_and_estimate()
    assert depth.left_right_metrics(truth, truth, np.ones(SIZE, bool)) == {"unsure_area": 0.0, "within_5_sure": 1.0}


def test_rank_correlation_is_that_of_repeated_entries():
    """Weights are numbers of repetitions, and Spearman's is Pearson's of mean ranks."""
    rng = np.random.default_rng(2)
    one, other, times = rng.integers(0, 6, 40) / 1.0, rng.normal(size=40), rng.integers(1, 4, 40)
    repeated = [np.repeat(values, times) for values in (one, other)]
    ranks = [[np.mean(np.flatnonzero(np.sort(v) == x)) for x in v] for v in repeated]
    expected = np.corrcoef(*ranks)[0, 1]
    assert depth.rank_correlation(one, other, times.astype(np.float64)) == pytest.approx(expected)
    assert depth.rank_correlation(one, -other, times.astype(np.float64)) == pytest.approx(-expected)
    assert depth.rank_correlation(np.ones(40), other, np.ones(40)) is None


def test_doubt_that_orders_errors_correlates_wholly_and_certainty_without_shades_says_nothing():
    truth, estimate = truth_and_estimate()
    error = np.maximum(estimate / truth, truth / estimate)
    figures, _ = depth.confidence_metrics(estimate, 1.0 / error, truth)
    assert figures["rank_correlation"] == pytest.approx(1.0)
    figures, _ = depth.confidence_metrics(estimate, 1.0 - 1.0 / error, truth)
    assert figures["rank_correlation"] == pytest.approx(-1.0)
    assert depth.confidence_metrics(estimate, np.ones(SIZE), truth) == ({}, {})


def test_confidence_that_is_the_share_within_a_tenth_is_calibrated():
    """Half of the columns are believed by 0.25 and a quarter of these are right, the others are right and believed."""
    truth = np.full(SIZE, 0.25)
    col = np.arange(SIZE[1])
    is_right = np.broadcast_to((col >= 16) | (col % 4 == 0), SIZE)
    estimate = np.where(is_right, truth * 1.07, truth * 1.2)
    confidence = np.broadcast_to(np.where(col >= 16, 1.0, 0.25), SIZE)
    figures, diagram = depth.confidence_metrics(estimate, confidence, truth)
    assert figures["calibration_error"] == pytest.approx(0.0, abs=1e-12)
    assert diagram["area"] == {"0.25": pytest.approx(0.5), "0.95": pytest.approx(0.5)}
    assert diagram["within_10"] == {"0.25": pytest.approx(0.25), "0.95": pytest.approx(1.0)}
    assert diagram["within_5"] == {"0.25": 0.0, "0.95": 0.0}
    overconfident, _ = depth.confidence_metrics(estimate, np.broadcast_to(np.where(col >= 16, 1.0, 0.45), SIZE), truth)
    assert overconfident["calibration_error"] == pytest.approx(0.1)


def test_what_is_infinitely_far_is_never_right():
    truth = np.full(SIZE, 0.25)
    estimate = np.zeros(SIZE)
    confidence = np.broadcast_to(np.linspace(0, 1, SIZE[1]), SIZE)
    _, diagram = depth.confidence_metrics(estimate, confidence, truth)
    assert set(diagram["within_10"].values()) == {0.0}
    assert "rank_correlation" not in depth.confidence_metrics(estimate, confidence, truth)[0]
