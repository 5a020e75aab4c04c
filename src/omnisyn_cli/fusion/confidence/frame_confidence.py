"""How far every pixel of a frame can be relied on, and the regions where it cannot."""

import math

import cv2
import numpy as np
from jaxtyping import Float32

from omnisyn_cli.compute.jit import fast_kernel
from omnisyn_cli.geometry.sampling import add_columns
from omnisyn_cli.types import DEPTH_CONFIDENCE_GAIN, MIN_VISIBLE_WEIGHT, ColourStep

ALONE = np.float32(0.6)
"""Confidence of what only one view shows, however well its depth is known: nothing confirms it."""

APART = np.float32(0.1)
DIFFERING = np.float32(0.15)

ROWS_OF_REGIONS = 32
DOUBTED, TRUSTED = 0.25, 0.45
"""Mean confidence up to which a region is given up, and from which on it is kept; in between gradually."""


def confidence_step(
    first_depth: Float32[np.ndarray, "height width"],
    second_depth: Float32[np.ndarray, "height width"],
    out: Float32[np.ndarray, "height width"],
) -> ColourStep:
    """What writes the confidence of some rows, in [0, 1], given their colours, exposed alike, before they are blended.

    0 where neither view shows anything; near 1 where both show one colour at one distance and their depth is believed;
    0.6 where only one does; low where they contradict each other in distance or colour.

    Args:
        first_depth: inverse depth of what the first view shows.
        second_depth: of what the second does.
        out: written.
    """

    def judge(first: np.ndarray, second: np.ndarray, top: int) -> None:
        rows = slice(top, top + len(first))
        _confidence_rows(first, first_depth[rows], second, second_depth[rows], ALONE, APART, DIFFERING, out[rows])

    return judge


@fast_kernel()
def _confidence_rows(first, first_rho, second, second_rho, alone, apart, differing, out):
    """Confidence of some rows.

    Args:
        first: ``(height, width, 4)`` RGB and weight.
        first_rho: its inverse depth.
        second: as ``first``.
        second_rho: as ``first_rho``.
        alone: confidence of what is fully believed but seen by one view only.
        apart: relative difference of inverse depth at which agreement has fallen to 1/e.
        differing: difference of colour (root mean square) at which it has.
        out: ``(height, width)``, written.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    for row in range(out.shape[0]):
        for col in range(out.shape[1]):
            a, b = first[row, col, 3], second[row, col, 3]
            believed = min(one, np.float32(DEPTH_CONFIDENCE_GAIN) * max(a, b))
            if a > MIN_VISIBLE_WEIGHT and b > MIN_VISIBLE_WEIGHT:
                near_a, near_b = max(first_rho[row, col], zero), max(second_rho[row, col], zero)
                gap = (near_a - near_b) / (max(near_a, near_b) * apart + np.float32(1e-9))
                squared = zero
                for k in range(3):
                    step = first[row, col, k] - second[row, col, k]
                    squared += step * step
                squared = squared / (np.float32(3.0) * differing * differing)
                out[row, col] = believed * math.exp(-gap * gap - squared)
            elif a > MIN_VISIBLE_WEIGHT or b > MIN_VISIBLE_WEIGHT:
                out[row, col] = believed * alone
            else:
                out[row, col] = zero


def low_confidence_regions(
    confidence: Float32[np.ndarray, "height width"],
) -> Float32[np.ndarray, "height width"]:
    """Smooth weights in [0, 1]: 1 where all around a pixel confidence is low. Wraps at the seam."""
    height, width = confidence.shape
    rows = min(ROWS_OF_REGIONS, height)
    coarse = cv2.resize(confidence, (2 * rows, rows), interpolation=cv2.INTER_AREA)
    wrapped = add_columns(coarse, 4)
    mean = cv2.GaussianBlur(wrapped, (5, 5), 1.0)
    doubt = np.clip((TRUSTED - mean) / (TRUSTED - DOUBTED), 0.0, 1.0).astype(np.float32)
    margin = 4 * width // (2 * rows)
    whole = cv2.resize(doubt, (width + 2 * margin, height), interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(whole[:, margin : margin + width])
