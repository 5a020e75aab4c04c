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

Array = Any  # numpy.ndarray or torch.Tensor
Pixels = Shaped[np.ndarray, "height width *channels"]

CATMULL_ROM_SLOPE = -0.5  # slope parameter of Keys' cubic convolution that reproduces quadratics


def wrap_pixel(row: Array, col: Array, height: int, width: int) -> tuple[Array, Array]:
    """Indices in the image: columns wrap, rows (up to a height outside) come back over the pole half a turn away."""
    xp = array_namespace(row, col)
    inside, is_beyond = _inside(xp, row, height)
    return inside, xp.where(is_beyond, col + width // 2, col) % width


def _inside(xp: Any, row: Array, height: int) -> tuple[Array, Array]:
    """Rows brought into the image, and where they lay beyond a pole."""
    above, below = row < 0, row >= height
    return xp.where(above, -1 - row, xp.where(below, 2 * height - 1 - row, row)), above | below


def add_border(image: Pixels, border: int) -> Shaped[np.ndarray, "rows cols ..."]:
    """A copy with ``border`` more rows and columns on all sides, as the sphere goes on; at most the image's height."""
    height, width = image.shape[:2]
    row, col = np.arange(-border, height + border)[:, None], np.arange(-border, width + border)[None, :]
    return np.ascontiguousarray(image[wrap_pixel(row, col, height, width)])


def add_columns(image: Pixels, columns: int) -> Shaped[np.ndarray, "height cols ..."]:
    """The image with ``columns`` more on either side, from over the seam; a copy."""
    return np.pad(image, ((0, 0), (columns, columns), *((0, 0) for _ in image.shape[2:])), mode="wrap")


def filter_across_seam(apply: Callable[[np.ndarray], np.ndarray], image: Pixels, reach: int) -> Pixels:
    """A filter that keeps the size and looks ``reach`` columns aside, where columns wrap; rows are its own affair."""
    return apply(add_columns(image, reach))[:, reach : reach + image.shape[1]]


def window_max(image: Pixels, reach: int) -> Pixels:
    """The greatest value within ``reach`` (a square); columns wrap. Types that OpenCV dilates: no bool or wide ints."""
    import cv2  # loaded only here: a plan needs this module, and no more

    return filter_across_seam(partial(cv2.dilate, kernel=_square(reach)), image, reach)


def window_min(image: Pixels, reach: int) -> Pixels:
    """The least value at most ``reach`` rows and columns away (erosion by a square); as :func:`window_max`."""
    import cv2  # loaded only here: a plan needs this module, and no more

    return filter_across_seam(partial(cv2.erode, kernel=_square(reach)), image, reach)


def _square(reach: int) -> np.ndarray:
    return np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)


def sample_nearest(image: Float[Array, "height width *channels"], direction: Float[Array, "*batch 3"]) -> Array:
    """The pixel that contains each direction, ``(*batch, *channels)``."""
    xp = array_namespace(image, direction)
    row, col = direction_to_pixel(direction, image.shape[:2])
    return image[wrap_pixel(_integers(xp, xp.round(row)), _integers(xp, xp.round(col)), *image.shape[:2])]


def sample_bilinear(image: Float[Array, "height width *channels"], direction: Float[Array, "*batch 3"]) -> Array:
    """Bilinear interpolation in pixel space, ``(*batch, *channels)``."""
    return sample_bilinear_at(image, *direction_to_pixel(direction, image.shape[:2]))


def sample_bilinear_at(
    image: Float[Array, "height width *channels"], row: Float[Array, "*batch"], col: Float[Array, "*batch"]
) -> Array:
    """:func:`sample_bilinear` at fractional pixel indices, ``(*batch, *channels)``; columns wrap."""
    return _convolve(image, row, col, reach=(0, 1), kernel=lambda xp, distance: 1.0 - xp.abs(distance))


def grid_subsample(
    image: Pixels, rows: Integer[np.ndarray, " rows"], cols: Integer[np.ndarray, " cols"]
) -> Shaped[np.ndarray, "rows cols *channels"]:
    """The pixels at the crossings of some rows and columns, given as ascending indices; even steps are faster."""
    if _is_evenly_spaced(rows) and _is_evenly_spaced(cols):
        row_slice, col_slice = (slice(index[0], index[-1] + 1, index[1] - index[0]) for index in (rows, cols))
        return np.ascontiguousarray(image[row_slice, col_slice])
    return np.asarray(image[rows].take(cols, axis=1))


def _is_evenly_spaced(index: Integer[np.ndarray, " count"]) -> bool:
    return len(index) > 1 and bool((np.diff(index) == index[1] - index[0]).all())


def sample_bicubic(image: Float[Array, "height width *channels"], direction: Float[Array, "*batch 3"]) -> Array:
    """Catmull-Rom in pixel space; may over- and undershoot. Source: Keys, Cubic convolution interpolation …, 1981."""
    return _convolve(image, *direction_to_pixel(direction, image.shape[:2]), reach=(-1, 2), kernel=_cubic_weight)


def rotated_directions(
    size: tuple[int, int], source_rotation: Float[np.ndarray, "3 3"], target_rotation: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "height width 3"]:
    """Unit rays of a target camera of a ``size`` in a source panorama's frame; rotations are world-from-camera."""
    return np.asarray(pixel_directions(*size) @ (source_rotation.T @ target_rotation).T)


def rotated_image(
    image: Float[np.ndarray, "rows cols 3"], source_rotation: Float[np.ndarray, "3 3"],
    target_rotation: Float[np.ndarray, "3 3"], size: tuple[int, int],
) -> Float[np.ndarray, "height width 3"]:  # fmt: skip
    """RGB in [0, 1] as a turned camera sees it (:func:`rotated_directions`), bicubic after area averaging."""
    import cv2  # loaded only here: a plan needs this module, and no more

    pixels = np.asarray(image, np.float32)
    if pixels.shape[0] > size[0]:
        pixels = np.asarray(cv2.resize(pixels, size[::-1], interpolation=cv2.INTER_AREA))
    directions = rotated_directions(size, source_rotation, target_rotation)
    return np.asarray(np.clip(sample_bicubic(pixels, directions), 0.0, 1.0))


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
        for column, col_weight in across:
            wrapped = xp.where(is_beyond, (column + width // 2) % width, column) if xp.any(is_beyond) else column
            texel = xp.reshape(
                xp.take(texels, xp.reshape(inside * width + wrapped, (-1,)), axis=0), (*row.shape, *channels)
            )
            total = total + texel * xp.reshape(weight * col_weight, weight.shape + (1,) * len(channels))
    return total


def _integers(xp: Any, value: Array) -> Array:
    return xp.astype(value, xp.int64)


def _cubic_weight(xp: Any, distance: Array) -> Array:
    a, x = CATMULL_ROM_SLOPE, xp.abs(distance)
    near = ((a + 2.0) * x - (a + 3.0)) * x * x + 1.0
    far = ((a * x - 5.0 * a) * x + 8.0 * a) * x - 4.0 * a
    return xp.where(x < 1.0, near, far)


def max_pool(values: np.ndarray, size: tuple[int, ...]) -> np.ndarray:
    """The greatest value (True among booleans) in each cell when an image is divided into ``size = (rows, cols)``."""
    for axis in (0, 1):
        values = np.maximum.reduceat(values, np.arange(size[axis]) * values.shape[axis] // size[axis], axis=axis)
    return values
