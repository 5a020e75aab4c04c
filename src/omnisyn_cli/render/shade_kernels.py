# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""The loops of :mod:`omnisyn_cli.render.shade`, in numba: texture lookup, one run of a row at a time.

A run goes through its steps in scratch arrays that stay in the L1 cache: texture coordinates and mip levels of all
pixels first, then the reads, in stretches of pixels that are read in the same way.
"""

import math
from typing import NamedTuple

import numpy as np

from omnisyn_cli.compute.arrays import empty, zeros
from omnisyn_cli.compute.jit import fast_kernel, fast_subkernel, inlined
from omnisyn_cli.compute.trigonometry import atan2_fast, log2_fast
from omnisyn_cli.render.simd import (
    FIXED_POINT_UNIT,
    FIXED_TEXEL,
    broadcast_weight,
    load_four_weights,
    load_texel_pairs,
    load_texels,
    prefetch,
    store_texel_sum,
)

# Texels per target pixel up to which the full resolution is read by itself, bicubically. Set by hand.
MAX_FULL_RESOLUTION_RATIO = 1.1
PREFETCH_PIXELS = 32  # how many pixels ahead texels are prefetched into the cache. Set by hand.
# Pixels of a row that go through the steps together: their scratch arrays stay in the L1 cache. Set by hand.
RUN_PIXELS = 256
# Mip levels by which a finer level is read, because bilinear reads blur by themselves. Below the first level the bias
# is that share of the level, so that it sets in where the photograph is no longer magnified. Ray-traced scenes with
# true depth at the size of the photographs gain 0.2 dB (SSIM 0.002), at half of it 1.7 dB (0.018).
MIP_BIAS = np.float32(0.5)
# The biased mip level that belongs to :data:`MAX_FULL_RESOLUTION_RATIO`.
MAX_FULL_RESOLUTION_LEVEL = (np.float32(1.0) - MIP_BIAS) * np.float32(math.log2(MAX_FULL_RESOLUTION_RATIO))
# How a pixel is read: not at all, or at full resolution; other pixels have the finer one of their two mip levels.
HOLE, FULL_RESOLUTION = np.int32(-2), np.int32(-1)
# Keeps levels below the last one, so that a coarser one can always be read; it gets no visible weight.
LEVEL_MARGIN = np.float32(1e-3)
# Rows of the coordinates: mip level, texel row and column at full resolution, and one for directions.
LEVEL, Y, X, Z = 0, 1, 2, 3


class TextureArrays(NamedTuple):
    """A photograph and the confidence in its surface, as kernels take them."""

    confidence: np.ndarray  # of the quarters of quads, row after row; empty where all of it is 1
    confidence_layout: np.ndarray  # see :class:`omnisyn_cli.render.shade.ConfidenceMap`
    texels: np.ndarray  # see :class:`omnisyn_cli.render.texture.Texture`
    layout: np.ndarray  # likewise
    # of :func:`omnisyn_cli.render.texture.cubic_weights` for these texels, of rows and of columns
    weights: tuple[np.ndarray, np.ndarray]


class SourceView(NamedTuple):
    """Where a source is seen from."""

    rotation: np.ndarray  # of the target's frame from the source's
    position: np.ndarray  # in the target's frame
    texels_per_pixel: np.float32  # of the texture at full resolution, per pixel of the target


class _Scratch(NamedTuple):
    """Scratch arrays for the runs of one thread, and what does not depend on the run."""

    coordinates: np.ndarray  # ``(4, run)``, see :data:`LEVEL`
    modes: np.ndarray  # how each pixel is read
    confidences: np.ndarray  # of each pixel
    fractions: np.ndarray  # ``(3, run)`` for bicubic reads: texel index, and which weights rows and columns have
    indices: np.ndarray  # ``(levels, run)`` for reads of mip levels: first texel
    shares: np.ndarray  # four bilinear weights of each pixel, level after level
    has_level: np.ndarray  # which levels of the two above are filled in for this run
    starts: np.ndarray  # offset of each level in the texels
    strides: np.ndarray  # numbers per row of each level
    factors: np.ndarray  # ``(levels, 4)`` from texel rows and columns at full resolution to those of each level


@fast_kernel()
def shade_rows(texture, view, rho, tables, image, begin, end):
    """Texture lookup for rows ``begin`` to ``end``; a texel's four channels are a quarter of a vector.

    ``texture``: :class:`TextureArrays`. ``view``: :class:`SourceView`. ``rho`` ``(height, width)``: inverse depth from
    the target; negative where nothing is seen. ``tables``: :class:`omnisyn_cli.types.DirectionTables` of these rows.
    ``image`` ``(height, width, 4)``, written: RGB, and alpha times confidence.
    """
    width, flat = rho.shape[1], image.reshape(-1)
    scratch = _new_scratch(texture.layout, texture.weights[1])
    for row in range(begin, end):
        sp, cp = tables.sin_p[row], tables.cos_p[row]
        for left in range(0, width, RUN_PIXELS):
            right = min(left + RUN_PIXELS, width)
            _shade_run(
                rho[row, left:right], texture, sp, cp, tables.sin_a[left:right], tables.cos_a[left:right], view,
                scratch, flat, 4 * (row * width + left),
            )  # fmt: skip


@fast_kernel()
def shade_edge_pixels(rho, edge_pixels, texture, sin_p, cos_p, view, colour):
    """The same for the samples of edge pixels: ``rho`` ``(2, samples)``, ``colour`` ``(2, samples, 4)``, written.

    ``sin_p``, ``cos_p``: of all rows of a target of twice the size, as is that of ``view``.
    """
    scratch = _new_scratch(texture.layout, texture.weights[1])
    for row in range(len(edge_pixels.tile_begins)):
        begin, end = 2 * edge_pixels.tile_begins[row, 0], 2 * edge_pixels.tile_begins[row, -1]
        for half in range(2):
            flat, double_row = colour[half].reshape(-1), 2 * (edge_pixels.top + row) + half
            for left in range(begin, end, RUN_PIXELS):
                right = min(left + RUN_PIXELS, end)
                _shade_run(
                    rho[half, left:right], texture, sin_p[double_row], cos_p[double_row],
                    edge_pixels.sin_a[left:right], edge_pixels.cos_a[left:right], view, scratch, flat, 4 * left,
                )  # fmt: skip


@inlined(fastmath=True)
def _new_scratch(layout, cubic):
    levels, confidences = layout.shape[0], empty(RUN_PIXELS, np.float32)
    confidences[:] = np.float32(1.0)
    return _Scratch(
        zeros((4, RUN_PIXELS), np.float32), empty(RUN_PIXELS, np.int32), confidences,
        empty((3, RUN_PIXELS), np.int32), empty((levels, RUN_PIXELS), np.int32),
        empty(levels * 4 * RUN_PIXELS, cubic.dtype), empty(levels, np.bool_), layout[:, 0].astype(np.int64),
        layout[:, 1].astype(np.int64), _levels_from_full(layout),
    )  # fmt: skip


@inlined(fastmath=True)
def _shade_run(rho, texture, sp, cp, sin_a, cos_a, view, scratch, flat, first):
    """Shade up to :data:`RUN_PIXELS` pixels of a row, given their inverse depth ``rho``.

    ``texture`` is a :class:`TextureArrays`, ``view`` a :class:`SourceView`, ``scratch`` a :class:`_Scratch`. ``sp`` and
    ``cp`` are sine and cosine of the polar angle of the row, ``sin_a`` and ``cos_a`` those of the azimuths of the
    pixels, which are written into ``flat`` from index ``first`` on.
    """
    if not _is_any(rho):
        flat[first : first + 4 * len(rho)] = np.float32(0.0)
        return
    texels, weights, coordinates, modes = texture.texels, texture.weights, scratch.coordinates, scratch.modes
    confidences, fractions, indices, shares = scratch.confidences, scratch.fractions, scratch.indices, scratch.shares
    has_level, strides = scratch.has_level, scratch.strides
    scales = _scales(weights[1], np.float32(texture.layout[0, 6]))
    _find_coordinates(rho, sp, cp, sin_a, cos_a, view, texture.layout, coordinates, modes)
    if len(texture.confidence) > 0:
        _find_confidences(coordinates, texture.confidence, texture.confidence_layout, confidences, len(rho))
    has_cubic, has_level[:], left = False, False, 0
    while left < len(rho):
        mode, right = modes[left], left + _count_same(modes[left : len(rho)])
        pixels = flat[first + 4 * left : first + 4 * right]
        if mode == HOLE:
            pixels[:] = np.float32(0.0)
        elif mode == FULL_RESOLUTION:
            if not has_cubic:
                _find_fractions(coordinates, strides[0], len(weights[1]) // 4 - 1, fractions)
                has_cubic = True
            _read_full(texels, strides[0], weights, fractions[:, left:right], scales, confidences[left:right], pixels)
        else:
            _prepare_levels(
                coordinates, mode, strides, scratch.factors, np.float32(weights[1][1]), has_level, indices, shares
            )
            finer, own = np.int64(mode), shares[4 * (RUN_PIXELS * np.int64(mode) + left) :]
            _read_levels(
                texels, scratch.starts, strides, finer, indices[finer : finer + 2, left:right], own, scales,
                confidences[left:right], pixels,
            )  # fmt: skip
        left = right


@inlined()
def _is_any(rho):
    """Whether any pixel of a run sees something."""
    for k in range(len(rho)):  # noqa: SIM110 - rho.max() takes longer to compile
        if rho[k] >= np.float32(0.0):
            return True
    return False


@inlined()
def _count_same(modes):
    """How many at the beginning are the same."""
    for k in range(len(modes)):
        if modes[k] != modes[0]:
            return k
    return len(modes)


@inlined(fastmath=True)
def _scales(cubic, unit):
    """Scale and offset of sums of texels: after one fixed-point product per texel, and after two.

    A fixed-point product keeps the high 16 bits, so each one loses half a unit on average; the offset adds that back.
    """
    one, zero = np.float32(cubic[1]), np.float32(0.0)
    if one == np.float32(1.0):
        return unit, zero, unit, zero
    # Mip levels: 8 texels lose half a unit each. Bicubic: 4 rows lose half a unit each, which the second product halves
    # (FIXED_ONE is half of 65536), and 4 columns lose half a unit each.
    once = unit * np.float32(65536.0 / FIXED_POINT_UNIT / FIXED_TEXEL)
    twice = once * np.float32(65536.0 / FIXED_POINT_UNIT)
    return once, np.float32(8 * 0.5) * once, twice, np.float32(4 * (0.5 + 0.25)) * twice


@inlined(fastmath=True)
def _find_coordinates(rho, sp, cp, sin_a, cos_a, view, layout, coordinates, modes):
    """Texture coordinates (see :data:`LEVEL`) and mip levels of the pixels of a run, and how they are read.

    ``coordinates`` and ``modes`` are written; ``layout`` is that of the texture. For ``rho``, ``sp``, ``cp``,
    ``sin_a``, ``cos_a`` and ``view`` see :func:`_shade_run`.
    """
    find_source_directions(rho, sp, cp, sin_a, cos_a, view, coordinates)
    _find_texels(coordinates, layout, len(rho))
    squared = view.texels_per_pixel * view.texels_per_pixel
    _find_modes(rho, coordinates, squared, np.float32(layout.shape[0] - 1) - LEVEL_MARGIN, modes)


@fast_subkernel()
def find_source_directions(rho, sp, cp, sin_a, cos_a, view, coordinates):
    """The direction ``Rᵀ(r − ρ·t)`` in which the source sees each pixel; its squared length as ``LEVEL``."""
    rotation, t = view.rotation, view.position
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    t0, t1, t2 = t[0], t[1], t[2]
    for col in range(len(rho)):
        w = max(rho[col], np.float32(0.0))
        x, y, z = sp * sin_a[col] - w * t0, cp - w * t1, -sp * cos_a[col] - w * t2
        dx, dy, dz = r00 * x + r10 * y + r20 * z, r01 * x + r11 * y + r21 * z, r02 * x + r12 * y + r22 * z
        coordinates[X, col], coordinates[Y, col], coordinates[Z, col] = dx, dy, dz
        coordinates[LEVEL, col] = dx * dx + dy * dy + dz * dz


@fast_subkernel()
def _find_texels(coordinates, layout, count):
    """Texel rows and columns at full resolution; two loops, so that the constants of each stay in registers."""
    scale, zero = np.float32(layout[0, 2]), np.float32(layout[0, 3])
    for col in range(count):
        dx, dz = coordinates[X, col], coordinates[Z, col]
        coordinates[Y, col] = atan2_fast(math.sqrt(dx * dx + dz * dz), coordinates[Y, col]) * scale + zero
    scale, zero = np.float32(layout[0, 4]), np.float32(layout[0, 5])
    for col in range(count):
        coordinates[X, col] = atan2_fast(coordinates[X, col], -coordinates[Z, col]) * scale + zero


@inlined(fastmath=True)
def mip_level(squared, length, highest):
    """The biased mip level, at most ``highest``, of squared texels per pixel and a direction's squared length."""
    level = np.float32(0.5) * log2_fast(squared / (length + np.float32(1e-20)))
    return min(max((np.float32(1.0) - MIP_BIAS) * level, level - MIP_BIAS), highest)


@fast_subkernel()
def _find_modes(rho, coordinates, squared, highest, modes):
    """Mip levels, and how pixels are read by them.

    The direction's length is (distance from the source / distance from the target): how much smaller than in the
    target the source shows the place. Texels per pixel over that length is the footprint; its log2 is the level.
    """
    for col in range(len(rho)):
        level = mip_level(squared, coordinates[LEVEL, col], highest)
        coordinates[LEVEL, col] = level
        mode = np.int32(level) if level > MAX_FULL_RESOLUTION_LEVEL else FULL_RESOLUTION
        modes[col] = mode if rho[col] >= 0.0 else HOLE


@fast_subkernel()
def _find_confidences(coordinates, confidence, confidence_layout, confidences, count):
    """Confidence of the quarter of a quad at each texture coordinate, from an image of quarters with a border."""
    row_scale, row_zero = confidence_layout[0], confidence_layout[1]
    col_scale, col_zero = confidence_layout[2], confidence_layout[3]
    stride = np.int32(confidence_layout[4])
    for k in range(count):
        row = np.int32(coordinates[Y, k] * row_scale + row_zero)
        col = np.int32(coordinates[X, k] * col_scale + col_zero)
        confidences[k] = confidence[np.int32(row * stride) + col]


@fast_subkernel()
def _find_fractions(coordinates, stride, parts, fractions):
    """For a whole run: the second texel of the second row of its 4x4, and the indices of row and column weights."""
    texels_a_row, parts = np.int32(stride // 4), np.float32(parts)
    ys, xs, index, down, across = coordinates[Y], coordinates[X], fractions[0], fractions[1], fractions[2]
    for col in range(RUN_PIXELS):
        i, j = np.int32(ys[col]), np.int32(xs[col])
        index[col] = np.int32(i * texels_a_row) + j
        down[col] = np.int32((ys[col] - np.float32(i)) * parts + np.float32(0.5))
        across[col] = np.int32((xs[col] - np.float32(j)) * parts + np.float32(0.5))


@inlined(fastmath=True)
def _read_full(texels, stride, weights, fractions, scales, confidences, flat):
    """Bicubic reads of 4x4 texels for some pixels of a run."""
    (of_rows, of_columns), (_, _, scale, shift) = weights, scales
    index, down, across = fractions[0], fractions[1], fractions[2]
    for k in range(len(confidences)):
        at, row = 4 * np.int64(index[k]) - stride - 4, 4 * np.int64(down[k])
        prefetch(texels, 4 * np.int64(index[min(k + PREFETCH_PIXELS, len(confidences) - 1)]) + 2 * stride)
        mixed = load_texels(texels, at) * broadcast_weight(of_rows, row)
        mixed = mixed + load_texels(texels, at + stride) * broadcast_weight(of_rows, row + 1)
        mixed = mixed + load_texels(texels, at + 2 * stride) * broadcast_weight(of_rows, row + 2)
        mixed = mixed + load_texels(texels, at + 3 * stride) * broadcast_weight(of_rows, row + 3)
        mixed = mixed * load_four_weights(of_columns, 4 * np.int64(across[k]))
        store_texel_sum(flat, 4 * k, mixed, scale, shift, confidences[k])


@inlined(fastmath=True)
def _levels_from_full(layout):
    """Scale and offset from texel rows and columns at full resolution to those of each level."""
    factors = empty((layout.shape[0], 4), np.float32)
    for level in range(layout.shape[0]):
        for axis in range(0, 4, 2):
            scale = layout[level, 2 + axis] / layout[0, 2 + axis]
            factors[level, axis] = scale
            factors[level, axis + 1] = layout[level, 3 + axis] - layout[0, 3 + axis] * scale
    return factors


@fast_subkernel()
def _prepare_levels(coordinates, finer, strides, factors, full_weight, has_level, index, shares):
    """Indices and weights of two mip levels, unless this run has them already."""
    for level in range(finer, finer + 2):
        if not has_level[level]:
            some = shares[4 * RUN_PIXELS * level : 4 * RUN_PIXELS * (level + 1)]
            _find_bilinear(coordinates, level, strides[level], factors[level], full_weight, index[level], some)
            has_level[level] = True


@fast_subkernel()
def _find_bilinear(coordinates, level, stride, factors, full_weight, index, shares):
    """For a whole run: the first of 2x2 texels in a mip level, and their bilinear weights, the upper two first.

    These include the weight of the level: ``full_weight`` where a pixel's level is this one, 0 one level away.
    """
    texels_a_row, one, zero = np.int32(stride // 4), np.float32(1.0), np.float32(0.0)
    y_scale, y_zero, x_scale, x_zero = factors[0], factors[1], factors[2], factors[3]
    for col in range(RUN_PIXELS):
        y, x = coordinates[Y, col] * y_scale + y_zero, coordinates[X, col] * x_scale + x_zero
        i, j = np.int32(y), np.int32(x)
        index[col] = np.int32(i * texels_a_row) + j
        share = full_weight * max(one - abs(coordinates[LEVEL, col] - np.float32(level)), zero)
        across = x - np.float32(j)
        below = share * (y - np.float32(i))
        above, below_right = share - below, below * across
        above_right = above * across
        shares[4 * col], shares[4 * col + 1] = above - above_right, above_right
        shares[4 * col + 2], shares[4 * col + 3] = below - below_right, below_right


@inlined(fastmath=True)
def _read_levels(texels, starts, strides, finer, index, shares, scales, confidences, flat):
    """Trilinear reads into ``flat``, 2x2 texels of the mip level ``finer`` and of the next, for some pixels of a run.

    ``starts`` has the offset of each level in ``texels`` and ``strides`` the numbers per row of each; ``index``,
    ``(2, pixels)``, the first texel in both levels; ``shares`` the bilinear weights in the finer level, and a run later
    in the other one; ``scales`` are those of :func:`_scales`, ``confidences`` those of the pixels.
    """
    scale, shift, _, _ = scales
    start, next_start, stride, next_stride = starts[finer], starts[finer + 1], strides[finer], strides[finer + 1]
    for k in range(len(confidences)):
        at, below = start + 4 * np.int64(index[0, k]), next_start + 4 * np.int64(index[1, k])
        prefetch(texels, start + 4 * np.int64(index[0, min(k + PREFETCH_PIXELS, len(confidences) - 1)]) + stride)
        mixed = load_texel_pairs(texels, at, at + stride) * load_four_weights(shares, 4 * k)
        mixed = mixed + load_texel_pairs(texels, below, below + next_stride) * load_four_weights(
            shares, 4 * (RUN_PIXELS + k)
        )
        store_texel_sum(flat, 4 * k, mixed, scale, shift, confidences[k])
