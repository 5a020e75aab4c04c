# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""The loops of :mod:`omnisyn_cli.fusion.warp_candidates` over the rows of a frame, in numba."""

import math

import numpy as np

from omnisyn_cli.compute.jit import fast_kernel, inlined
from omnisyn_cli.fusion.blend_kernels import neighbours, stored


@inlined(fastmath=True)
def _columns_after(j, width, cols):
    """The pixels whose centres lie between those of coarse columns ``j`` and ``j + 1``: first, and after the last."""
    begin = math.ceil((j + 0.5) * width / cols - 0.5)
    return max(0, begin), min(width, math.ceil((j + 1.5) * width / cols - 0.5))


@inlined(fastmath=True)
def _corners(values, row, j, height):
    """Values of a coarse map at the left and the right of pixels of a row after coarse column ``j``, over the seam."""
    rows, cols = values.shape
    i, down = neighbours(row, height, rows)
    upper, lower, before, beyond = max(i, 0), min(i + 1, rows - 1), j % cols, (j + 1) % cols
    left = values[upper, before] + down * (values[lower, before] - values[upper, before])
    return left, values[upper, beyond] + down * (values[lower, beyond] - values[upper, beyond])


@fast_kernel()
def hypothesis_rows(supposed, share, top, height, points):
    """The points that are looked up in some rows; whether there are any.

    Args:
        supposed: ``(rows, cols)`` inverse depth.
        share: ``(rows, cols)``, at a size of its own.
        top: row of the picture that the first row is.
        height: rows of the picture.
        points: ``(rows, width)``, written: the inverse depth that lies nearest, −1 where none is looked up.
    """
    (rows, cols), width, zero = supposed.shape, points.shape[1], np.float32(0.0)
    is_any = False
    for k in range(len(points)):
        i = (top + k) * rows // height
        for j in range(-1, share.shape[1]):
            begin, end = _columns_after(j, width, share.shape[1])
            left, right = _corners(share, top + k, j, height)
            if max(left, right) > zero:
                is_any = True
                for col in range(begin, end):
                    points[k, col] = supposed[i, col * cols // width]
            else:
                points[k, begin:end] = np.float32(-1.0)
    return is_any


@fast_kernel()
def add_rows(share, colour, top, height, total):
    """Add a candidate's share of the colours, and the share, to some rows of ``total``.

    Args:
        share: ``(rows, cols)``, interpolated over the seam.
        colour: ``(rows, width, 4)`` RGB and alpha.
        top: row of the picture that the first row is.
        height: rows of the picture.
        total: ``(rows, width, 4)``, changed.
    """
    width, cols, half = total.shape[1], share.shape[1], np.float32(0.5)
    step = np.float32(cols / width)
    for k in range(len(total)):
        for j in range(-1, cols):
            left, right = _corners(share, top + k, j, height)
            if max(left, right) <= np.float32(0.0):
                continue
            begin, end = _columns_after(j, width, cols)
            for col in range(begin, end):
                along = (np.float32(col) + half) * step - half - np.float32(j)
                counts = colour[k, col, 3] * (left + along * (right - left))
                for channel in range(3):
                    total[k, col, channel] += counts * colour[k, col, channel]
                total[k, col, 3] += counts


@fast_kernel()
def join_rows(total, storing, picture):
    """Some rows of a picture, of which ``total`` takes its share; ``storing`` is of samples in the picture."""
    one, zero = np.float32(1.0), np.float32(0.0)
    for k in range(len(total)):
        for col in range(total.shape[1]):
            taken = min(total[k, col, 3], one)
            if taken > zero:
                for channel in range(3):
                    own = np.float32(picture[k, col, channel]) / storing.scale
                    picture[k, col, channel] = stored((one - taken) * own + total[k, col, channel], storing)


@inlined(fastmath=True)
def _difference(one, other):
    """Mean difference of two colours."""
    return (abs(one[0] - other[0]) + abs(one[1] - other[1]) + abs(one[2] - other[2])) * np.float32(1.0 / 3.0)


@inlined(fastmath=True)
def _told(nearer, most):
    """How much nearer (positive) or farther a surface is, in [−1, 1]."""
    return min(max(nearer / most, -np.float32(1.0)), np.float32(1.0))


@inlined(fastmath=True)
def _confront(shown, seen, colours, nearer, most, row, col, values):
    """Add what the other view says of what one shows in a pixel to ``values``; how many pixels that is, 1 or 0."""
    zero = np.float32(0.0)
    if seen[row, col] < zero:
        return 0
    gap = _told(nearer[row, col], most)
    for k in range(3):
        values[k] += colours[row, col, k]
    values[3] += _difference(colours[row, col], shown[row, col])
    values[4] += max(gap, zero)
    values[5] += max(-gap, zero)
    return 1


@inlined(fastmath=True)
def _suppose(colours, nearer, roots, most, row, col, share, values):
    """Add a share of what both photographs say of both supposed surfaces in a pixel to ``values``."""
    for candidate in range(4):
        for k in range(3):
            values[3 * candidate + k] += share * colours[candidate, row, col, k]
        values[14 + candidate] += share * _told(nearer[candidate, row, col], most)
    for k in range(2):
        values[12 + k] += share * roots[k, row, col]
        values[18 + k] += share * _difference(colours[2 * k, row, col], colours[2 * k + 1, row, col])


@fast_kernel()
def average_candidates(shown, seen, colours, nearer, roots, most, planes, begin, end):
    """All planes of a second look, see :mod:`omnisyn_cli.fusion.warp_candidates`: means over blocks of pixels.

    Args:
        shown: ``(rows, cols, 3)`` of either view.
        seen: ``(2, rows, cols)`` inverse depth of that; below 0 there is none, and nothing counts there.
        colours: ``(6, rows, cols, 4)`` of the other view there; then of both photographs at the farthest surface, then
            at the nearest.
        nearer: ``(6, rows, cols)``, by how much the surfaces of those who answer are nearer.
        roots: ``(2, rows, cols)`` of both supposed surfaces.
        most: of ``nearer``, that is told.
        planes: ``(LOOKS, height, width)``, written.
        begin: first of its rows.
        end: the row after the last.
    """
    finer = seen.shape[1] // planes.shape[1]
    share, values = np.float32(1.0 / (finer * finer)), np.empty(len(planes), np.float32)
    for i in range(begin, end):
        for j in range(planes.shape[2]):
            values[:] = np.float32(0.0)
            first, second = 0, 0
            for row in range(finer * i, finer * (i + 1)):
                for col in range(finer * j, finer * (j + 1)):
                    first += _confront(shown[0], seen[0], colours[0], nearer[0], most, row, col, values[:6])
                    second += _confront(shown[1], seen[1], colours[1], nearer[1], most, row, col, values[6:12])
                    _suppose(colours[2:], nearer[2:], roots, most, row, col, share, values[12:])
            values[:6] /= np.float32(max(first, 1))
            values[6:12] /= np.float32(max(second, 1))
            planes[:, i, j] = values
