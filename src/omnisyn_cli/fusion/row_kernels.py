# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""The loops that fuse some rows at a time, rounded to 8 bits, in numba: :mod:`omnisyn_cli.fusion.kernels`, but faster.

What is found out about the pixels of a row is kept number by number, so that loops over them become loops of vectors.
"""

from __future__ import annotations

import math

import numpy as np

from omnisyn_cli.fusion.kernels import FAR_PREFERENCE
from omnisyn_cli.jit import fast_kernel, inlined
from omnisyn_cli.types import BELIEF, UNSEEN

__all__ = ["blend_samples", "push_samples"]

RUN = 512
"""Pixels of a row that are blended together: what is found out about them stays in the nearest cache."""

STEPS = 6
"""A power of e is the square of the square … of another one, so many times; that one is close to 1."""

MOST_GAP = np.float32(4.0)
"""Beyond it nothing is left of a hidden surface's weight that could be seen: e⁻¹⁶."""


@inlined(fastmath=True)
def _nearness(rho, x, y, z, t0, t1, t2):
    """(Distance from the target / distance from the source) of what is seen, cubed."""
    dx, dy, dz = x - rho * t0, y - rho * t1, z - rho * t2
    squared = dx * dx + dy * dy + dz * dz + np.float32(1e-8)
    return np.float32(1.0) / (squared * math.sqrt(squared))


@inlined(fastmath=True)
def _falling(gap):
    """``exp(-gap²)``, relatively within 1e-4, without a call, so that the loop around it becomes one of vectors."""
    gap = min(max(gap, -MOST_GAP), MOST_GAP)
    x = gap * gap * np.float32(-1.0 / (1 << STEPS))
    value = np.float32(1 / 6) + x * np.float32(1 / 24)
    value = np.float32(1.0) + x * (np.float32(1.0) + x * (np.float32(1 / 2) + x * value))
    value = value * value
    value = value * value
    value = value * value
    value = value * value
    value = value * value
    return value * value


@fast_kernel()
def _blend_run(
    first, first_rho, first_offset, second, second_rho, second_offset, t, disagreement, hidden, sp, y, sin_a, cos_a,
    mixed,
):  # fmt: skip
    """Red, green, blue and weight of some pixels of a row, each :data:`RUN` numbers apart in ``mixed``.

    Colours are flat, four numbers for each pixel: steps that are known make vectors possible.
    """
    zero, one, far_preference = np.float32(0.0), np.float32(1.0), np.float32(FAR_PREFERENCE)
    a0, a1, a2 = first_offset[0], first_offset[1], first_offset[2]
    b0, b1, b2 = second_offset[0], second_offset[1], second_offset[2]
    for col in range(len(first_rho)):
        x, z = sp * sin_a[col], -sp * cos_a[col]
        near_a, near_b = max(first_rho[col], zero), max(second_rho[col], zero)
        worth_a, worth_b = first[4 * col + 3], second[4 * col + 3]
        a = worth_a * _nearness(near_a, x, y, z, a0, a1, a2)
        b = worth_b * _nearness(near_b, x, y, z, b0, b1, b2)
        a = a if worth_a > UNSEEN else zero
        b = b if worth_b > UNSEEN else zero
        gap = (near_a - near_b) / (max(near_a, near_b) * disagreement + np.float32(1e-9))
        believed = min(one, np.float32(BELIEF) * (worth_a if gap > zero else worth_b))
        rest = one - believed * (one - max(_falling(gap), hidden))
        seen_by_both = min(a, b) > zero
        share_a = (one - t) * (rest if gap < zero else one)
        share_b = t * (one if gap < zero else rest)
        a = a * share_a if seen_by_both else a
        b = b * share_b if seen_by_both else b
        total = a + b
        smaller = min(a, b) / max(total, np.float32(1e-37))  # the larger share is 1 minus this: 1 if the other is 0
        share_a = smaller if a < b else one - smaller
        share_b = one - smaller if a < b else smaller
        far = far_preference / (share_a * near_a + share_b * near_b + far_preference)
        mixed[col] = max(zero, share_a * first[4 * col] + share_b * second[4 * col])
        mixed[RUN + col] = max(zero, share_a * first[4 * col + 1] + share_b * second[4 * col + 1])
        mixed[2 * RUN + col] = max(zero, share_a * first[4 * col + 2] + share_b * second[4 * col + 2])
        mixed[3 * RUN + col] = far * far * far * far if total > zero else zero


@fast_kernel()
def blend_samples(
    first, first_rho, first_offset, second, second_rho, second_offset, t, disagreement, hidden,
    sin_p, cos_p, sin_a, cos_a, samples, seen, holes, coarse_colour, coarse_weight, begin, end,
):  # fmt: skip
    """``blend_rows``, rounded to 8 bits, and the first step of ``pull``, in one pass over the renderings.

    Args:
        first: ``(height, width, 4)`` RGB and worth; height and width are even.
        first_rho: its inverse depth.
        first_offset: position of its source in the target's frame.
        second: as ``first``.
        second_rho: as ``first_rho``.
        second_offset: as ``first_offset``.
        t: share of the way.
        disagreement: see :class:`omnisyn_cli.fusion.options.BlendOptions`.
        hidden: likewise.
        sin_p: direction tables.
        cos_p: likewise.
        sin_a: likewise.
        cos_a: likewise.
        samples: ``(height, width, 3)`` uint8, written; of no meaning in holes.
        seen: ``(height, width)`` uint8, written: 0 in holes, else 1.
        holes: by pair of rows, written: how many pixels are holes.
        coarse_colour: ``(height / 2, width / 2, 3)``, written.
        coarse_weight: ``(height / 2, width / 2)``, written.
        begin: first pair of rows.
        end: the pair after the last.
    """
    width = samples.shape[1]
    upper, lower = np.empty(4 * RUN, np.float32), np.empty(4 * RUN, np.float32)
    first_flat, second_flat, samples_flat = first.reshape(-1), second.reshape(-1), samples.reshape(-1)
    coarse_flat = coarse_colour.reshape(-1)
    for pair in range(begin, end):
        filled = 0
        for left in range(0, width, RUN):
            right = min(left + RUN, width)
            for row, mixed in ((2 * pair, upper), (2 * pair + 1, lower)):
                begins, ends = row * width + left, row * width + right
                _blend_run(
                    first_flat[4 * begins : 4 * ends], first_rho[row, left:right], first_offset,
                    second_flat[4 * begins : 4 * ends], second_rho[row, left:right], second_offset,
                    t, disagreement, hidden,
                    sin_p[row], cos_p[row], sin_a[left:right], cos_a[left:right], mixed,
                )  # fmt: skip
                filled += _store_samples(mixed, samples_flat[3 * begins : 3 * ends], seen[row, left:right])
            begins, ends = (pair * width + left) // 2, (pair * width + right) // 2
            half = coarse_weight[pair, left // 2 : right // 2]
            _pull_run(upper, lower, coarse_flat[3 * begins : 3 * ends], half)
        holes[pair] = 2 * width - filled


@inlined(fastmath=True)
def _sample(value):
    """A number as one of 256 levels, rounded."""
    return np.uint8(np.int32(min(max(value, np.float32(0.0)), np.float32(1.0)) * np.float32(255.0) + np.float32(0.5)))


@fast_kernel()
def _store_samples(mixed, samples, seen):
    """What :func:`_blend_run` found, rounded; answers how many of the pixels are no holes."""
    filled = np.int32(0)
    for col in range(len(seen)):
        samples[3 * col] = _sample(mixed[col])
        samples[3 * col + 1] = _sample(mixed[RUN + col])
        samples[3 * col + 2] = _sample(mixed[2 * RUN + col])
        is_seen = np.uint8(mixed[3 * RUN + col] > np.float32(0.0))
        seen[col] = is_seen
        filled += np.int32(is_seen)
    return filled


@inlined(fastmath=True)
def _mean(upper, lower, at, w00, w01, w10, w11):
    """Two by two numbers by their weights; the sum."""
    return w00 * upper[at] + w01 * upper[at + 1] + w10 * lower[at] + w11 * lower[at + 1]


@fast_kernel()
def _pull_run(upper, lower, colour, weight):
    """``pull`` for the pixels of two runs, one above the other; a hole's colour is finite there."""
    for col in range(len(weight)):
        at = 3 * RUN + 2 * col
        w00, w01, w10, w11 = upper[at], upper[at + 1], lower[at], lower[at + 1]
        total = w00 + w01 + w10 + w11
        share = np.float32(1.0) / max(total, np.float32(1e-37))
        weight[col] = total
        colour[3 * col] = share * _mean(upper, lower, 2 * col, w00, w01, w10, w11)
        colour[3 * col + 1] = share * _mean(upper, lower, RUN + 2 * col, w00, w01, w10, w11)
        colour[3 * col + 2] = share * _mean(upper, lower, 2 * RUN + 2 * col, w00, w01, w10, w11)


@fast_kernel()
def push_samples(coarse_colour, coarse_weight, samples, seen, holes, begin, end):
    """``push`` into the samples of the finest level, for pairs of rows ``begin`` to ``end``."""
    width = samples.shape[1]
    coarse_height, coarse_width = coarse_weight.shape
    for pair in range(begin, end):
        if holes[pair] == 0:
            continue
        for row in range(2 * pair, 2 * pair + 2):
            i2 = max(pair - 1, 0) if row == 2 * pair else min(pair + 1, coarse_height - 1)
            for col in range(width):
                if seen[row, col]:
                    continue
                j = col // 2
                j2 = (j - 1 if col % 2 == 0 else j + 1) % coarse_width
                a, b = np.float32(0.5625) * coarse_weight[pair, j], np.float32(0.1875) * coarse_weight[pair, j2]
                c, d = np.float32(0.1875) * coarse_weight[i2, j], np.float32(0.0625) * coarse_weight[i2, j2]
                total = a + b + c + d
                share = np.float32(1.0) / total if total > np.float32(0.0) else np.float32(0.0)
                for k in range(3):
                    mixed = a * coarse_colour[pair, j, k] + b * coarse_colour[pair, j2, k]
                    mixed += c * coarse_colour[i2, j, k] + d * coarse_colour[i2, j2, k]
                    samples[row, col, k] = _sample(mixed * share)
