"""The loop before a fusion network, in numba; what it says about weights is in the loop that blends."""

import numpy as np

from omnisyn_cli.compute.jit import fast_kernel
from omnisyn_cli.types import MIN_VISIBLE_WEIGHT

LOOKED_AT = 4
"""Rows and columns of a block that are enough for its mean."""


@fast_kernel()
def downsample_rows(colour, rho, coarse, coarse_rho, top, height):
    """Some rows of a rendering at a smaller size: means over blocks of what is seen, by its weight.

    Of large blocks every so many-th row and column is looked at, at least :data:`LOOKED_AT` of each.

    Args:
        colour: ``(rows, width, 4)`` RGB and weight; the rows are those of whole blocks.
        rho: inverse depth.
        coarse: ``(coarse height, cols, 4)`` written: RGB in [0, 1]; the mean of the weight, what is not seen having
            none. All of it 0 where nothing is seen.
        coarse_rho: written; −1 where nothing is seen.
        top: row of the picture that the first row is.
        height: rows of the picture, at least as many as coarse ones.
    """
    width = rho.shape[1]
    rows, cols = coarse_rho.shape
    zero, one = np.float32(0.0), np.float32(1.0)
    for i in range(-(-top * rows // height), -(-(top + len(rho)) * rows // height)):
        above, below = i * height // rows - top, (i + 1) * height // rows - top
        for j in range(cols):
            left, right = j * width // cols, (j + 1) * width // cols
            down, across = max(1, (below - above) // LOOKED_AT), max(1, (right - left) // LOOKED_AT)
            red = green = blue = near = total = zero
            count = 0
            for row in range(above, below, down):
                for col in range(left, right, across):
                    count += 1
                    weight = colour[row, col, 3]
                    if weight > MIN_VISIBLE_WEIGHT:
                        red += weight * colour[row, col, 0]
                        green += weight * colour[row, col, 1]
                        blue += weight * colour[row, col, 2]
                        near += weight * max(rho[row, col], zero)
                        total += weight
            weight = total / np.float32(count)
            if weight > MIN_VISIBLE_WEIGHT:
                coarse[i, j, 0] = min(one, max(zero, red / total))
                coarse[i, j, 1] = min(one, max(zero, green / total))
                coarse[i, j, 2] = min(one, max(zero, blue / total))
                coarse[i, j, 3] = weight
                coarse_rho[i, j] = near / total
            else:
                for k in range(4):
                    coarse[i, j, k] = zero
                coarse_rho[i, j] = -one
