"""Reading an equirectangular image at arbitrary directions and beyond its border, across the seam and over the poles.

The plain, readable form, for numpy and torch (differentiable in image and direction); the renderer has its own kernels
and is tested against these.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from array_api_compat import array_namespace
from jaxtyping import Float, Integer, Shaped

from omnisyn_cli.geometry.sphere import direction_to_pixel, pixel_directions

__all__ = [
    "add_border",
    "add_columns",
    "at_crossings",
    "filter_across_seam",
    "greatest_of_parts",
    "sample_bicubic",
    "sample_bilinear",
    "sample_bilinear_at",
    "sample_nearest",
    "turned_directions",
    "turned_image",
    "window_max",
    "window_min",
]

Array = Any  # numpy.ndarray or torch.Tensor

CATMULL_ROM = -0.5
"""Slope parameter of Keys' cubic convolution that reproduces quadratics."""


def wrap_pixel(row: Array, col: Array, height: int, width: int) -> tuple[Array, Array]:
    """Integer indices brought into the image: columns wrap, rows beyond a pole come back half a turn away.

    Rows may lie up to one image height outside.
    """
    xp = array_namespace(row, col)
    inside, is_beyond = _inside(xp, row, height)
    return inside, xp.where(is_beyond, col + width // 2, col) % width


def _inside(xp: Any, row: Array, height: int) -> tuple[Array, Array]:
    """Rows brought into the image, and where they lay beyond a pole."""
    above, below = row < 0, row >= height
    return xp.where(above, -1 - row, xp.where(below, 2 * height - 1 - row, row)), above | below


def add_border(image: Shaped[np.ndarray, "height width *channels"], border: int) -> Shaped[np.ndarray, "rows cols ..."]:
    """The image with ``border`` more rows and columns on every side, as the sphere goes on there; a copy.

    It is at least ``border`` pixels high.
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

    ``apply`` keeps the size; its answers depend on ``reach`` columns on either side.
    """
    return apply(add_columns(image, reach))[:, reach : reach + image.shape[1]]


def window_max(
    image: Shaped[np.ndarray, "height width *channels"], reach: int
) -> Shaped[np.ndarray, "height width ..."]:
    """The greatest value at most ``reach`` rows and columns away (dilation by a square).

    Columns wrap; beyond the poles there is nothing. Types are those that OpenCV dilates: not bool, no wide integers.
    """
    import cv2  # loaded only here: a plan needs this module, and no more

    return filter_across_seam(partial(cv2.dilate, kernel=_square(reach)), image, reach)


def window_min(
    image: Shaped[np.ndarray, "height width *channels"], reach: int
) -> Shaped[np.ndarray, "height width ..."]:
    """The least value at most ``reach`` rows and columns away (erosion by a square); as :func:`window_max`."""
    import cv2  # loaded only here: a plan needs this module, and no more

    return filter_across_seam(partial(cv2.erode, kernel=_square(reach)), image, reach)


def _square(reach: int) -> np.ndarray:
    return np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)


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
    return _convolve(image, row, col, reach=(0, 1), kernel=lambda xp, distance: 1.0 - xp.abs(distance))


def at_crossings(
    image: Shaped[np.ndarray, "height width *channels"], rows: Integer[np.ndarray, " rows"],
    cols: Integer[np.ndarray, " cols"],
) -> Shaped[np.ndarray, "rows cols *channels"]:  # fmt: skip
    """The pixels where some rows and columns cross, given as ascending indices; equal steps are taken faster."""
    if _is_even(rows) and _is_even(cols):
        every, each = (slice(index[0], index[-1] + 1, index[1] - index[0]) for index in (rows, cols))
        return np.ascontiguousarray(image[every, each])
    return np.asarray(image[rows].take(cols, axis=1))


def _is_even(index: Integer[np.ndarray, " count"]) -> bool:
    return len(index) > 1 and bool((np.diff(index) == index[1] - index[0]).all())


def sample_bicubic(image: Float[Array, "height width *channels"], direction: Float[Array, "*batch 3"]) -> Array:
    """Catmull-Rom bicubic interpolation in pixel space, ``(*batch, *channels)``; may over- and undershoot.

    Source: Keys, Cubic convolution interpolation for digital image processing, 1981.
    """
    return _convolve(image, *direction_to_pixel(direction, image.shape[:2]), reach=(-1, 2), kernel=_cubic_weight)


def turned_directions(
    size: tuple[int, int], source: Float[np.ndarray, "3 3"], held: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "height width 3"]:
    """Unit vectors in the frame of a panorama through the pixels (``size``) of a camera that is held otherwise.

    ``source`` and ``held`` are the world-from-camera rotations of the two.
    """
    return np.asarray(pixel_directions(*size) @ (source.T @ held).T)


def turned_image(
    image: Float[np.ndarray, "rows cols 3"],
    source: Float[np.ndarray, "3 3"],
    held: Float[np.ndarray, "3 3"],
    size: tuple[int, int],
) -> Float[np.ndarray, "height width 3"]:
    """A panorama as a network is shown it, in training and after: bicubic, averaged over areas where it is larger.

    RGB in [0, 1]; ``size`` is that of the result, ``source`` and ``held`` are as for :func:`turned_directions`.
    """
    import cv2  # loaded only here: a plan needs this module, and no more

    numbers = np.asarray(image, np.float32)
    if numbers.shape[0] > size[0]:
        numbers = np.asarray(cv2.resize(numbers, size[::-1], interpolation=cv2.INTER_AREA))
    return np.asarray(np.clip(sample_bicubic(numbers, turned_directions(size, source, held)), 0.0, 1.0))


def _convolve(image: Array, row: Array, col: Array, *, reach: tuple[int, int], kernel: Any) -> Array:
    xp = array_namespace(image, row)
    (height, width), channels = image.shape[:2], image.shape[2:]
    base_row, base_col = xp.floor(row), xp.floor(col)
    first_row, first_col = _integers(xp, base_row), _integers(xp, base_col)
    texels, offsets = xp.reshape(image, (height * width, *channels)), range(reach[0], reach[1] + 1)
    across = [((first_col + j) % width, kernel(xp, col - base_col - j)) for j in offsets]
    total: Array = 0.0
    for i in offsets:
        weight, (inside, is_beyond) = kernel(xp, row - base_row - i), _inside(xp, first_row + i, height)
        for column, share in across:
            there = xp.where(is_beyond, (column + width // 2) % width, column) if xp.any(is_beyond) else column
            texel = xp.reshape(
                xp.take(texels, xp.reshape(inside * width + there, (-1,)), axis=0), (*row.shape, *channels)
            )
            total = total + texel * xp.reshape(weight * share, weight.shape + (1,) * len(channels))
    return total


def _fetch(image: Array, row: Array, col: Array) -> Array:
    height, width = image.shape[:2]
    row, col = wrap_pixel(row, col, height, width)
    return image[row, col]


def _integers(xp: Any, value: Array) -> Array:
    return xp.astype(value, xp.int64)


def _cubic_weight(xp: Any, distance: Array) -> Array:
    a, x = CATMULL_ROM, xp.abs(distance)
    near = ((a + 2.0) * x - (a + 3.0)) * x * x + 1.0
    far = ((a * x - 5.0 * a) * x + 8.0 * a) * x - 4.0 * a
    return xp.where(x < 1.0, near, far)


def greatest_of_parts(values: np.ndarray, size: tuple[int, ...]) -> np.ndarray:
    """The greatest value, True among booleans, in each of ``size = (rows, cols)`` parts of an image."""
    for axis in (0, 1):
        values = np.maximum.reduceat(values, np.arange(size[axis]) * values.shape[axis] // size[axis], axis=axis)
    return values
