# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""Rasterisation into perspective pictures, in numba: boxes of quads on the image plane; rays are tested as ever.

Straight edges stay straight, so a quad in front of the camera lies in the box of its projected corners. Quads that lie
beyond one of the sides of the view, or behind it, are left out before they are set up.
"""

import math

import numpy as np

from omnisyn_cli.compute.arrays import empty
from omnisyn_cli.compute.jit import inlined, kernel, subkernel
from omnisyn_cli.render.box_kernels import (
    BOX_MARGIN_PIXELS,
    FIRST_COL,
    FIRST_ROW,
    LAST_COL,
    LAST_ROW,
    MAX_BLOCK_POINTS,
    MIN_EDGE_DISTANCE_RATIO,
    X,
    Y,
    Z,
    place_quads,
)
from omnisyn_cli.render.draw_kernels import Box, draw_box, draw_exactly, draw_narrow_box, exact_corners
from omnisyn_cli.render.quad_blocks import BLOCK
from omnisyn_cli.render.quad_kernels import BLOCK_ROWS, IN_FLOAT32, PRECISION, SKIPPED_QUAD, set_up_quads
from omnisyn_cli.render.raster_kernels import NO_FACE
from omnisyn_cli.render.simd import LANES

MIN_PROJECTED_SHARE = 1e-3  # share of its distance that a corner has to be in front of the camera to be projected


@inlined()
def _range_of(a, b, c, d):
    return min(min(a, b), min(c, d)), max(max(a, b), max(c, d))


@inlined()
def perspective_box(block, corners, k, gap, view, height, width):
    """First and last row, first and last column of the box of a placed quad, empty where nothing of it can be seen.

    ``view``: pixels of a step sideways at distance 1, and half of the height and of the width there.
    """
    (focal, down, across), (at0, at1, at2, at3) = view, corners
    xs, ys, zs = block[X], block[Y], block[Z]
    zero, margin = np.float32(0.0), np.float32(BOX_MARGIN_PIXELS)
    last_row, last_col = np.float32(height - 1), np.float32(width - 1)
    x0, x1, x2, x3 = xs[at0 + k], xs[at1 + k], xs[at2 + k], xs[at3 + k]
    y0, y1, y2, y3 = ys[at0 + k], ys[at1 + k], ys[at2 + k], ys[at3 + k]
    d0, d1, d2, d3 = -zs[at0 + k], -zs[at1 + k], -zs[at2 + k], -zs[at3 + k]
    slack = gap * (np.float32(1.0) + across) / np.float32(MIN_EDGE_DISTANCE_RATIO)
    right = min(min(x0 - across * d0, x1 - across * d1), min(x2 - across * d2, x3 - across * d3))
    left = min(min(-x0 - across * d0, -x1 - across * d1), min(-x2 - across * d2, -x3 - across * d3))
    above = min(min(y0 - down * d0, y1 - down * d1), min(y2 - down * d2, y3 - down * d3))
    below = min(min(-y0 - down * d0, -y1 - down * d1), min(-y2 - down * d2, -y3 - down * d3))
    nearest, farthest = _range_of(d0, d1, d2, d3)
    if max(max(right, left), max(above, below)) > slack or farthest < -slack:
        return np.float32(height), np.float32(-1.0), np.float32(width), np.float32(-1.0)
    length = math.sqrt(max(max(x0 * x0 + y0 * y0, x1 * x1 + y1 * y1), max(x2 * x2 + y2 * y2, x3 * x3 + y3 * y3)))
    if nearest <= np.float32(MIN_PROJECTED_SHARE) * (length + farthest):
        return zero, last_row, zero, last_col
    x_low, x_high = _range_of(x0 / d0, x1 / d1, x2 / d2, x3 / d3)
    y_low, y_high = _range_of(y0 / d0, y1 / d1, y2 / d2, y3 / d3)
    slope = max(max(abs(x_low), abs(x_high)), max(abs(y_low), abs(y_high)))
    reach = focal * gap / (np.float32(MIN_EDGE_DISTANCE_RATIO) * nearest) * (np.float32(1.0) + slope * slope)
    reach = min(reach + margin, np.float32(width))
    middle_row, middle_col = np.float32(0.5 * (height - 1)), np.float32(0.5 * (width - 1))
    return (
        max(np.float32(math.ceil(middle_row - focal * y_high - reach)), zero),
        min(np.float32(math.floor(middle_row - focal * y_low + reach)), last_row),
        max(np.float32(math.ceil(middle_col + focal * x_low - reach)), zero),
        min(np.float32(math.floor(middle_col + focal * x_high + reach)), last_col),
    )


@subkernel()
def _find_boxes(block, quads, view, height, width):
    """Boxes of the quads of a block with placed points, see :func:`perspective_box`."""
    for k in range(BLOCK):
        gap = quads.gaps[k] if len(quads.gaps) > 0 else np.float32(0.0)
        first_row, last_row, first_col, last_col = perspective_box(block, quads.corners, k, gap, view, height, width)
        block[FIRST_ROW, k], block[LAST_ROW, k] = first_row, last_row
        block[FIRST_COL, k], block[LAST_COL, k] = first_col, last_col


@kernel()
def find_rows_of_blocks(quads, pose, target, view, rows, begin, end):
    """Write the first and the last row that blocks ``begin`` to ``end`` can touch; the last is smaller if none."""
    block = empty((BLOCK_ROWS, MAX_BLOCK_POINTS), np.float32)
    for k in range(begin, end):
        placed = place_quads(quads, k, pose, target.scale, block)
        _find_boxes(block, placed, view, target.height, target.width)
        first, last = block[FIRST_ROW, 0], block[LAST_ROW, 0]
        for i in range(1, BLOCK):
            first, last = min(first, block[FIRST_ROW, i]), max(last, block[LAST_ROW, i])
        rows[k, 0], rows[k, 1] = np.int32(first), np.int32(last)


@kernel()
def rasterize_perspective(quads, rows, pose, target, view, face, begin, end):
    """Draw all quads in rows ``begin`` to ``end`` of :class:`omnisyn_cli.render.draw_kernels.Target`.

    ``rows``: of :func:`find_rows_of_blocks`. ``pose``: three rows of a rotation with the shift behind them, target from
    panorama. ``view``: as :func:`_find_boxes` takes it. ``face``: written, see
    :func:`omnisyn_cli.render.raster_kernels.rasterize_blocks`; None if nobody wants it.
    """
    width = target.width
    target.inverse_depth[begin * width : end * width] = -1.0
    if face is not None:
        face[begin * width : end * width] = NO_FACE
    block = empty((BLOCK_ROWS, MAX_BLOCK_POINTS), np.float32)
    for k in range(len(rows)):
        if rows[k, 0] < end and rows[k, 1] >= begin and rows[k, 1] >= rows[k, 0]:
            placed = place_quads(quads, k, pose, target.scale, block)
            _find_boxes(block, placed, view, target.height, width)
            set_up_quads(block, placed, np.int64(0), np.int64(BLOCK))  # types as elsewhere: compiled once
            _draw_quads(block, placed, 2 * BLOCK * k, target, face, begin, end)


@subkernel()
def _draw_quads(block, quads, number, target, face, begin, end):
    """Draw the set-up quads of a block in target rows ``begin`` to ``end``; arguments as of ``draw_quads``."""
    for k in range(BLOCK):
        first_row, last_row = max(np.int64(block[FIRST_ROW, k]), begin), min(np.int64(block[LAST_ROW, k]), end - 1)
        first_col, last_col = np.int64(block[FIRST_COL, k]), np.int64(block[LAST_COL, k])
        if block[PRECISION, k] == SKIPPED_QUAD or first_row > last_row or first_col > last_col:
            continue
        box = Box(first_row, last_row, first_col, last_col)
        if block[PRECISION, k] == IN_FLOAT32 and target.width >= LANES:
            if last_col - first_col < LANES // 2:
                draw_narrow_box(block, k, number + 2 * k, box, target, face)
            else:
                draw_box(block, k, number + 2 * k, box, target, face)
        else:
            gap = np.float64(quads.gaps[k]) if len(quads.gaps) > 0 else 0.0
            points = exact_corners(block, quads.corners, quads.codes[k], k)
            draw_exactly(points, gap, number + 2 * k, box, target, face)
