# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""The loops of :mod:`omnisyn_cli.render.shade`, in numba."""

import math

import numpy as np

from omnisyn_cli.compute.jit import fast_kernel, inlined
from omnisyn_cli.render.simd import (
    FIXED_ONE,
    FIXED_TEXEL,
    fetch,
    four_weights,
    load_texel_pairs,
    load_texels,
    one_weight,
    store_sum,
)
from omnisyn_cli.render.trigonometry import atan2_fast, log2_fast

__all__ = ["FINER", "SPECIAL"]

MAGNIFIED = 1.1
"""Texels per target pixel up to which the full resolution is read as it is."""

AHEAD = 32
"""Pixels after the one that is read for which the processor is to bring texels near."""

RUN = 256
"""Pixels of a row whose places are found together: they stay in the nearest cache."""

FINER = np.float32(0.5)
"""Mip levels: reading between the texels of a level blurs by itself, so one that is so much finer is read.

Below the first level it is that share of the level, so that this sets in where the photograph is no longer magnified.
Ray-traced scenes with true depth at the size of the photographs gain 0.2 dB (SSIM 0.002), at half of it 1.7 dB (0.018).
"""

SPECIAL = (np.float32(1.0) - FINER) * np.float32(math.log2(MAGNIFIED))
"""Mip level above which a pixel is not simply read at full resolution."""

HOLE, FULL = np.int32(-2), np.int32(-1)
"""A pixel that sees nothing, and one that is read at full resolution; others are known by the finer of two levels."""

ALMOST = np.float32(1e-3)
"""The last mip level is always read together with the one before it, even where only so little of that is left."""

LEVEL, Y, X, Z = 0, 1, 2, 3
"""Numbers per pixel of a row: mip level, texel row and column at full resolution, and room for one more on the way."""


@fast_kernel()
def shade_rows(
    rho, trust, trust_layout, texels, layout, weights, sin_p, cos_p, sin_a, cos_a, rotation, t, ratio, image,
    begin, end,
):  # fmt: skip
    """Texture lookup for target rows ``begin`` to ``end``; a texel's four channels are a quarter of a vector.

    Trust is that of the quarter of a quad that a texture coordinate lies in: ``trust_layout`` takes texel rows and
    columns to those of ``trust``. Without any ``trust`` it is 1. ``weights`` are the tables of
    :func:`omnisyn_cli.render.texture.cubic_weights` for these texels.
    """
    width, flat, source = rho.shape[1], image.reshape(-1), (trust, trust_layout, texels, layout, weights)
    view, room = (rotation, t, ratio), _room_for_runs(layout, weights[1])
    for row in range(begin, end):
        for left in range(0, width, RUN):
            right = min(left + RUN, width)
            _shade_run(
                rho[row, left:right], source, sin_p[row], cos_p[row], sin_a[left:right], cos_a[left:right], view,
                room, flat, 4 * (row * width + left),
            )  # fmt: skip


@fast_kernel()
def shade_edge_pixels(
    rho, edge_pixels, trust, trust_layout, texels, layout, weights, sin_p, cos_p, rotation, t, ratio, colour
):  # fmt: skip
    """The same for the samples of spots; ``sin_p`` and ``cos_p`` are of all rows of a target of twice the size."""
    source, view = (trust, trust_layout, texels, layout, weights), (rotation, t, ratio)
    room = _room_for_runs(layout, weights[1])
    for row in range(len(edge_pixels.begins)):
        begin, end = 2 * edge_pixels.begins[row, 0], 2 * edge_pixels.begins[row, -1]
        for half in range(2):
            flat, double_row = colour[half].reshape(-1), 2 * (edge_pixels.top + row) + half
            for left in range(begin, end, RUN):
                right = min(left + RUN, end)
                _shade_run(
                    rho[half, left:right], source, sin_p[double_row], cos_p[double_row], edge_pixels.sin_a[left:right],
                    edge_pixels.cos_a[left:right], view, room, flat, 4 * left,
                )  # fmt: skip


@inlined(fastmath=True)
def _room_for_runs(layout, cubic):
    """Memory for what is found out about a run, and what does not depend on it."""
    levels = layout.shape[0]
    return (
        np.zeros((4, RUN), np.float32), np.empty(RUN, np.int32), np.ones(RUN, np.float32),
        np.empty((3, RUN), np.int32), np.empty((levels, RUN), np.int32), np.empty(levels * 4 * RUN, cubic.dtype),
        np.empty(levels, np.bool_), layout[:, 0].astype(np.int64), layout[:, 1].astype(np.int64),
        _levels_from_full(layout),
    )  # fmt: skip


@inlined(fastmath=True)
def _shade_run(rho, source, sp, cp, sin_a, cos_a, view, room, flat, first):
    """Up to :data:`RUN` pixels of a row, written to ``flat`` from ``first`` on."""
    if not _is_any(rho):
        flat[first : first + 4 * len(rho)] = np.float32(0.0)
        return
    trust, trust_layout, texels, layout, weights = source
    places, kinds, trusted, fractions, index, shares, has_level, starts, strides, factors = room
    scales = _scales(weights[1], np.float32(layout[0, 6]))
    _find_places(rho, sp, cp, sin_a, cos_a, view, layout, places, kinds)
    if len(trust) > 0:
        _find_trust(places, trust, trust_layout, trusted, len(rho))
    has_cubic, has_level[:], left = False, False, 0
    while left < len(rho):
        kind, right = kinds[left], left + _count_same(kinds[left : len(rho)])
        some = flat[first + 4 * left : first + 4 * right]
        if kind == HOLE:
            some[:] = np.float32(0.0)
        elif kind == FULL:
            if not has_cubic:
                _find_fractions(places, strides[0], len(weights[1]) // 4 - 1, fractions)
                has_cubic = True
            _read_full(texels, strides[0], weights, fractions[:, left:right], scales, trusted[left:right], some)
        else:
            _prepare_levels(places, kind, strides, factors, np.float32(weights[1][1]), has_level, index, shares)
            finer, own = np.int64(kind), shares[4 * (RUN * np.int64(kind) + left) :]
            _read_levels(
                texels, starts, strides, finer, index[finer : finer + 2, left:right], own, scales,
                trusted[left:right], some,
            )  # fmt: skip
        left = right


@inlined()
def _is_any(rho):
    """Whether any pixel of a run sees something."""
    return rho.max() >= np.float32(0.0)


@inlined()
def _count_same(kinds):
    """How many at the beginning are the same."""
    for k in range(len(kinds)):
        if kinds[k] != kinds[0]:
            return k
    return len(kinds)


@inlined(fastmath=True)
def _scales(cubic, unit):
    """What sums of texels are multiplied by, and what is added, after one product each and after two.

    Products of integers are cut off, by half a part on average.
    """
    one, zero = np.float32(cubic[1]), np.float32(0.0)
    if one == np.float32(1.0):
        return unit, zero, unit, zero
    once = unit * np.float32(65536.0 / FIXED_ONE / FIXED_TEXEL)
    twice = once * np.float32(65536.0 / FIXED_ONE)
    return once, np.float32(8 * 0.5) * once, twice, np.float32(4 * (0.5 + 0.25)) * twice


@inlined(fastmath=True)
def _find_places(rho, sp, cp, sin_a, cos_a, view, layout, places, kinds):
    """Where the source sees what the pixels of a row show, and how it is read."""
    rotation, t, ratio = view
    find_directions(rho, sp, cp, sin_a, cos_a, rotation, t, places)
    _find_texels(places, layout, len(rho))
    squared, highest = ratio * ratio, np.float32(layout.shape[0] - 1) - ALMOST
    _find_kinds(rho, places, squared, highest, kinds)


@fast_kernel()
def find_directions(rho, sp, cp, sin_a, cos_a, rotation, t, places):
    """``Rᵀ(r − ρ·t)`` of the pixels of a row, and its square."""
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    t0, t1, t2 = t[0], t[1], t[2]
    for col in range(len(rho)):
        w = max(rho[col], np.float32(0.0))
        x, y, z = sp * sin_a[col] - w * t0, cp - w * t1, -sp * cos_a[col] - w * t2
        dx, dy, dz = r00 * x + r10 * y + r20 * z, r01 * x + r11 * y + r21 * z, r02 * x + r12 * y + r22 * z
        places[X, col], places[Y, col], places[Z, col] = dx, dy, dz
        places[LEVEL, col] = dx * dx + dy * dy + dz * dz


@fast_kernel()
def _find_texels(places, layout, count):
    """Rows and columns at full resolution that directions lie at, one after the other: constants stay in registers."""
    scale, zero = np.float32(layout[0, 2]), np.float32(layout[0, 3])
    for col in range(count):
        dx, dz = places[X, col], places[Z, col]
        places[Y, col] = atan2_fast(math.sqrt(dx * dx + dz * dz), places[Y, col]) * scale + zero
    scale, zero = np.float32(layout[0, 4]), np.float32(layout[0, 5])
    for col in range(count):
        places[X, col] = atan2_fast(places[X, col], -places[Z, col]) * scale + zero


@fast_kernel()
def _find_kinds(rho, places, squared, highest, kinds):
    """Mip levels from squares of distances, and how pixels are read by them."""
    for col in range(len(rho)):
        level = np.float32(0.5) * log2_fast(squared / (places[LEVEL, col] + np.float32(1e-20)))
        level = min(max((np.float32(1.0) - FINER) * level, level - FINER), highest)
        places[LEVEL, col] = level
        kind = np.int32(level) if level > SPECIAL else FULL
        kinds[col] = kind if rho[col] >= 0.0 else HOLE


@fast_kernel()
def _find_trust(places, trust, trust_layout, trusted, count):
    """Trust in the quarter at each texture coordinate, from an image of quarters with a border."""
    row_scale, row_zero, col_scale, col_zero = trust_layout[0], trust_layout[1], trust_layout[2], trust_layout[3]
    stride = np.int32(trust_layout[4])
    for k in range(count):
        row, col = np.int32(places[Y, k] * row_scale + row_zero), np.int32(places[X, k] * col_scale + col_zero)
        trusted[k] = trust[np.int32(row * stride) + col]


@fast_kernel()
def _find_fractions(places, stride, parts, fractions):
    """For a whole run, the second texel of the second row that is read, and which weights rows and columns have."""
    texels_a_row, parts = np.int32(stride // 4), np.float32(parts)
    ys, xs, index, down, across = places[Y], places[X], fractions[0], fractions[1], fractions[2]
    for col in range(RUN):
        i, j = np.int32(ys[col]), np.int32(xs[col])
        index[col] = np.int32(i * texels_a_row) + j
        down[col] = np.int32((ys[col] - np.float32(i)) * parts + np.float32(0.5))
        across[col] = np.int32((xs[col] - np.float32(j)) * parts + np.float32(0.5))


@inlined(fastmath=True)
def _read_full(texels, stride, weights, fractions, scales, trusted, flat):
    """Four texels of each of four rows, weighted, for some pixels of a run."""
    (of_rows, of_columns), (_, _, scale, shift) = weights, scales
    index, down, across = fractions[0], fractions[1], fractions[2]
    for k in range(len(trusted)):
        at, row = 4 * np.int64(index[k]) - stride - 4, 4 * np.int64(down[k])
        fetch(texels, 4 * np.int64(index[min(k + AHEAD, len(trusted) - 1)]) + 2 * stride)
        mixed = load_texels(texels, at) * one_weight(of_rows, row)
        mixed = mixed + load_texels(texels, at + stride) * one_weight(of_rows, row + 1)
        mixed = mixed + load_texels(texels, at + 2 * stride) * one_weight(of_rows, row + 2)
        mixed = mixed + load_texels(texels, at + 3 * stride) * one_weight(of_rows, row + 3)
        mixed = mixed * four_weights(of_columns, 4 * np.int64(across[k]))
        store_sum(flat, 4 * k, mixed, scale, shift, trusted[k])


@inlined(fastmath=True)
def _levels_from_full(layout):
    """Per level, scale and offset from texel rows and columns at full resolution to those of the level."""
    factors = np.empty((layout.shape[0], 4), np.float32)
    for level in range(layout.shape[0]):
        for axis in range(0, 4, 2):
            scale = layout[level, 2 + axis] / layout[0, 2 + axis]
            factors[level, axis] = scale
            factors[level, axis + 1] = layout[level, 3 + axis] - layout[0, 3 + axis] * scale
    return factors


@fast_kernel()
def _prepare_levels(places, finer, strides, factors, whole, has_level, index, shares):
    """What reading two levels takes, unless the run has it already."""
    for level in range(finer, finer + 2):
        if not has_level[level]:
            some = shares[4 * RUN * level : 4 * RUN * (level + 1)]
            _find_bilinear(places, level, strides[level], factors[level], whole, index[level], some)
            has_level[level] = True


@fast_kernel()
def _find_bilinear(places, level, stride, factors, whole, index, shares):
    """For a whole run, the first texel in a mip level, and the weights of two by two: above first.

    These are multiplied by the weight of the level: ``whole`` where it is what is wanted, 0 at the next ones.
    """
    texels_a_row, one, zero = np.int32(stride // 4), np.float32(1.0), np.float32(0.0)
    y_scale, y_zero, x_scale, x_zero = factors[0], factors[1], factors[2], factors[3]
    for col in range(RUN):
        y, x = places[Y, col] * y_scale + y_zero, places[X, col] * x_scale + x_zero
        i, j = np.int32(y), np.int32(x)
        index[col] = np.int32(i * texels_a_row) + j
        share, across = whole * max(one - abs(places[LEVEL, col] - np.float32(level)), zero), x - np.float32(j)
        below = share * (y - np.float32(i))
        above, below_right = share - below, below * across
        above_right = above * across
        shares[4 * col], shares[4 * col + 1] = above - above_right, above_right
        shares[4 * col + 2], shares[4 * col + 3] = below - below_right, below_right


@inlined(fastmath=True)
def _read_levels(texels, starts, strides, finer, index, shares, scales, trusted, flat):
    """Two by two texels of each of two mip levels, weighted, for some pixels of a run."""
    scale, shift, _, _ = scales
    start, next_start, stride, next_stride = starts[finer], starts[finer + 1], strides[finer], strides[finer + 1]
    for k in range(len(trusted)):
        at, below = start + 4 * np.int64(index[0, k]), next_start + 4 * np.int64(index[1, k])
        fetch(texels, start + 4 * np.int64(index[0, min(k + AHEAD, len(trusted) - 1)]) + stride)
        mixed = load_texel_pairs(texels, at, at + stride) * four_weights(shares, 4 * k)
        mixed = mixed + load_texel_pairs(texels, below, below + next_stride) * four_weights(shares, 4 * (RUN + k))
        store_sum(flat, 4 * k, mixed, scale, shift, trusted[k])
