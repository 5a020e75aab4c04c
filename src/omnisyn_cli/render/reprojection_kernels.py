# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""The loop of :mod:`omnisyn_cli.render.reprojection`, in numba."""

import math

import numpy as np

from omnisyn_cli.compute.arrays import empty
from omnisyn_cli.compute.jit import fast_kernel
from omnisyn_cli.compute.trigonometry import atan2_fast
from omnisyn_cli.render.shade_kernels import LEVEL, X, Y, Z, find_source_directions


@fast_kernel()
def measure_occlusion(rho, tables, view, surface, min_inverse_depth, out, begin, end):
    """By how much a panorama's own surface is nearer to it than points, for target rows ``begin`` to ``end``.

    Args:
        rho: ``(height, width)`` inverse depth of the points from the target; negative where there is none.
        tables: :class:`omnisyn_cli.types.DirectionTables` of the target.
        view: :class:`omnisyn_cli.render.shade_kernels.SourceView`.
        surface: ``(rows, cols)`` inverse depth of the panorama.
        min_inverse_depth: that differences are relative to at least.
        out: ``(height, width)``, written: difference of inverse depth, seen from the panorama, over the larger of both;
            positive where the surface hides the point, 0 where there is no point.
        begin: first row.
        end: the row after the last.
    """
    width, (rows, cols) = rho.shape[1], surface.shape
    row_scale, col_scale = np.float32(rows / math.pi), np.float32(cols / (2.0 * math.pi))
    coordinates, zero = empty((4, width), np.float32), np.float32(0.0)
    for row in range(begin, end):
        find_source_directions(
            rho[row], tables.sin_p[row], tables.cos_p[row], tables.sin_a, tables.cos_a, view, coordinates
        )
        for col in range(width):
            dx, dz = coordinates[X, col], coordinates[Z, col]
            coordinates[Y, col] = atan2_fast(math.sqrt(dx * dx + dz * dz), coordinates[Y, col]) * row_scale
            coordinates[X, col] = (atan2_fast(dx, -dz) + np.float32(math.pi)) * col_scale
            # The length of the direction is the point's distance from the source over that from the target.
            distance_ratio = math.sqrt(coordinates[LEVEL, col]) + np.float32(1e-9)
            coordinates[LEVEL, col] = max(rho[row, col], zero) / distance_ratio
        for col in range(width):
            i = min(max(np.int32(coordinates[Y, col]), 0), rows - 1)
            j = min(max(np.int32(coordinates[X, col]), 0), cols - 1)
            expected, own = coordinates[LEVEL, col], surface[i, j]
            difference = (own - expected) / max(expected, own, min_inverse_depth)
            out[row, col] = difference if rho[row, col] >= zero else zero
