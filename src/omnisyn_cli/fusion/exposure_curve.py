"""The exposure curve of a pair: how much brighter one picture is than the other, for every channel and level.

Light is counted in stops, ``log2`` of linear light. A place that the first picture shows at ``y1`` and the second at
``y2`` stops has the *level* ``m = (y1 + y2) / 2`` and the *gain* ``g(m) = y2 − y1``, and is shown at ``m + (t −
½)·g(m)`` a share ``t`` of the way: brightness changes steadily, both pictures agree on it, and the ends are what they
were. A change of exposure is one constant ``g``, of white balance one for each channel; other tone curves make it a
function of the level, so it is kept at a few knots.

``g`` is the weighted median of ``y2 − y1`` among places of one level that both pictures show. Sorting by the mean of
both keeps noise and slightly wrong places from bending it (Altman and Bland, Measurement in medicine, 1983), and makes
the fit symmetric in the two pictures.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

SRGB_LINEAR_LIMIT = 0.04045
SRGB_LINEAR_SLOPE = 12.92
SRGB_OFFSET = 0.055
SRGB_GAMMA = 2.4  # Of the sRGB transfer function from encoded value to linear light (IEC 61966-2-1:1999, 5.2).
# Levels in stops at which the gain is kept; it is linear between them and constant beyond. Set by hand.
KNOTS = np.array([-7.0, -5.5, -4.0, -2.5, -1.5, -0.5])
USABLE_SRGB = (0.04, 0.97)  # usable sRGB values: darker ones are noise, brighter ones may be clipped. Set by hand.
# Level of the brighter picture up to which a level counts: above, clipped places are missing from its samples, which
# would bias the median. Set by hand.
MAX_LEVEL_STOPS = -0.25
# Pictures that differ by less in all channels count as equally exposed: about 1 % of an sRGB value. Set by hand.
MIN_GAIN_STOPS = 0.04
MIN_USABLE_SHARE = 0.01  # share of all samples that has to be usable. Set by hand.
# Weight of a step between knots, as a share of all samples: empty knots follow their neighbours. Set by hand.
SMOOTHNESS_WEIGHT = 0.02
# Share of the typical difference that a curve may leave; above it the pictures differ in other ways. Set by hand.
MAX_UNEXPLAINED_SHARE = 0.9
# Differences count as this at most when a curve is judged: moving things may differ by any amount. Set by hand.
MAX_OUTLIER_STOPS = 2.0
INLIER_STOPS = 0.15  # a sample agrees with a curve if it leaves at most this difference. Set by hand.
# Share of inliers beyond chance, of all that chance leaves (Cohen's kappa). On wide generated pairs, curves from right
# depth reach 0.2 to 0.9, and curves from wrong depth 0.16 in one of the halves.
MIN_INLIER_EXCESS = 0.18
# By how much a curve has to raise the share of inliers. On the same pairs, right curves raise it by 0.11 or more.
MIN_INLIER_GAIN = 0.1
# What moving a few metres may change in the distribution of a picture's values. Set by hand.
MIN_ROUGH_GAIN_STOPS = 0.25
# Quantiles of both pictures that the rough gain compares; the ends are left out. Set by hand.
QUANTILES = np.linspace(0.05, 0.95, 46)
GAIN_BINS_PER_STOP = 50
LEVEL_BINS_PER_STOP = 4  # Resolution of the histogram that medians are read from. Set by hand.
MAX_GAIN_STOPS = 5.0  # the largest gain that is looked for. Set by hand.
EXPOSURE_TABLE_ENTRIES = 1024  # entries of a table from sRGB value to sRGB value, evenly from 0 to 1; read linearly


@dataclass(frozen=True)
class ExposureCurve:
    """The gain from a first picture to a second one."""

    # stops by channel, at the levels :data:`KNOTS`; positive where the second is brighter
    gain: Float[np.ndarray, "3 knots"]

    @property
    def is_identity(self) -> bool:
        """Whether both pictures are exposed alike."""
        return not self.gain.any()

    def reversed(self) -> "ExposureCurve":
        """The curve for the pictures in the other order."""
        return ExposureCurve(-self.gain)

    def table(self, t: float, *, of_second: bool) -> Float[np.ndarray, "3 entries"]:
        """Of ``linspace(0, 1, entries)`` at ``t``: sRGB, rising to at most 1; at its own end the identity."""
        srgb, share = np.linspace(0.0, 1.0, EXPOSURE_TABLE_ENTRIES), t - float(of_second)
        if share == 0.0 or self.is_identity:
            return np.tile(srgb, (3, 1)).astype(np.float32)
        moved = _to_stops(srgb) + share * self.gains_at(srgb, of_second=of_second)
        table = np.where(srgb > 0.0, linear_to_srgb(np.exp2(moved)), 0.0)
        return np.asarray(np.minimum(table, 1.0), np.float32)

    def gains_at(self, srgb: Float[np.ndarray, " values"], *, of_second: bool) -> Float[np.ndarray, "3 values"]:
        """The gain in stops at places where one picture shows these values."""
        # Constant beyond the outer knots. A value is its level ± half of the gain: interpolate over that.
        level = np.concatenate([[KNOTS[0] - 60.0], KNOTS, [KNOTS[-1] + 60.0]])
        changes = np.concatenate([self.gain[:, :1], self.gain, self.gain[:, -1:]], axis=1)
        own = 0.5 if of_second else -0.5
        return np.stack([np.interp(_to_stops(srgb), level + own * change, change) for change in changes])


def _to_stops(srgb: np.ndarray) -> np.ndarray:
    return np.asarray(np.log2(np.maximum(srgb_to_linear(srgb), 1e-9)))


def estimate_curve(
    first: Float[np.ndarray, "samples 3"], second: Float[np.ndarray, "samples 3"], weight: Float[np.ndarray, " samples"]
) -> ExposureCurve:
    """The gain between two pictures of the same places; zero where they are alike or too little can be compared.

    sRGB in [0, 1]; ``weight`` >= 0 of each place. Up to half of the samples of a level may show different things.
    """
    fits = [_fit_channel(first[:, k], second[:, k], weight) for k in range(3)]
    is_alike = max(fit.rms_gain for fit in fits) < MIN_GAIN_STOPS
    if is_alike or sum(fit.error_after for fit in fits) > MAX_UNEXPLAINED_SHARE * sum(fit.error_before for fit in fits):
        return ExposureCurve(np.zeros((3, len(KNOTS))))
    gain = np.stack([fit.gain for fit in fits])
    middle, steepest = gain.mean(axis=1, keepdims=True), float((np.abs(np.diff(gain, axis=1)) / np.diff(KNOTS)).max())
    # A level m is shown at m ± g(m)/2. Brighter places stay brighter as long as |g'| < 2; 1.5 leaves a margin.
    return ExposureCurve(np.asarray(middle + (gain - middle) * min(1.0, 1.5 / max(steepest, 1e-12))))


def cross_validated_curve(
    samples: Sequence[tuple[Float[np.ndarray, "samples 3"], Float[np.ndarray, "samples 3"], np.ndarray]],
) -> ExposureCurve:
    """Of two halves of samples; zero unless each one's curve holds in the other: of wrong depth few agree."""
    for half, other in (samples, samples[::-1]):
        inliers, without, by_chance = _inlier_shares(estimate_curve(*half), *other)
        excess = (inliers - by_chance) / max(1.0 - by_chance, 1e-9)
        if excess < MIN_INLIER_EXCESS or inliers < without + MIN_INLIER_GAIN:
            return ExposureCurve(np.zeros((3, len(KNOTS))))
    return estimate_curve(*(np.concatenate(values) for values in zip(*samples, strict=True)))


def _inlier_shares(
    curve: ExposureCurve, first: np.ndarray, second: np.ndarray, weight: np.ndarray
) -> tuple[float, float, float]:
    """Mean shares of samples that a curve explains, that none does, and that it does of shuffled (chance) pairs."""
    shares = np.zeros((3, 3))
    for k in range(3):
        before, after, usable = _usable_stops(first[:, k], second[:, k], weight)
        shuffled = np.random.default_rng(0).permutation(after)
        for of_case, gain, now in ((0, curve.gain[k], after), (1, 0.0 * KNOTS, after), (2, curve.gain[k], shuffled)):
            left = now - before - np.interp(0.5 * (before + now), KNOTS, gain)
            shares[of_case, k] = np.average(np.abs(left) < INLIER_STOPS, weights=weight[usable]) if len(left) else 0.0
    with_curve, without, by_chance = shares.mean(axis=1)
    return float(with_curve), float(without), float(by_chance)


def _usable_stops(
    first: np.ndarray, second: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray, Bool[np.ndarray, " samples"]]:
    """Stops of the samples of one channel that are neither too dark nor clipped; and which ones these are."""
    low, high = USABLE_SRGB
    usable = (np.minimum(first, second) > low) & (np.maximum(first, second) < high) & (weight > 0.0)
    before, after = (np.log2(srgb_to_linear(x[usable].astype(np.float64))) for x in (first, second))
    return before, after, usable


@dataclass(frozen=True)
class _ChannelFit:
    """Of one channel: stops of gain at the knots, their RMS over what is seen, mean differences without and with it."""

    gain: Float[np.ndarray, " knots"]
    rms_gain: float
    error_before: float
    error_after: float


def estimate_gain(first: Float[np.ndarray, "pixels 3"], second: Float[np.ndarray, "more_pixels 3"]) -> ExposureCurve:
    """A rough gain between two pictures of one scene, without correspondences: good enough to find matches by.

    The median difference in stops of equal quantiles, by channel; zero if all are small. Samples, sRGB in [0, 1], stand
    for equal shares of the sphere.
    """
    low, high = USABLE_SRGB
    gain = np.zeros((3, len(KNOTS)))
    for k in range(3):
        before, after = np.quantile(first[:, k], QUANTILES), np.quantile(second[:, k], QUANTILES)
        usable = (np.minimum(before, after) > low) & (np.maximum(before, after) < high)
        if usable.any():
            stops = [np.log2(srgb_to_linear(x[usable])) for x in (before, after)]
            gain[k] = np.median(stops[1] - stops[0])  # a difference, not a quotient: exactly antisymmetric
    return ExposureCurve(gain if np.abs(gain).max() >= MIN_ROUGH_GAIN_STOPS else np.zeros_like(gain))


def _fit_channel(first: np.ndarray, second: np.ndarray, weight: np.ndarray) -> _ChannelFit:
    nothing = _ChannelFit(np.zeros(len(KNOTS)), 0.0, 0.0, 0.0)
    before, after, usable = _usable_stops(first, second, weight)
    if float(weight[usable].sum()) <= MIN_USABLE_SHARE * float(weight.sum()):
        return nothing
    srgb = [x[usable].astype(np.float64) for x in (first, second)]
    visible = weight[usable] * (srgb[0] + srgb[1]) ** 2  # a stop changes an sRGB value in proportion to it
    levels, changes = 0.5 * (before + after), after - before
    level, median, share = _median_gains(levels, changes, visible / visible.sum())
    whole = level + 0.5 * np.abs(median) < MAX_LEVEL_STOPS  # the level of the brighter of both pictures
    if not whole.any():
        return nothing
    gain = _smooth_fit(level[whole], median[whole], share[whole])
    found = np.interp(level[whole], KNOTS, gain)
    rms_gain = float(np.sqrt(np.average(found**2, weights=share[whole])))
    left = changes - np.interp(levels, KNOTS, gain)
    return _ChannelFit(gain, rms_gain, _mean_magnitude(changes, visible), _mean_magnitude(left, visible))


def _mean_magnitude(stops: np.ndarray, weight: np.ndarray) -> float:
    """A clipped mean: a median would ignore the smaller of two kinds of samples, a plain mean trusts outliers."""
    return float(np.average(np.minimum(np.abs(stops), MAX_OUTLIER_STOPS), weights=weight))


def _median_gains(
    level: np.ndarray, change: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Level, weighted median of the change (from a histogram: no sorting of millions) and weight of filled bins."""
    lowest, columns = KNOTS[0] - 2.0, int(2 * MAX_GAIN_STOPS * GAIN_BINS_PER_STOP)
    rows = int((2.0 - lowest) * LEVEL_BINS_PER_STOP)
    row = np.clip(((level - lowest) * LEVEL_BINS_PER_STOP).astype(np.intp), 0, rows - 1)
    col = np.clip(((change + MAX_GAIN_STOPS) * GAIN_BINS_PER_STOP).astype(np.intp), 0, columns - 1)
    histogram = np.bincount(row * columns + col, weight, rows * columns).reshape(rows, columns)
    count = histogram.sum(axis=1)
    seen = np.flatnonzero(count > 0.0)
    sums = np.cumsum(histogram[seen], axis=1)
    half = 0.5 * count[seen]
    bin_of_median = np.minimum((sums < half[:, None]).sum(axis=1), columns - 1)
    at = np.arange(len(seen)), bin_of_median
    inside = (half - (sums[at] - histogram[seen][at])) / np.maximum(histogram[seen][at], 1e-12)
    median = (bin_of_median + inside) / GAIN_BINS_PER_STOP - MAX_GAIN_STOPS
    return (seen + 0.5) / LEVEL_BINS_PER_STOP + lowest, median, count[seen]


def _smooth_fit(level: np.ndarray, median: np.ndarray, share: np.ndarray) -> Float[np.ndarray, " knots"]:
    """Least squares for the gain at the knots, with a penalty on steps (a smoothing spline of degree 1)."""
    hats = np.stack([np.interp(level, KNOTS, unit) for unit in np.eye(len(KNOTS))], axis=1)
    steps = np.diff(np.eye(len(KNOTS)), axis=0)
    left = hats.T @ (share[:, None] * hats) + SMOOTHNESS_WEIGHT * steps.T @ steps
    return np.asarray(np.linalg.solve(left, hats.T @ (share * median)))


def srgb_to_linear(value: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Linear light of sRGB values >= 0: 1 is white, brighter values go on along the same curve."""
    power = ((np.maximum(value, SRGB_LINEAR_LIMIT) + SRGB_OFFSET) / (1.0 + SRGB_OFFSET)) ** SRGB_GAMMA
    return np.asarray(np.where(value <= SRGB_LINEAR_LIMIT, value / SRGB_LINEAR_SLOPE, power))


def linear_to_srgb(light: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """The inverse of :func:`srgb_to_linear`, for light >= 0."""
    bright = SRGB_LINEAR_LIMIT / SRGB_LINEAR_SLOPE
    power = (1.0 + SRGB_OFFSET) * np.maximum(light, bright) ** (1.0 / SRGB_GAMMA) - SRGB_OFFSET
    return np.asarray(np.where(light <= bright, light * SRGB_LINEAR_SLOPE, power))
