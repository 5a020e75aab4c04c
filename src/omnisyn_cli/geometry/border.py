"""What lies beyond the border of an equirectangular image, for filters that take it for a plane.

Beyond the first and the last column the image goes on at its other side, beyond a pole half a turn away.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Shaped

from omnisyn_cli.geometry.sampling import wrap_pixel

__all__ = ["add_border", "add_columns", "filter_across_seam"]


def add_border(image: Shaped[np.ndarray, "height width *channels"], border: int) -> Shaped[np.ndarray, "rows cols ..."]:
    """The image with ``border`` more rows and columns on every side, as the sphere goes on there; a copy.

    Args:
        image: at least ``border`` pixels high.
        border: pixels.
    """
    height, width = image.shape[:2]
    row, col = np.arange(-border, height + border)[:, None], np.arange(-border, width + border)[None, :]
    return np.ascontiguousarray(image[wrap_pixel(row, col, height, width)])


def add_columns(
    image: Shaped[np.ndarray, "height width *channels"], columns: int
) -> Shaped[np.ndarray, "height cols ..."]:
    """The image with ``columns`` more on either side, from over the seam; a copy."""
    return np.pad(image, ((0, 0), (columns, columns), *((0, 0) for _ in image.shape[2:])), mode="wrap")


def filter_across_seam(
    apply: Callable[[np.ndarray], np.ndarray], image: Shaped[np.ndarray, "height width *channels"], reach: int
) -> Shaped[np.ndarray, "height width ..."]:
    """What a filter makes of an image whose columns wrap; beyond the poles it sees what it likes.

    Args:
        apply: takes and returns an image of one size.
        image: what to filter.
        reach: columns on either side that an answer depends on.
    """
    return apply(add_columns(image, reach))[:, reach : reach + image.shape[1]]
