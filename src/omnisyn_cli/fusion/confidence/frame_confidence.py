"""Confidence of every pixel of a frame, and regions where it is low."""

import math
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float32

from omnisyn_cli.compute.jit import fast_kernel, inlined
from omnisyn_cli.geometry.sampling import add_columns
from omnisyn_cli.types import DEPTH_CONFIDENCE_GAIN, MIN_VISIBLE_WEIGHT, ColourStep

# Confidence of what only one layer shows, however reliable its depth: nothing confirms it. Set by hand.
ONE_VIEW_CONFIDENCE = np.float32(0.6)
# Relative difference of inverse depth at which confidence has fallen to 1/e. Set by hand.
DEPTH_TOLERANCE = np.float32(0.1)
COLOUR_TOLERANCE = np.float32(0.15)  # root mean square difference of colour at which it has. Set by hand.
REGION_ROWS = 32  # rows of the coarse grid of regions: about 6°. Set by hand.
# Mean confidence up to which a region is given up, and from which on it is kept; linear in between. Set by hand.
GIVE_UP_CONFIDENCE, KEEP_CONFIDENCE = 0.25, 0.45


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
    """:data:`ONE_VIEW_CONFIDENCE`, :data:`DEPTH_TOLERANCE` and :data:`COLOUR_TOLERANCE` as kernels take them."""

    one_view_confidence: np.float32
    depth: np.float32
    colour: np.float32


TOLERANCES = ConfidenceTolerances(ONE_VIEW_CONFIDENCE, DEPTH_TOLERANCE, COLOUR_TOLERANCE)


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
