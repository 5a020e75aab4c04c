"""How close an estimated depth is to the true one, and whether it knows where it is wrong.

Errors are the figures of the paper's depth table, and a few more. What confidence is worth is measured on the same
pixels, weighted by solid angle, against the relative error max(p/g, g/p), since confidence is the probability that a
value is within a tenth of the truth: of absolute errors of inverse depth the far would have hardly any, however wrong.
"""

import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.evaluation.metrics.image import check_same_size
from omnisyn_cli.geometry.sphere import row_weights

# Metres; pixels whose true depth lies strictly between are scored, in every metric the same ones.
SCORED_DEPTH = (1.0, 50.0)
# Metres; an estimate beyond, infinity included, counts as this far in the metrics that are measured in metres.
FAR_BOUND = 100.0
# Greatest ratios of depth that count as right, by the ends of their keys; 1.25 and its powers are usual.
DELTAS = {"105": 1.05, "110": 1.10, "125": 1.25, "125_squared": 1.25**2, "125_cubed": 1.25**3}
CONFIDENCE_BINS = 10  # of confidence, equally wide

Values = Float[np.ndarray, " count"]


def scored_pixels(true_inverse_depth: Float[np.ndarray, "height width"]) -> Bool[np.ndarray, "height width"]:
    """Where depth is scored: True where the truth is known (not NaN) and within :data:`SCORED_DEPTH`."""
    nearest, farthest = SCORED_DEPTH
    return np.asarray((true_inverse_depth < 1.0 / nearest) & (true_inverse_depth > 1.0 / farthest))


def depth_metrics(
    estimate: Float[np.ndarray, "height width"], truth: Float[np.ndarray, "height width"], *, weighted: bool
) -> dict[str, float]:
    """All figures of one panorama; every one is finite. They are means over the pixels with 1 m < true depth < 50 m.

    p is the estimate, g the truth, ρ = 1/depth, and p counts as at most :data:`FAR_BOUND` in metres:

    * ``imae``: mean |ρ_p − ρ_g|, 1/m; ``irmse``: square root of the mean (ρ_p − ρ_g)², 1/m;
    * ``mae``: mean |p − g|, m; ``rmse``: square root of the mean (p − g)², m; ``abs_rel``: mean |p − g| / g;
    * ``delta_105``: share of the pixels with max(p/g, g/p) < 1.05; an infinite estimate is never among them.
      ``delta_110``, ``delta_125``, ``delta_125_squared``, ``delta_125_cubed``: the same for 1.10, 1.25, 1.25², 1.25³.

    Both maps are inverse depth, 1/m; 0 is infinitely far, and in the truth NaN unknown. If ``weighted``, pixels count
    by their solid angle instead of alike.

    Source: the table of depth prediction in OmniSyn, whose δ columns have these five thresholds.
    Something is scored (ask :func:`scored_pixels` first). ValueError: sizes differ, or the estimate is negative or not
    finite there.
    """
    check_same_size(estimate, truth)
    scored = scored_pixels(truth)
    rho_p, rho_g = estimate[scored].astype(np.float64), truth[scored].astype(np.float64)
    if not (np.isfinite(rho_p).all() and rho_p.min() >= 0):
        raise ValueError("expected finite inverse depth of at least 0, got another value; 0 stands for infinitely far")
    weights = np.broadcast_to(row_weights(len(truth))[:, None], truth.shape)[scored] if weighted else None

    def mean(values: np.ndarray) -> float:
        return float(np.average(values, weights=weights))

    g = 1.0 / rho_g
    inverse_error = np.abs(rho_p - rho_g)
    error = np.abs(1.0 / np.maximum(rho_p, 1.0 / FAR_BOUND) - g)
    larger, smaller = np.maximum(rho_p, rho_g), np.minimum(rho_p, rho_g)
    return {
        "imae": mean(inverse_error), "irmse": mean(inverse_error**2) ** 0.5,
        "mae": mean(error), "rmse": mean(error**2) ** 0.5, "abs_rel": mean(error / g),
        **{f"delta_{name}": mean(larger < threshold * smaller) for name, threshold in DELTAS.items()},
    }  # fmt: skip


def left_right_metrics(
    estimate: Float[np.ndarray, "height width"], truth: Float[np.ndarray, "height width"],
    stereo_valid: Bool[np.ndarray, "height width"],
) -> dict[str, float]:  # fmt: skip
    """Area without left-right consistent disparities, and the accuracy of depth there and elsewhere.

    ``unsure_area`` is that share of the scored pixels; ``within_5_unsure`` and ``within_5_sure`` the shares within 5 %
    of the truth in it and in the rest, if there is any. Maps as of :func:`depth_metrics`, somewhere scored.
    """
    check_same_size(estimate, truth)
    scored, weights = _scored(truth)
    is_close, is_valid = _ratio(estimate[scored], truth[scored]) < DELTAS["105"], stereo_valid[scored]
    shares = {"unsure": ~is_valid, "sure": is_valid}
    return {"unsure_area": float(weights[~is_valid].sum())} | {
        f"within_5_{name}": float(np.average(is_close[area], weights=weights[area]))
        for name, area in shares.items()
        if area.any()
    }


def confidence_metrics(
    estimate: Float[np.ndarray, "height width"], confidence: Float[np.ndarray, "height width"],
    truth: Float[np.ndarray, "height width"],
) -> tuple[dict[str, float], dict[str, dict[str, float]]]:  # fmt: skip
    """What confidence is worth, and the reliability diagram; both empty where it is the same everywhere.

    ``rank_correlation`` is Spearman's, of doubt (1 − confidence) and relative error: 1 where the less sure is always
    the more wrong. ``calibration_error`` is the mean over pixels of how far the mean confidence of their bin is from
    the share within 10 % there. The diagram has, for each bin with pixels, named by its middle, its share of the
    pixels (``area``), the mean ``confidence``, and the shares ``within_5`` and ``within_10``. Confidence is in [0, 1],
    the other maps are those of :func:`depth_metrics`, somewhere scored.

    Source: Guo, Pleiss, Sun and Weinberger, On calibration of modern neural networks, 2017.
    """
    check_same_size(estimate, truth)
    scored, weights = _scored(truth)
    ratio, confidences = _ratio(estimate[scored], truth[scored]), confidence[scored].astype(np.float64)
    if confidences.min() == confidences.max():
        return {}, {}
    diagram = _reliability(confidences, ratio, weights)
    error = sum(
        share * abs(diagram["confidence"][name] - diagram["within_10"][name]) for name, share in diagram["area"].items()
    )
    correlation = rank_correlation(-confidences, ratio, weights)
    found = {} if correlation is None else {"rank_correlation": correlation}
    return {**found, "calibration_error": error}, diagram


def rank_correlation(one: Values, other: Values, weights: Values) -> float | None:
    """Spearman's, weighted (rank: weight of all less, half of all equal); None where either is constant."""
    first, second = (_ranks(values, weights) for values in (one, other))
    first, second = (ranks - np.average(ranks, weights=weights) for ranks in (first, second))
    spread = np.average(first**2, weights=weights) * np.average(second**2, weights=weights)
    return float(np.average(first * second, weights=weights) / np.sqrt(spread)) if spread > 0.0 else None


def _ranks(values: Values, weights: Values) -> Values:
    _, group = np.unique(values, return_inverse=True)
    total = np.bincount(group, weights)
    return np.asarray((np.cumsum(total) - 0.5 * total)[group])


def _reliability(confidences: Values, ratio: Values, weights: Values) -> dict[str, dict[str, float]]:
    number = np.minimum((confidences * CONFIDENCE_BINS).astype(np.int64), CONFIDENCE_BINS - 1)
    area = np.bincount(number, weights, CONFIDENCE_BINS)
    sums = {
        "confidence": np.bincount(number, weights * confidences, CONFIDENCE_BINS),
        "within_5": np.bincount(number, weights * (ratio < DELTAS["105"]), CONFIDENCE_BINS),
        "within_10": np.bincount(number, weights * (ratio < DELTAS["110"]), CONFIDENCE_BINS),
    }
    named = {f"{(index + 0.5) / CONFIDENCE_BINS:.2f}": index for index in np.flatnonzero(area)}
    return {"area": {name: float(area[index]) for name, index in named.items()}} | {
        figure: {name: float(of_bins[index] / area[index]) for name, index in named.items()}
        for figure, of_bins in sums.items()
    }


def _scored(truth: np.ndarray) -> tuple[np.ndarray, Values]:
    """Which pixels count, and the share of each of them."""
    scored = scored_pixels(truth)
    weights = np.broadcast_to(row_weights(len(truth))[:, None], truth.shape)[scored]
    return scored, weights / weights.sum()


def _ratio(estimate: np.ndarray, truth: np.ndarray) -> Values:
    """max(p/g, g/p); infinite where the estimate is infinitely far."""
    larger, smaller = np.maximum(estimate, truth), np.minimum(estimate, truth)
    return np.asarray(np.divide(larger, smaller, out=np.full(larger.shape, np.inf), where=smaller > 0.0))
