"""The cells of a picture that ghosts are looked for in, and filters over squares of cells.

Filters take torch tensors, and numpy arrays, which OpenCV filters faster than numpy would; it is loaded where it is
used, since a plan needs this module and no more. Columns wrap at the seam, rows end at the poles.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from array_api_compat import array_namespace, is_numpy_array
from jaxtyping import Num

from omnisyn_cli.geometry.sampling import filter_across_seam

__all__ = ["ghost_sample_step"]

Array = Any  # numpy.ndarray or torch.Tensor

ROWS_OF_CELLS = 128

LEAST_CELL = 4
"""Pixels along the side of a cell at least, because views are displaced by pixels, not by angles."""

SAMPLES_ALONG_CELL = 4


def ghost_cell_size(size: tuple[int, int]) -> int:
    """Pixels along the side of a cell of a picture of ``size = (height, width)``."""
    return max(LEAST_CELL, -(-size[0] // ROWS_OF_CELLS))


def ghost_sample_step(size: tuple[int, int]) -> int:
    """Every so many-th pixel of a row and of a column is looked at; 1 where cells are small: then all of them are."""
    return max(1, ghost_cell_size(size) // SAMPLES_ALONG_CELL)


def greatest_near(values: Num[Array, "rows cols *channels"], reach: int) -> Num[Array, "rows cols *channels"]:
    """The greatest value at most ``reach`` rows and columns away; beyond a pole there is none.

    Whole numbers are below 2^53.
    """
    if is_numpy_array(values):
        import cv2

        known = values.astype(np.float64) if values.dtype.kind == "i" else values  # OpenCV has no such integers here
        square = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
        return filter_across_seam(partial(cv2.dilate, kernel=square), known, reach).astype(values.dtype, copy=False)
    return _over_squares(array_namespace(values).maximum, values, reach, is_mirrored=False)


def mean_near(
    values: Num[Array, "rows cols *channels"], reach: int, *, is_mirrored: bool
) -> Num[Array, "rows cols *channels"]:
    """The mean over all that is at most ``reach`` rows and columns away.

    Args:
        values: to be averaged.
        reach: less than the number of rows and columns.
        is_mirrored: beyond a pole the last rows come again, the nearest first; otherwise the last one repeats.
    """
    if is_numpy_array(values):
        import cv2

        beyond, side = cv2.BORDER_REFLECT if is_mirrored else cv2.BORDER_REPLICATE, 2 * reach + 1
        return filter_across_seam(
            partial(cv2.boxFilter, ddepth=-1, ksize=(side, side), borderType=beyond), values, reach
        )
    total = _over_squares(lambda one, other: one + other, values, reach, is_mirrored=is_mirrored)
    return total * (1.0 / (2 * reach + 1) ** 2)


def _over_squares(combine: Callable[[Array, Array], Array], values: Array, reach: int, *, is_mirrored: bool) -> Array:
    xp, count = array_namespace(values), 2 * reach + 1
    if is_mirrored:
        beyond = [xp.flip(values[:reach], axis=0), values, xp.flip(values[-reach:], axis=0)]
    else:
        beyond = [*[values[:1]] * reach, values, *[values[-1:]] * reach]
    tall = _over_rows(combine, xp.concat(beyond, axis=0), count)
    wide = xp.concat([tall[:, -reach:], tall, tall[:, :reach]], axis=1)
    return xp.moveaxis(_over_rows(combine, xp.moveaxis(wide, 1, 0), count), 0, 1)


def _over_rows(combine: Callable[[Array, Array], Array], values: Array, count: int) -> Array:
    """``count`` rows from each one on combined, each once: two halves, and the last one if their number is odd."""
    if count == 1:
        return values
    half = _over_rows(combine, values, count // 2)
    rows = values.shape[0] - count + 1
    both = combine(half[:rows], half[count // 2 : count // 2 + rows])
    return combine(both, values[count - 1 :]) if count % 2 else both
