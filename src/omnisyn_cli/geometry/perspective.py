"""Perspective pictures as targets of what draws equirectangular ones.

A pixel's ray is written as ``(sin p · sin a, cos p, −sin p · cos a)`` everywhere. With 1 for ``sin p`` and ``cos a``, y
of the row for ``cos p`` and x of the column for ``sin a``, it is ``(x, y, −1)``: a perspective ray, whose length is not
1. Inverse depths are those of the distance along the axis then, and what is proportional to both stays as it is.
"""

import math

import numpy as np
from jaxtyping import Float

from omnisyn_cli.geometry.sphere import direction_tables, pixel_directions, pixel_scale


class PerspectiveSize(tuple[int, int]):
    """Height and width of a perspective picture, which looks along −z; it goes wherever sizes of panoramas go."""

    focal: float  # pixels that a step of 1 sideways has on the plane at distance 1

    def __new__(cls, height: int, width: int, fov: float) -> "PerspectiveSize":
        """Of a picture whose width spans ``fov`` radians."""
        size = super().__new__(cls, (height, width))
        size.focal = width / 2.0 / math.tan(fov / 2.0)
        return size

    @property
    def half_extent(self) -> tuple[float, float]:
        """Half of its height and of its width on the plane at distance 1."""
        return self[0] / 2.0 / self.focal, self[1] / 2.0 / self.focal


def pixels_per_radian(size: tuple[int, int]) -> float:
    """Of a picture in its centre."""
    return size.focal if isinstance(size, PerspectiveSize) else pixel_scale(size)[0]


def equivalent_rows(size: tuple[int, int]) -> int:
    """Rows of the panorama whose pixels are as small as those of a picture in its centre."""
    return round(math.radians(180.0) * pixels_per_radian(size))


def target_tables(size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """:func:`omnisyn_cli.geometry.sphere.direction_tables` of a panorama, and what stands for it of a perspective."""
    if not isinstance(size, PerspectiveSize):
        return direction_tables(*size)
    y, x = _on_plane(size, size)
    return np.ones(len(y)), y, x, np.ones(len(x))


def cell_directions(size: tuple[int, int], grid: tuple[int, int]) -> Float[np.ndarray, "rows cols 3"]:
    """Rays through the middles of a grid of cells over a picture."""
    if not isinstance(size, PerspectiveSize):
        return pixel_directions(*grid)
    y, x = _on_plane(size, grid)
    return np.stack(np.broadcast_arrays(x, y[:, None], -1.0), axis=-1)


def _on_plane(size: PerspectiveSize, grid: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Y of the rows and x of the columns of a grid over a picture, on the plane at distance 1."""
    (down, across), (rows, cols) = size.half_extent, grid
    y = down * (1.0 - (2.0 * np.arange(rows) + 1.0) / rows)
    return y, across * ((2.0 * np.arange(cols) + 1.0) / cols - 1.0)
