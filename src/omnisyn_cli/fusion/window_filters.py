"""Dilation and box filter over square windows, for numpy and torch. Columns wrap, rows end at the poles."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from array_api_compat import array_namespace, is_numpy_array
from jaxtyping import Num

from omnisyn_cli.geometry.sampling import filter_across_seam, window_max

Array = Any  # numpy.ndarray or torch.Tensor


def dilate(values: Num[Array, "rows cols *channels"], radius: int) -> Num[Array, "rows cols *channels"]:
    """The maximum over ``2·radius + 1`` rows and columns, none beyond a pole; integers below 2^53."""
    if is_numpy_array(values):
        # OpenCV dilates no wide integers, and float64 holds these exactly.
        known = values.astype(np.float64) if values.dtype.kind == "i" else values
        return window_max(known, radius).astype(values.dtype, copy=False)
    return _combine_windows(array_namespace(values).maximum, values, radius, mirror_poles=False)


def box_filter(
    values: Num[Array, "rows cols *channels"], radius: int, *, mirror_poles: bool
) -> Num[Array, "rows cols *channels"]:
    """The mean over ``2·radius + 1`` rows and columns; beyond a pole rows are mirrored, or the last one repeats."""
    if is_numpy_array(values):
        import cv2  # loaded only here: most callers need torch or no filter at all

        border, side = cv2.BORDER_REFLECT if mirror_poles else cv2.BORDER_REPLICATE, 2 * radius + 1
        return filter_across_seam(
            partial(cv2.boxFilter, ddepth=-1, ksize=(side, side), borderType=border), values, radius
        )
    total = _combine_windows(lambda one, other: one + other, values, radius, mirror_poles=mirror_poles)
    return total * (1.0 / (2 * radius + 1) ** 2)


def _combine_windows(
    combine: Callable[[Array, Array], Array], values: Array, radius: int, *, mirror_poles: bool
) -> Array:
    """A separable reduction over square windows: first along columns, then along rows."""
    xp, side = array_namespace(values), 2 * radius + 1
    if mirror_poles:
        padded = [xp.flip(values[:radius], axis=0), values, xp.flip(values[-radius:], axis=0)]
    else:
        padded = [*[values[:1]] * radius, values, *[values[-1:]] * radius]
    rows_done = _combine_rows(combine, xp.concat(padded, axis=0), side)
    wrapped = xp.concat([rows_done[:, -radius:], rows_done, rows_done[:, :radius]], axis=1)
    return xp.moveaxis(_combine_rows(combine, xp.moveaxis(wrapped, 1, 0), side), 0, 1)


def _combine_rows(combine: Callable[[Array, Array], Array], values: Array, count: int) -> Array:
    """``count`` successive rows, from each row on, each counted once: windows double in log2(count) steps."""
    if count == 1:
        return values
    half = _combine_rows(combine, values, count // 2)
    rows = values.shape[0] - count + 1
    both = combine(half[:rows], half[count // 2 : count // 2 + rows])
    return combine(both, values[count - 1 :]) if count % 2 else both
