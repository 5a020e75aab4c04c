"""What is measured, as pictures to look at: errors and depth in colours."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from omnisyn_cli.metrics.image import check_same_size

__all__ = ["ERROR_SCALE", "error_map", "nearest_shown", "turbo"]

ERROR_SCALE = 0.25
"""Mean absolute difference of the channels that has the brightest colour; fixed, so that maps can be compared."""

NEAREST_SHARE = 99.0
"""Percentile of inverse depth that has the last colour: a few stray near pixels do not darken all the others."""


def error_map(
    image: Float[np.ndarray, "height width 3"], truth: Float[np.ndarray, "height width 3"]
) -> UInt8[np.ndarray, "height width 3"]:
    """Mean difference of the channels in the Inferno colours: black 0, pale yellow :data:`ERROR_SCALE` or more.

    Args:
        image: RGB in [0, 1].
        truth: RGB in [0, 1], of the same size.

    Raises:
        ValueError: the pictures differ in size.
    """
    check_same_size(image, truth)
    error = np.abs(image.astype(np.float32) - truth).mean(axis=-1)
    return _coloured(error / ERROR_SCALE, cv2.COLORMAP_INFERNO)


def turbo(
    inverse_depth: Float[np.ndarray, "height width"], *, largest: float | None = None
) -> UInt8[np.ndarray, "height width 3"]:
    """Inverse depth in the Turbo colours: red is near, dark blue infinitely far, black unknown (negative or NaN).

    The colour is that of the square root of ``inverse_depth / largest``, so that far things differ as well.

    Args:
        inverse_depth: 1/m.
        largest: inverse depth that has the last colour; give both of two pictures that are to be compared the same.
            By default that of :func:`nearest_shown`.

    Source of the colours: Mikhailov, Turbo, an improved rainbow colormap for visualization, 2019.
    """
    known = np.nan_to_num(inverse_depth, nan=-1.0) >= 0
    largest = nearest_shown(inverse_depth) if largest is None else largest
    share = np.where(known, inverse_depth, 0.0) / largest
    coloured = _coloured(np.sqrt(np.clip(share, 0.0, 1.0)), cv2.COLORMAP_TURBO)
    return np.where(known[..., None], coloured, np.uint8(0))


def nearest_shown(inverse_depth: Float[np.ndarray, "height width"]) -> float:
    """Inverse depth, 1/m, that has the last colour: the 99th percentile of what is positive and finite, else 1."""
    positive = inverse_depth[(inverse_depth > 0) & np.isfinite(inverse_depth)]
    return float(np.percentile(positive, NEAREST_SHARE)) if positive.size else 1.0


def _coloured(share: np.ndarray, colours: int) -> np.ndarray:
    """RGB of values in [0, 1]; beyond, the last colour."""
    level = np.rint(np.clip(share, 0.0, 1.0) * 255.0).astype(np.uint8)
    return np.ascontiguousarray(cv2.applyColorMap(level, colours)[..., ::-1])
