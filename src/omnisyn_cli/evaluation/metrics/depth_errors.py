"""How close an estimated depth is to the true one: the figures of the paper's depth table, and a few more."""

import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.evaluation.metrics.image import check_same_size
from omnisyn_cli.geometry.sphere import row_weights

SCORED_DEPTH = (1.0, 50.0)
"""Metres; pixels whose true depth lies strictly between are scored, in every metric the same ones."""

FAR_BOUND = 100.0
"""Metres; an estimate beyond, infinity included, counts as this far in the metrics that are measured in metres."""

DELTAS = {"105": 1.05, "110": 1.10, "125": 1.25, "125_squared": 1.25**2, "125_cubed": 1.25**3}
"""Greatest ratios of depth that count as right, by the ends of their keys; 1.25 and its powers are usual."""


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

    Args:
        estimate: inverse depth, 1/m, >= 0; 0 is infinitely far.
        truth: true inverse depth, 1/m; 0 is infinitely far, NaN unknown.
        weighted: pixels count by their solid angle instead of alike.

    Source: the table of depth prediction in OmniSyn, whose δ columns have these five thresholds.

    Raises:
        ValueError: sizes differ, the estimate is negative or not finite where it is scored, or nothing is scored
            (ask :func:`scored_pixels` first).
    """
    check_same_size(estimate, truth)
    scored = scored_pixels(truth)
    rho_p, rho_g = estimate[scored].astype(np.float64), truth[scored].astype(np.float64)
    _check(rho_p)
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


def _check(rho: np.ndarray) -> None:
    if rho.size == 0:
        raise ValueError("expected a true depth between 1 m and 50 m somewhere, got none; this pair has none to score")
    if not (np.isfinite(rho).all() and rho.min() >= 0):
        raise ValueError("expected finite inverse depth of at least 0, got another value; 0 stands for infinitely far")
