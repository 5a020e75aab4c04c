"""The blend loops, in numba: two layers become one picture, some rows at a time.

Intermediate results are kept in planar scratch rows (all reds, then all greens, …) so that LLVM vectorises the loops.
"""

import math
from typing import NamedTuple

import numpy as np

from omnisyn_cli.compute.arrays import empty
from omnisyn_cli.compute.jit import fast_kernel, fast_subkernel, inlined
from omnisyn_cli.fusion.blend_rule import FAR_WEIGHT_OFFSET, BlendRule
from omnisyn_cli.types import DEPTH_CONFIDENCE_GAIN, MIN_VISIBLE_WEIGHT, DirectionTables, Layer

# Pixels of a row that are blended together, even: 8 kB of scratch for each of two rows stay in the L1 cache.
RUN_PIXELS = 512
# ``exp(x)`` is computed as ``exp(x / 2^6)`` squared six times; the small argument makes a short series accurate.
EXP_SQUARINGS = 6
MAX_GAP = np.float32(4.0)  # normalised depth gap beyond which a hidden surface's weight is invisible: e⁻¹⁶


class LayerRows(NamedTuple):
    """Some rows of a layer."""

    colour: np.ndarray  # ``(rows, width, 4)`` RGB and weight
    inverse_depth: np.ndarray  # ``(rows, width)``; negative where nothing is seen
    offset: tuple[np.float32, np.float32, np.float32]  # position of the view in the frame of the target


class KernelRule(NamedTuple):
    """:class:`omnisyn_cli.fusion.blend_rule.BlendRule` as kernels take it."""

    t: np.float32
    disagreement: np.float32
    hidden_weight: np.float32


class Quantization(NamedTuple):
    """How colours >= 0 are written: ``min(colour, max_colour)·scale + rounding``, truncated to the array's type."""

    max_colour: np.float32
    scale: np.float32
    rounding: np.float32


def kernel_rule(rule: BlendRule) -> KernelRule:
    """The rule as kernels take it."""
    return KernelRule(np.float32(rule.t), np.float32(rule.disagreement), np.float32(rule.hidden_weight))


def quantization_for(out: np.ndarray) -> Quantization:
    """Rounding to the levels of unsigned integers; no change for floating point."""
    if out.dtype.kind == "f":
        return Quantization(np.float32(np.finfo(np.float32).max), np.float32(1.0), np.float32(0.0))
    return Quantization(np.float32(1.0), np.float32(np.iinfo(out.dtype).max), np.float32(0.5))


def source_offset(layer: Layer) -> tuple[np.float32, np.float32, np.float32]:
    """Position of a layer's view in the frame of the target, as kernels take it."""
    x, y, z = np.asarray(layer.target_from_source.position, np.float32)
    return x, y, z


@inlined(fastmath=True)
def quantize(value, quantization):
    """A colour as it is assigned to an array."""
    return min(max(value, np.float32(0.0)), quantization.max_colour) * quantization.scale + quantization.rounding


@inlined(fastmath=True)
def _inverse_distance_weight(rho, x, y, z, offset):
    """(``1 / ρ`` over ``|r − ρ·offset| / ρ``)³ by distances from target and source: ρ cancels, also at infinity."""
    dx, dy, dz = x - rho * offset[0], y - rho * offset[1], z - rho * offset[2]
    squared = dx * dx + dy * dy + dz * dz + np.float32(1e-8)  # a surface at the source itself: no division by 0
    return np.float32(1.0) / (squared * math.sqrt(squared))


@inlined(fastmath=True)
def _gaussian(gap):
    """``exp(-gap²)`` within 1e-7, without a call, so that LLVM vectorises the loop around it."""
    gap = min(max(gap, -MAX_GAP), MAX_GAP)
    x = gap * gap * np.float32(-1.0 / (1 << EXP_SQUARINGS))
    # The Taylor series of exp to x⁴: |x| is at most 16/64, so the rest is below x⁵/120 = 1e-5.
    value = np.float32(1 / 6) + x * np.float32(1 / 24)
    value = np.float32(1.0) + x * (np.float32(1.0) + x * (np.float32(1 / 2) + x * value))
    value = value * value
    value = value * value
    value = value * value
    value = value * value
    value = value * value
    return value * value


@inlined(fastmath=True)
def view_weights(weight_a, rho_a, offset_a, weight_b, rho_b, offset_b, x, y, z, rule):
    """:func:`omnisyn_cli.fusion.blend_rule.view_weights` of one pixel, without branches.

    ``weight_a`` and ``weight_b`` are those of the layers' colours, ``rho_a`` and ``rho_b`` their inverse depths from
    the target (>= 0), ``offset_a`` and ``offset_b`` the positions of their views in the frame of the target; ``x``,
    ``y``, ``z`` is the pixel's unit ray, ``rule`` a :class:`KernelRule`.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    a = weight_a * _inverse_distance_weight(rho_a, x, y, z, offset_a)
    b = weight_b * _inverse_distance_weight(rho_b, x, y, z, offset_b)
    a = a if weight_a > MIN_VISIBLE_WEIGHT else zero
    b = b if weight_b > MIN_VISIBLE_WEIGHT else zero
    gap = (rho_a - rho_b) / (max(rho_a, rho_b) * rule.disagreement + np.float32(1e-9))
    depth_confidence = min(one, np.float32(DEPTH_CONFIDENCE_GAIN) * (weight_a if gap > zero else weight_b))
    rest = one - depth_confidence * (one - max(_gaussian(gap), rule.hidden_weight))
    is_both = min(a, b) > zero
    share_a = (one - rule.t) * (rest if gap < zero else one)
    share_b = rule.t * (one if gap < zero else rest)
    return a * share_a if is_both else a, b * share_b if is_both else b


@inlined(fastmath=True)
def blend_shares(weights, rho_a, rho_b):
    """Shares of two layers by their :func:`view_weights`, and the pixel's weight for holes around it."""
    (a, b), zero, one, far_offset = weights, np.float32(0.0), np.float32(1.0), np.float32(FAR_WEIGHT_OFFSET)
    total = a + b
    smaller = min(a, b) / max(total, np.float32(1e-37))  # the larger share is 1 − smaller: exactly 1 if this is 0
    share_a = smaller if a < b else one - smaller
    share_b = one - smaller if a < b else smaller
    # Far surfaces fill holes: the weight falls with inverse depth to the fourth power, see fusion/fill.py.
    far = far_offset / (share_a * rho_a + share_b * rho_b + far_offset)
    return share_a, share_b, far * far * far * far if total > zero else zero


@fast_kernel()
def blend_rows(first, second, rule, tables, quantization, out, seen, coarse_colour, coarse_weight):
    """Blend some rows of two layers, quantise them, and halve them for the pyramid that fills holes.

    ``first`` and ``second`` are :class:`LayerRows`, ``rule`` is a :class:`KernelRule`, ``quantization`` a
    :class:`Quantization`, ``tables`` are the :class:`omnisyn_cli.types.DirectionTables` of these rows. Written are
    ``out``, ``(rows, width, 3)``, undefined in holes, where the number of rows may be odd at the end of the picture;
    ``seen``, 0 in holes, else 1; and of half the size, rounded up, ``coarse_colour`` where there is weight, and
    ``coarse_weight``, large where the surface is far.
    """
    rows, width = seen.shape
    upper, lower = empty(4 * RUN_PIXELS, np.float32), empty(4 * RUN_PIXELS, np.float32)
    first_flat, second_flat, out_flat = first.colour.reshape(-1), second.colour.reshape(-1), out.reshape(-1)
    coarse_flat, half_width = coarse_colour.reshape(-1), coarse_weight.shape[1]
    for pair in range(len(coarse_weight)):
        for left in range(0, width, RUN_PIXELS):
            right = min(left + RUN_PIXELS, width)
            for row, mixed in ((2 * pair, upper), (2 * pair + 1, lower)):
                if row == rows:
                    mixed[:] = np.float32(0.0)
                    continue
                begin, end = row * width + left, row * width + right
                a = LayerRows(first_flat[4 * begin : 4 * end], first.inverse_depth[row, left:right], first.offset)
                b = LayerRows(second_flat[4 * begin : 4 * end], second.inverse_depth[row, left:right], second.offset)
                tile_tables = DirectionTables(
                    tables.sin_p[row:], tables.cos_p[row:], tables.sin_a[left:right], tables.cos_a[left:right]
                )
                _blend_run(a, b, rule, tile_tables, mixed)
                _quantize_run(mixed, quantization, out_flat[3 * begin : 3 * end], seen[row, left:right])
                if right < left + RUN_PIXELS:  # an odd last column has no neighbour: give it an empty one
                    for number in range(4):
                        mixed[number * RUN_PIXELS + right - left] = np.float32(0.0)
            begin, end = pair * half_width + left // 2, pair * half_width + (right + 1) // 2
            half = coarse_weight[pair, left // 2 : (right + 1) // 2]
            _pull_run(upper, lower, coarse_flat[3 * begin : 3 * end], half)


@fast_kernel()
def blend_edge_pixels(first, second, rule, tables, edge_pixels, share, quantization, out):
    """Replace edge pixels by the mean of their samples, each blended by the rule; unseen samples count as the pixel.

    ``first``, ``second``: :class:`LayerRows` of both views: ``(2, samples, 4)`` and ``(2, samples)``. ``tables``:
    :class:`omnisyn_cli.types.DirectionTables` of a picture of twice the size; only rows are used. ``share`` is that of
    the mean; the rest is what the pixel was. ``out``: ``(height, width, 3)``, changed.
    """
    upper, lower = empty(4 * RUN_PIXELS, np.float32), empty(4 * RUN_PIXELS, np.float32)
    for row in range(len(edge_pixels.tile_begins)):
        begin, end = 2 * edge_pixels.tile_begins[row, 0], 2 * edge_pixels.tile_begins[row, -1]
        for left in range(begin, end, RUN_PIXELS):
            right = min(left + RUN_PIXELS, end)
            for half, mixed in ((0, upper), (1, lower)):
                double_row = 2 * (edge_pixels.top + row) + half
                a = LayerRows(
                    first.colour[half, left:right].reshape(-1), first.inverse_depth[half, left:right], first.offset
                )
                b = LayerRows(
                    second.colour[half, left:right].reshape(-1), second.inverse_depth[half, left:right], second.offset
                )
                sample_tables = DirectionTables(
                    tables.sin_p[double_row:], tables.cos_p[double_row:],
                    edge_pixels.sin_a[left:right], edge_pixels.cos_a[left:right],
                )  # fmt: skip
                _blend_run(a, b, rule, sample_tables, mixed)
            for at in range(left // 2, right // 2):
                if edge_pixels.cols[at] >= 0:
                    pixel = out[edge_pixels.top + row, edge_pixels.cols[at]]
                    _quantize_mean(upper, lower, 2 * at - left, share, quantization, pixel)


@inlined(fastmath=True)
def _quantize_mean(upper, lower, at, share, quantization, pixel):
    """Move a pixel by ``share`` towards the mean of its four samples."""
    quarter, zero = np.float32(0.25), np.float32(0.0)
    for k in range(3):
        total, own = zero, np.float32(pixel[k]) / quantization.scale
        for mixed in (upper, lower):
            for i in (at, at + 1):
                total += mixed[k * RUN_PIXELS + i] if mixed[3 * RUN_PIXELS + i] > zero else own
        pixel[k] = quantize(own + share * (quarter * total - own), quantization)


@fast_subkernel()
def _blend_run(first, second, rule, tables, mixed):
    """Blend flat pixels; ``mixed`` gets red, green, blue and fill weight, :data:`RUN_PIXELS` apart."""
    zero, sine, y = np.float32(0.0), tables.sin_p[0], tables.cos_p[0]
    a_colour, b_colour = first.colour, second.colour
    for col in range(len(first.inverse_depth)):
        x, z = sine * tables.sin_a[col], -sine * tables.cos_a[col]
        rho_a, rho_b = max(first.inverse_depth[col], zero), max(second.inverse_depth[col], zero)
        weights = view_weights(
            a_colour[4 * col + 3], rho_a, first.offset, b_colour[4 * col + 3], rho_b, second.offset, x, y, z, rule
        )
        share_a, share_b, fill_weight = blend_shares(weights, rho_a, rho_b)
        mixed[col] = max(zero, share_a * a_colour[4 * col] + share_b * b_colour[4 * col])
        mixed[RUN_PIXELS + col] = max(zero, share_a * a_colour[4 * col + 1] + share_b * b_colour[4 * col + 1])
        mixed[2 * RUN_PIXELS + col] = max(zero, share_a * a_colour[4 * col + 2] + share_b * b_colour[4 * col + 2])
        mixed[3 * RUN_PIXELS + col] = fill_weight


@fast_subkernel()
def _quantize_run(mixed, quantization, out, seen):
    """Quantise what :func:`_blend_run` wrote."""
    for col in range(len(seen)):
        out[3 * col] = quantize(mixed[col], quantization)
        out[3 * col + 1] = quantize(mixed[RUN_PIXELS + col], quantization)
        out[3 * col + 2] = quantize(mixed[2 * RUN_PIXELS + col], quantization)
        seen[col] = np.uint8(mixed[3 * RUN_PIXELS + col] > np.float32(0.0))


@inlined(fastmath=True)
def _weighted_mean_2x2(upper, lower, at, w00, w01, w10, w11):
    """Weighted sum over 2×2 pixels."""
    return w00 * upper[at] + w01 * upper[at + 1] + w10 * lower[at] + w11 * lower[at + 1]


@fast_subkernel()
def _pull_run(upper, lower, colour, weight):
    """The first pull step of :mod:`omnisyn_cli.fusion.fill`, for two runs, one above the other."""
    for col in range(len(weight)):
        at = 3 * RUN_PIXELS + 2 * col
        w00, w01, w10, w11 = upper[at], upper[at + 1], lower[at], lower[at + 1]
        total = w00 + w01 + w10 + w11
        share = np.float32(1.0) / max(total, np.float32(1e-37))
        weight[col] = total
        colour[3 * col] = share * _weighted_mean_2x2(upper, lower, 2 * col, w00, w01, w10, w11)
        colour[3 * col + 1] = share * _weighted_mean_2x2(upper, lower, RUN_PIXELS + 2 * col, w00, w01, w10, w11)
        colour[3 * col + 2] = share * _weighted_mean_2x2(upper, lower, 2 * RUN_PIXELS + 2 * col, w00, w01, w10, w11)


@inlined(fastmath=True)
def coarse_position(index, fine, coarse):
    """The coarse index before the centre of a fine pixel (it may be −1), and the fraction beyond it."""
    position = (np.float32(index) + np.float32(0.5)) * np.float32(coarse) / np.float32(fine) - np.float32(0.5)
    before = math.floor(position)
    return int(before), position - np.float32(before)


@fast_kernel()
def quantize_rows(image, levels, out, begin, end):
    """Round some rows of colours in [0, 1] to integers in [0, levels]."""
    for row in range(begin, end):
        for col in range(image.shape[1]):
            for k in range(3):
                value = min(max(image[row, col, k], np.float32(0.0)), np.float32(1.0))
                out[row, col, k] = np.int64(value * levels + np.float32(0.5))
