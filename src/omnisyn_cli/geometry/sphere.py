"""Equirectangular pixels, angles and directions: the one place that knows the convention.

The convention, used everywhere in this package:

* right-handed frame, **x right, y up, −z forward**; the centre of an image looks along −z;
* pixel ``(row, col)`` has its centre at ``(row + ½, col + ½)``;
* ``azimuth = (col + ½) / width · 2π − π``: 0 at the image centre, growing to the right;
* ``polar_angle = (row + ½) / height · π``: 0 at the top (the zenith), π at the bottom;
* ``direction = (sin p · sin a, cos p, −sin p · cos a)``;
* column 0 and column width − 1 are neighbours (the seam); above row 0 the image goes on at column + width / 2.

Pixel coordinates below are *indices*: 0.0 is the centre of the first pixel. Every closed formula takes numpy arrays or
torch tensors with any leading axes and answers in kind.
"""

import math
from typing import Any

import numpy as np
from array_api_compat import array_namespace
from jaxtyping import Float

Array = Any  # numpy.ndarray or torch.Tensor

FORWARD = np.array([0.0, 0.0, -1.0])  # where the centre of an unturned panorama looks
UP = np.array([0.0, 1.0, 0.0])  # where its zenith is, and that of the world
# Polar distance α within which :func:`linearised_arccos` is a straight line (paper, section 3.5.2).
LINEARISED_CAP = math.radians(10.0)


def pixel_to_angles(row: Array, col: Array, size: tuple[int, int]) -> tuple[Array, Array]:
    """Azimuth and polar angle in radians of (fractional) pixel indices in an image of ``size = (height, width)``."""
    height, width = size
    return (col + 0.5) * (2.0 * math.pi / width) - math.pi, (row + 0.5) * (math.pi / height)


def angles_to_pixel(azimuth: Array, polar_angle: Array, size: tuple[int, int]) -> tuple[Array, Array]:
    """Fractional ``(row, col)`` indices of angles in radians; the column is not wrapped."""
    height, width = size
    return polar_angle * (height / math.pi) - 0.5, (azimuth + math.pi) * (width / (2.0 * math.pi)) - 0.5


def pixel_scale(size: tuple[int, int]) -> tuple[float, float, float, float]:
    """:func:`angles_to_pixel` for kernels: scale and offset of rows (by polar angle), then of columns (by azimuth)."""
    row_at_zero, col_at_zero = angles_to_pixel(0.0, 0.0, size)
    row_at_one, col_at_one = angles_to_pixel(1.0, 1.0, size)
    return row_at_one - row_at_zero, row_at_zero, col_at_one - col_at_zero, col_at_zero


def angles_to_direction(azimuth: Array, polar_angle: Array) -> Array:
    """Unit vectors ``(..., 3)`` of angles in radians."""
    xp = array_namespace(azimuth, polar_angle)
    sin_polar = xp.sin(polar_angle)
    x, y, z = sin_polar * xp.sin(azimuth), xp.cos(polar_angle), -sin_polar * xp.cos(azimuth)
    return xp.stack(xp.broadcast_arrays(x, y, z), axis=-1)


def direction_to_angles(direction: Float[Array, "*batch 3"]) -> tuple[Array, Array]:
    """Azimuth in (−π, π], 0 at a pole, and polar angle in [0, π], radians, exact there; of any length."""
    xp = array_namespace(direction)
    x, y, z = direction[..., 0], direction[..., 1], direction[..., 2]
    return xp.atan2(x, -z), xp.atan2(xp.hypot(x, z), y)


def pixel_to_direction(row: Array, col: Array, size: tuple[int, int]) -> Array:
    """Unit vectors ``(..., 3)`` through (fractional) pixel indices."""
    return angles_to_direction(*pixel_to_angles(row, col, size))


def direction_to_pixel(direction: Float[Array, "*batch 3"], size: tuple[int, int]) -> tuple[Array, Array]:
    """Fractional ``(row, col)`` indices that vectors of any length point at; ``-½ <= col <= width - ½``."""
    return angles_to_pixel(*direction_to_angles(direction), size)


def pixel_to_texture(row: Array, col: Array, size: tuple[int, int]) -> tuple[Array, Array]:
    """Texture coordinates ``(u, v)`` of (fractional) pixel indices, (0, 0) in the upper left corner."""
    height, width = size
    return (col + 0.5) / width, (row + 0.5) / height


def pixel_directions(height: int, width: int) -> Float[np.ndarray, "height width 3"]:
    """Unit vector through every pixel centre, float64."""
    row, col = np.arange(height, dtype=np.float64)[:, None], np.arange(width, dtype=np.float64)[None, :]
    return np.asarray(pixel_to_direction(row, col, (height, width)))


def direction_tables(height: int, width: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Float64 parts of :func:`pixel_directions`: sin and cos of polar angle per row, of azimuth per column."""
    azimuth, polar_angle = pixel_to_angles(np.arange(height), np.arange(width), (height, width))
    return np.sin(polar_angle), np.cos(polar_angle), np.sin(azimuth), np.cos(azimuth)


def row_weights(height: int) -> Float[np.ndarray, " height"]:
    """Sine of the polar angle of every row's centre: what a pixel of that row covers of the sphere, up to a factor."""
    return direction_tables(height, 2 * height)[0]


def mean_over_sphere(image: Float[np.ndarray, "height width channels"]) -> float:
    """Mean of a panorama, each pixel weighted by its share of the sphere."""
    rows = image.mean(axis=(1, 2))
    return float(np.average(rows, weights=row_weights(len(rows))))


def solid_angles(height: int, width: int) -> Float[np.ndarray, "height width"]:
    """Solid angle of every pixel in steradians, exact: the rows' bands sum to 4π."""
    edges = np.cos(np.arange(height + 1) * (math.pi / height))
    band = (edges[:-1] - edges[1:]) * (2.0 * math.pi / width)
    return np.broadcast_to(band[:, None], (height, width)).copy()


def normalize(vector: Float[Array, "*batch 3"]) -> Array:
    """Vectors of length one. A zero vector stays zero, with a zero gradient."""
    xp = array_namespace(vector)
    squared = xp.sum(vector * vector, axis=-1, keepdims=True)
    is_zero = squared == 0
    return vector / xp.sqrt(xp.where(is_zero, xp.ones_like(squared), squared))


def linearised_arccos(cosine: Array, cap: float = LINEARISED_CAP) -> Array:
    """Arccos whose slope stays bounded: within ``cap`` radians of 0 and π it goes on as a straight line.

    The infinite slope at ±1 would send infinite gradients through the poles. The chord from ``cos(cap)`` to the pole is
    continuous, exact at 0, ``cap`` and ``π − cap``, of one (negative) sign; values outside [−1, 1] continue along it.
    Source: OmniSyn, section 3.5.2.
    """
    xp = array_namespace(cosine)
    edge = math.cos(cap)
    slope = cap / (1.0 - edge)
    north, south = cosine > edge, cosine < -edge
    inside = xp.where(north | south, xp.zeros_like(cosine), cosine)  # a safe value: no NaN flows back from the pole
    middle = xp.acos(inside)
    return xp.where(north, (1.0 - cosine) * slope, xp.where(south, math.pi - (1.0 + cosine) * slope, middle))
