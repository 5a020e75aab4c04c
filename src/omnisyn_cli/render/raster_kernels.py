# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""The loops of :mod:`omnisyn_cli.render.rasterize`, in numba.

A block of quads goes through all steps in a scratch array that fits into the L1 cache: its points are transformed into
the target's frame and projected, boxes are found, edges and planes are set up, rays are tested.

In a perspective picture straight edges stay straight, so a quad in front of the camera lies in the box of its projected
corners. Quads that lie beyond one of the sides of the view, or behind it, are left out before they are set up.

The samples of edge pixels are pixels of a target of twice the size. Those of a row lie side by side, whatever their
columns, so they are tested eight at a time as well; an index by tiles of columns tells which of them lie in a box.
"""

import math

import numpy as np

from omnisyn_cli.compute.arrays import empty
from omnisyn_cli.compute.jit import fast_subkernel, inlined, kernel, subkernel
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
    find_quad_boxes,
    place_quads,
    tighten_wide_box,
)
from omnisyn_cli.render.draw_kernels import (
    Box,
    draw_quads,
    exact_corners,
    exact_setup,
    intersect_exactly,
    intersect_rays,
)
from omnisyn_cli.render.quad_blocks import BLOCK, HOLE_FLAG
from omnisyn_cli.render.quad_kernels import BLOCK_ROWS, IN_FLOAT32, PRECISION, SKIPPED_QUAD, set_up_quads
from omnisyn_cli.render.simd import LANES, broadcast, load_halves, pair, store_halves, where
from omnisyn_cli.types import EDGE_TILE_COLUMNS

NO_FACE = -1  # face number of pixels that see no surface
MIN_PROJECTED_SHARE = 1e-3  # share of its distance that a corner has to be in front of the camera to be projected
HALF_LANES = LANES // 2  # samples of a row that are tested together, with those below them


@kernel()
def find_block_bounds(quads, pose, target, view, boxes, begin, end):
    """Write first and last target row, first and last column that blocks ``begin`` to ``end`` can touch.

    For the arguments see :func:`rasterize_blocks`. The last one is smaller if none can be seen.
    """
    block = empty((BLOCK_ROWS, MAX_BLOCK_POINTS), np.float32)
    for k in range(begin, end):
        placed = place_quads(quads, k, pose, target.scale, block)
        _find_boxes(block, placed, target, view)
        _write_bounds(block, boxes, k, view)


@inlined()
def _write_bounds(block, boxes, k, view):
    boxes[k, 0], boxes[k, 1] = _range(block[FIRST_ROW], block[LAST_ROW])
    if view is None:  # columns are asked for by samples of edge pixels alone
        boxes[k, 2], boxes[k, 3] = _range(block[FIRST_COL], block[LAST_COL])


@fast_subkernel()
def _range(first, last):
    """Minimum and maximum over the quads of a block; LLVM vectorises this loop, but not numpy's reductions."""
    smallest, largest = first[0], last[0]
    for k in range(1, BLOCK):
        smallest, largest = min(smallest, first[k]), max(largest, last[k])
    return np.int32(smallest), np.int32(largest)


@kernel()
def rasterize_blocks(quads, boxes, pose, target, view, face, begin, end):
    """Draw all quads in rows ``begin`` to ``end`` of :class:`omnisyn_cli.render.draw_kernels.Target`.

    ``boxes``: of :func:`find_block_bounds`; written if all rows are drawn at once. ``pose``: three rows of a rotation
    with the shift behind them, target from panorama. ``view``: of a perspective picture, see :func:`perspective_box`;
    None for a panorama. ``face``: written, twice the index of the quad that is seen, plus one for its second triangle;
    None if nobody wants it.
    """
    target.inverse_depth[begin * target.width : end * target.width] = -1.0
    if face is not None:
        face[begin * target.width : end * target.width] = NO_FACE
    block = empty((BLOCK_ROWS, MAX_BLOCK_POINTS), np.float32)
    is_whole = begin == 0 and end == target.height
    for k in range(len(boxes)):
        if is_whole or (boxes[k, 0] < end and boxes[k, 1] >= begin):
            placed = place_quads(quads, k, pose, target.scale, block)
            _find_boxes(block, placed, target, view)
            if is_whole:
                _write_bounds(block, boxes, k, view)
            if boxes[k, 1] >= boxes[k, 0]:
                set_up_quads(block, placed, np.int64(0), np.int64(BLOCK))  # types as elsewhere: compiled once
                draw_quads(block, placed, 2 * BLOCK * k, target, view, face, begin, end)


@inlined()
def _extent(a, b, c, d):
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
    nearest, farthest = _extent(d0, d1, d2, d3)
    if max(max(right, left), max(above, below)) > slack or farthest < -slack:
        return np.float32(height), np.float32(-1.0), np.float32(width), np.float32(-1.0)
    length = math.sqrt(max(max(x0 * x0 + y0 * y0, x1 * x1 + y1 * y1), max(x2 * x2 + y2 * y2, x3 * x3 + y3 * y3)))
    if nearest <= np.float32(MIN_PROJECTED_SHARE) * (length + farthest):
        return zero, last_row, zero, last_col
    x_low, x_high = _extent(x0 / d0, x1 / d1, x2 / d2, x3 / d3)
    y_low, y_high = _extent(y0 / d0, y1 / d1, y2 / d2, y3 / d3)
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


@inlined()
def _find_boxes(block, quads, target, view):
    """Boxes of the quads of a block with placed points."""
    if view is None:
        find_quad_boxes(block, quads, target.rows[0], target.height, target.width)
    else:
        _find_perspective_boxes(block, quads, view, target.height, target.width)


@subkernel()
def _find_perspective_boxes(block, quads, view, height, width):
    for k in range(BLOCK):
        gap = quads.gaps[k] if len(quads.gaps) > 0 else np.float32(0.0)
        first_row, last_row, first_col, last_col = perspective_box(block, quads.corners, k, gap, view, height, width)
        block[FIRST_ROW, k], block[LAST_ROW, k] = first_row, last_row
        block[FIRST_COL, k], block[LAST_COL, k] = first_col, last_col


@kernel()
def rasterize_edge_pixels(quads, boxes, pose, target, edge_pixels, out):
    """Inverse depth of the samples of edge pixels, the upper row and then the lower one, negative if nothing is seen.

    ``boxes``: of the blocks of ``quads`` in the target itself, see
    :func:`find_block_bounds`. ``pose``: three rows of a rotation with the shift
    behind them, target from panorama. ``target`` has twice the size; its image is not used. ``out``: ``inverse_depth``
    of the :class:`omnisyn_cli.types.EdgePixels`, flat, changed.
    """
    width = target.width // 2
    block, found = empty((BLOCK_ROWS, MAX_BLOCK_POINTS), np.float32), empty((3 * BLOCK, 5), np.int64)
    for k in range(len(boxes)):
        # The boxes are those of pixel centres; samples lie up to a quarter of a pixel beside them.
        box = Box(boxes[k, 0] - 1, boxes[k, 1] + 1, boxes[k, 2] - 1, boxes[k, 3] + 1)
        if not _is_any_unknown(edge_pixels, box, width):
            continue
        placed = place_quads(quads, k, pose, target.scale, block)
        find_quad_boxes(block, placed, target.rows[0], target.height, target.width)
        count = _find_quads(block, placed, target, edge_pixels, found)
        if count > 0:
            set_up_quads(block, placed, found[0, 0], found[count - 1, 0] + 1)
            _draw_found(block, placed, found[:count], target, edge_pixels, out)


@inlined()
def _is_any_unknown(edge_pixels, box, width):
    """Whether a box, rounded to tiles, has edge pixels of unknown depth; columns outside the image wrap."""
    tiles = edge_pixels.unknown_counts.shape[1] - 1
    begin, end = 0, tiles
    if box.first_col >= 0 and box.last_col < width:
        begin, end = box.first_col // EDGE_TILE_COLUMNS, box.last_col // EDGE_TILE_COLUMNS + 1
    first, last = max(box.first_row - edge_pixels.top, 0), box.last_row - edge_pixels.top
    for row in range(first, min(last, len(edge_pixels.tile_begins) - 1) + 1):
        if edge_pixels.unknown_counts[row, end] > edge_pixels.unknown_counts[row, begin]:
            return True
    return False


@subkernel()
def _find_quads(block, quads, target, edge_pixels, found):
    """List the quads of a block that have edge pixels in their boxes; returns how many. Wide boxes are tightened.

    ``target`` has twice the size. ``found`` ``(entries, 5)`` is written: index and box. Rows are those of this target,
    columns those of the target itself. A quad across the seam has two entries.
    """
    width, top, count = target.width, 2 * edge_pixels.top, 0
    bottom = 2 * (edge_pixels.top + len(edge_pixels.tile_begins))
    for k in range(BLOCK):
        if quads.codes[k] & HOLE_FLAG or block[LAST_ROW, k] < top or block[FIRST_ROW, k] >= bottom:
            continue
        if block[LAST_COL, k] - block[FIRST_COL, k] >= width - 1:
            gap = quads.gaps[k] if len(quads.gaps) > 0 else np.float32(0.0)
            tighten_wide_box(block, quads.corners, k, gap, target.height, width)
        first_row, last_row = max(np.int64(block[FIRST_ROW, k]), top), min(np.int64(block[LAST_ROW, k]), bottom - 1)
        left, right = np.int64(block[FIRST_COL, k]), np.int64(block[LAST_COL, k])
        if left >= 0 and right < width:
            count = _add_if_any(edge_pixels, k, Box(first_row, last_row, left, right), found, count)
            continue
        for turn in (-width, 0, width):
            begin, end = max(left + turn, 0), min(right + turn, width - 1)
            count = _add_if_any(edge_pixels, k, Box(first_row, last_row, begin, end), found, count)
    return count


@inlined()
def _add_if_any(edge_pixels, k, box, found, count):
    """Add a box of samples to the list if it has edge pixels."""
    if box.first_row > box.last_row or box.first_col > box.last_col:
        return count
    if not _has_unknown(edge_pixels, box.first_row >> 1, box.last_row >> 1, box.first_col >> 1, box.last_col >> 1):
        return count
    found[count, 0], found[count, 1], found[count, 2] = k, box.first_row, box.last_row
    found[count, 3], found[count, 4] = box.first_col >> 1, box.last_col >> 1
    return count + 1


@inlined()
def _has_unknown(edge_pixels, first_row, last_row, first_col, last_col):
    """Whether a box inside the target, rounded to tiles, has edge pixels of unknown depth."""
    begin, end = first_col // EDGE_TILE_COLUMNS, last_col // EDGE_TILE_COLUMNS + 1
    for row in range(first_row - edge_pixels.top, last_row - edge_pixels.top + 1):
        if edge_pixels.unknown_counts[row, end] > edge_pixels.unknown_counts[row, begin]:
            return True
    return False


@subkernel()
def _draw_found(block, quads, found, target, edge_pixels, out):
    """Draw the set-up quads that :func:`_find_quads` listed."""
    for i in range(len(found)):
        k, first_row, last_row, first_col, last_col = found[i]
        box = Box(first_row, last_row, first_col, last_col)
        if block[PRECISION, k] == IN_FLOAT32:
            _draw_in_float32(block, k, box, target, edge_pixels, out)
        elif block[PRECISION, k] != SKIPPED_QUAD:
            gap = np.float64(quads.gaps[k]) if len(quads.gaps) > 0 else 0.0
            setup = exact_setup(exact_corners(block, quads.corners, quads.codes[k], k), gap)
            _draw_in_float64(setup, box, target, edge_pixels, out)


@inlined()
def _range_of(edge_pixels, row, box):
    """First edge pixel, and the one after the last, of a target row in the columns of a box, rounded to tiles."""
    begins, at = edge_pixels.tile_begins, row - edge_pixels.top
    return begins[at, box.first_col // EDGE_TILE_COLUMNS], begins[at, box.last_col // EDGE_TILE_COLUMNS + 1]


@inlined()
def _draw_in_float32(block, k, box, target, edge_pixels, out):
    """Two edge pixels at a time, with both rows of their samples.

    Whole vectors may reach beyond the box: edges are tested anyway, so that costs time and changes nothing.
    """
    rows, zero, count = target.rows, broadcast(np.float32(0.0)), len(out) // 2
    for row in range(box.first_row // 2, box.last_row // 2 + 1):
        begin, end = _range_of(edge_pixels, row, box)
        sp, y = pair(rows[0, 2 * row], rows[0, 2 * row + 1]), pair(rows[1, 2 * row], rows[1, 2 * row + 1])
        for at in range(2 * begin // HALF_LANES * HALF_LANES, 2 * end, HALF_LANES):
            below = count + at
            x, z = sp * load_halves(edge_pixels.sin_a, at, at), zero - sp * load_halves(edge_pixels.cos_a, at, at)
            old = load_halves(out, at, below)
            seen, wins, _ = intersect_rays(block, k, x, y, z, old)
            store_halves(out, at, below, where(wins, seen, old))


@subkernel()
def _draw_in_float64(setup, box, target, edge_pixels, out):
    """An :func:`omnisyn_cli.render.draw_kernels.exact_setup`, one sample at a time."""
    rows, cols = target.exact_rows, target.exact_cols
    for row in range(box.first_row, box.last_row + 1):
        begin, end = _range_of(edge_pixels, row // 2, box)
        sp, y = rows[0, row], rows[1, row]
        for at in range(2 * begin, 2 * end):
            col = 2 * edge_pixels.cols[at // 2] + at % 2
            if col >= 0:
                seen, _ = intersect_exactly(setup, sp * cols[0, col], y, sp * cols[1, col])
                place = row % 2 * (len(out) // 2) + at
                out[place] = max(seen, out[place])
