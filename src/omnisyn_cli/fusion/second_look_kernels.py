# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""The loops of :mod:`omnisyn_cli.fusion.second_look` over the rows of a frame, in numba."""

import math

import numpy as np

from omnisyn_cli.fusion.kernels import neighbours, stored
from omnisyn_cli.runtime.jit import fast_kernel, inlined


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
def suppose_rows(supposed, share, top, height, points):
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
