# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""Photographs looked up on a GPU, one pixel at a time, as :mod:`omnisyn_cli.render.shade_kernels` does for runs."""

import math
from typing import Any, NamedTuple

import numpy as np

from omnisyn_cli.compute.trigonometry import atan2_fast
from omnisyn_cli.fusion.ghost_kernels import interpolate_strength, neighbour_cell_rows
from omnisyn_cli.fusion.photometry import CLIPPING_SRGB, exposed_weight, interpolate_table
from omnisyn_cli.render.shade_kernels import LEVEL_MARGIN, MAX_FULL_RESOLUTION_LEVEL, mip_level
from omnisyn_cli.synthesis.device.cuda_device import device_function
from omnisyn_cli.types import MIN_VISIBLE_WEIGHT


class Photograph(NamedTuple):
    """A :class:`omnisyn_cli.render.texture.Texture` and the confidence of its surface, on the device."""

    texels: Any  # four samples of 8 bits in one number; or four numbers each
    starts: Any  # of each level: its first texel, and texels per row
    factors: Any  # of each level: scale and offset from rows, then from columns, at full resolution
    scale: tuple[np.float32, ...]  # of an angle in rows and in columns at full resolution, each with an offset
    unit: np.float32  # what texels are multiplied by
    confidence: Any  # see :class:`omnisyn_cli.render.shade.ConfidenceMap`
    confidence_layout: Any


class DeviceLayer(NamedTuple):
    """One view in a frame."""

    photograph: Photograph
    pose: tuple[tuple[np.float32, ...], ...]  # rows of a rotation with the shift behind them, target from source
    texels_per_pixel: np.float32
    table: Any  # of exposure, see :meth:`omnisyn_cli.fusion.exposure_curve.ExposureCurve.table`
    loss: np.float32  # of weight where white is darkened; negative where exposure does not change
    inverse_depth: Any  # row after row; negative where nothing is seen
    samples: Any  # inverse depth of the four samples of each edge pixel
    mark: int  # the bit that marks an edge of this view


@device_function(fastmath=True)
def _texel(texels, at):
    if texels.ndim == 1:
        texel = texels[at]
        red, green = np.float32(texel & np.uint32(255)), np.float32((texel >> np.uint32(8)) & np.uint32(255))
        return red, green, np.float32((texel >> np.uint32(16)) & np.uint32(255)), np.float32(texel >> np.uint32(24))
    return texels[at, 0], texels[at, 1], texels[at, 2], texels[at, 3]


@device_function(fastmath=True)
def add(total, texel, weight):
    """A sum of four channels, and another colour times a weight."""
    return (
        total[0] + weight * texel[0], total[1] + weight * texel[1], total[2] + weight * texel[2],
        total[3] + weight * texel[3],
    )  # fmt: skip


@device_function(fastmath=True)
def _cubic_weights(x):
    """Of :func:`omnisyn_cli.render.texture.cubic_weights`, at one fraction."""
    half, two, three, four, five = np.float32(0.5), np.float32(2), np.float32(3), np.float32(4), np.float32(5)
    x2 = x * x
    x3 = x2 * x
    return (
        half * (two * x2 - x3 - x), half * (three * x3 - five * x2 + two), half * (four * x2 - three * x3 + x),
        half * (x3 - x2),
    )  # fmt: skip


@device_function(fastmath=True)
def _read_full(photograph, y, x):
    """Bicubic: 4×4 texels."""
    i, j = int(y), int(x)
    down, across = _cubic_weights(y - np.float32(i)), _cubic_weights(x - np.float32(j))
    stride, zero = photograph.starts[0, 1], np.float32(0.0)
    total = (zero, zero, zero, zero)
    for m in range(4):
        at = (i + m - 1) * stride + j - 1
        for n in range(4):
            total = add(total, _texel(photograph.texels, at + n), down[m] * across[n])
    return total


@device_function(fastmath=True)
def _read_level(photograph, level, y, x, share, total):
    """Add a share of a bilinear read of one mip level."""
    scales, one = photograph.factors, np.float32(1.0)
    row, col = y * scales[level, 0] + scales[level, 1], x * scales[level, 2] + scales[level, 3]
    i, j, stride = int(row), int(col), photograph.starts[level, 1]
    at, down, across = photograph.starts[level, 0] + i * stride + j, row - np.float32(i), col - np.float32(j)
    total = add(total, _texel(photograph.texels, at), share * (one - down) * (one - across))
    total = add(total, _texel(photograph.texels, at + 1), share * (one - down) * across)
    total = add(total, _texel(photograph.texels, at + stride), share * down * (one - across))
    return add(total, _texel(photograph.texels, at + stride + 1), share * down * across)


@device_function(fastmath=True)
def shade(view, rho, x, y, z, texels_per_pixel, by_confidence):
    """RGB and blend weight, exposed, of what a ray meets at an inverse depth; all 0 where that is negative."""
    zero, one, photograph = np.float32(0.0), np.float32(1.0), view.photograph
    if rho < zero:
        return zero, zero, zero, zero
    (r00, r01, r02, t0), (r10, r11, r12, t1), (r20, r21, r22, t2) = view.pose
    row_scale, row_zero, col_scale, col_zero = photograph.scale
    x, y, z = x - rho * t0, y - rho * t1, z - rho * t2
    dx, dy, dz = r00 * x + r10 * y + r20 * z, r01 * x + r11 * y + r21 * z, r02 * x + r12 * y + r22 * z
    flat = dx * dx + dz * dz
    row = atan2_fast(np.float32(math.sqrt(flat)), dy) * row_scale + row_zero
    col = atan2_fast(dx, -dz) * col_scale + col_zero
    highest = np.float32(photograph.starts.shape[0] - 1) - LEVEL_MARGIN
    level = mip_level(texels_per_pixel * texels_per_pixel, flat + dy * dy, highest)
    if level > MAX_FULL_RESOLUTION_LEVEL:
        finer = int(level)
        share = level - np.float32(finer)
        read = _read_level(photograph, finer, row, col, one - share, (zero, zero, zero, zero))
        read = _read_level(photograph, finer + 1, row, col, share, read)
    else:
        read = _read_full(photograph, row, col)
    unit, layout, confidence = photograph.unit, photograph.confidence_layout, one
    if by_confidence and len(photograph.confidence) > 0:
        i, j = int(row * layout[0] + layout[1]), int(col * layout[2] + layout[3])
        confidence = photograph.confidence[i * int(layout[4]) + j]
    return _exposed(view, read[0] * unit, read[1] * unit, read[2] * unit, read[3] * unit * confidence)


@device_function(fastmath=True)
def _exposed(view, red, green, blue, weight):
    if view.loss < np.float32(0.0) or not weight > np.float32(0.0):
        return red, green, blue, weight
    weight = exposed_weight(max(red, max(green, blue)), weight, view.loss, CLIPPING_SRGB)
    table = view.table
    return (
        interpolate_table(red, table, 0),
        interpolate_table(green, table, 1),
        interpolate_table(blue, table, 2),
        weight,
    )


@device_function(fastmath=True)
def offset_of(view):
    """The position of a view in the frame of the target."""
    return view.pose[0][3], view.pose[1][3], view.pose[2][3]


@device_function(fastmath=True)
def suppressed(strength, cell_size, a, b, row, col):
    """Blend weights of both layers where ghosts are suppressed, if they are."""
    if len(strength) == 0 or not (a > MIN_VISIBLE_WEIGHT and b > MIN_VISIBLE_WEIGHT):
        return a, b
    upper, lower, down = neighbour_cell_rows(strength, cell_size, row)
    value = interpolate_strength(strength, cell_size, upper, lower, down, col)
    if value > np.float32(0.0):
        return a, b * (np.float32(1.0) - value)
    return a * (np.float32(1.0) + value), b
