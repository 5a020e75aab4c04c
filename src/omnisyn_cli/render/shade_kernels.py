"""The loops of :mod:`omnisyn_cli.render.shade`, in numba."""

from __future__ import annotations

import math

import numpy as np

from omnisyn_cli.jit import fast_kernel, inlined
from omnisyn_cli.render.mesh import FACES_PER_QUAD
from omnisyn_cli.render.trigonometry import atan2_fast

__all__ = ["shade_rows"]

FACE_BITS = FACES_PER_QUAD.bit_length() - 1
"""A face number without these bits is its quad's."""

MAGNIFIED = 1.05
"""Texels per target pixel up to which the full resolution is read as it is."""


@fast_kernel()
def shade_rows(
    rho, face, trust, texels, layout, sin_p, cos_p, sin_a, cos_a, rotation, t, ratio, bicubic, image, begin, end
):  # fmt: skip
    """Texture lookup for target rows ``begin`` to ``end``; angles of a whole row first, so that they are vectorised."""
    width = rho.shape[1]
    ys, xs, footprint = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    y_scale, y_zero, x_scale, x_zero = _angle_to_texel(layout, 0)
    stride = np.int64(layout[0, 1])
    for row in range(begin, end):
        sp, cp = sin_p[row], cos_p[row]
        for col in range(width):
            w = max(rho[row, col], np.float32(0.0))
            x, y, z = sp * sin_a[col] - w * t[0], cp - w * t[1], -sp * cos_a[col] - w * t[2]
            dx = rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z
            dy = rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z
            dz = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z
            flat = dx * dx + dz * dz
            ys[col] = atan2_fast(math.sqrt(flat), dy) * y_scale + y_zero
            xs[col] = atan2_fast(dx, -dz) * x_scale + x_zero
            footprint[col] = ratio * ratio / (flat + dy * dy + np.float32(1e-20))
        for col in range(width):
            if rho[row, col] < 0.0:
                for k in range(4):
                    image[row, col, k] = 0.0
                continue
            if footprint[col] > MAGNIFIED * MAGNIFIED:
                _read_between_levels(texels, layout, ys[col], xs[col], footprint[col], image, row, col)
            elif bicubic:
                _read_bicubic(texels, stride, ys[col], xs[col], image, row, col)
            else:
                _read_bilinear(texels, 0, stride, ys[col], xs[col], np.float32(1.0), image, row, col)
            quad = face[row, col] >> FACE_BITS
            if quad < trust.size:  # the caps beyond have all of it
                image[row, col, 3] *= trust[quad]


@inlined(fastmath=True)
def _angle_to_texel(layout, level):
    """Scale and offset from polar angle to row and from azimuth to column of a level."""
    return (
        np.float32(layout[level, 2]), np.float32(layout[level, 3]),
        np.float32(layout[level, 4]), np.float32(layout[level, 5]),
    )  # fmt: skip


@inlined(fastmath=True)
def _read_between_levels(texels, layout, y, x, footprint, image, row, col):
    """Two mip levels, mixed by the logarithm of the texels that fall on one pixel."""
    level = min(np.float32(0.5) * math.log2(footprint), np.float32(layout.shape[0] - 1))
    finer = int(level)
    share = level - finer
    _read_level(texels, layout, finer, y, x, np.float32(1.0) - share, image, row, col)
    if share > 0.0:
        r, g, b, a = image[row, col, 0], image[row, col, 1], image[row, col, 2], image[row, col, 3]
        _read_level(texels, layout, finer + 1, y, x, share, image, row, col)
        image[row, col, 0] += r
        image[row, col, 1] += g
        image[row, col, 2] += b
        image[row, col, 3] += a


@inlined(fastmath=True)
def _read_level(texels, layout, level, y, x, weight, image, row, col):
    """A bilinear read at the place in ``level`` that has the texel coordinates (y, x) at full resolution."""
    y_scale, y_zero, x_scale, x_zero = _angle_to_texel(layout, 0)
    y_level, y_level_zero, x_level, x_level_zero = _angle_to_texel(layout, level)
    y, x = (y - y_zero) / y_scale * y_level + y_level_zero, (x - x_zero) / x_scale * x_level + x_level_zero
    _read_bilinear(texels, np.int64(layout[level, 0]), np.int64(layout[level, 1]), y, x, weight, image, row, col)


@inlined(fastmath=True)
def _read_bilinear(texels, offset, stride, y, x, weight, image, row, col):
    i, j = np.int64(y), np.int64(x)
    a, b = y - np.float32(i), x - np.float32(j)
    above = np.uint64(offset + i * stride + 4 * j)
    below = above + np.uint64(stride)
    w0, w1 = weight * (np.float32(1.0) - a), weight * a
    w00, w01, w10, w11 = w0 * (np.float32(1.0) - b), w0 * b, w1 * (np.float32(1.0) - b), w1 * b
    for k in range(4):
        n, m = np.uint64(k), np.uint64(k + 4)
        upper = w00 * texels[above + n] + w01 * texels[above + m]
        image[row, col, k] = upper + w10 * texels[below + n] + w11 * texels[below + m]


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
def _read_bicubic(texels, stride, y, x, image, row, col):
    i, j = np.int64(y), np.int64(x)
    u0, u1, u2, u3 = _cubic_weights(y - np.float32(i))
    v0, v1, v2, v3 = _cubic_weights(x - np.float32(j))
    row0 = np.uint64((i - 1) * stride + 4 * (j - 1))
    row1 = row0 + np.uint64(stride)
    row2, row3 = row1 + np.uint64(stride), row1 + np.uint64(2 * stride)
    for k in range(4):
        a, b, c, d = np.uint64(k), np.uint64(k + 4), np.uint64(k + 8), np.uint64(k + 12)
        s0 = v0 * texels[row0 + a] + v1 * texels[row0 + b] + v2 * texels[row0 + c] + v3 * texels[row0 + d]
        s1 = v0 * texels[row1 + a] + v1 * texels[row1 + b] + v2 * texels[row1 + c] + v3 * texels[row1 + d]
        s2 = v0 * texels[row2 + a] + v1 * texels[row2 + b] + v2 * texels[row2 + c] + v3 * texels[row2 + d]
        s3 = v0 * texels[row3 + a] + v1 * texels[row3 + b] + v2 * texels[row3 + c] + v3 * texels[row3 + d]
        image[row, col, k] = u0 * s0 + u1 * s1 + u2 * s2 + u3 * s3
