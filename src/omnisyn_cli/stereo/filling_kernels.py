# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""The fit of a plane around every pixel, see :mod:`omnisyn_cli.stereo.filling`, in numba."""

import numpy as np

from omnisyn_cli.compute.arrays import empty
from omnisyn_cli.compute.jit import kernel

NORMAL_EQUATION_TERMS = 9
"""Numbers per pixel: the upper triangle of the matrix, row after row, and the right side."""


@kernel()
def normal_equations(values, weight, directions):
    """What every pixel adds to the least-squares fit of ``normal · direction = value``.

    Args:
        values: ``(height, width)``.
        weight: of its size, >= 0.
        directions: ``(height, width, 3)`` unit vectors.

    Returns:
        ``(height, width, 9)`` float32.
    """
    height, width = values.shape
    out = empty((height, width, NORMAL_EQUATION_TERMS), np.float32)
    for row in range(height):
        for col in range(width):
            x, y, z = directions[row, col, 0], directions[row, col, 1], directions[row, col, 2]
            w = weight[row, col]
            v = w * values[row, col]
            out[row, col, 0], out[row, col, 1], out[row, col, 2] = w * x * x, w * x * y, w * x * z
            out[row, col, 3], out[row, col, 4], out[row, col, 5] = w * y * y, w * y * z, w * z * z
            out[row, col, 6], out[row, col, 7], out[row, col, 8] = v * x, v * y, v * z
    return out


@kernel()
def fitted_values(sums, fallback, directions, fallback_weight, tilt_ridge):
    """The value at every pixel of the plane that is fitted around it.

    The matrix is positive definite: along the ray by the fallback, across it by the ridge, however little is known.

    Args:
        sums: ``(height, width, 9)``, of :func:`normal_equations` around each pixel.
        fallback: ``(height, width)``, what the plane is drawn to at the pixel itself.
        directions: ``(height, width, 3)`` unit vectors.
        fallback_weight: of it, > 0.
        tilt_ridge: of a ridge against tilts, relative to the trace of the matrix.

    Returns:
        ``(height, width)`` float64.
    """
    height, width = fallback.shape
    out = empty((height, width), np.float64)
    for row in range(height):
        for col in range(width):
            x, y, z = directions[row, col, 0], directions[row, col, 1], directions[row, col, 2]
            s = sums[row, col]
            ridge = tilt_ridge * (np.float64(s[0]) + np.float64(s[3]) + np.float64(s[5])) + 1e-9
            along = fallback_weight - ridge
            m00, m01, m02 = s[0] + along * x * x + ridge, s[1] + along * x * y, s[2] + along * x * z
            m11, m12, m22 = s[3] + along * y * y + ridge, s[4] + along * y * z, s[5] + along * z * z + ridge
            drawn = fallback_weight * fallback[row, col]
            b0, b1, b2 = s[6] + drawn * x, s[7] + drawn * y, s[8] + drawn * z
            l10, l20 = m01 / m00, m02 / m00  # L·D·Lᵀ
            d1 = m11 - l10 * m01
            l21 = (m12 - l20 * m01) / d1
            d2 = m22 - l20 * m02 - l21 * l21 * d1
            b1 -= l10 * b0
            b2 -= l20 * b0 + l21 * b1
            n2 = b2 / d2
            n1 = b1 / d1 - l21 * n2
            n0 = b0 / m00 - l10 * n1 - l20 * n2
            out[row, col] = n0 * x + n1 * y + n2 * z
    return out
