"""The loops of :mod:`omnisyn_cli.baselines.two_pass`, in numba."""

import math

import numpy as np

from omnisyn_cli.compute.jit import kernel


@kernel()
def flatten_triangles(direction, rho, rotation, t, scale, corners, begin, end):
    """Row, column and inverse depth in the target of the corners of triangles ``begin`` to ``end``."""
    for face in range(begin, end):
        for k in range(3):
            x, y, z, w = direction[face, k, 0], direction[face, k, 1], direction[face, k, 2], rho[face, k]
            vx = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + w * t[0]
            vy = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + w * t[1]
            vz = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + w * t[2]
            length = math.sqrt(vx * vx + vy * vy + vz * vz)
            corners[face, k, 0] = math.atan2(math.sqrt(vx * vx + vz * vz), vy) * scale[0] + scale[1]
            corners[face, k, 1] = math.atan2(vx, -vz) * scale[2] + scale[3]
            corners[face, k, 2] = w / length if length > 0.0 else 0.0


@kernel()
def draw_flat_triangles(numbers, corners, turn, out_rho, out_face, begin, end):
    """Draw in an image turned by ``turn`` columns; none from behind, or wider than half of it (across its seam)."""
    width = out_rho.shape[1]
    for face in range(corners.shape[0]):
        r0, r1, r2 = corners[face, 0, 0], corners[face, 1, 0], corners[face, 2, 0]
        low, high = min(r0, min(r1, r2)), max(r0, max(r1, r2))
        if high < begin or low > end - 1:
            continue
        c0, c1, c2 = (
            (corners[face, 0, 1] + turn) % width,
            (corners[face, 1, 1] + turn) % width,
            (corners[face, 2, 1] + turn) % width,
        )
        left, right = min(c0, min(c1, c2)), max(c0, max(c1, c2))
        area = (c1 - c0) * (r2 - r0) - (c2 - c0) * (r1 - r0)
        if right - left > 0.5 * width or area <= 0.0:
            continue
        for row in range(max(begin, math.ceil(low)), min(end - 1, math.floor(high)) + 1):
            for turned in range(math.ceil(left), math.floor(right) + 1):
                b0 = (c1 - turned) * (r2 - row) - (c2 - turned) * (r1 - row)
                b1 = (c2 - turned) * (r0 - row) - (c0 - turned) * (r2 - row)
                b2 = (c0 - turned) * (r1 - row) - (c1 - turned) * (r0 - row)
                if b0 < 0.0 or b1 < 0.0 or b2 < 0.0:
                    continue
                col = (turned - turn) % width
                seen = (b0 * corners[face, 0, 2] + b1 * corners[face, 1, 2] + b2 * corners[face, 2, 2]) / area
                if np.float32(seen) > out_rho[row, col]:
                    out_rho[row, col] = seen
                    out_face[row, col] = numbers[face]
