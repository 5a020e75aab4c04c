"""The loops of :mod:`omnisyn_cli.baselines.soft_points`, in numba."""

import math

import numpy as np

from omnisyn_cli.compute.jit import kernel, subkernel

NO_POINT = -1  # index that says that no further point covers a pixel


@kernel()
def project_points(rho, mask, sin_p, cos_p, sin_a, cos_a, rotation, t, scale, points, begin, end):
    """Cosine and sine of the polar angle, column and inverse depth in the target, for source rows of points.

    They are written into ``points``, ``(height, width, 4)``, for source rows from ``begin`` to before ``end``; points
    that are masked or lie at the target's centre get a negative inverse depth. ``rho`` is the inverse depth of the
    source, 1/metre, ``mask`` tells which pixels are points. ``sin_p`` and ``cos_p`` are of the polar angle per source
    row, ``sin_a`` and ``cos_a`` of the azimuth per column; ``rotation`` and ``t`` (metres) of the target camera from
    the source camera; ``scale`` is the target's, see :func:`omnisyn_cli.geometry.sphere.pixel_scale`.
    """
    width = rho.shape[1]
    for row in range(begin, end):
        sp, y = np.float64(sin_p[row]), np.float64(cos_p[row])
        for col in range(width):
            x, z, w = sp * sin_a[col], -sp * cos_a[col], np.float64(rho[row, col])
            vx = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + w * t[0]
            vy = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + w * t[1]
            vz = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + w * t[2]
            length = math.sqrt(vx * vx + vy * vy + vz * vz)
            seen = mask[row, col] and length > 1e-9
            shrink = 1.0 / length if seen else 0.0
            points[row, col, 0] = vy * shrink
            points[row, col, 1] = math.sqrt(vx * vx + vz * vz) * shrink
            points[row, col, 2] = math.atan2(vx, -vz) * scale[2] + scale[3]
            points[row, col, 3] = w * shrink if seen else -1.0


@subkernel()
def disc_rows(point, radius, height, begin, end):
    """First and last row that a disc of angle ``radius`` around a point can touch."""
    polar = math.atan2(point[1], point[0])
    scale = height / math.pi
    first = math.ceil((polar - radius) * scale - 0.5)
    last = math.floor((polar + radius) * scale - 0.5)
    return max(begin, first), min(end - 1, last)


@subkernel()
def disc_columns(point, cos_radius, sp, cp, width):
    """First and last column of a row in a disc (spherical law of cosines); all with the pole, none beside it."""
    excess = cos_radius - cp * point[0]
    ring = sp * point[1]
    if excess > ring:
        return 0, -1
    if excess <= -ring:
        return 0, width - 1
    half = math.acos(excess / ring) * (width / (2.0 * math.pi))
    return math.ceil(point[2] - half), min(math.floor(point[2] + half), math.ceil(point[2] - half) + width - 1)


@kernel()
def list_points(points, order, radius, sin_p, cos_p, found, begin, end):
    """Indices of the first points in ``order`` over each pixel of target rows; :data:`NO_POINT` after the last."""
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
    """Blend the listed points from front to back; the last channel of ``out`` gets the opacity of all together.

    ``points`` are those of :func:`project_points`; ``found`` has their indices, ``(height, width, most)``, front to
    back, :data:`NO_POINT` after the last; ``features`` are ``(points, channels)``. Discs have a ``radius`` in radians;
    ``floor`` is the least squared distance from a disc's centre over its squared radius, which bounds the opacity below
    1. ``sin_p`` and ``cos_p`` are of the polar angle per target row; rows from ``begin`` to before ``end`` of ``out``,
    ``(height, width, channels + 1)``, are written.
    """
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
