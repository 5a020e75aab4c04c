"""The loops of fusion, in numba."""

from __future__ import annotations

import math

import numpy as np

from omnisyn_cli.jit import fast_kernel, inlined
from omnisyn_cli.types import BELIEF, UNSEEN

__all__ = ["FAR_PREFERENCE", "blend_rows", "pull", "push", "quantize_rows", "view_weights"]

FAR_PREFERENCE = 0.01
"""1/metre added before inverse depths are compared in a hole: what is a hundred metres away is as good as infinity."""


@inlined(fastmath=True)
def _nearness(rho, x, y, z, t):
    """(Distance from the target / distance from the source) of what is seen, cubed."""
    dx, dy, dz = x - rho * t[0], y - rho * t[1], z - rho * t[2]
    squared = dx * dx + dy * dy + dz * dz + np.float32(1e-8)
    return np.float32(1.0) / (squared * math.sqrt(squared))


@inlined(fastmath=True)
def view_weights(
    worth_a, near_a, first_offset, worth_b, near_b, second_offset, x, y, z, t, disagreement, hidden
):  # fmt: skip
    """Weights of what two views show along the direction ``(x, y, z)``, not normalised; 0 for a view that shows none.

    Args:
        worth_a: of the first's colour.
        near_a: the first's inverse depth from the target, >= 0.
        first_offset: its position in the frame of the target.
        worth_b: of the second's colour.
        near_b: as ``near_a``.
        second_offset: as ``first_offset``.
        x: of a unit vector, as ``y`` and ``z``.
        y: upwards.
        z: backwards.
        t: share of the way.
        disagreement: relative difference of inverse depth at which the farther surface has lost most of its weight.
        hidden: the least share of its weight that it keeps.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    a = worth_a * _nearness(near_a, x, y, z, first_offset)
    b = worth_b * _nearness(near_b, x, y, z, second_offset)
    a = a if worth_a > UNSEEN else zero
    b = b if worth_b > UNSEEN else zero
    if a > zero and b > zero:
        a, b = (one - t) * a, t * b
        gap = (near_a - near_b) / (max(near_a, near_b) * disagreement + np.float32(1e-9))
        believed = worth_a if gap > zero else worth_b
        believed = min(one, np.float32(BELIEF) * believed)
        rest = one - believed * (one - max(math.exp(-gap * gap), hidden))
        a, b = (a * rest, b) if gap < zero else (a, b * rest)
    return a, b


@fast_kernel()
def blend_rows(
    first, first_rho, first_offset, second, second_rho, second_offset, t, disagreement, hidden,
    sin_p, cos_p, sin_a, cos_a, image, weight, begin, end,
):  # fmt: skip
    """Weighted mean of two renderings; ``weight`` is 0 in holes, elsewhere large where the surface is far."""
    width = image.shape[1]
    zero, one = np.float32(0.0), np.float32(1.0)
    for row in range(begin, end):
        sp, y = sin_p[row], cos_p[row]
        for col in range(width):
            x, z = sp * sin_a[col], -sp * cos_a[col]
            rho_a, rho_b = first_rho[row, col], second_rho[row, col]
            near_a, near_b = max(rho_a, zero), max(rho_b, zero)
            a, b = view_weights(
                first[row, col, 3], near_a, first_offset, second[row, col, 3], near_b, second_offset,
                x, y, z, t, disagreement, hidden,
            )  # fmt: skip
            total = a + b
            if total > zero:
                smaller = min(a, b) / total  # the larger share is 1 minus this: exactly 1 where the other is 0
                share_a, share_b = (smaller, one - smaller) if a < b else (one - smaller, smaller)
                for k in range(3):
                    image[row, col, k] = max(zero, share_a * first[row, col, k] + share_b * second[row, col, k])
                far = np.float32(FAR_PREFERENCE) / (share_a * near_a + share_b * near_b + np.float32(FAR_PREFERENCE))
                weight[row, col] = far * far * far * far
            else:
                weight[row, col] = zero


@fast_kernel()
def pull(colour, weight, coarse_colour, coarse_weight, begin, end):
    """Weighted means over 2×2 pixels, for coarse rows ``begin`` to ``end``; an odd last row or column stands alone.

    Colours without weight are not read: they may be anything, NaN included.
    """
    height, width = weight.shape
    for row in range(begin, end):
        for col in range(coarse_weight.shape[1]):
            r = g = b = total = np.float32(0.0)
            for i in range(2 * row, min(2 * row + 2, height)):
                for j in range(2 * col, min(2 * col + 2, width)):
                    w = weight[i, j]
                    if w > 0.0:
                        r += w * colour[i, j, 0]
                        g += w * colour[i, j, 1]
                        b += w * colour[i, j, 2]
                        total += w
            coarse_weight[row, col] = total
            if total > 0.0:
                coarse_colour[row, col, 0] = r / total
                coarse_colour[row, col, 1] = g / total
                coarse_colour[row, col, 2] = b / total


@fast_kernel()
def push(coarse_colour, coarse_weight, colour, weight, keep_weight, begin, end):
    """Holes of rows ``begin`` to ``end`` get the coarse colours, bilinearly and by weight; rows end at the poles.

    A filled pixel's own weight, for the next finer level, is the mean of those it was filled from unless
    ``keep_weight``.
    """
    width = weight.shape[1]
    coarse_height, coarse_width = coarse_weight.shape
    for row in range(begin, end):
        i = row // 2
        i2 = max(i - 1, 0) if row % 2 == 0 else min(i + 1, coarse_height - 1)
        for col in range(width):
            if weight[row, col] > 0.0:
                continue
            j = col // 2
            j2 = (j - 1 if col % 2 == 0 else j + 1) % coarse_width
            a, b = np.float32(0.5625) * coarse_weight[i, j], np.float32(0.1875) * coarse_weight[i, j2]
            c, d = np.float32(0.1875) * coarse_weight[i2, j], np.float32(0.0625) * coarse_weight[i2, j2]
            total = a + b + c + d
            if total > 0.0:
                for k in range(3):
                    mixed = a * coarse_colour[i, j, k] + b * coarse_colour[i, j2, k]
                    mixed += c * coarse_colour[i2, j, k] + d * coarse_colour[i2, j2, k]
                    colour[row, col, k] = mixed / total
            else:
                for k in range(3):
                    colour[row, col, k] = np.float32(0.0)
            if not keep_weight:
                weight[row, col] = np.float32(0.25) * total


@fast_kernel()
def quantize_rows(image, levels, out, begin, end):
    """Numbers in [0, 1] as integers in [0, levels], rounded."""
    for row in range(begin, end):
        for col in range(image.shape[1]):
            for k in range(3):
                value = min(max(image[row, col, k], np.float32(0.0)), np.float32(1.0))
                out[row, col, k] = np.int64(value * levels + np.float32(0.5))
