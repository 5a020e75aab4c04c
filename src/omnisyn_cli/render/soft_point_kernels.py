"""The loops of :mod:`omnisyn_cli.render.soft_points`, in numba."""

import math

import numpy as np

from omnisyn_cli.render.point_kernels import disc_columns, disc_rows
from omnisyn_cli.runtime.jit import kernel

NO_POINT = -1


@kernel()
def list_points(points, order, radius, sin_p, cos_p, found, begin, end):
    """The first points in ``order`` whose discs cover each pixel of target rows ``begin`` to ``end``.

    ``found`` gets as many indices as its last axis holds, :data:`NO_POINT` after the last.
    """
    height, width, most = found.shape
    found[begin:end] = NO_POINT
    count = np.zeros((end - begin, width), np.int32)
    cos_radius = math.cos(radius)
    for k in range(order.shape[0]):
        point = points[order[k]]
        first, last = disc_rows(point, radius, height, begin, end)
        for row in range(first, last + 1):
            left, right = disc_columns(point, cos_radius, sin_p[row], cos_p[row], width)
            for turned in range(left, right + 1):
                col = turned % width
                here = count[row - begin, col]
                if here < most:
                    found[row, col, here] = order[k]
                    count[row - begin, col] = here + 1


@kernel()
def composite(points, found, features, radius, floor, sin_p, cos_p, out, begin, end):
    """Blend the listed points from front to back; the last channel of ``out`` gets the opacity of all together."""
    width, most = found.shape[1], found.shape[2]
    channels = features.shape[1]
    largest = (2.0 * math.sin(0.5 * radius)) ** 2
    for row in range(begin, end):
        for col in range(width):
            left = 1.0
            out[row, col] = 0.0
            for k in range(most):
                index = found[row, col, k]
                if index == NO_POINT:
                    break
                point = points[index]
                turn = math.cos((col - point[2]) * (2.0 * math.pi / width))
                square = (2.0 - 2.0 * (cos_p[row] * point[0] + sin_p[row] * point[1] * turn)) / largest
                alpha = 1.0 - math.sqrt(min(max(square, floor), 1.0))
                share = np.float32(left * alpha)
                left *= 1.0 - alpha
                for channel in range(channels):
                    out[row, col, channel] += share * features[index, channel]
            out[row, col, channels] = 1.0 - left
