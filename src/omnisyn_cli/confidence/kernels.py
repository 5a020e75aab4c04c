"""The loop over the pixels of a frame, in numba."""

from __future__ import annotations

import math

import numpy as np

from omnisyn_cli.jit import fast_kernel
from omnisyn_cli.types import BELIEF, UNSEEN

__all__ = ["confidence_rows"]


@fast_kernel()
def confidence_rows(first, first_rho, second, second_rho, alone, apart, differing, out, begin, end):
    """Confidence of rows ``begin`` to ``end``.

    Args:
        first: ``(height, width, 4)`` RGB and worth.
        first_rho: its inverse depth.
        second: as ``first``.
        second_rho: as ``first_rho``.
        alone: confidence of what is fully believed but seen by one view only.
        apart: relative difference of inverse depth at which agreement has fallen to 1/e.
        differing: difference of colour (root mean square) at which it has.
        out: ``(height, width)``, written.
        begin: first row.
        end: the row after the last.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    for row in range(begin, end):
        for col in range(out.shape[1]):
            a, b = first[row, col, 3], second[row, col, 3]
            believed = min(one, np.float32(BELIEF) * max(a, b))
            if a > UNSEEN and b > UNSEEN:
                near_a, near_b = max(first_rho[row, col], zero), max(second_rho[row, col], zero)
                gap = (near_a - near_b) / (max(near_a, near_b) * apart + np.float32(1e-9))
                squared = zero
                for k in range(3):
                    step = first[row, col, k] - second[row, col, k]
                    squared += step * step
                squared = squared / (np.float32(3.0) * differing * differing)
                out[row, col] = believed * math.exp(-gap * gap - squared)
            elif a > UNSEEN or b > UNSEEN:
                out[row, col] = believed * alone
            else:
                out[row, col] = zero
