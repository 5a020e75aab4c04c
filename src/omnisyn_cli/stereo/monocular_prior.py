"""What a network sees in one panorama, as a prior of a pair: its scale and shift come from what was matched.

Such networks answer up to an unknown scale and shift, and their numbers are depth, its inverse or its logarithm. A
perspective network has scales of its own in each picture: pictures agree where they overlap, and with the matches. Many
matches may be wrong, all in the same way, such as those of tiles. So the best alignment is the one that most of them
confirm, and how close these are says how far the answer can be trusted. Where fewer than half do, descriptors decide.
"""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.geometry.sphere import pixel_directions, solid_angles
from omnisyn_cli.stereo.disparity import DisparityMap, is_measurable
from omnisyn_cli.stereo.expected_depth import (
    NETWORK_SIZE,
    TEN_PERCENT,
    Matches,
    at_best_scale,
    in_frame,
    likeness_of_priors,
    log_inverse_depth,
    smooth_from_known,
)  # fmt: skip
from omnisyn_cli.stereo.monocular_answer import READINGS, MonocularAnswer, Reading, Samples
from omnisyn_cli.stereo.rectify import MIN_SQRT_INV_DEPTH, DepthPrior, RectifiedPair
from omnisyn_cli.types import View

ALIGNMENT_SIZE = (64, 128)  # rows and columns of the directions in which scale and shift are looked for
MIN_MATCHES = 100  # in fewer of these directions matches say nothing about scale and shift
MIN_INVERSE_DEPTH = 0.02  # in 1/baselines: farther matches say nothing exact
# Pairs of matches that scale and shift are taken from, to begin with; likewise single ones for a scale alone.
HYPOTHESES = 500
MAX_LOG_ERROR = 0.25  # of the logarithm of inverse depth: matches that differ by more do not confirm an alignment
MIN_CONFIRMING_SHARE = 0.5  # share of the matches that confirm an alignment; below it descriptors decide
OVERLAP_WEIGHT = 0.3  # of two pictures that should agree in a direction, against 1 for a match there
# Of the median of all numbers: errors are not relative to smaller ones, such as the inverse depth of the sky.
MIN_UNIT_SHARE = 0.3
SOLVER_STEPS = 8  # of least squares, each with the weights that make it the least sum of absolute errors
MIN_LOG_ERROR = 0.02  # smaller errors count alike
UNCONFIRMED_ERROR = 0.1  # of the logarithm, as if known of an answer that descriptors scale
ALL_LOG_SCALES = np.arange(-30, 31) / 10.0  # logarithms of the factors of an answer of unknown scale that are tried
CORRECTED_ERRORS = 3.0  # matches within so many median errors correct the answer around them


class Alignment(NamedTuple):
    """How an answer becomes inverse depth in 1/baselines."""

    reading: Reading  # of its numbers
    # of each picture
    scale: Float[np.ndarray, " pictures"]
    shift: Float[np.ndarray, " pictures"]
    # mean error of the logarithm of inverse depth at the matches; errors above :data:`MAX_LOG_ERROR` count as that
    cost: float = np.inf
    error: float = np.inf  # median error at the matches that confirm it
    confirming_share: float = 0.0  # of the matches

    def log_inverse_depth(self, samples: Samples) -> Float[np.ndarray, "rows cols"]:
        """The mean of the pictures."""
        factor, addend = _along_rays(self.reading, samples)
        numbers = factor * (self.scale[:, None, None] * samples.values + self.shift[:, None, None]) + addend
        total = (samples.weight * self.reading.to_log(numbers)).sum(0)
        return np.asarray(total / samples.weight.sum(0))


def with_monocular_priors(
    pair: RectifiedPair, first: View, second: View, matches: Matches,
    *, model: Callable[[View], MonocularAnswer],
) -> RectifiedPair:  # fmt: skip
    """The pair with what a network expects of both panoramas: as matches confirm it, else as descriptors do, if any."""
    answers = model(first), model(second)
    sides = list(zip((pair, pair.reversed()), matches, answers, strict=True))
    aligned = [align(answer, *_in_world(own, found, ALIGNMENT_SIZE)) for own, found, answer in sides]
    tried = []
    if None not in aligned:
        by_matches = (_prior(*side, each) for side, each in zip(sides, aligned, strict=True) if each is not None)
        tried.append(_with_priors(pair, *by_matches))
        if all(each is not None and each.confirming_share >= MIN_CONFIRMING_SHARE for each in aligned):
            return tried[0]
    if pair.descriptors is None:
        return pair
    for name in answers[0].readings:
        unscaled = (_as_prior(_unaligned(answer, READINGS[name]), UNCONFIRMED_ERROR) for answer in answers)
        tried.append(at_best_scale(_with_priors(pair, *unscaled), ALL_LOG_SCALES))
    return max(tried, key=likeness_of_priors)


def _with_priors(pair: RectifiedPair, *priors: DepthPrior) -> RectifiedPair:
    """Priors of both panoramas, given in the orientation of the world."""
    first, second = (
        in_frame(own.world_from_frame, pair.size, np.eye(3), prior)
        for own, prior in zip((pair, pair.reversed()), priors, strict=True)
    )
    return replace(pair, priors=(first, second))


def _prior(pair: RectifiedPair, matches: DisparityMap, answer: MonocularAnswer, alignment: Alignment) -> DepthPrior:
    """Of the first panorama of a pair, in the orientation of the world, corrected by the matches that confirm it."""
    measured, known = _in_world(pair, matches, NETWORK_SIZE)
    expected = alignment.log_inverse_depth(answer.at(pixel_directions(*NETWORK_SIZE)))
    error = max(alignment.error, MIN_LOG_ERROR)
    known &= np.abs(measured - expected) < CORRECTED_ERRORS * error
    return _as_prior(expected + smooth_from_known(measured - expected, known), error)


def _unaligned(answer: MonocularAnswer, reading: Reading) -> Float[np.ndarray, "height width"]:
    """Logarithms of inverse depth without a shift, and of no known scale: their median is 0."""
    joined = _joined(reading, answer.at(pixel_directions(*ALIGNMENT_SIZE)))
    expected = joined.log_inverse_depth(answer.at(pixel_directions(*NETWORK_SIZE)))
    return np.asarray(expected - np.median(expected))


def _as_prior(expected: Float[np.ndarray, "height width"], error: float) -> DepthPrior:
    """Given logarithms of inverse depth, and their error."""
    sqrt_inv_depth = np.exp(0.5 * expected)
    tolerance = error * np.maximum(sqrt_inv_depth, MIN_SQRT_INV_DEPTH)
    confidence = np.full(expected.shape, 1.0 - np.exp(-2.0 * TEN_PERCENT / error))
    return DepthPrior(*(np.asarray(each, np.float32) for each in (sqrt_inv_depth, tolerance, confidence)))


def _in_world(
    pair: RectifiedPair, matches: DisparityMap, size: tuple[int, int]
) -> tuple[Float[np.ndarray, "height width"], Bool[np.ndarray, "height width"]]:
    """Logarithms of the first panorama's inverse depth in the orientation of the world, and where they were matched."""
    table = pair.remap_to(np.eye(3), size)
    measured = log_inverse_depth(table.nearest(pair.grid.inverse_depth(matches.disparity)))
    return measured, table.nearest(matches.valid & is_measurable(pair.grid, matches.disparity))


def align(
    answer: MonocularAnswer, measured: Float[np.ndarray, "rows cols"], known: Bool[np.ndarray, "rows cols"]
) -> Alignment | None:
    """Reading, scales and shifts with which an answer agrees best with matches; None if there are too few.

    ``measured`` are logarithms of inverse depth in the orientation of the world, matched where they are ``known``.
    """
    known = known & (measured > np.log(MIN_INVERSE_DEPTH))
    if known.sum() < MIN_MATCHES:
        return None
    samples = answer.at(pixel_directions(*measured.shape))
    found = [_align_as(READINGS[name], samples, measured, known) for name in answer.readings]
    return min(found, key=lambda alignment: alignment.cost)


def _align_as(reading: Reading, samples: Samples, measured: np.ndarray, known: np.ndarray) -> Alignment:
    """Its pictures joined, the scale and shift of all that most matches confirm, and then of each picture."""
    joined = _joined(reading, samples)
    numbers = reading.of_log(joined.log_inverse_depth(samples))[known]
    scale, shift = _hypotheses(numbers, reading.of_log(measured)[known])
    if not len(scale):
        return joined
    weight = _weights(measured.shape)[known]
    errors = np.abs(reading.to_log(scale[:, None] * numbers + shift[:, None]) - measured[known])
    best = int((np.minimum(errors, MAX_LOG_ERROR) @ weight).argmin())
    factors, seen = _along_rays(reading, samples)[0], samples.weight
    factor = (factors * seen).sum((1, 2)) / seen.sum((1, 2))
    begun = joined._replace(scale=scale[best] * joined.scale, shift=scale[best] * joined.shift + shift[best] / factor)
    found = [_measured_on(begun, samples, measured, known)]
    for _ in range(SOLVER_STEPS):
        found.append(_measured_on(_solve(found[-1], samples, measured, known), samples, measured, known))
    return min(found, key=lambda alignment: alignment.cost)


def _hypotheses(numbers: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scales above 0, and shifts, through two matches each; and scales through one match, without a shift."""
    one, other = np.random.default_rng(0).integers(len(numbers), size=(2, HYPOTHESES))
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.concatenate([(wanted[other] - wanted[one]) / (numbers[other] - numbers[one]), wanted / numbers])
    shift = np.concatenate([wanted[one] - scale[:HYPOTHESES] * numbers[one], np.zeros(len(numbers))])
    is_one = np.isfinite(scale) & (scale > 0)
    return scale[is_one][: 2 * HYPOTHESES], shift[is_one][: 2 * HYPOTHESES]


def _measured_on(alignment: Alignment, samples: Samples, measured: np.ndarray, known: np.ndarray) -> Alignment:
    """The alignment with its cost, error and share."""
    errors, weight = np.abs(alignment.log_inverse_depth(samples) - measured)[known], _weights(measured.shape)[known]
    confirming = errors < MAX_LOG_ERROR
    error = float(np.median(errors[confirming])) if confirming.any() else np.inf
    cost = float(np.average(np.minimum(errors, MAX_LOG_ERROR), weights=weight))
    return alignment._replace(cost=cost, error=error, confirming_share=float(np.average(confirming, weights=weight)))


def _joined(reading: Reading, samples: Samples) -> Alignment:
    """Its pictures as they agree where they overlap, each by a factor of depth of its own; logarithms by one scale.

    A scale and a shift of all pictures together stay open.
    """
    pictures = np.eye(len(samples.values))
    typical = (float(np.median(np.abs(samples.values[samples.weight > 0]))) if reading.power else 1.0) or 1.0
    logs, stretch = reading.to_log(samples.values / typical), np.log(samples.stretch)
    systems, wanted = [np.ones((1, len(pictures) + 1)), np.eye(len(pictures) + 1)[-1:]], [np.ones(1), np.ones(1)]
    for one, other, where in _overlaps(samples):
        step, apart = pictures[one] - pictures[other], (logs[one] - logs[other])[where]
        systems.append(np.column_stack([np.tile(step, (len(apart), 1)), apart]))
        wanted.append((stretch[one] - stretch[other])[where])
    system, target = np.concatenate(systems), np.concatenate(wanted)
    if reading.power:  # the scale of these logarithms is known
        system, target = system[:, :-1], target - system[:, -1]
    weight = np.ones(len(target))
    for _ in range(SOLVER_STEPS):
        solution = _least_squares(system * weight[:, None], target * weight)
        weight = 1.0 / np.sqrt(np.abs(system @ solution - target) + MIN_LOG_ERROR)
    added = solution[: len(pictures)]
    if reading.power:
        return Alignment(reading, np.exp(-reading.power * added) / typical, np.zeros(len(pictures)))
    return Alignment(reading, np.full(len(pictures), max(float(solution[-1]), MIN_LOG_ERROR)), -added)


def _solve(alignment: Alignment, samples: Samples, measured: np.ndarray, known: np.ndarray) -> Alignment:
    """Scales and shifts of all pictures anew, from the matches that confirm them and where pictures overlap."""
    reading, pictures = alignment.reading, len(samples.values)
    logs = alignment.log_inverse_depth(samples)
    error = np.abs(logs - measured)
    numbers = np.abs(reading.of_log(logs)) if reading.power else np.ones(logs.shape)
    unit = np.maximum(numbers, MIN_UNIT_SHARE * np.median(numbers))  # errors are relative to depth
    weight = np.sqrt(_weights(measured.shape) / (error + MIN_LOG_ERROR)) * (known & (error < MAX_LOG_ERROR)) / unit
    overlap_weight = OVERLAP_WEIGHT * np.sqrt(_weights(measured.shape) / MIN_LOG_ERROR) / unit
    factor, addend = _along_rays(reading, samples)
    target, systems, wanted = reading.of_log(measured), [], []

    def equations(where: np.ndarray, weight: np.ndarray, *signs: tuple[int, float]) -> None:
        block = np.zeros((int(where.sum()), 2 * pictures))
        for picture, sign in signs:
            block[:, 2 * picture] = (sign * weight * factor[picture] * samples.values[picture])[where]
            block[:, 2 * picture + 1] = (sign * weight * factor[picture])[where]
        systems.append(block)

    for picture, seen in enumerate((samples.weight > 0) & (weight > 0)):
        equations(seen, weight, (picture, 1.0))
        wanted.append((weight * (target - addend[picture]))[seen])
    for one, other, where in _overlaps(samples):
        equations(where, overlap_weight, (one, 1.0), (other, -1.0))
        wanted.append((overlap_weight * (addend[other] - addend[one]))[where])
    solution = _least_squares(np.concatenate(systems), np.concatenate(wanted))
    return Alignment(reading, solution[::2], solution[1::2])


def _least_squares(system: np.ndarray, target: np.ndarray) -> np.ndarray:
    """By the normal equations, which are few: the shortest solution where pictures have no contrast."""
    return np.asarray(np.linalg.lstsq(system.T @ system, system.T @ target, rcond=1e-12)[0])


def _overlaps(samples: Samples) -> Iterator[tuple[int, int, np.ndarray]]:
    """Two pictures each, and the directions that both see."""
    seen = samples.weight > 0
    for one, other in itertools.combinations(range(len(seen)), 2):
        if (where := seen[one] & seen[other]).any():
            yield one, other, where


def _along_rays(reading: Reading, samples: Samples) -> tuple[np.ndarray, np.ndarray]:
    """Factor and addend that make numbers of depth along an axis those of distance along rays."""
    stretch = samples.stretch
    if reading.power:
        return stretch**reading.power, np.zeros_like(stretch)
    return np.ones_like(stretch), np.log(stretch)


def _weights(size: tuple[int, ...]) -> Float[np.ndarray, "rows cols"]:
    areas = solid_angles(size[0], size[1])
    return np.broadcast_to(areas / areas.max(), size)
