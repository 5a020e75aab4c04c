"""How close two pictures are on the sphere."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from omnisyn_cli.geometry.sphere import pixel_to_angles

__all__ = ["psnr", "row_weights", "ws_psnr"]

PEAK = 1.0


def row_weights(height: int) -> Float[np.ndarray, " height"]:
    """Sine of the polar angle of every row's centre: what a pixel of that row covers of the sphere, up to a factor."""
    _, polar_angle = pixel_to_angles(np.arange(height), np.zeros(height), (height, 2 * height))
    return np.asarray(np.sin(polar_angle))


def psnr(image: Float[np.ndarray, "height width 3"], truth: Float[np.ndarray, "height width 3"]) -> float:
    """Peak signal-to-noise ratio in dB for values in [0, 1]; infinite where both are the same."""
    return _decibels(float(_squared_error(image, truth).mean()))


def ws_psnr(image: Float[np.ndarray, "height width 3"], truth: Float[np.ndarray, "height width 3"]) -> float:
    """PSNR in dB with every pixel weighted by its share of the sphere.

    Source: Sun, Lu and Yu, Weighted-to-spherically-uniform quality evaluation for omnidirectional video, 2017.
    """
    rows = _squared_error(image, truth).mean(axis=(1, 2))
    weights = row_weights(len(rows))
    return _decibels(float((rows * weights).sum() / weights.sum()))


def _squared_error(image: np.ndarray, truth: np.ndarray) -> np.ndarray:
    if image.shape != truth.shape:
        raise ValueError(f"expected two pictures of one size, got {image.shape} and {truth.shape}")
    return np.asarray((image.astype(np.float64) - truth) ** 2)


def _decibels(mean_squared_error: float) -> float:
    return math.inf if mean_squared_error == 0 else 10.0 * math.log10(PEAK**2 / mean_squared_error)
