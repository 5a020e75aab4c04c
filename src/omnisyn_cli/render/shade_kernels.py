# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""The loops of :mod:`omnisyn_cli.render.shade`, in numba."""

from __future__ import annotations

import math

import numpy as np

from omnisyn_cli.jit import fast_kernel, inlined
from omnisyn_cli.render.mesh import FACES_PER_QUAD
from omnisyn_cli.render.simd import load, pair, splat, store_half, swapped
from omnisyn_cli.render.trigonometry import atan2_fast, log2_fast

__all__ = ["shade_rows"]

FACE_BITS = FACES_PER_QUAD.bit_length() - 1
"""A face number without these bits is its quad's."""

MAGNIFIED = 1.05
"""Texels per target pixel up to which the full resolution is read as it is."""

Y, X, LEVEL = 0, 1, 2
"""Where in the texture each pixel of a row is found: texel row and column at full resolution, and mip level."""


@fast_kernel()
def shade_rows(
    rho, face, trust, texels, layout, sin_p, cos_p, sin_a, cos_a, rotation, t, ratio, bicubic, image, begin, end
):  # fmt: skip
    """Texture lookup for target rows ``begin`` to ``end``; a texel's four channels are one half of a vector."""
    width = rho.shape[1]
    places = np.empty((3, width), np.float32)
    flat = image.reshape(-1)
    stride = np.int64(layout[0, 1])
    for row in range(begin, end):
        _find_places(rho[row], sin_p[row], cos_p[row], sin_a, cos_a, rotation, t, ratio, layout, places)
        for col in range(width):
            at = 4 * (row * width + col)
            if rho[row, col] < 0.0:
                for k in range(4):
                    flat[at + k] = 0.0
                continue
            y, x = places[Y, col], places[X, col]
            if places[LEVEL, col] > math.log2(MAGNIFIED):
                colour = _between_levels(texels, layout, y, x, places[LEVEL, col])
            elif bicubic:
                colour = _bicubic(texels, stride, y, x)
            else:
                colour = _bilinear(texels, 0, stride, y, x)
            store_half(flat, at, colour)
            quad = face[row, col] >> FACE_BITS
            if quad < trust.size and trust[quad] != 1.0:  # the caps beyond have all of it
                flat[at + 3] *= trust[quad]


@fast_kernel()
def _find_places(rho, sp, cp, sin_a, cos_a, rotation, t, ratio, layout, places):
    """Where the source sees what the pixels of a row show: at ``Rᵀ(r − ρ·t)``."""
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    t0, t1, t2 = t[0], t[1], t[2]
    y_scale, y_zero, x_scale, x_zero = _angle_to_texel(layout, 0)
    highest = np.float32(layout.shape[0] - 1)
    squared = ratio * ratio
    for col in range(len(rho)):
        w = max(rho[col], np.float32(0.0))
        x, y, z = sp * sin_a[col] - w * t0, cp - w * t1, -sp * cos_a[col] - w * t2
        dx, dy, dz = r00 * x + r10 * y + r20 * z, r01 * x + r11 * y + r21 * z, r02 * x + r12 * y + r22 * z
        flat = dx * dx + dz * dz
        places[Y, col] = atan2_fast(math.sqrt(flat), dy) * y_scale + y_zero
        places[X, col] = atan2_fast(dx, -dz) * x_scale + x_zero
        footprint = squared / (flat + dy * dy + np.float32(1e-20))
        places[LEVEL, col] = min(np.float32(0.5) * log2_fast(footprint), highest)


@inlined(fastmath=True)
def _angle_to_texel(layout, level):
    """Scale and offset from polar angle to row and from azimuth to column of a level."""
    return (
        np.float32(layout[level, 2]), np.float32(layout[level, 3]),
        np.float32(layout[level, 4]), np.float32(layout[level, 5]),
    )  # fmt: skip


@inlined(fastmath=True)
def _between_levels(texels, layout, y, x, level):
    """Two mip levels, mixed by the logarithm of the texels that fall on one pixel."""
    finer = int(level)
    share = level - np.float32(finer)
    colour = _level(texels, layout, finer, y, x)
    coarser = _level(texels, layout, min(finer + 1, layout.shape[0] - 1), y, x)
    return colour + (coarser - colour) * splat(share)


@inlined(fastmath=True)
def _level(texels, layout, level, y, x):
    """A bilinear read at the place in ``level`` that has the texel coordinates (y, x) at full resolution."""
    y_scale, y_zero, x_scale, x_zero = _angle_to_texel(layout, 0)
    y_level, y_level_zero, x_level, x_level_zero = _angle_to_texel(layout, level)
    y, x = (y - y_zero) / y_scale * y_level + y_level_zero, (x - x_zero) / x_scale * x_level + x_level_zero
    return _bilinear(texels, np.int64(layout[level, 0]), np.int64(layout[level, 1]), y, x)


@inlined(fastmath=True)
def _bilinear(texels, offset, stride, y, x):
    """Two texels side by side are one vector, those below them another."""
    i, j = np.int64(y), np.int64(x)
    b = x - np.float32(j)
    at = offset + i * stride + 4 * j
    above, below = load(texels, at), load(texels, at + stride)
    mixed = (above + (below - above) * splat(y - np.float32(i))) * pair(np.float32(1.0) - b, b)
    return mixed + swapped(mixed)


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
def _bicubic(texels, stride, y, x):
    """Four texels of each of four rows are two vectors."""
    i, j = np.int64(y), np.int64(x)
    u0, u1, u2, u3 = _cubic_weights(y - np.float32(i))
    v0, v1, v2, v3 = _cubic_weights(x - np.float32(j))
    first = (i - 1) * stride + 4 * (j - 1)
    second, third, fourth = first + stride, first + 2 * stride, first + 3 * stride
    w0, w1, w2, w3 = splat(u0), splat(u1), splat(u2), splat(u3)
    left = load(texels, first) * w0 + load(texels, second) * w1
    left = left + load(texels, third) * w2 + load(texels, fourth) * w3
    right = load(texels, first + 8) * w0 + load(texels, second + 8) * w1
    right = right + load(texels, third + 8) * w2 + load(texels, fourth + 8) * w3
    mixed = left * pair(v0, v1) + right * pair(v2, v3)
    return mixed + swapped(mixed)
