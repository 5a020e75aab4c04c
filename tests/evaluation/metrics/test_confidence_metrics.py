"""What is known of errors of depth: figures that brute force finds as well, and what they are of constructed cases."""

import numpy as np
import pytest

from omnisyn_cli.evaluation.metrics.depth import (
    confidence_metrics,
    left_right_metrics,
    merged_reliability,
    rank_correlation,
)
from omnisyn_cli.geometry.sphere import row_weights

SIZE = (16, 32)


def truth_and_estimate(seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    truth = rng.uniform(0.03, 0.9, SIZE)
    return truth, truth * np.exp(rng.normal(0.0, 0.1, SIZE))


def test_the_unsure_area_is_weighted_by_solid_angle_and_scored_where_depth_is():
    truth, estimate = truth_and_estimate()
    truth[2], truth[5] = np.nan, 1.5
    sure = np.random.default_rng(1).random(SIZE) < 0.6
    figures = left_right_metrics(estimate, truth, sure)
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
    assert left_right_metrics(truth, truth, np.ones(SIZE, bool)) == {"unsure_area": 0.0, "within_5_sure": 1.0}


def test_rank_correlation_is_that_of_repeated_entries():
    """Weights are numbers of repetitions, and Spearman's is Pearson's of mean ranks."""
    rng = np.random.default_rng(2)
    one, other, times = rng.integers(0, 6, 40) / 1.0, rng.normal(size=40), rng.integers(1, 4, 40)
    repeated = [np.repeat(values, times) for values in (one, other)]
    ranks = [[np.mean(np.flatnonzero(np.sort(v) == x)) for x in v] for v in repeated]
    expected = np.corrcoef(*ranks)[0, 1]
    assert rank_correlation(one, other, times.astype(np.float64)) == pytest.approx(expected)
    assert rank_correlation(one, -other, times.astype(np.float64)) == pytest.approx(-expected)
    assert rank_correlation(np.ones(40), other, np.ones(40)) is None


def test_doubt_that_orders_errors_correlates_wholly_and_certainty_without_shades_says_nothing():
    truth, estimate = truth_and_estimate()
    error = np.maximum(estimate / truth, truth / estimate)
    figures, _ = confidence_metrics(estimate, 1.0 / error, truth)
    assert figures["rank_correlation"] == pytest.approx(1.0)
    figures, _ = confidence_metrics(estimate, 1.0 - 1.0 / error, truth)
    assert figures["rank_correlation"] == pytest.approx(-1.0)
    assert confidence_metrics(estimate, np.ones(SIZE), truth) == ({}, {})


def test_confidence_that_is_the_share_within_a_tenth_is_calibrated():
    """Half of the columns are believed by 0.25 and a quarter of these are right, the others are right and believed."""
    truth = np.full(SIZE, 0.25)
    col = np.arange(SIZE[1])
    is_right = np.broadcast_to((col >= 16) | (col % 4 == 0), SIZE)
    estimate = np.where(is_right, truth * 1.07, truth * 1.2)
    confidence = np.broadcast_to(np.where(col >= 16, 1.0, 0.25), SIZE)
    figures, diagram = confidence_metrics(estimate, confidence, truth)
    assert figures["calibration_error"] == pytest.approx(0.0, abs=1e-12)
    assert diagram["area"] == {"0.25": pytest.approx(0.5), "0.95": pytest.approx(0.5)}
    assert diagram["within_10"] == {"0.25": pytest.approx(0.25), "0.95": pytest.approx(1.0)}
    assert diagram["within_5"] == {"0.25": 0.0, "0.95": 0.0}
    overconfident, _ = confidence_metrics(estimate, np.broadcast_to(np.where(col >= 16, 1.0, 0.45), SIZE), truth)
    assert overconfident["calibration_error"] == pytest.approx(0.1)


def test_what_is_infinitely_far_is_never_right():
    truth = np.full(SIZE, 0.25)
    estimate = np.zeros(SIZE)
    confidence = np.broadcast_to(np.linspace(0, 1, SIZE[1]), SIZE)
    _, diagram = confidence_metrics(estimate, confidence, truth)
    assert set(diagram["within_10"].values()) == {0.0}
    assert "rank_correlation" not in confidence_metrics(estimate, confidence, truth)[0]


def test_diagrams_together_are_those_of_all_pixels():
    pairs = [truth_and_estimate(seed) for seed in (1, 2)]
    confidence = [np.random.default_rng(seed).random(SIZE) for seed in (1, 2)]
    apart = [confidence_metrics(estimate, c, truth)[1] for (truth, estimate), c in zip(pairs, confidence, strict=True)]
    wide = [np.concatenate(values, axis=1) for values in zip(*pairs, strict=True)]
    _, together = confidence_metrics(wide[1], np.concatenate(confidence, axis=1), wide[0])
    merged = merged_reliability(apart)
    assert merged.keys() == together.keys()
    for figure, of_bins in together.items():
        assert merged[figure] == {name: pytest.approx(value) for name, value in of_bins.items()}
