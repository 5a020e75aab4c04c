"""The loops of :mod:`omnisyn_cli.render.points`, in numba."""

import math

import numpy as np

from omnisyn_cli.runtime.jit import kernel

EMPTY = -1


@kernel()
def project_points(rho, mask, sin_p, cos_p, sin_a, cos_a, rotation, t, scale, points, begin, end):
    """Cosine and sine of the polar angle, column and inverse depth in the target, for source rows of points.

    Points that are masked or lie at the target's centre get a negative inverse depth.
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


@kernel()
def disc_rows(point, radius, height, begin, end):
    """First and last row that a disc of angle ``radius`` around a point can touch."""
    polar = math.atan2(point[1], point[0])
    scale = height / math.pi
    first = math.ceil((polar - radius) * scale - 0.5)
    last = math.floor((polar + radius) * scale - 0.5)
    return max(begin, first), min(end - 1, last)


@kernel()
def disc_columns(point, cos_radius, sp, cp, width):
    """First and last column of a row that a disc covers; all of them if it holds the pole, none if it misses the row.

    The spherical law of cosines: ``cos radius = cos p·cos p₀ + sin p·sin p₀·cos Δazimuth``.
    """
    excess = cos_radius - cp * point[0]
    ring = sp * point[1]
    if excess > ring:
        return 0, -1
    if excess <= -ring:
        return 0, width - 1
    half = math.acos(excess / ring) * (width / (2.0 * math.pi))
    return math.ceil(point[2] - half), min(math.floor(point[2] + half), math.ceil(point[2] - half) + width - 1)


@kernel()
def find_nearest(points, radius, sin_p, cos_p, out_rho, begin, end):
    """The largest inverse depth of all discs over each pixel of target rows ``begin`` to ``end``; −1 where none is."""
    height, width = out_rho.shape
    out_rho[begin:end] = -1.0
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            point = points[i, j]
            if point[3] < 0.0:
                continue
            first, last = disc_rows(point, radius, height, begin, end)
            for row in range(first, last + 1):
                left, right = disc_columns(point, math.cos(radius), sin_p[row], cos_p[row], width)
                for turned in range(left, right + 1):
                    col = turned % width
                    out_rho[row, col] = max(out_rho[row, col], np.float32(point[3]))


@kernel()
def choose_points(points, radius, same_surface, sin_p, cos_p, aside, out_rho, out_face, begin, end):
    """Of the points on the nearest surface, the one whose centre is closest to the pixel; ties go to the first.

    ``out_rho`` holds the answer of :func:`find_nearest` and gets the inverse depth of the chosen point; ``aside`` is
    room for one minus the cosine between the two, which single precision can tell apart where cosines are nearly 1.
    """
    height, width = out_rho.shape
    aside[begin:end] = 4.0
    out_face[begin:end] = EMPTY
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            point = points[i, j]
            if point[3] < 0.0:
                continue
            first, last = disc_rows(point, radius, height, begin, end)
            for row in range(first, last + 1):
                left, right = disc_columns(point, math.cos(radius), sin_p[row], cos_p[row], width)
                for turned in range(left, right + 1):
                    col = turned % width
                    if point[3] < same_surface * out_rho[row, col]:
                        continue
                    turn = math.cos((turned - point[2]) * (2.0 * math.pi / width))
                    distance = np.float32(1.0 - (cos_p[row] * point[0] + sin_p[row] * point[1] * turn))
                    if distance < aside[row, col]:
                        aside[row, col] = distance
                        out_face[row, col] = i * points.shape[1] + j
    for row in range(begin, end):
        for col in range(width):
            face = out_face[row, col]
            if face != EMPTY:
                out_rho[row, col] = points[face // points.shape[1], face % points.shape[1], 3]
