# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""The samples of spots against quads, in numba: the rasteriser of a target of twice the size, at a few of its pixels.

Boxes, plans and tests are those of :mod:`omnisyn_cli.render.draw_kernels`. The samples of a row lie side by side,
whatever columns they are of, so they are tested eight at a time as well; an index says which of them are in a box.
"""

import numpy as np

from omnisyn_cli.compute.jit import inlined, kernel
from omnisyn_cli.render.box_kernels import (
    FIRST_COL,
    FIRST_ROW,
    LAST_COL,
    LAST_ROW,
    MOST_POINTS,
    find_boxes,
    place_block,
    surround,
)
from omnisyn_cli.render.draw_kernels import exact_corners, exact_quad, seen_exactly, seen_on_rays
from omnisyn_cli.render.quad_blocks import BLOCK, REMOVED
from omnisyn_cli.render.quad_kernels import BLOCK_ROWS, DRAWN, IN_FLOAT32, NOT_AT_ALL, plan_quads
from omnisyn_cli.render.simd import LANES, load_halves, pair, splat, store_halves, where
from omnisyn_cli.types import EDGE_TILE_COLUMNS

HALF = LANES // 2
"""Samples of a row that are tested together, with those below them."""


@kernel()
def rasterize_edge_pixels(quads, boxes, pose, target, edge_pixels, out):
    """Inverse depth of the samples of spots, the upper row and then the lower one, negative where nothing is seen.

    Args:
        quads: the surface.
        boxes: of its blocks in the target itself, see :func:`omnisyn_cli.render.raster_kernels.find_block_bounds`.
        pose: the target's frame from theirs.
        target: of twice the size; its image is not used.
        spots: :class:`omnisyn_cli.types.EdgePixels`.
        out: that of the spots, changed.
    """
    width = target.width // 2
    block, found = np.empty((BLOCK_ROWS, MOST_POINTS), np.float32), np.empty((3 * BLOCK, 5), np.int64)
    for k in range(len(boxes)):
        if not _is_any(edge_pixels, boxes[k, 0] - 1, boxes[k, 1] + 1, boxes[k, 2] - 1, boxes[k, 3] + 1, width):
            continue
        codes, gaps = quads.codes[k], quads.gaps[BLOCK * k : BLOCK * (k + 1)]
        corners = place_block(quads, k, pose, target.scale, block)
        find_boxes(block, corners, gaps, target.rows[0], target.height, target.width)
        count = _find(block, corners, codes, gaps, target, edge_pixels, found)
        if count > 0:
            plan_quads(block, corners, codes, gaps, found[0, 0], found[count - 1, 0] + 1)
            _draw(block, corners, codes, gaps, found, count, target, edge_pixels, out)


@inlined()
def _is_any(edge_pixels, row_first, row_last, col_first, col_last, width):
    """Whether there are spots in a box, or beside it in its tiles; columns outside the image are wrapped."""
    tiles = edge_pixels.counts.shape[1] - 1
    begin, end = 0, tiles
    if col_first >= 0 and col_last < width:
        begin, end = col_first // EDGE_TILE_COLUMNS, col_last // EDGE_TILE_COLUMNS + 1
    for row in range(max(row_first - edge_pixels.top, 0), min(row_last - edge_pixels.top, len(edge_pixels.begins) - 1) + 1):
        if edge_pixels.counts[row, end] > edge_pixels.counts[row, begin]:
            return True
    return False


@kernel()
def _find(block, corners, codes, gaps, target, edge_pixels, found):
    """Write which quads of a block have spots in their boxes, and these; how many there are.

    Rows are those of the target of twice the size, columns of the target itself. Across the seam a quad has two boxes.
    """
    width, top, bottom, count = target.width, 2 * edge_pixels.top, 2 * (edge_pixels.top + len(edge_pixels.begins)), 0
    for k in range(BLOCK):
        if codes[k] & REMOVED or block[LAST_ROW, k] < top or block[FIRST_ROW, k] >= bottom:
            continue
        if block[LAST_COL, k] - block[FIRST_COL, k] >= width - 1:
            surround(block, corners, k, gaps[k] if len(gaps) > 0 else np.float32(0.0), target.height, width)
        row_first, row_last = max(np.int64(block[FIRST_ROW, k]), top), min(np.int64(block[LAST_ROW, k]), bottom - 1)
        left, right = np.int64(block[FIRST_COL, k]), np.int64(block[LAST_COL, k])
        if left >= 0 and right < width:
            count = _note(edge_pixels, k, row_first, row_last, left, right, found, count)
            continue
        for turn in (-width, 0, width):
            begin, end = max(left + turn, 0), min(right + turn, width - 1)
            count = _note(edge_pixels, k, row_first, row_last, begin, end, found, count)
    return count


@inlined()
def _note(edge_pixels, k, row_first, row_last, left, right, found, count):
    """Write a box if there are spots in it."""
    if row_first > row_last or left > right:
        return count
    if not _has_spots(edge_pixels, row_first >> 1, row_last >> 1, left >> 1, right >> 1):
        return count
    found[count, 0], found[count, 1], found[count, 2] = k, row_first, row_last
    found[count, 3], found[count, 4] = left >> 1, right >> 1
    return count + 1


@inlined()
def _has_spots(edge_pixels, row_first, row_last, col_first, col_last):
    """Whether there are spots in a box inside the target, or beside it in its tiles."""
    begin, end = col_first // EDGE_TILE_COLUMNS, col_last // EDGE_TILE_COLUMNS + 1
    for row in range(row_first - edge_pixels.top, row_last - edge_pixels.top + 1):
        if edge_pixels.counts[row, end] > edge_pixels.counts[row, begin]:
            return True
    return False


@kernel()
def _draw(block, corners, codes, gaps, found, count, target, edge_pixels, out):
    """The planned quads that were found."""
    for i in range(count):
        k, row_first, row_last, col_first, col_last = found[i]
        if block[DRAWN, k] == IN_FLOAT32:
            _draw_in_float32(block, k, row_first, row_last, col_first, col_last, target, edge_pixels, out)
        elif block[DRAWN, k] != NOT_AT_ALL:
            gap = np.float64(gaps[k]) if len(gaps) > 0 else 0.0
            quad = exact_quad(*exact_corners(block, corners, codes[k], k), gap)
            _draw_in_float64(quad, row_first, row_last, col_first, col_last, target, edge_pixels, out)


@inlined()
def _range_of(edge_pixels, row, col_first, col_last):
    """First spot, and the one after the last, of a row of the target between two columns, or beside them."""
    at = row - edge_pixels.top
    return edge_pixels.begins[at, col_first // EDGE_TILE_COLUMNS], edge_pixels.begins[at, col_last // EDGE_TILE_COLUMNS + 1]


@inlined()
def _draw_in_float32(block, k, row_first, row_last, col_first, col_last, target, edge_pixels, out):
    """Two spots at a time, with both rows of their samples."""
    rows, zero, count = target.rows, splat(np.float32(0.0)), len(out) // 2
    for row in range(row_first // 2, row_last // 2 + 1):
        begin, end = _range_of(edge_pixels, row, col_first, col_last)
        sp, y = pair(rows[0, 2 * row], rows[0, 2 * row + 1]), pair(rows[1, 2 * row], rows[1, 2 * row + 1])
        for at in range(2 * begin // HALF * HALF, 2 * end, HALF):
            below = count + at
            x, z = sp * load_halves(edge_pixels.sin_a, at, at), zero - sp * load_halves(edge_pixels.cos_a, at, at)
            old = load_halves(out, at, below)
            seen, wins, _ = seen_on_rays(block, k, x, y, z, old)
            store_halves(out, at, below, where(wins, seen, old))


@kernel()
def _draw_in_float64(quad, row_first, row_last, col_first, col_last, target, edge_pixels, out):
    rows, cols = target.exact_rows, target.exact_cols
    for row in range(row_first, row_last + 1):
        begin, end = _range_of(edge_pixels, row // 2, col_first, col_last)
        sp, y = rows[0, row], rows[1, row]
        for at in range(2 * begin, 2 * end):
            col = 2 * edge_pixels.cols[at // 2] + at % 2
            if col >= 0:
                seen, _ = seen_exactly(quad, sp * cols[0, col], y, sp * cols[1, col])
                place = row % 2 * (len(out) // 2) + at
                out[place] = max(seen, out[place])
