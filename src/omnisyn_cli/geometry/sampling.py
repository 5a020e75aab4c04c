"""Reading an equirectangular image at arbitrary directions, across the seam and over the poles.

The plain, readable form, for numpy and torch (differentiable in image and direction); the renderer has its own kernels
and is tested against these.
"""

from __future__ import annotations

from typing import Any

from array_api_compat import array_namespace
from jaxtyping import Float

from omnisyn_cli.geometry.sphere import direction_to_pixel

__all__ = ["sample_bicubic", "sample_bilinear", "sample_bilinear_at", "sample_nearest", "wrap_pixel"]

Array = Any  # numpy.ndarray or torch.Tensor

CATMULL_ROM = -0.5
"""Slope parameter of Keys' cubic convolution that reproduces quadratics."""


def wrap_pixel(row: Array, col: Array, height: int, width: int) -> tuple[Array, Array]:
    """Integer indices brought into the image: columns wrap, rows beyond a pole come back half a turn away.

    Rows may lie up to one image height outside.
    """
    xp = array_namespace(row, col)
    above, below = row < 0, row >= height
    inside = xp.where(above, -1 - row, xp.where(below, 2 * height - 1 - row, row))
    shifted = xp.where(above | below, col + width // 2, col)
    return inside, shifted % width


def sample_nearest(image: Float[Array, "height width *channels"], direction: Float[Array, "*batch 3"]) -> Array:
    """The pixel that contains each direction, ``(*batch, *channels)``."""
    xp = array_namespace(image, direction)
    row, col = direction_to_pixel(direction, image.shape[:2])
    return _fetch(image, _integers(xp, xp.round(row)), _integers(xp, xp.round(col)))


def sample_bilinear(image: Float[Array, "height width *channels"], direction: Float[Array, "*batch 3"]) -> Array:
    """Bilinear interpolation in pixel space, ``(*batch, *channels)``."""
    return sample_bilinear_at(image, *direction_to_pixel(direction, image.shape[:2]))


def sample_bilinear_at(
    image: Float[Array, "height width *channels"], row: Float[Array, "*batch"], col: Float[Array, "*batch"]
) -> Array:
    """:func:`sample_bilinear` at fractional pixel indices, ``(*batch, *channels)``; columns wrap."""
    return _convolve(image, row, col, reach=(0, 1), kernel=_linear_weight)


def sample_bicubic(image: Float[Array, "height width *channels"], direction: Float[Array, "*batch 3"]) -> Array:
    """Catmull-Rom bicubic interpolation in pixel space, ``(*batch, *channels)``; may over- and undershoot.

    Source: Keys, Cubic convolution interpolation for digital image processing, 1981.
    """
    return _convolve(image, *direction_to_pixel(direction, image.shape[:2]), reach=(-1, 2), kernel=_cubic_weight)


def _convolve(image: Array, row: Array, col: Array, *, reach: tuple[int, int], kernel: Any) -> Array:
    xp = array_namespace(image, row)
    base_row, base_col = xp.floor(row), xp.floor(col)
    offsets = range(reach[0], reach[1] + 1)
    total: Array = 0.0
    for i in offsets:
        row_weight = kernel(xp, row - base_row - i)
        for j in offsets:
            weight = row_weight * kernel(xp, col - base_col - j)
            texel = _fetch(image, _integers(xp, base_row) + i, _integers(xp, base_col) + j)
            total = total + texel * weight.reshape(weight.shape + (1,) * (image.ndim - 2))
    return total


def _fetch(image: Array, row: Array, col: Array) -> Array:
    height, width = image.shape[:2]
    row, col = wrap_pixel(row, col, height, width)
    return image[row, col]


def _integers(xp: Any, value: Array) -> Array:
    return xp.astype(value, xp.int64)


def _linear_weight(xp: Any, distance: Array) -> Array:
    return 1.0 - xp.abs(distance)


def _cubic_weight(xp: Any, distance: Array) -> Array:
    a, x = CATMULL_ROM, xp.abs(distance)
    near = ((a + 2.0) * x - (a + 3.0)) * x * x + 1.0
    far = ((a * x - 5.0 * a) * x + 8.0 * a) * x - 4.0 * a
    return xp.where(x < 1.0, near, far)
