# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""The loop of :mod:`omnisyn_cli.render.reprojection`, in numba."""

import math

import numpy as np

from omnisyn_cli.compute.jit import fast_kernel
from omnisyn_cli.render.shade_kernels import LEVEL, X, Y, Z, find_directions
from omnisyn_cli.render.trigonometry import atan2_fast


@fast_kernel()
def measure_occlusion(rho, sin_p, cos_p, sin_a, cos_a, rotation, t, surface, least, out, begin, end):
    """By how much a panorama's surface is nearer than points, for target rows ``begin`` to ``end``.

    Args:
        rho: ``(height, width)`` inverse depth of the points from the target; below 0 there is none.
        sin_p: of the target's directions, as the next three.
        cos_p: likewise.
        sin_a: likewise.
        cos_a: likewise.
        rotation: target from panorama.
        t: likewise.
        surface: ``(rows, cols)`` inverse depth of the panorama.
        least: inverse depth that differences count against at least.
        out: ``(height, width)``, written: difference of inverse depth, seen from the panorama, over the greater of
            both; positive where the surface hides the point, 0 where there is no point.
        begin: first row.
        end: the row after the last.
    """
    width, (rows, cols) = rho.shape[1], surface.shape
    down, across = np.float32(rows / math.pi), np.float32(cols / (2.0 * math.pi))
    places, zero = np.empty((4, width), np.float32), np.float32(0.0)
    for row in range(begin, end):
        find_directions(rho[row], sin_p[row], cos_p[row], sin_a, cos_a, rotation, t, places)
        for col in range(width):
            dx, dz = places[X, col], places[Z, col]
            places[Y, col] = atan2_fast(math.sqrt(dx * dx + dz * dz), places[Y, col]) * down
            places[X, col] = (atan2_fast(dx, -dz) + np.float32(math.pi)) * across
            distance = math.sqrt(places[LEVEL, col]) + np.float32(1e-9)
            places[LEVEL, col] = max(rho[row, col], zero) / distance
        for col in range(width):
            i = min(max(np.int32(places[Y, col]), 0), rows - 1)
            j = min(max(np.int32(places[X, col]), 0), cols - 1)
            expected, seen = places[LEVEL, col], surface[i, j]
            difference = (seen - expected) / max(expected, seen, least)
            out[row, col] = difference if rho[row, col] >= zero else zero
