"""Metrics of depth against their definition, pixel by pixel, and where depth is infinite or unknown."""

import math
from collections import defaultdict

import numpy as np
import pytest

from omnisyn_cli.evaluation.metrics.depth import depth_metrics, scored_pixels

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


def test_nothing_to_score_and_other_sizes_are_refused():
    with pytest.raises(ValueError, match="true depth between 1 m and 50 m"):
        depth_metrics(np.ones((4, 8)), np.zeros((4, 8)), weighted=True)
    with pytest.raises(ValueError, match="one size"):
        depth_metrics(np.ones((4, 8)), np.ones((8, 16)), weighted=True)
