"""The transfer function of sRGB pictures: what is stored against how much light it stands for.

Source: IEC 61966-2-1:1999, section 5.2.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

__all__ = ["linear_from_stored", "stored_from_linear"]

LINEAR_PART = 0.04045
SLOPE = 12.92
OFFSET = 0.055
GAMMA = 2.4


def linear_from_stored(value: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Light of stored values >= 0: 1 is white, brighter values go on along the same curve."""
    power = ((np.maximum(value, LINEAR_PART) + OFFSET) / (1.0 + OFFSET)) ** GAMMA
    return np.asarray(np.where(value <= LINEAR_PART, value / SLOPE, power))


def stored_from_linear(light: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """The inverse of :func:`linear_from_stored`, for light >= 0."""
    bright = LINEAR_PART / SLOPE
    power = (1.0 + OFFSET) * np.maximum(light, bright) ** (1.0 / GAMMA) - OFFSET
    return np.asarray(np.where(light <= bright, light * SLOPE, power))
