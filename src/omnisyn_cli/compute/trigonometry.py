"""Fast arctangents and logarithms for kernels."""

import math

import numpy as np

from omnisyn_cli.compute.jit import inlined

ATAN2_ERROR = 4e-7  # largest error of :func:`atan2_fast` in radians, float32 rounding included
LOG2_ERROR = 3e-6  # largest error of :func:`log2_fast` for numbers near 1; elsewhere float32 rounding comes on top


@inlined(fastmath=True)
def atan2_fast(y, x):
    """Float32 ``atan2`` without branches, 0 at the origin. Source: Abramowitz and Stegun, 4.4.49, error 2e-8."""
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


@inlined(fastmath=True)
def log2_fast(x):
    """``log2`` of a normal positive float32: exponent bits and m + m·(1 − m)·p(m), fitted by least squares."""
    bits = np.float32(x).view(np.int32)
    exponent = np.float32((bits >> 23) - 127)
    m = np.int32((bits & 0x007FFFFF) | 0x3F800000).view(np.float32) - np.float32(1.0)
    p = np.float32(0.025285507)
    p = p * m + np.float32(-0.094814755)
    p = p * m + np.float32(0.181154206)
    p = p * m + np.float32(-0.275386214)
    p = p * m + np.float32(0.442527264)
    return exponent + m + m * (np.float32(1.0) - m) * p
