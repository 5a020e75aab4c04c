"""The loops that make one picture of two renderings, some rows at a time, in numba.

What is found out about the pixels of a row is kept number by number, so that loops over them become loops of vectors.
"""

import math
from typing import NamedTuple

import numpy as np

from omnisyn_cli.compute.jit import fast_kernel, inlined
from omnisyn_cli.fusion.blend_rule import FAR_WEIGHT_OFFSET, BlendRule
from omnisyn_cli.types import DEPTH_CONFIDENCE_GAIN, MIN_VISIBLE_WEIGHT, Layer

__all__ = ["blend_rows", "quantization_for", "quantize_rows"]

RUN = 512
"""Pixels of a row that are blended together, an even number: what is found out stays in the nearest cache."""

STEPS = 6
"""A power of e is the square of the square … of another one, so many times; that one is close to 1."""

MOST_GAP = np.float32(4.0)
"""Beyond it nothing is left of a hidden surface's weight that could be seen: e⁻¹⁶."""


class LayerRows(NamedTuple):
    """Some rows of a rendering: ``(rows, width, 4)`` RGB and weight; inverse depth; where its view is, three numbers.

    The position is in the frame of the target.
    """

    colour: np.ndarray
    inverse_depth: np.ndarray
    offset: tuple[np.float32, np.float32, np.float32]


class Rule(NamedTuple):
    """:class:`omnisyn_cli.fusion.blend_rule.BlendRule` as kernels take it."""

    t: np.float32
    disagreement: np.float32
    hidden: np.float32


class Tables(NamedTuple):
    """Of directions, see :func:`omnisyn_cli.geometry.sphere.direction_tables`; for the rows of a kernel."""

    sin_p: np.ndarray
    cos_p: np.ndarray
    sin_a: np.ndarray
    cos_a: np.ndarray


class Quantization(NamedTuple):
    """How numbers >= 0 become samples: at most ``most``, times ``scale``, plus ``half``; then cut off."""

    most: np.float32
    scale: np.float32
    half: np.float32


def rule_of(rule: BlendRule) -> Rule:
    """The rule as kernels take it."""
    return Rule(np.float32(rule.t), np.float32(rule.disagreement), np.float32(rule.hidden))


def quantization_for(out: np.ndarray) -> Quantization:
    """Rounded to the levels of integers, unchanged as floating-point numbers."""
    if out.dtype.kind == "f":
        return Quantization(np.float32(np.finfo(np.float32).max), np.float32(1.0), np.float32(0.0))
    return Quantization(np.float32(1.0), np.float32(np.iinfo(out.dtype).max), np.float32(0.5))


def offset_of(view: Layer) -> tuple[np.float32, np.float32, np.float32]:
    """Position of a view in the frame of the target, as kernels take it."""
    x, y, z = np.asarray(view.target_from_source.position, np.float32)
    return x, y, z


@inlined(fastmath=True)
def stored(value, storing):
    """A number as it is assigned to a sample."""
    return min(max(value, np.float32(0.0)), storing.most) * storing.scale + storing.half


@inlined(fastmath=True)
def _nearness(rho, x, y, z, offset):
    """(Distance from the target / distance from the source) of what is seen, cubed."""
    dx, dy, dz = x - rho * offset[0], y - rho * offset[1], z - rho * offset[2]
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


@inlined(fastmath=True)
def view_weights(weight_a, near_a, offset_a, weight_b, near_b, offset_b, x, y, z, rule):
    """:func:`omnisyn_cli.fusion.blend_rule.view_weights` of one pixel, all branches chosen without a jump.

    Args:
        weight_a: of the first's colour.
        near_a: the first's inverse depth from the target, >= 0.
        offset_a: its position in the frame of the target.
        weight_b: of the second's colour.
        near_b: as ``near_a``.
        offset_b: as ``offset_a``.
        x: of a unit vector, as ``y`` and ``z``.
        y: upwards.
        z: backwards.
        rule: at a place of the way.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    a = weight_a * _nearness(near_a, x, y, z, offset_a)
    b = weight_b * _nearness(near_b, x, y, z, offset_b)
    a = a if weight_a > MIN_VISIBLE_WEIGHT else zero
    b = b if weight_b > MIN_VISIBLE_WEIGHT else zero
    gap = (near_a - near_b) / (max(near_a, near_b) * rule.disagreement + np.float32(1e-9))
    believed = min(one, np.float32(DEPTH_CONFIDENCE_GAIN) * (weight_a if gap > zero else weight_b))
    rest = one - believed * (one - max(_falling(gap), rule.hidden))
    is_both = min(a, b) > zero
    share_a = (one - rule.t) * (rest if gap < zero else one)
    share_b = rule.t * (one if gap < zero else rest)
    return a * share_a if is_both else a, b * share_b if is_both else b


@fast_kernel()
def blend_rows(first, second, rule, tables, storing, out, seen, coarse_colour, coarse_weight):
    """Blend some rows of two renderings, store them, and join them in twos for the pyramid that fills holes.

    Args:
        first: :class:`LayerRows` of the first view.
        second: of the second view.
        rule: :class:`Rule`.
        tables: :class:`Tables`.
        storing: :class:`Quantization`.
        out: ``(rows, width, 3)`` samples, written; of no meaning in holes. An odd number of rows ends the picture.
        seen: ``(rows, width)`` uint8, written: 0 in holes, else 1.
        coarse_colour: ``(half of rows, half of width, 3)``, written where there is weight, halves being rounded up.
        coarse_weight: of these, written; much where the surface is far.
    """
    rows, width = seen.shape
    upper, lower = np.empty(4 * RUN, np.float32), np.empty(4 * RUN, np.float32)
    first_flat, second_flat, out_flat = first.colour.reshape(-1), second.colour.reshape(-1), out.reshape(-1)
    coarse_flat, half_width = coarse_colour.reshape(-1), coarse_weight.shape[1]
    for pair in range(len(coarse_weight)):
        for left in range(0, width, RUN):
            right = min(left + RUN, width)
            for row, mixed in ((2 * pair, upper), (2 * pair + 1, lower)):
                if row == rows:
                    mixed[:] = np.float32(0.0)
                    continue
                begin, end = row * width + left, row * width + right
                a = LayerRows(first_flat[4 * begin : 4 * end], first.inverse_depth[row, left:right], first.offset)
                b = LayerRows(second_flat[4 * begin : 4 * end], second.inverse_depth[row, left:right], second.offset)
                some = Tables(
                    tables.sin_p[row:], tables.cos_p[row:], tables.sin_a[left:right], tables.cos_a[left:right]
                )
                _blend_run(a, b, rule, some, mixed)
                _store_run(mixed, storing, out_flat[3 * begin : 3 * end], seen[row, left:right])
                if right < left + RUN:  # an odd last column stands alone
                    for number in range(4):
                        mixed[number * RUN + right - left] = np.float32(0.0)
            begin, end = pair * half_width + left // 2, pair * half_width + (right + 1) // 2
            half = coarse_weight[pair, left // 2 : (right + 1) // 2]
            _pull_run(upper, lower, coarse_flat[3 * begin : 3 * end], half)


@fast_kernel()
def blend_edge_pixels(first, second, rule, tables, edge_pixels, share, storing, out):
    """Give some pixels the means of their samples, blended one by one; samples that see nothing keep the pixel's own.

    Args:
        first: :class:`LayerRows` of the first view: ``(2, samples, 4)`` and ``(2, samples)``.
        second: of the second view.
        rule: :class:`Rule`.
        tables: :class:`Tables`, of which those of rows: of all rows of a picture of twice the size.
        spots: :class:`omnisyn_cli.types.EdgePixels`.
        share: of the mean; the rest is what the pixel was.
        storing: :class:`Quantization`.
        out: ``(height, width, 3)`` samples, changed.
    """
    upper, lower = np.empty(4 * RUN, np.float32), np.empty(4 * RUN, np.float32)
    for row in range(len(edge_pixels.begins)):
        begin, end = 2 * edge_pixels.begins[row, 0], 2 * edge_pixels.begins[row, -1]
        for left in range(begin, end, RUN):
            right = min(left + RUN, end)
            for half, mixed in ((0, upper), (1, lower)):
                double_row = 2 * (edge_pixels.top + row) + half
                a = LayerRows(
                    first.colour[half, left:right].reshape(-1), first.inverse_depth[half, left:right], first.offset
                )
                b = LayerRows(
                    second.colour[half, left:right].reshape(-1), second.inverse_depth[half, left:right], second.offset
                )
                some = Tables(
                    tables.sin_p[double_row:], tables.cos_p[double_row:],
                    edge_pixels.sin_a[left:right], edge_pixels.cos_a[left:right],
                )  # fmt: skip
                _blend_run(a, b, rule, some, mixed)
            for at in range(left // 2, right // 2):
                if edge_pixels.cols[at] >= 0:
                    _store_mean(upper, lower, 2 * at - left, share, storing, out[edge_pixels.top + row, edge_pixels.cols[at]])


@inlined(fastmath=True)
def _store_mean(upper, lower, at, share, storing, pixel):
    """The mean of four samples, and of what the pixel was, as that pixel."""
    quarter, zero = np.float32(0.25), np.float32(0.0)
    for k in range(3):
        total, own = zero, np.float32(pixel[k]) / storing.scale
        for mixed in (upper, lower):
            for i in (at, at + 1):
                total += mixed[k * RUN + i] if mixed[3 * RUN + i] > zero else own
        pixel[k] = stored(own + share * (quarter * total - own), storing)


@fast_kernel()
def _blend_run(first, second, rule, tables, mixed):
    """Red, green, blue and weight of some pixels of a row, each :data:`RUN` numbers apart in ``mixed``.

    Colours are flat, four numbers for each pixel: steps that are known make vectors possible.
    """
    zero, one, far_preference = np.float32(0.0), np.float32(1.0), np.float32(FAR_WEIGHT_OFFSET)
    sine, y = tables.sin_p[0], tables.cos_p[0]
    a_colour, b_colour = first.colour, second.colour
    for col in range(len(first.inverse_depth)):
        x, z = sine * tables.sin_a[col], -sine * tables.cos_a[col]
        near_a, near_b = max(first.inverse_depth[col], zero), max(second.inverse_depth[col], zero)
        a, b = view_weights(
            a_colour[4 * col + 3], near_a, first.offset, b_colour[4 * col + 3], near_b, second.offset, x, y, z, rule
        )
        total = a + b
        smaller = min(a, b) / max(total, np.float32(1e-37))  # the larger share is 1 minus this: 1 if the other is 0
        share_a = smaller if a < b else one - smaller
        share_b = one - smaller if a < b else smaller
        far = far_preference / (share_a * near_a + share_b * near_b + far_preference)
        mixed[col] = max(zero, share_a * a_colour[4 * col] + share_b * b_colour[4 * col])
        mixed[RUN + col] = max(zero, share_a * a_colour[4 * col + 1] + share_b * b_colour[4 * col + 1])
        mixed[2 * RUN + col] = max(zero, share_a * a_colour[4 * col + 2] + share_b * b_colour[4 * col + 2])
        mixed[3 * RUN + col] = far * far * far * far if total > zero else zero


@fast_kernel()
def _store_run(mixed, storing, out, seen):
    """What :func:`_blend_run` found, as samples."""
    for col in range(len(seen)):
        out[3 * col] = stored(mixed[col], storing)
        out[3 * col + 1] = stored(mixed[RUN + col], storing)
        out[3 * col + 2] = stored(mixed[2 * RUN + col], storing)
        seen[col] = np.uint8(mixed[3 * RUN + col] > np.float32(0.0))


@inlined(fastmath=True)
def _mean(upper, lower, at, w00, w01, w10, w11):
    """Two by two numbers by their weights; the sum."""
    return w00 * upper[at] + w01 * upper[at + 1] + w10 * lower[at] + w11 * lower[at + 1]


@fast_kernel()
def _pull_run(upper, lower, colour, weight):
    """The first step of pulling (:mod:`omnisyn_cli.fusion.fill`) for the pixels of two runs, one above the other."""
    for col in range(len(weight)):
        at = 3 * RUN + 2 * col
        w00, w01, w10, w11 = upper[at], upper[at + 1], lower[at], lower[at + 1]
        total = w00 + w01 + w10 + w11
        share = np.float32(1.0) / max(total, np.float32(1e-37))
        weight[col] = total
        colour[3 * col] = share * _mean(upper, lower, 2 * col, w00, w01, w10, w11)
        colour[3 * col + 1] = share * _mean(upper, lower, RUN + 2 * col, w00, w01, w10, w11)
        colour[3 * col + 2] = share * _mean(upper, lower, 2 * RUN + 2 * col, w00, w01, w10, w11)


@inlined(fastmath=True)
def neighbours(index, fine, coarse):
    """The coarse pixel before the centre of a fine one (it may be −1), and how far the centre lies beyond it."""
    position = (np.float32(index) + np.float32(0.5)) * np.float32(coarse) / np.float32(fine) - np.float32(0.5)
    before = math.floor(position)
    return int(before), position - np.float32(before)


@fast_kernel()
def quantize_rows(image, levels, out, begin, end):
    """Numbers in [0, 1] as integers in [0, levels], rounded."""
    for row in range(begin, end):
        for col in range(image.shape[1]):
            for k in range(3):
                value = min(max(image[row, col, k], np.float32(0.0)), np.float32(1.0))
                out[row, col, k] = np.int64(value * levels + np.float32(0.5))
