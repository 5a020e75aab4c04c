"""How much brighter one picture is than the other, for every channel and level.

Light is counted in stops, ``log2`` of linear light (1 is white at 0 stops). A place that the first picture shows at
``y1`` and the second at ``y2`` stops has the *level* ``m = (y1 + y2) / 2`` and the *gain* ``g(m) = y2 − y1``. At a
share ``t`` of the way it is shown at

    ``y(t) = m + (t − ½)·g(m)``,

so that its brightness in stops changes steadily, both pictures agree on it, and at the ends each is what it was. A
change of exposure is one constant ``g`` for all channels, of white balance a constant for each; other tone curves make
it a function of the level, which is why it is kept at a few knots.

``g`` is the weighted median of ``y2 − y1`` among places of one level that both pictures show. Sorting by the mean of
both, not by one of them, keeps noise and slightly wrong places from bending it (Altman and Bland, Measurement in
medicine, 1983), and the roles of the pictures can be exchanged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

LINEAR_PART = 0.04045
SLOPE = 12.92
OFFSET = 0.055
GAMMA = 2.4
"""Of the transfer function of sRGB, what is stored against how much light it stands for (IEC 61966-2-1:1999, 5.2)."""

KNOTS = np.array([-7.0, -5.5, -4.0, -2.5, -1.5, -0.5])
"""Levels in stops at which the gain is kept; it is linear between them and constant beyond."""

USABLE = (0.04, 0.97)
"""Stored values that say something: darker ones are noise, brighter ones may have been cut off."""

HIGHEST = -0.25
"""Level in stops of the brighter picture from which on some of its places may be missing, because they were cut off."""

LEAST_GAIN = 0.04
"""Stops: pictures that differ by less in all channels are taken for equally exposed."""

LEAST_SAMPLES = 0.01
"""Share of all samples that has to be usable."""

STIFFNESS = 0.02
"""Share of all samples that a step between knots counts as: knots without samples follow their neighbours."""

MOST_LEFT = 0.9
"""Share of the typical difference that a curve may leave unexplained; otherwise the pictures differ in other ways."""

ABSURD = 2.0
"""Stops: differences count as this at most when it is judged how much a curve explains."""

LEAST_ROUGH_GAIN = 0.25
"""Stops: what moving a few metres may change in the distribution of a picture's values."""

QUANTILES = np.linspace(0.05, 0.95, 46)

BINS_PER_STOP = 50
LEVEL_BINS_PER_STOP = 4
MOST_GAIN = 5.0
"""Stops: the widest difference that is looked for."""

TABLE = 1024
"""Entries of a table from stored value to stored value, evenly from 0 to 1."""


@dataclass(frozen=True)
class ExposureCurve:
    """The gain from a first picture to a second one.

    Attributes:
        gain: ``(3, knots)`` stops by channel, at the levels :data:`KNOTS`; positive where the second is brighter.
    """

    gain: Float[np.ndarray, "3 knots"]

    @property
    def is_identity(self) -> bool:
        """Whether both pictures are exposed alike."""
        return not self.gain.any()

    def reversed(self) -> ExposureCurve:
        """The curve for the pictures in the other order."""
        return ExposureCurve(-self.gain)

    def table(self, t: float, *, of_second: bool) -> Float[np.ndarray, "3 entries"]:
        """Stored values at a share ``t`` of the way for stored values ``linspace(0, 1, entries)`` of one picture.

        Rising from 0 to at most 1: what would be brighter than white is white. At the picture's own end of the way it
        is the identity.
        """
        stored, share = np.linspace(0.0, 1.0, TABLE), t - float(of_second)
        if share == 0.0 or self.is_identity:
            return np.tile(stored, (3, 1)).astype(np.float32)
        moved = _stops(stored) + share * self.gains_of(stored, of_second=of_second)
        table = np.where(stored > 0.0, linear_to_srgb(np.exp2(moved)), 0.0)
        return np.asarray(np.minimum(table, 1.0), np.float32)

    def gains_of(self, stored: Float[np.ndarray, " values"], *, of_second: bool) -> Float[np.ndarray, "3 values"]:
        """Stops between what the first and what the second picture show where one of them shows these values."""
        level = np.concatenate([[KNOTS[0] - 60.0], KNOTS, [KNOTS[-1] + 60.0]])
        changes = np.concatenate([self.gain[:, :1], self.gain, self.gain[:, -1:]], axis=1)
        own = 0.5 if of_second else -0.5
        return np.stack([np.interp(_stops(stored), level + own * change, change) for change in changes])


def _stops(stored: np.ndarray) -> np.ndarray:
    return np.asarray(np.log2(np.maximum(srgb_to_linear(stored), 1e-9)))


def estimate_curve(
    first: Float[np.ndarray, "samples 3"],
    second: Float[np.ndarray, "samples 3"],
    weight: Float[np.ndarray, " samples"],
) -> ExposureCurve:
    """The gain between two pictures of the same places; zero where they are alike or too little can be compared.

    Up to half of the samples of each level may show different things.

    Args:
        first: stored values in [0, 1].
        second: likewise, of the same places.
        weight: >= 0; how much each place counts.
    """
    fits = [_fit(first[:, k], second[:, k], weight) for k in range(3)]
    is_alike = max(fit.typical for fit in fits) < LEAST_GAIN
    if is_alike or sum(fit.left for fit in fits) > MOST_LEFT * sum(fit.before for fit in fits):
        return ExposureCurve(np.zeros((3, len(KNOTS))))
    return ExposureCurve(_monotone(np.stack([fit.gain for fit in fits])))


@dataclass(frozen=True)
class _Fit:
    """One channel's gain at the knots, and how good it is.

    Attributes:
        gain: stops at the knots.
        typical: stops, root mean square of the gain over what is seen.
        before, left: stops, typical difference of samples without and with the gain.
    """

    gain: Float[np.ndarray, " knots"]
    typical: float
    before: float
    left: float


def estimate_gain(first: Float[np.ndarray, "pixels 3"], second: Float[np.ndarray, "more_pixels 3"]) -> ExposureCurve:
    """The gain between two pictures of one scene before it is known which pixels show the same places.

    One constant per channel, the median difference in stops between equal quantiles; zero where it is small in all
    channels. It is good enough to find matches by.

    Args:
        first: stored values in [0, 1], each standing for the same share of the sphere.
        second: likewise.
    """
    low, high = USABLE
    gain = np.zeros((3, len(KNOTS)))
    for k in range(3):
        before, after = np.quantile(first[:, k], QUANTILES), np.quantile(second[:, k], QUANTILES)
        usable = (np.minimum(before, after) > low) & (np.maximum(before, after) < high)
        if usable.any():
            stops = [np.log2(srgb_to_linear(x[usable])) for x in (before, after)]
            gain[k] = np.median(stops[1] - stops[0])  # the other way round exactly the opposite, as a quotient is not
    return ExposureCurve(gain if np.abs(gain).max() >= LEAST_ROUGH_GAIN else np.zeros_like(gain))


def _fit(first: np.ndarray, second: np.ndarray, weight: np.ndarray) -> _Fit:
    low, high = USABLE
    nothing = _Fit(np.zeros(len(KNOTS)), 0.0, 0.0, 0.0)
    usable = (np.minimum(first, second) > low) & (np.maximum(first, second) < high) & (weight > 0.0)
    if float(weight[usable].sum()) <= LEAST_SAMPLES * float(weight.sum()):
        return nothing
    stored = [x[usable].astype(np.float64) for x in (first, second)]
    before, after = (np.log2(srgb_to_linear(x)) for x in stored)
    visible = weight[usable] * (stored[0] + stored[1]) ** 2  # a stop changes a stored value in proportion to it
    levels, changes = 0.5 * (before + after), after - before
    level, median, share = _medians(levels, changes, visible / visible.sum())
    whole = level + 0.5 * np.abs(median) < HIGHEST
    if not whole.any():
        return nothing
    gain = _smooth_fit(level[whole], median[whole], share[whole])
    found = np.interp(level[whole], KNOTS, gain)
    typical = float(np.sqrt(np.average(found**2, weights=share[whole])))
    left = changes - np.interp(levels, KNOTS, gain)
    return _Fit(gain, typical, _mean_size(changes, visible), _mean_size(left, visible))


def _mean_size(stops: np.ndarray, weight: np.ndarray) -> float:
    """A mean, because a median is content with half of two kinds of samples; a few of them may still be absurd."""
    return float(np.average(np.minimum(np.abs(stops), ABSURD), weights=weight))


def _medians(level: np.ndarray, change: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Level, weighted median of the change and weight of every bin of levels that has samples."""
    lowest, columns = KNOTS[0] - 2.0, int(2 * MOST_GAIN * BINS_PER_STOP)
    rows = int((2.0 - lowest) * LEVEL_BINS_PER_STOP)
    row = np.clip(((level - lowest) * LEVEL_BINS_PER_STOP).astype(np.intp), 0, rows - 1)
    col = np.clip(((change + MOST_GAIN) * BINS_PER_STOP).astype(np.intp), 0, columns - 1)
    histogram = np.bincount(row * columns + col, weight, rows * columns).reshape(rows, columns)
    count = histogram.sum(axis=1)
    seen = np.flatnonzero(count > 0.0)
    sums = np.cumsum(histogram[seen], axis=1)
    half = 0.5 * count[seen]
    bin_of_median = np.minimum((sums < half[:, None]).sum(axis=1), columns - 1)
    at = np.arange(len(seen)), bin_of_median
    inside = (half - (sums[at] - histogram[seen][at])) / np.maximum(histogram[seen][at], 1e-12)
    median = (bin_of_median + inside) / BINS_PER_STOP - MOST_GAIN
    return (seen + 0.5) / LEVEL_BINS_PER_STOP + lowest, median, count[seen]


def _smooth_fit(level: np.ndarray, median: np.ndarray, share: np.ndarray) -> Float[np.ndarray, " knots"]:
    """Least squares for values at the knots, with a price on steps between neighbours."""
    hats = np.stack([np.interp(level, KNOTS, unit) for unit in np.eye(len(KNOTS))], axis=1)
    steps = np.diff(np.eye(len(KNOTS)), axis=0)
    left = hats.T @ (share[:, None] * hats) + STIFFNESS * steps.T @ steps
    return np.asarray(np.linalg.solve(left, hats.T @ (share * median)))


def _monotone(gain: np.ndarray) -> Float[np.ndarray, "3 knots"]:
    """Less steep where a brighter place would otherwise be shown darker than a darker one in one of the pictures."""
    steepest = float((np.abs(np.diff(gain, axis=1)) / np.diff(KNOTS)).max())
    middle = gain.mean(axis=1, keepdims=True)
    return np.asarray(middle + (gain - middle) * min(1.0, 1.5 / max(steepest, 1e-12)))


def srgb_to_linear(value: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Light of stored values >= 0: 1 is white, brighter values go on along the same curve."""
    power = ((np.maximum(value, LINEAR_PART) + OFFSET) / (1.0 + OFFSET)) ** GAMMA
    return np.asarray(np.where(value <= LINEAR_PART, value / SLOPE, power))


def linear_to_srgb(light: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """The inverse of :func:`srgb_to_linear`, for light >= 0."""
    bright = LINEAR_PART / SLOPE
    power = (1.0 + OFFSET) * np.maximum(light, bright) ** (1.0 / GAMMA) - OFFSET
    return np.asarray(np.where(light <= bright, light * SLOPE, power))
