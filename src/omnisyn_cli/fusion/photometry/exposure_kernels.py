"""The loops that give pictures another exposure, in numba."""

import numpy as np

from omnisyn_cli.compute.jit import fast_kernel, inlined


@inlined(fastmath=True)
def _looked_up(value, table, k):
    """``table[k]`` at a value from 0 to 1, linearly; values beyond go on in proportion to its ends."""
    last = table.shape[1] - 1
    if value <= np.float32(0.0):
        return value * table[k, 1] * np.float32(last)
    if value >= np.float32(1.0):
        return value * table[k, last]
    place = value * np.float32(last)
    index = min(int(place), last - 1)
    part = place - np.float32(index)
    return table[k, index] + part * (table[k, index + 1] - table[k, index])


@fast_kernel()
def look_up_rows(image, table, begin, end):
    """Rows ``begin`` to ``end`` of an ``(height, width, 3)`` image through a ``(3, entries)`` table, in place."""
    for row in range(begin, end):
        for col in range(image.shape[1]):
            for k in range(3):
                image[row, col, k] = _looked_up(image[row, col, k], table, k)


@fast_kernel()
def expose_rows(colour, table, loss, clipping):
    """Colours through ``table``, in place; what was cut off loses a share of its weight.

    Args:
        colour: ``(rows, width, 4)`` RGB and weight.
        table: ``(3, entries)`` for values from 0 to 1; others go on in proportion to its ends.
        loss: share of the weight that a white pixel loses.
        clipping: value from which on a channel counts as cut off, gradually up to 1.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    for row in range(colour.shape[0]):
        for col in range(colour.shape[1]):
            weight = colour[row, col, 3]
            if weight > zero:
                brightest = max(colour[row, col, 0], max(colour[row, col, 1], colour[row, col, 2]))
                cut_off = min(max((brightest - clipping) / (one - clipping), zero), one)
                colour[row, col, 3] = weight * (one - loss * cut_off)
                for k in range(3):
                    colour[row, col, k] = _looked_up(colour[row, col, k], table, k)
