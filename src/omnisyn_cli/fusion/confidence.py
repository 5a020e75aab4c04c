"""Confidence without ground truth: of the pixels of a frame, and of a pair, whose photographs predict each other.

Correct depth and poses carry a photograph to where the other one was taken, and there it must look like it; colours of
that one are not used. This error and the difference of both layers half way rank clips as their true WS-PSNR does
(Spearman 0.98 over 39 pairs, see ``docs/confidence.md``).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Float32

from omnisyn_cli.compute.jit import fast_kernel, inlined
from omnisyn_cli.fusion.pixel_classes import classify_pixels
from omnisyn_cli.geometry.sampling import add_columns, filter_across_seam
from omnisyn_cli.geometry.sphere import pixel_to_direction, solid_angles
from omnisyn_cli.types import DEPTH_CONFIDENCE_GAIN, MIN_VISIBLE_WEIGHT, ColourStep, Layer

REGION_ROWS = 32  # rows of the coarse grid of regions: about 6°. Set by hand.
# Mean confidence up to which a region is given up, and from which on it is kept; linear in between. Chosen by eye: at
# 0.05 and 0.2 three real pairs gain 0.2 dB, but are torn again.
GIVE_UP_CONFIDENCE, KEEP_CONFIDENCE = 0.25, 0.45
MIN_SCORE_DB, MAX_SCORE_DB = 12.0, 36.0  # decibels that score 0 and 1. Set by hand.
MAX_COLOUR_RMS = 0.1  # root mean square difference over the channels above which colours differ. Set by hand.
CONTOUR_ROWS = 23  # the height of a picture in windows whose structure is compared: some 8 degrees each. Set by hand.
# Standard deviation of grey values from which on a window has structure, and likeness of the same structure.
MIN_CONTOUR_CONTRAST, MIN_CONTOUR_LIKENESS = 0.04, 0.4
# Decibels that the score falls by where everything is doubled, beyond a share that good pairs have as well. Measured on
# generated pairs, WS-PSNR falls by 2 dB; a contour that is seen twice disturbs more than that says.
DOUBLING_DB, MAX_GOOD_DOUBLING = 4.0, 0.1
WORST_REGION_GRID = (12, 24)  # rows and columns of 15°: the weakest place is three by three of them
HOLE_ERROR = 0.05  # squared error of a pixel that neither layer shows: it is filled with blurred surroundings


def confidence_step(
    first_depth: Float32[np.ndarray, "height width"], second_depth: Float32[np.ndarray, "height width"],
    out: Float32[np.ndarray, "height width"],
) -> ColourStep:  # fmt: skip
    """A step that writes the confidence of some rows, in [0, 1], into ``out``; it changes no colours.

    It is 0 where neither layer shows anything; near 1 where both show one colour at one reliable (inverse) depth; 0.6
    where only one shows something; low where they contradict each other.
    """

    def judge(first: np.ndarray, second: np.ndarray, top: int) -> None:
        rows = slice(top, top + len(first))
        _confidence_rows(first, first_depth[rows], second, second_depth[rows], TOLERANCES, out[rows])

    return judge


class ConfidenceTolerances(NamedTuple):
    """What pixels are judged by, as kernels take it. All set by hand."""

    one_view_confidence: np.float32 = np.float32(0.6)  # of what only one layer shows: nothing confirms it
    depth: np.float32 = np.float32(0.1)  # relative difference of inverse depth at which confidence has fallen to 1/e
    colour: np.float32 = np.float32(0.15)  # root mean square difference of colour at which it has


TOLERANCES = ConfidenceTolerances()


@inlined(fastmath=True)
def pixel_confidence(first, first_rho, second, second_rho, tolerances):
    """Confidence of one pixel, given RGB and weight, and inverse depth, of both layers."""
    zero, one, a, b = np.float32(0.0), np.float32(1.0), first[3], second[3]
    depth_confidence = min(one, np.float32(DEPTH_CONFIDENCE_GAIN) * max(a, b))
    if a > MIN_VISIBLE_WEIGHT and b > MIN_VISIBLE_WEIGHT:
        rho_a, rho_b = max(first_rho, zero), max(second_rho, zero)
        gap = (rho_a - rho_b) / (max(rho_a, rho_b) * tolerances.depth + np.float32(1e-9))
        squared = zero
        for k in range(3):
            step = first[k] - second[k]
            squared += step * step
        squared = squared / (np.float32(3.0) * tolerances.colour * tolerances.colour)
        return depth_confidence * math.exp(-gap * gap - squared)
    if a > MIN_VISIBLE_WEIGHT or b > MIN_VISIBLE_WEIGHT:
        return depth_confidence * tolerances.one_view_confidence
    return zero


@fast_kernel()
def _confidence_rows(first, first_rho, second, second_rho, tolerances, out):
    """Confidence of rows of layers ``(height, width, 4)``, RGB and weight, and their inverse depths, into ``out``."""
    for row in range(out.shape[0]):
        for col in range(out.shape[1]):
            out[row, col] = pixel_confidence(
                first[row, col], first_rho[row, col], second[row, col], second_rho[row, col], tolerances
            )


def low_confidence_regions(confidence: Float32[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width"]:
    """Smooth weights in [0, 1]: 1 in regions of low confidence, which may be replaced. Wraps at the seam."""
    height, width = confidence.shape
    rows = min(REGION_ROWS, height)
    coarse = cv2.resize(confidence, (2 * rows, rows), interpolation=cv2.INTER_AREA)
    wrapped = add_columns(coarse, 4)
    mean = cv2.GaussianBlur(wrapped, (5, 5), 1.0)
    weight = np.clip((KEEP_CONFIDENCE - mean) / (KEEP_CONFIDENCE - GIVE_UP_CONFIDENCE), 0.0, 1.0).astype(np.float32)
    margin = 4 * width // (2 * rows)
    whole = cv2.resize(weight, (width + 2 * margin, height), interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(whole[:, margin : margin + width])


@dataclass(frozen=True)
class PairConfidence:
    """How reliable the frames between two panoramas are."""

    expected: float  # dB, from the mean error of the photographs against each other and of both layers half way
    unseen: float  # share of the sphere that neither layer shows half way
    depth_disagreement: float  # share where both show something, at different distances
    inconsistency: float  # share where both show something at one distance, in different colours
    # the direction, half way and in the frame of the camera there, around which both layers fit worst
    weakest: tuple[float, float, float] = (0.0, 0.0, -1.0)
    doubling: float = 0.0  # share of what has contrast half way, by area, at which the layers show other structures

    @property
    def scored_db(self) -> float:
        """What the score is made from: ``expected``, less what doubled contours take; at least 0."""
        return max(0.0, self.expected - DOUBLING_DB * max(0.0, self.doubling - MAX_GOOD_DOUBLING))

    @property
    def score(self) -> float:
        """In [0, 1]; 0 is 12 dB or less, 1 is 36 dB or more."""
        return min(1.0, max(0.0, (self.scored_db - MIN_SCORE_DB) / (MAX_SCORE_DB - MIN_SCORE_DB)))

    def describe(self) -> dict[str, float]:
        """The values, rounded, for people and for JSON."""
        return {
            "score": round(self.score, 3), "expected_db": round(self.expected, 2), "unseen": round(self.unseen, 4),
            "disagreement": round(self.depth_disagreement, 4), "inconsistency": round(self.inconsistency, 4),
            "doubling": round(self.doubling, 4),
        }  # fmt: skip


def assess_pair(across: Sequence[tuple[Layer, Layer]], middle: tuple[Layer, Layer]) -> PairConfidence:
    """``across``: each photograph and the other view's layer there; ``middle``: both half way; of equal exposure."""
    errors = [_mean_error(own, other) for own, other in (*across, middle)]
    # The photographs against each other count as much as the layers half way.
    error = 0.5 * (0.5 * (errors[0] + errors[1]) + errors[2])
    expected = -10.0 * math.log10(max(error, 1e-10))
    return PairConfidence(expected, *_shares(*middle), _weakest_direction(*middle), _doubling(*middle))


def _mean_error(one: Layer, other: Layer) -> float:
    """Mean squared error over the sphere where both show something; 1 where there is nothing to compare."""
    weight = solid_angles(*one.inverse_depth.shape) * _seen(one) * _seen(other)
    return float(np.average(_squared_difference(one, other), weights=weight)) if weight.any() else 1.0


def _shares(one: Layer, other: Layer) -> tuple[float, float, float]:
    """Unseen, disagreeing and inconsistent shares of the sphere."""
    weight = solid_angles(*one.inverse_depth.shape)
    weight /= weight.sum()
    classes = classify_pixels(one, other)
    differs = _squared_difference(one, other) > MAX_COLOUR_RMS**2
    cases = (classes.hole, classes.disagree, classes.agree & differs)
    unseen, disagreement, inconsistency = (float(weight[case].sum()) for case in cases)
    return unseen, disagreement, inconsistency


def _doubling(one: Layer, other: Layer) -> float:
    """Share of seen windows with contrast whose structure differs: contours side by side are there twice."""
    seen = (_seen(one) & _seen(other)).astype(np.float32)
    a, b = (np.clip(layer.colour[..., :3], 0.0, 1.0).mean(axis=-1) for layer in (one, other))
    side = max(3, len(seen) // CONTOUR_ROWS)

    def mean(values: np.ndarray) -> np.ndarray:
        return filter_across_seam(lambda image: cv2.blur(image, (side, side)), values * seen, side)

    count = np.maximum(mean(np.ones_like(seen)), 1e-6)
    mean_a, mean_b = mean(a) / count, mean(b) / count
    variance_a, variance_b = mean(a * a) / count - mean_a**2, mean(b * b) / count - mean_b**2
    likeness = 2.0 * (mean(a * b) / count - mean_a * mean_b) / np.maximum(variance_a + variance_b, 1e-9)
    weight = solid_angles(*seen.shape) * seen * (np.maximum(variance_a, variance_b) > MIN_CONTOUR_CONTRAST**2)
    return float((weight * (likeness < MIN_CONTOUR_LIKENESS)).sum() / max(float(weight.sum()), 1e-9))


def _weakest_direction(one: Layer, other: Layer) -> tuple[float, float, float]:
    """The middle of the part of the sphere, some 45 degrees wide, in which two layers fit worst."""
    both, none = _seen(one) & _seen(other), ~(_seen(one) | _seen(other))
    error = np.where(both, _squared_difference(one, other), HOLE_ERROR * none)
    area = solid_angles(*error.shape)
    rows, cols = WORST_REGION_GRID
    cells = [cv2.resize(values, (cols, rows), interpolation=cv2.INTER_AREA) for values in (error * area, area)]
    sums = [cv2.blur(np.pad(values, ((0, 0), (1, 1)), mode="wrap"), (3, 3))[:, 1:-1] for values in cells]
    row, col = np.unravel_index(np.argmax(sums[0] / sums[1]), WORST_REGION_GRID)
    x, y, z = pixel_to_direction(np.asarray(float(row)), np.asarray(float(col)), WORST_REGION_GRID).tolist()
    return x, y, z


def _seen(layer: Layer) -> np.ndarray:
    return np.asarray(layer.colour[..., 3] > MIN_VISIBLE_WEIGHT)


def _squared_difference(one: Layer, other: Layer) -> Float[np.ndarray, "height width"]:
    a, b = (np.clip(layer.colour[..., :3], 0.0, 1.0) for layer in (one, other))
    return np.asarray(((a - b) ** 2).mean(axis=-1))
