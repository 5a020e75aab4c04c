# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""The loops of :mod:`omnisyn_cli.render.tiles`, in numba.

A block of tiles goes through all steps in buffers that fit into the nearest cache: its points are moved into the
target's frame and projected, boxes are found, edges and planes are planned, rays are tested.
"""

from __future__ import annotations

import math

import numpy as np

from omnisyn_cli.jit import inlined, kernel
from omnisyn_cli.render.box_kernels import find_boxes, project_points
from omnisyn_cli.render.quad_kernels import DRAWN, IN_FLOAT32, NOT_AT_ALL, PLAN_ROWS, draw_quads, plan_quads
from omnisyn_cli.render.raster_kernels import BLOCK
from omnisyn_cli.render.simd import LANES, load, splat, store
from omnisyn_cli.render.span_kernels import SPAN_ROWS, draw_spans

__all__ = ["POINTS", "find_tile_rows", "rasterize_tiles"]

POINTS = 4 * BLOCK
"""Points of a block of tiles: all first corners, then all second ones."""

CLOSE = 0.5
"""An edge of a tile is taken to be at least this share as near as the nearer of its ends."""

SPANNED = 24
"""Columns of a box from which on spans are found row by row."""

STEEP = 1.4
"""Tiles within an angle of this (radians) have boxes; for larger ones all columns are searched."""


@kernel()
def _place(points, rotation, t, scale, moved, pixels):
    """Points of a block in the frame of the target, and the pixels they fall on.

    All points go through the same instructions, so that those that tiles share remain the same.
    """
    r00, r01, r02 = splat(rotation[0, 0]), splat(rotation[0, 1]), splat(rotation[0, 2])
    r10, r11, r12 = splat(rotation[1, 0]), splat(rotation[1, 1]), splat(rotation[1, 2])
    r20, r21, r22 = splat(rotation[2, 0]), splat(rotation[2, 1]), splat(rotation[2, 2])
    t0, t1, t2 = splat(t[0]), splat(t[1]), splat(t[2])
    for k in range(0, POINTS, LANES):
        x, y, z = load(points, k), load(points, k + POINTS), load(points, k + 2 * POINTS)
        w = load(points, k + 3 * POINTS)
        store(moved, k, r00 * x + (r01 * y + (r02 * z + t0 * w)))
        store(moved, k + POINTS, r10 * x + (r11 * y + (r12 * z + t1 * w)))
        store(moved, k + 2 * POINTS, r20 * x + (r21 * y + (r22 * z + t2 * w)))
        store(moved, k + 3 * POINTS, w)
    project_points(moved, pixels, POINTS, 0, POINTS, scale)


@inlined()
def _corner(moved, corner, k):
    """A corner of a tile, and how far away it is."""
    at = corner * BLOCK + k
    x, y, z = moved[at], moved[POINTS + at], moved[2 * POINTS + at]
    return x, y, z, math.sqrt(x * x + y * y + z * z) + np.float32(1e-20)


@kernel()
def _surround(moved, k, margin, height, width, box):
    """The box of the smallest cap around the middle of a tile: tight where a tile is near a pole of the target."""
    ax = ay = az = np.float32(0.0)
    for corner in range(4):
        x, y, z, distance = _corner(moved, corner, k)
        ax, ay, az = ax + x / distance, ay + y / distance, az + z / distance
    length = math.sqrt(ax * ax + ay * ay + az * az) + 1e-20
    closeness = 1.0
    for corner in range(4):
        x, y, z, distance = _corner(moved, corner, k)
        closeness = min(closeness, (ax * x + ay * y + az * z) / (length * distance))
    radius = math.acos(max(closeness - 1e-6, -1.0)) + margin
    if radius > STEEP:
        return
    polar, azimuth = math.acos(max(-1.0, min(1.0, float(ay / length)))), math.atan2(ax, -az)
    rows, cols = height / math.pi, width / (2.0 * math.pi)
    box[0, k] = max(box[0, k], np.float32(math.floor((polar - radius) * rows - 0.5)))
    box[1, k] = min(box[1, k], np.float32(math.ceil((polar + radius) * rows - 0.5)))
    if radius < polar < math.pi - radius:
        reach = math.asin(min(1.0, math.sin(radius) / math.sin(polar)))
        left, right = (azimuth - reach + math.pi) * cols - 0.5, (azimuth + reach + math.pi) * cols - 0.5
        if right - left < width - 2:
            box[2, k], box[3, k] = np.float32(math.floor(left)), np.float32(math.ceil(right))


@kernel()
def _widen(moved, k, gap, sin_p, height, width, box):
    """Make room for what the edges of a tile reach outwards; returns the angle."""
    nearest = np.float32(1e30)
    for corner in range(4):
        nearest = min(nearest, _corner(moved, corner, k)[3])
    angle = gap / (np.float32(CLOSE) * nearest)
    rows = np.ceil(min(angle * np.float32(height / math.pi), np.float32(height)))
    first, last = max(box[0, k] - rows, np.float32(0.0)), min(box[1, k] + rows, np.float32(height - 1))
    box[0, k], box[1, k] = first, last
    if box[3, k] - box[2, k] < np.float32(width - 1):
        narrowest = min(sin_p[np.int64(first)], sin_p[np.int64(last)])
        cols = np.ceil(min(angle / narrowest * np.float32(width / (2.0 * math.pi)), np.float32(width)))
        box[2, k], box[3, k] = box[2, k] - cols, box[3, k] + cols
        if box[3, k] - box[2, k] >= np.float32(width - 1):
            box[2, k], box[3, k] = np.float32(0.0), np.float32(width - 1)
    return angle


@kernel()
def _find_tile_boxes(moved, pixels, gaps, sin_p, height, width, box):
    """Boxes of the tiles of a block, with room for their gaps; of those near poles and of near ones as well."""
    find_boxes(pixels, POINTS, 0, BLOCK, 2 * BLOCK, 3 * BLOCK, BLOCK, height, width, box)
    for k in range(BLOCK):
        if box[0, k] <= box[1, k] and (gaps[k] > 0.0 or box[3, k] - box[2, k] >= np.float32(width - 1)):
            angle = _widen(moved, k, gaps[k], sin_p, height, width, box) if gaps[k] > 0.0 else np.float32(0.0)
            if box[3, k] - box[2, k] >= np.float32(width - 1):
                _surround(moved, k, angle, height, width, box)


@kernel()
def find_tile_rows(points, gaps, rotation, t, scale, sin_p, height, width, rows, begin, end):
    """First and last target row that blocks ``begin`` to ``end`` can touch."""
    moved, pixels = np.empty(4 * POINTS, np.float32), np.empty(2 * POINTS, np.float32)
    box = np.empty((4, BLOCK), np.float32)
    for block in range(begin, end):
        _place(points[block].reshape(-1), rotation, t, scale, moved, pixels)
        _find_tile_boxes(moved, pixels, gaps[block], sin_p, height, width, box)
        rows[block, 0], rows[block, 1] = np.int32(box[0].min()), np.int32(box[1].max())


@kernel()
def _draw_large(pixels, plan, box, spans, tables, out, width, begin, end):
    """Large tiles of a block in rows ``begin`` to ``end``; for others they are done with then."""
    for k in range(BLOCK):
        col_first, col_last = np.int64(box[2, k]), np.int64(box[3, k])
        if plan[DRAWN, k] != IN_FLOAT32 or col_last - col_first < SPANNED or width < LANES:
            continue
        plan[DRAWN, k] = NOT_AT_ALL
        row_first, row_last = max(np.int64(box[0, k]), begin), min(np.int64(box[1, k]), end - 1)
        if col_last - col_first >= width - 1:  # around the tile, so that spans can be cut from both ends
            col_first = np.int64(pixels[POINTS + k]) - width // 2
            col_last = col_first + width - 1
        draw_spans(plan, k, row_first, row_last, col_first, col_last, tables, out, width, spans)


@kernel()
def rasterize_tiles(points, codes, gaps, rows, rotation, t, scale, tables, exact_tables, inverse_depth, begin, end):
    """All tiles in target rows ``begin`` to ``end``."""
    height, width = inverse_depth.shape
    out = inverse_depth.reshape(-1)
    moved, pixels = np.empty(4 * POINTS, np.float32), np.empty(2 * POINTS, np.float32)
    plan, box, spans = (
        np.empty((PLAN_ROWS, BLOCK), np.float32),
        np.empty((4, BLOCK), np.float32),
        np.empty((4, SPAN_ROWS), np.float32),
    )
    for block in range(len(points)):
        if rows[block, 1] < begin or rows[block, 0] >= end:
            continue
        _place(points[block].reshape(-1), rotation, t, scale, moved, pixels)
        _find_tile_boxes(moved, pixels, gaps[block], tables[0], height, width, box)
        plan_quads(moved, POINTS, 0, BLOCK, 2 * BLOCK, 3 * BLOCK, codes[block], gaps[block], 0, BLOCK, plan)
        _draw_large(pixels, plan, box, spans, tables, out, width, begin, end)
        draw_quads(
            moved, POINTS, 0, BLOCK, 2 * BLOCK, 3 * BLOCK, codes[block], gaps[block], 0, BLOCK, plan, box, None,
            tables, exact_tables, out, None, width, begin, end,
        )  # fmt: skip
