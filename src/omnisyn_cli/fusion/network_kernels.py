"""The loops around the fusion network, in numba."""

from __future__ import annotations

import math

import numpy as np

from omnisyn_cli.fusion.kernels import view_weights
from omnisyn_cli.jit import fast_kernel, inlined
from omnisyn_cli.types import UNSEEN

__all__ = ["DIFFERENT", "LEAST_SHARE", "PLAIN", "colour_holes", "compare_rows", "correct_rows", "reduce_rows"]

PLAIN, DIFFERENT = np.float32(0.01), np.float32(0.06)
"""Root mean square of the difference of two colours up to which it does not matter which of them is shown, and from
which on all of a correction counts."""

ALIKE = np.float32(0.5)
"""Difference of the log-ratios of weights at which a coarse pixel counts half for a fine one."""

LEAST_SHARE = np.float32(1e-9)

FAINT = np.float32(1e-4)
"""Share of coarse pixels that have anything to say below which a fine pixel stays as it is."""


@inlined(fastmath=True)
def _relevance(red, green, blue):
    """How much of a correction counts where two colours differ by this: from 0 (they are alike) to 1, smooth."""
    third = np.float32(1.0) / np.float32(3.0)
    difference = math.sqrt((red * red + green * green + blue * blue) * third)
    x = min(np.float32(1.0), max(np.float32(0.0), (difference - PLAIN) / (DIFFERENT - PLAIN)))
    return x * x * (np.float32(3.0) - np.float32(2.0) * x)


@inlined(fastmath=True)
def _log_ratio(a, b):
    """log(a / b) of two positive weights, bounded where one of them is next to nothing."""
    return np.float32(math.log((a + LEAST_SHARE * b) / (b + LEAST_SHARE * a)))


@fast_kernel()
def reduce_rows(colour, rho, coarse, coarse_rho, begin, end):
    """A rendering at a smaller size: means over blocks of what is seen, by its worth, for coarse rows.

    Args:
        colour: ``(height, width, 4)`` RGB and worth.
        rho: inverse depth.
        coarse: ``(rows, cols, 4)`` with ``rows <= height``, written: RGB in [0, 1]; the mean of the worth, what is not
            seen being worth nothing. All of it 0 where nothing is seen.
        coarse_rho: written; −1 where nothing is seen.
        begin: first coarse row.
        end: the row after the last.
    """
    height, width = rho.shape
    rows, cols = coarse_rho.shape
    zero, one = np.float32(0.0), np.float32(1.0)
    for i in range(begin, end):
        top, bottom = i * height // rows, (i + 1) * height // rows
        for j in range(cols):
            left, right = j * width // cols, (j + 1) * width // cols
            red = green = blue = near = total = zero
            for row in range(top, bottom):
                for col in range(left, right):
                    worth = colour[row, col, 3]
                    if worth > UNSEEN:
                        red += worth * colour[row, col, 0]
                        green += worth * colour[row, col, 1]
                        blue += worth * colour[row, col, 2]
                        near += worth * max(rho[row, col], zero)
                        total += worth
            worth = total / np.float32((bottom - top) * (right - left))
            if worth > UNSEEN:
                coarse[i, j, 0] = min(one, max(zero, red / total))
                coarse[i, j, 1] = min(one, max(zero, green / total))
                coarse[i, j, 2] = min(one, max(zero, blue / total))
                coarse[i, j, 3] = worth
                coarse_rho[i, j] = near / total
            else:
                for k in range(4):
                    coarse[i, j, k] = zero
                coarse_rho[i, j] = -one


@fast_kernel()
def compare_rows(
    first, first_rho, first_offset, second, second_rho, second_offset, t, disagreement, hidden,
    sin_p, cos_p, sin_a, cos_a, log_ratio, gap, relevance, begin, end,
):  # fmt: skip
    """What two views say about each other, for rows ``begin`` to ``end``; renderings and rule as in ``blend_rows``.

    Written, all ``(height, width)``: ``log_ratio``, log(weight of the first / weight of the second), and ``gap``, the
    difference of inverse depth in units of the disagreement, both 0 unless both views see; ``relevance``, from 0 to 1,
    whether it matters which view is shown: 1 in holes, 0 where only one view sees.
    """
    zero, one, tiny = np.float32(0.0), np.float32(1.0), np.float32(1e-9)
    for row in range(begin, end):
        sp, y = sin_p[row], cos_p[row]
        for col in range(first_rho.shape[1]):
            x, z = sp * sin_a[col], -sp * cos_a[col]
            near_a, near_b = max(first_rho[row, col], zero), max(second_rho[row, col], zero)
            a, b = view_weights(
                first[row, col, 3], near_a, first_offset, second[row, col, 3], near_b, second_offset,
                x, y, z, t, disagreement, hidden,
            )  # fmt: skip
            if a > zero and b > zero:
                log_ratio[row, col] = _log_ratio(a, b)
                gap[row, col] = (near_a - near_b) / (max(near_a, near_b) * disagreement + tiny)
                relevance[row, col] = _relevance(
                    first[row, col, 0] - second[row, col, 0],
                    first[row, col, 1] - second[row, col, 1],
                    first[row, col, 2] - second[row, col, 2],
                )
            else:
                log_ratio[row, col] = gap[row, col] = zero
                relevance[row, col] = one if a + b == zero else zero


@inlined(fastmath=True)
def _neighbours(index, fine, coarse):
    """The coarse pixel before the centre of a fine one (it may be −1), and how far the centre lies beyond it."""
    position = (np.float32(index) + np.float32(0.5)) * np.float32(coarse) / np.float32(fine) - np.float32(0.5)
    before = math.floor(position)
    return int(before), position - np.float32(before)


@fast_kernel()
def correct_rows(
    first, first_rho, first_offset, second, second_rho, second_offset, t, disagreement, hidden,
    sin_p, cos_p, sin_a, cos_a, correction, log_ratio, both, image, begin, end,
):  # fmt: skip
    """Correct a blend where it matters which of the views is shown, for rows ``begin`` to ``end``.

    Renderings and rule are as in ``blend_rows``, which made the ``image`` that is changed in place. The ``correction``
    ``(rows, cols)`` is added to the log-ratio of the weights. It is carried from coarse pixels that both views see
    (``both`` is 1), the more the more alike the weights are there (``log_ratio``, from ``compare_rows``): edges stay
    where the fine renderings have them.
    """
    height, width = first_rho.shape
    rows, cols = correction.shape
    zero, one, half = np.float32(0.0), np.float32(1.0), np.float32(0.5)
    for row in range(begin, end):
        sp, y = sin_p[row], cos_p[row]
        i, down = _neighbours(row, height, rows)
        upper, lower = max(i, 0), min(i + 1, rows - 1)
        for col in range(width):
            if not (first[row, col, 3] > UNSEEN and second[row, col, 3] > UNSEEN):
                continue
            counts = _relevance(
                first[row, col, 0] - second[row, col, 0],
                first[row, col, 1] - second[row, col, 1],
                first[row, col, 2] - second[row, col, 2],
            )
            if counts == zero:
                continue
            x, z = sp * sin_a[col], -sp * cos_a[col]
            a, b = view_weights(
                first[row, col, 3], max(first_rho[row, col], zero), first_offset,
                second[row, col, 3], max(second_rho[row, col], zero), second_offset,
                x, y, z, t, disagreement, hidden,
            )  # fmt: skip
            if not (a > zero and b > zero):
                continue
            ratio = _log_ratio(a, b)
            j, right = _neighbours(col, width, cols)
            left, beyond = j % cols, (j + 1) % cols
            total = value = zero
            for corner in range(4):
                r, c = upper if corner < 2 else lower, left if corner % 2 == 0 else beyond
                share = (one - down if corner < 2 else down) * (one - right if corner % 2 == 0 else right)
                unlike = (log_ratio[r, c] - ratio) / ALIKE
                share *= both[r, c] / (one + unlike * unlike)
                total += share
                value += share * correction[r, c]
            if total < FAINT or value == zero:
                continue
            factor = np.float32(math.exp(half * counts * value / total))
            share_a = a * factor / (a * factor + b / factor)
            share_b = one - share_a
            for k in range(3):
                image[row, col, k] = max(zero, share_a * first[row, col, k] + share_b * second[row, col, k])


@fast_kernel()
def colour_holes(weight, colours, holes, strength, image, begin, end):
    """Add to what holes were filled with, for rows ``begin`` to ``end``.

    Args:
        weight: ``(height, width)``; 0 in holes.
        colours: ``(3, rows, cols)`` to be added.
        holes: ``(rows, cols)`` 1 where neither view sees anything, else 0; holes finer than that stay as they are.
        strength: how much of the colours is added, from 0 to 1.
        image: ``(height, width, 3)``, changed in place, never below 0.
        begin: first row.
        end: the row after the last.
    """
    height, width = weight.shape
    rows, cols = holes.shape
    zero, one = np.float32(0.0), np.float32(1.0)
    for row in range(begin, end):
        i, down = _neighbours(row, height, rows)
        upper, lower = max(i, 0), min(i + 1, rows - 1)
        for col in range(width):
            if weight[row, col] > zero:
                continue
            j, right = _neighbours(col, width, cols)
            left, beyond = j % cols, (j + 1) % cols
            total = red = green = blue = zero
            for corner in range(4):
                r, c = upper if corner < 2 else lower, left if corner % 2 == 0 else beyond
                share = (one - down if corner < 2 else down) * (one - right if corner % 2 == 0 else right)
                share *= holes[r, c]
                total += share
                red += share * colours[0, r, c]
                green += share * colours[1, r, c]
                blue += share * colours[2, r, c]
            if total < FAINT:
                continue
            scale = strength / total
            image[row, col, 0] = max(zero, image[row, col, 0] + scale * red)
            image[row, col, 1] = max(zero, image[row, col, 1] + scale * green)
            image[row, col, 2] = max(zero, image[row, col, 2] + scale * blue)
