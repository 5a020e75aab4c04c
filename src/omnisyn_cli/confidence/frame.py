"""How far every pixel of a frame can be relied on, and the regions where it cannot."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float32

from omnisyn_cli.confidence.kernels import confidence_rows
from omnisyn_cli.geometry.border import add_columns
from omnisyn_cli.threads import run_bands
from omnisyn_cli.types import Rendering

__all__ = ["confidence_of_frame", "doubtful_regions"]

ALONE = np.float32(0.6)
"""Confidence of what only one view shows, however well its depth is known: nothing confirms it."""

APART = np.float32(0.1)
DIFFERING = np.float32(0.15)

ROWS_OF_REGIONS = 32
DOUBTED, TRUSTED = 0.25, 0.45
"""Mean confidence up to which a region is given up, and from which on it is kept; in between gradually."""


def confidence_of_frame(
    first: Rendering, second: Rendering, threads: int | None = None
) -> Float32[np.ndarray, "height width"]:
    """Confidence in [0, 1] of every pixel that is made of two renderings, exposed alike, before they are blended.

    0 where neither view shows anything; near 1 where both show one colour at one distance and their depth is believed;
    0.6 where only one does; low where they contradict each other in distance or colour.
    """
    out = np.empty(first.inverse_depth.shape, np.float32)
    run_bands(
        lambda begin, end: confidence_rows(
            first.colour, first.inverse_depth, second.colour, second.inverse_depth, ALONE, APART, DIFFERING,
            out, begin, end,
        ),
        len(out),
        threads,
    )  # fmt: skip
    return out


def doubtful_regions(
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
