"""The loop that downsamples a layer for a fusion network, in numba."""

import numpy as np

from omnisyn_cli.compute.jit import fast_kernel
from omnisyn_cli.types import MIN_VISIBLE_WEIGHT

# Rows and columns of a large block that are read: 16 pixels are enough for its mean. Set by hand.
SAMPLES_PER_BLOCK_SIDE = 4


@fast_kernel()
def downsample_rows(colour, rho, coarse, coarse_rho, top, height):
    """Some rows of a layer at a smaller size: means over blocks of what is seen, by its weight.

    Of large blocks only :data:`SAMPLES_PER_BLOCK_SIDE` rows and columns, or some more, are read. ``colour`` ``(rows,
    width, 4)``, RGB and weight, and ``rho`` are rows of whole blocks, from ``top`` on, of a frame of ``height`` rows.
    Written are ``coarse``, RGB in [0, 1] and mean weight, 0 where nothing is seen, and ``coarse_rho``, −1 there.
    """
    width = rho.shape[1]
    rows, cols = coarse_rho.shape
    zero, one = np.float32(0.0), np.float32(1.0)
    for i in range(-(-top * rows // height), -(-(top + len(rho)) * rows // height)):
        above, below = i * height // rows - top, (i + 1) * height // rows - top
        for j in range(cols):
            left, right = j * width // cols, (j + 1) * width // cols
            row_step = max(1, (below - above) // SAMPLES_PER_BLOCK_SIDE)
            col_step = max(1, (right - left) // SAMPLES_PER_BLOCK_SIDE)
            red = green = blue = rho_sum = total = zero
            count = 0
            for row in range(above, below, row_step):
                for col in range(left, right, col_step):
                    count += 1
                    weight = colour[row, col, 3]
                    if weight > MIN_VISIBLE_WEIGHT:
                        red += weight * colour[row, col, 0]
                        green += weight * colour[row, col, 1]
                        blue += weight * colour[row, col, 2]
                        rho_sum += weight * max(rho[row, col], zero)
                        total += weight
            weight = total / np.float32(count)
            if weight > MIN_VISIBLE_WEIGHT:
                coarse[i, j, 0] = min(one, max(zero, red / total))
                coarse[i, j, 1] = min(one, max(zero, green / total))
                coarse[i, j, 2] = min(one, max(zero, blue / total))
                coarse[i, j, 3] = weight
                coarse_rho[i, j] = rho_sum / total
            else:
                for k in range(4):
                    coarse[i, j, k] = zero
                coarse_rho[i, j] = -one
