# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""Patches: what of a mesh is no whole quad, in numba.

A cut quad leaves four quarters, one for each corner, and around each pole there is a fan of triangles, here quads with
two points at the pole. Patches have points of their own: first the quarters of all cut quads, then the caps.
"""

from __future__ import annotations

import numpy as np

from omnisyn_cli.jit import kernel
from omnisyn_cli.render.box_kernels import project_points
from omnisyn_cli.render.quads import CUT_EDGES
from omnisyn_cli.render.simd import load, splat, store_half, swapped

__all__ = ["AT_A_POLE", "transform_caps", "transform_quarters"]

AT_A_POLE = 1e-8
"""A point that is less than this (radians) from a pole of the target has no azimuth of its own."""


@kernel()
def transform_quarters(vertices, quads, cut_quads, weights, translation, scale, points, pixels, begin, end):
    """Points of the quarters of cut quads ``begin`` to ``end``, and the pixels they fall on.

    ``vertices`` are ``(4, rows, columns)``: x, y, z and inverse depth in the target's frame. ``weights[code, i]`` are
    the shares of corner i of a quad in the directions of its 16 points (point 0 of all quarters first) and then, in the
    inverse depths, what goes beyond them. ``points[a, i]`` is coordinate a of corner i of all patches.
    """
    columns, length = quads.shape[1], points.shape[2]
    t = translation.astype(np.float32)
    tx, ty, tz = splat(t[0]), splat(t[1]), splat(t[2])
    for k in range(begin, end):
        row, col = cut_quads[k] // columns, cut_quads[k] % columns
        shares = weights[quads[row, col] & CUT_EDGES]
        for half in range(0, 16, 8):
            x = y = z = w = excess = splat(np.float32(0.0))
            for corner in range(4):
                i, j = row + corner // 2, col + corner % 2
                share = load(shares[corner], half)
                x = x + share * splat(vertices[0, i, j])
                y = y + share * splat(vertices[1, i, j])
                z = z + share * splat(vertices[2, i, j])
                w = w + share * splat(vertices[3, i, j])
                excess = excess + load(shares[corner], 16 + half) * splat(vertices[3, i, j])
            moved = (x + excess * tx, y + excess * ty, z + excess * tz, w + excess)
            for axis in range(4):
                store_half(points[axis, half // 4], 4 * k, moved[axis])
                store_half(points[axis, half // 4 + 1], 4 * k, swapped(moved[axis]))
    for corner in range(4):
        place = corner * length
        project_points(points.reshape(-1), pixels.reshape(-1), 4 * length, place + 4 * begin, place + 4 * end, scale)


@kernel()
def transform_caps(rho, caps, vertices, rotation, t, scale, first, points, pixels):
    """Points of the caps, from patch ``first`` on, and the pixels they fall on.

    A pole that falls on a pole of the target has no column; it gets that of its triangle.
    """
    height, columns = rho.shape
    length = points.shape[2]
    for cap in range(2):
        ring, sign = (0, 1.0) if cap == 0 else (height - 1, -1.0)
        pole_corner, ring_corner = (0, 2) if cap == 0 else (2, 0)
        for col in range(columns):
            at = first + cap * columns + col
            for axis in range(3):
                turned = sign * rotation[axis, 1] + caps[cap, col, 0] * t[axis]
                points[axis, pole_corner, at] = points[axis, pole_corner + 1, at] = turned
                for side in range(2):
                    change = caps[cap, col, 1 + side] - rho[ring, (col + side) % columns]
                    points[axis, ring_corner + side, at] = vertices[axis, ring, col + side] + change * t[axis]
            points[3, pole_corner, at] = points[3, pole_corner + 1, at] = caps[cap, col, 0]
            points[3, ring_corner, at], points[3, ring_corner + 1, at] = caps[cap, col, 1], caps[cap, col, 2]
            for corner in range(4):
                place = corner * length + at
                project_points(points.reshape(-1), pixels.reshape(-1), 4 * length, place, place + 1, scale)
            x, y, z = points[0, pole_corner, at], points[1, pole_corner, at], points[2, pole_corner, at]
            if max(abs(x), abs(z)) <= AT_A_POLE * abs(y):
                pixels[1, pole_corner, at] = pixels[1, pole_corner + 1, at] = pixels[1, ring_corner, at]
