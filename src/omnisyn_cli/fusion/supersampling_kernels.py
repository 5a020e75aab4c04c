# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""The loops of :mod:`omnisyn_cli.fusion.supersampling`, in numba."""

import numpy as np

from omnisyn_cli.compute.jit import fast_kernel, inlined
from omnisyn_cli.fusion.pixel_classes import DISAGREEMENT, FARTHEST
from omnisyn_cli.types import EDGE_PIXEL_MULTIPLE, EDGE_TILE_COLUMNS

TOGETHER = 64
"""Pixels that are passed over together if none of them is marked."""


@fast_kernel()
def mark_edge_pixels(first, second, picture, scale, contrast, marks, begin, end):
    """Mark pixels of rows ``begin`` to ``end`` beside a jump of either surface that can be told by their colours.

    Args:
        first: ``(height, width)`` inverse depth of the first view, negative where nothing is seen.
        second: of the second view.
        picture: ``(height, width, 3)`` what they were blended to.
        scale: times its samples are levels of 8 bits.
        contrast: levels by which some channel has to differ among a pixel and those around it.
        marks: ``(height, width)`` uint8, written: 1 for a jump of the first surface, 2 for one of the second, 3.
        begin: first row.
        end: the row after the last.
    """
    height, width = marks.shape
    for row in range(begin, end):
        above, below = max(row - 1, 0), min(row + 1, height - 1)
        marks[row] = 0
        _mark_jumps(first[above], first[row], first[below], marks[row], np.uint8(1))
        _mark_jumps(second[above], second[row], second[below], marks[row], np.uint8(2))
        for left in range(0, width, TOGETHER):
            right = min(left + TOGETHER, width)
            if not _is_any(marks[row], left, right):
                continue
            for col in range(left, right):
                if marks[row, col] and not _stands_out(picture, scale, contrast, above, below, col):
                    marks[row, col] = 0


@fast_kernel()
def _mark_jumps(above, rho, below, marks, mark):
    """Mark those pixels of a row that one of their four neighbours is apart from."""
    last = len(rho) - 1
    for col in range(1, last):
        here = rho[col]
        is_other_surface = _is_apart(here, rho[col - 1]) | _is_apart(here, rho[col + 1])
        is_other_surface |= _is_apart(here, above[col]) | _is_apart(here, below[col])
        marks[col] |= mark if is_other_surface else np.uint8(0)
    for col in (0, last):
        here = rho[col]
        is_other_surface = _is_apart(here, rho[col - 1]) | _is_apart(here, rho[0 if col == last else col + 1])
        is_other_surface |= _is_apart(here, above[col]) | _is_apart(here, below[col])
        marks[col] |= mark if is_other_surface else np.uint8(0)


@fast_kernel()
def _is_any(marks, begin, end):
    found = np.uint8(0)
    for col in range(begin, end):
        found |= marks[col]
    return found != 0


@inlined(fastmath=True)
def _is_apart(one, other):
    """:func:`omnisyn_cli.fusion.pixel_classes.is_other_surface` of two pixels, what is not seen being infinitely far."""
    a, b = max(one, np.float32(0.0)), max(other, np.float32(0.0))
    return abs(a - b) > np.float32(DISAGREEMENT) * max(max(a, b), np.float32(FARTHEST))


@inlined(fastmath=True)
def _stands_out(picture, scale, contrast, above, below, col):
    """Whether some channel differs enough among nine pixels; rows end, columns wrap."""
    last = picture.shape[1] - 1
    left, right = col - 1 if col > 0 else last, col + 1 if col < last else 0
    for k in range(3):
        lowest, highest = np.float32(255.0), np.float32(0.0)
        for row in range(above, below + 1):
            for at in (left, col, right):
                value = min(max(picture[row, at, k] * scale, np.float32(0.0)), np.float32(255.0))
                lowest, highest = min(lowest, value), max(highest, value)
        if int(highest + np.float32(0.5)) - int(lowest + np.float32(0.5)) >= contrast:
            return True
    return False


@fast_kernel()
def list_edge_pixels(marks, top, begins, cols, sin_table, cos_table, sin_a, cos_a):
    """Write :class:`omnisyn_cli.types.EdgePixels` of the marked pixels of some rows; how many there are with padding.

    Args:
        marks: ``(height, width)``.
        top: first row.
        begins: ``(rows, tiles + 1)``, written.
        cols: with room for all, written.
        sin_table: sines of the azimuths of the columns of a picture of twice the size.
        cos_table: cosines.
        sin_a: of the samples, written.
        cos_a: likewise.
    """
    count, width = 0, marks.shape[1]
    for row in range(len(begins)):
        for left in range(0, width, TOGETHER):
            right = min(left + TOGETHER, width)
            if not _is_any(marks[top + row], left, right):
                begins[row, left // EDGE_TILE_COLUMNS : -(-right // EDGE_TILE_COLUMNS)] = count
                continue
            for col in range(left, right):
                if col % EDGE_TILE_COLUMNS == 0:
                    begins[row, col // EDGE_TILE_COLUMNS] = count
                if marks[top + row, col]:
                    cols[count] = col
                    count += 1
        while count % EDGE_PIXEL_MULTIPLE != 0:
            cols[count] = -1
            count += 1
        begins[row, -1] = count
    for at in range(count):
        col = max(cols[at], 0)
        for side in range(2):
            sin_a[2 * at + side], cos_a[2 * at + side] = sin_table[2 * col + side], cos_table[2 * col + side]
    return count


@fast_kernel()
def prefill_visibility(marks, mark, rho, top, begins, cols, counts, inverse_depth):
    """Write what is known of the samples of a view: where it does not jump they lie on a plane with their pixels.

    Args:
        marks: ``(height, width)``.
        mark: which of them are jumps of this view's.
        rho: ``(height, width)`` its inverse depth.
        top: first row.
        begins: see :class:`omnisyn_cli.types.EdgePixels`.
        cols: likewise.
        counts: written.
        inverse_depth: ``(2, samples)``, written.
    """
    height, width = marks.shape
    for row in range(len(begins)):
        here, tiles, tile, count = top + row, begins.shape[1] - 1, 0, 0
        above, below = max(here - 1, 0), min(here + 1, height - 1)
        for at in range(begins[row, 0], begins[row, tiles]):
            col = cols[at]
            while col >= 0 and tile * EDGE_TILE_COLUMNS <= col:
                counts[row, tile] = count
                tile += 1
            left, right = (col - 1 if col > 0 else width - 1), (col + 1 if col < width - 1 else 0)
            is_sought = col < 0 or marks[here, col] & mark
            count += 1 if is_sought and col >= 0 else 0
            across = np.float32(0.125) * (rho[here, right] - rho[here, left])
            down = np.float32(0.25) * (rho[below, col] - rho[above, col]) / np.float32(max(below - above, 1))
            for half in range(2):
                for side in range(2):
                    value = rho[here, col] + (across if side else -across) + (down if half else -down)
                    known = max(value, np.float32(0.0)) if rho[here, col] >= np.float32(0.0) else np.float32(-1.0)
                    inverse_depth[half, 2 * at + side] = np.float32(-1.0) if is_sought else known
        counts[row, tile:] = count
