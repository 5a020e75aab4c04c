"""Fast arctangents for kernels."""

from __future__ import annotations

import math

import numpy as np

from omnisyn_cli.jit import inlined

__all__ = ["ATAN2_ERROR", "atan2_fast"]

ATAN2_ERROR = 4e-7
"""Largest error of :func:`atan2_fast` in radians, float32 rounding included."""


@inlined(fastmath=True)
def atan2_fast(y, x):
    """``atan2(y, x)`` in float32 without branches, so that loops over it are vectorised; 0 at the origin.

    Source: polynomial 4.4.49 of Abramowitz and Stegun, error 2e-8.
    """
    ax, ay = abs(x), abs(y)
    large, small = max(ax, ay), min(ax, ay)
    q = small / (large + np.float32(1e-30))
    s = q * q
    p = np.float32(0.0028662257)
    p = p * s + np.float32(-0.0161657367)
    p = p * s + np.float32(0.0429096138)
    p = p * s + np.float32(-0.0752896400)
    p = p * s + np.float32(0.1065626393)
    p = p * s + np.float32(-0.1420889944)
    p = p * s + np.float32(0.1999355085)
    p = p * s + np.float32(-0.3333314528)
    a = q + q * s * p
    a = np.float32(0.5 * math.pi) - a if ay > ax else a
    a = np.float32(math.pi) - a if x < np.float32(0.0) else a
    return -a if y < np.float32(0.0) else a
