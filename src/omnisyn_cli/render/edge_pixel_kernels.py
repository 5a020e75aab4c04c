# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""The rasteriser for the samples of edge pixels, in numba: a target of twice the size, drawn at a few of its pixels.

Boxes, setups and ray tests are those of :mod:`omnisyn_cli.render.draw_kernels`. The samples of a row lie side by side,
whatever their columns, so they are tested eight at a time as well; an index by tiles of columns tells which of them lie
in a box.
"""

import numpy as np

from omnisyn_cli.compute.arrays import empty
from omnisyn_cli.compute.jit import inlined, kernel, subkernel
from omnisyn_cli.render.box_kernels import (
    FIRST_COL,
    FIRST_ROW,
    LAST_COL,
    LAST_ROW,
    MAX_BLOCK_POINTS,
    find_quad_boxes,
    place_quads,
    tighten_wide_box,
)
from omnisyn_cli.render.draw_kernels import Box, exact_corners, exact_setup, intersect_exactly, intersect_rays
from omnisyn_cli.render.quad_blocks import BLOCK, HOLE_FLAG
from omnisyn_cli.render.quad_kernels import BLOCK_ROWS, IN_FLOAT32, PRECISION, SKIPPED_QUAD, set_up_quads
from omnisyn_cli.render.simd import LANES, broadcast, load_halves, pair, store_halves, where
from omnisyn_cli.types import EDGE_TILE_COLUMNS

HALF_LANES = LANES // 2  # samples of a row that are tested together, with those below them


@kernel()
def rasterize_edge_pixels(quads, boxes, pose, target, edge_pixels, out):
    """Inverse depth of the samples of edge pixels, the upper row and then the lower one, negative if nothing is seen.

    ``boxes``: of the blocks of ``quads`` in the target itself, see
    :func:`omnisyn_cli.render.raster_kernels.find_block_bounds`. ``pose``: three rows of a rotation with the shift
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
