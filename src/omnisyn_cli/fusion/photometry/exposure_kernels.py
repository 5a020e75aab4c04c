"""The loops that change the exposure of pictures, in numba."""

import numpy as np

from omnisyn_cli.compute.jit import fast_kernel, inlined


@inlined(fastmath=True)
def interpolate_table(value, table, k):
    """``table[k]`` at a value from 0 to 1, linearly; beyond, in proportion to its ends: blends may overshoot."""
    last = table.shape[1] - 1
    if value <= np.float32(0.0):
        return value * table[k, 1] * np.float32(last)
    if value >= np.float32(1.0):
        return value * table[k, last]
    position = value * np.float32(last)
    index = min(int(position), last - 1)
    fraction = position - np.float32(index)
    return table[k, index] + fraction * (table[k, index + 1] - table[k, index])


@inlined(fastmath=True)
def exposed_weight(brightest, weight, loss, clipping):
    """The weight of a colour with this brightest channel, see :func:`expose_rows`."""
    zero, one = np.float32(0.0), np.float32(1.0)
    return weight * (one - loss * min(max((brightest - clipping) / (one - clipping), zero), one))


@fast_kernel()
def look_up_rows(image, table, begin, end):
    """Rows ``begin`` to ``end`` of an ``(height, width, 3)`` image through a ``(3, entries)`` table, in place."""
    for row in range(begin, end):
        for col in range(image.shape[1]):
            for k in range(3):
                image[row, col, k] = interpolate_table(image[row, col, k], table, k)


@fast_kernel()
def expose_rows(colour, table, loss, clipping):
    """Send colours ``(rows, width, 4)`` through a table, in place; clipped pixels lose a share of their weight.

    ``table`` ``(3, entries)`` is from 0 to 1 and goes on in proportion; white loses ``loss``, ``clipping`` (sRGB)
    nothing.
    """
    zero = np.float32(0.0)
    for row in range(colour.shape[0]):
        for col in range(colour.shape[1]):
            weight = colour[row, col, 3]
            if weight > zero:
                brightest = max(colour[row, col, 0], max(colour[row, col, 1], colour[row, col, 2]))
                colour[row, col, 3] = exposed_weight(brightest, weight, loss, clipping)
                for k in range(3):
                    colour[row, col, k] = interpolate_table(colour[row, col, k], table, k)
