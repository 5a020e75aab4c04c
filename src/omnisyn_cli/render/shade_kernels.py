"""The loops of :mod:`omnisyn_cli.render.shade`, in numba."""

from __future__ import annotations

import math

import numpy as np

from omnisyn_cli.jit import fast_kernel, inlined
from omnisyn_cli.render.mesh import FACES_PER_QUAD
from omnisyn_cli.render.trigonometry import atan2_fast

__all__ = ["shade_rows"]

MAGNIFIED = 1.05
"""Texels per target pixel up to which the full resolution is read as it is."""


@fast_kernel()
def shade_rows(rho, face, trust, texels, layout, sin_p, cos_p, sin_a, cos_a, rotation, t, ratio, bicubic, image, begin, end):
    """Texture lookup for target rows ``begin`` to ``end``; angles of a whole row first, so that they are vectorised."""
    width = rho.shape[1]
    polar, azimuth, footprint = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    for row in range(begin, end):
        sp, cp = sin_p[row], cos_p[row]
        for col in range(width):
            w = max(rho[row, col], np.float32(0.0))
            x, y, z = sp * sin_a[col] - w * t[0], cp - w * t[1], -sp * cos_a[col] - w * t[2]
            dx = rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z
            dy = rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z
            dz = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z
            flat = dx * dx + dz * dz
            polar[col] = atan2_fast(math.sqrt(flat), dy)
            azimuth[col] = atan2_fast(dx, -dz)
            footprint[col] = ratio * ratio / (flat + dy * dy + np.float32(1e-20))
        for col in range(width):
            if rho[row, col] < 0.0:
                for k in range(4):
                    image[row, col, k] = 0.0
            elif footprint[col] > MAGNIFIED * MAGNIFIED:
                _read_between_levels(texels, layout, polar[col], azimuth[col], footprint[col], image, row, col)
            elif bicubic:
                _read_bicubic(texels, layout, polar[col], azimuth[col], image, row, col)
            else:
                _read_bilinear(texels, layout, 0, polar[col], azimuth[col], np.float32(1.0), image, row, col)
            image[row, col, 3] *= _trust_of(face[row, col], trust)


@inlined(fastmath=True)
def _trust_of(face, trust):
    """Trust in the quad of a face; caps have all of it."""
    quad = face // FACES_PER_QUAD
    return trust[quad // trust.shape[1], quad % trust.shape[1]] if 0 <= quad < trust.size else np.float32(1.0)


@inlined(fastmath=True)
def _read_between_levels(texels, layout, polar, azimuth, footprint, image, row, col):
    """Two mip levels, mixed by the logarithm of the texels that fall on one pixel."""
    level = min(np.float32(0.5) * math.log2(footprint), np.float32(layout.shape[0] - 1))
    finer = int(level)
    share = level - finer
    _read_bilinear(texels, layout, finer, polar, azimuth, np.float32(1.0) - share, image, row, col)
    if share > 0.0:
        r, g, b, a = image[row, col, 0], image[row, col, 1], image[row, col, 2], image[row, col, 3]
        _read_bilinear(texels, layout, finer + 1, polar, azimuth, share, image, row, col)
        image[row, col, 0] += r
        image[row, col, 1] += g
        image[row, col, 2] += b
        image[row, col, 3] += a


@inlined(fastmath=True)
def _texel(layout, level, polar, azimuth):
    """Index of the upper left texel and the fractions to the next ones."""
    y = polar * np.float32(layout[level, 2]) + np.float32(layout[level, 3])
    x = azimuth * np.float32(layout[level, 4]) + np.float32(layout[level, 5])
    i, j = np.int64(y), np.int64(x)
    return np.int64(layout[level, 0]) + i * np.int64(layout[level, 1]) + 4 * j, y - i, x - j


@inlined(fastmath=True)
def _read_bilinear(texels, layout, level, polar, azimuth, weight, image, row, col):
    at, a, b = _texel(layout, level, polar, azimuth)
    below = at + np.int64(layout[level, 1])
    w0, w1 = weight * (np.float32(1.0) - a), weight * a
    w00, w01, w10, w11 = w0 * (np.float32(1.0) - b), w0 * b, w1 * (np.float32(1.0) - b), w1 * b
    for k in range(4):
        upper = w00 * texels[np.uint64(at + k)] + w01 * texels[np.uint64(at + 4 + k)]
        image[row, col, k] = upper + w10 * texels[np.uint64(below + k)] + w11 * texels[np.uint64(below + 4 + k)]


@inlined(fastmath=True)
def _cubic_weights(x):
    """Catmull-Rom weights at offsets −1, 0, 1, 2 of a fraction in [0, 1)."""
    half = np.float32(0.5)
    x2 = x * x
    x3 = x2 * x
    return (
        half * (np.float32(2.0) * x2 - x3 - x),
        half * (np.float32(3.0) * x3 - np.float32(5.0) * x2 + np.float32(2.0)),
        half * (np.float32(4.0) * x2 - np.float32(3.0) * x3 + x),
        half * (x3 - x2),
    )


@inlined(fastmath=True)
def _read_bicubic(texels, layout, polar, azimuth, image, row, col):
    at, a, b = _texel(layout, 0, polar, azimuth)
    stride = np.int64(layout[0, 1])
    u0, u1, u2, u3 = _cubic_weights(a)
    v0, v1, v2, v3 = _cubic_weights(b)
    row0, row1, row2, row3 = np.uint64(at - stride - 4), np.uint64(at - 4), np.uint64(at + stride - 4), np.uint64(at + 2 * stride - 4)
    for k in range(4):
        n = np.uint64(k)
        one, two, three = np.uint64(4), np.uint64(8), np.uint64(12)
        s0 = v0 * texels[row0 + n] + v1 * texels[row0 + n + one] + v2 * texels[row0 + n + two] + v3 * texels[row0 + n + three]
        s1 = v0 * texels[row1 + n] + v1 * texels[row1 + n + one] + v2 * texels[row1 + n + two] + v3 * texels[row1 + n + three]
        s2 = v0 * texels[row2 + n] + v1 * texels[row2 + n + one] + v2 * texels[row2 + n + two] + v3 * texels[row2 + n + three]
        s3 = v0 * texels[row3 + n] + v1 * texels[row3 + n + one] + v2 * texels[row3 + n + two] + v3 * texels[row3 + n + three]
        image[row, col, k] = u0 * s0 + u1 * s1 + u2 * s2 + u3 * s3
