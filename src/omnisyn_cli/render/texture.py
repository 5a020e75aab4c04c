"""Textures: a photograph with a border and mip levels, ready for lookups."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float, Float32, Shaped, UInt8

from omnisyn_cli.geometry.sphere import pixel_scale
from omnisyn_cli.render.simd import FIXED_POINT_UNIT

# Pixels repeated around every level, across the seam and over the poles, so that kernels need not wrap indices.
BORDER = 2
CHANNELS = 4  # RGB and alpha
SMALLEST_LEVEL = 8  # rows of the smallest mip level. Set by hand.
ROWS_AT_A_TIME = 64  # rows that are averaged together, to bound memory. Set by hand.
# Positions between two texels that bicubic weights are tabulated for: 8 bits need fewer. Set by hand.
CUBIC_STEPS = {"uint8": 1024, "float32": 8192}


@dataclass(frozen=True)
class Texture:
    """A panorama's colours and alpha at full and reduced resolutions."""

    size: tuple[int, int]  # height and width of the full resolution
    # all levels one after the other, float32 or 8 bits of one, each ``(height + 4, width + 4, 4)`` with a border of two
    # pixels; level k is half the size of level k − 1 (rounded down), averaged
    texels: Float32[np.ndarray, " numbers"] | UInt8[np.ndarray, " numbers"]
    # per level: offset in ``texels``, numbers per row, (row, col) of an angle as scale and offset, and what to multiply
    # texels by
    layout: Float[np.ndarray, "levels 7"]


def make_texture(
    image: Float[np.ndarray, "height width 3"] | UInt8[np.ndarray, "height width 3"],
    mask: Bool[np.ndarray, "height width"] | None = None,
) -> Texture:
    """Mip levels of a panorama, down to 8 rows; alpha is 1, or 0 where ``mask`` is False. The width has to be even.

    Samples of 8 bits stay what they are, in a quarter of the memory; their mip levels are rounded to 8 bits.
    """
    dtype, peak = (np.uint8, 255) if image.dtype == np.uint8 else (np.float32, 1)
    sizes = _level_sizes(*image.shape[:2])
    counts = [(rows + 2 * BORDER) * (cols + 2 * BORDER) * CHANNELS for rows, cols in sizes]
    offsets = np.concatenate([[0], np.cumsum(counts)])
    texels = np.empty(offsets[-1], dtype)
    layout = []
    level = np.empty((0, 0, CHANNELS), np.float32)
    for (rows, cols), offset, count in zip(sizes, offsets, counts, strict=False):
        bordered = texels[offset : offset + count].reshape(rows + 2 * BORDER, cols + 2 * BORDER, CHANNELS)
        inside = bordered[BORDER:-BORDER, BORDER:-BORDER]
        if offset == 0:
            inside[..., :3] = image
            inside[..., 3] = peak if mask is None else np.where(mask, peak, 0)
            level = inside
        else:
            level = _reduced(level, rows, cols)
            inside[:] = np.rint(level) if dtype == np.uint8 else level
        _repeat_border(bordered)
        layout.append((offset, bordered.shape[1] * CHANNELS, *_angle_to_texel((rows, cols)), 1.0 / peak))
    return Texture(sizes[0], texels, np.array(layout, np.float64))


@cache
def cubic_weights(dtype: str) -> tuple[Shaped[np.ndarray, " numbers"], Shaped[np.ndarray, " numbers"]]:
    """Catmull-Rom weights of texels at offsets −1, 0, 1, 2 of fractions from 0 to 1, for rows and for columns.

    They are what :mod:`omnisyn_cli.render.simd` takes for texels of this type.
    """
    x = np.linspace(0.0, 1.0, CUBIC_STEPS[dtype] + 1)
    weights = 0.5 * np.stack(
        [2 * x**2 - x**3 - x, 3 * x**3 - 5 * x**2 + 2, 4 * x**2 - 3 * x**3 + x, x**3 - x**2], axis=-1
    )
    if dtype != "uint8":
        return weights.astype(np.float32).ravel(), weights.astype(np.float32).ravel()
    fixed = np.rint(FIXED_POINT_UNIT * weights).astype(np.int16).ravel()
    return np.repeat(fixed, 2).view(np.int32), fixed


def _level_sizes(height: int, width: int) -> list[tuple[int, int]]:
    """Halved from level to level. Widths are even, so that half a turn across a pole is a whole number of columns."""
    sizes = [(height, width)]
    while sizes[-1][0] > SMALLEST_LEVEL and sizes[-1][1] >= 8:
        rows, cols = sizes[-1]
        sizes.append((rows // 2, 2 * (cols // 4)))
    return sizes


def _reduced(image: np.ndarray, rows: int, cols: int) -> Float32[np.ndarray, "rows cols channels"]:
    """Area averages, some rows at a time."""
    if image.shape[:2] != (2 * rows, 2 * cols):
        return np.asarray(_shrunk(_shrunk(image.astype(np.float32), rows, axis=0), cols, axis=1), np.float32)
    out = np.empty((rows, cols, image.shape[2]), np.float32)
    for begin in range(0, rows, ROWS_AT_A_TIME):
        part = image[2 * begin : 2 * (begin + ROWS_AT_A_TIME)].astype(np.float32)
        out[begin : begin + ROWS_AT_A_TIME] = _shrunk(_shrunk(part, len(part) // 2, axis=0), cols, axis=1)
    return out


def _shrunk(image: np.ndarray, count: int, axis: int) -> np.ndarray:
    """Area averages along one axis; the parts need not be whole numbers of pixels."""
    pixels = np.moveaxis(image, axis, 0)
    if len(pixels) == 2 * count:
        return np.moveaxis(np.float32(0.5) * (pixels[0::2] + pixels[1::2]), 0, axis)
    edges = np.arange(count + 1) * (len(pixels) / count)
    whole = np.minimum(edges.astype(np.intp), len(pixels) - 1)
    sums = np.concatenate([np.zeros((1, *pixels.shape[1:])), np.cumsum(pixels, axis=0, dtype=np.float64)])
    up_to_edge = sums[whole] + (edges - whole)[:, None, None] * pixels[whole]
    return np.moveaxis(np.diff(up_to_edge, axis=0) * (count / len(pixels)), 0, axis)


def _angle_to_texel(size: tuple[int, int]) -> tuple[float, float, float, float]:
    """Row scale and offset, column scale and offset of polar angle and azimuth in a bordered level."""
    row_scale, row_offset, col_scale, col_offset = pixel_scale(size)
    return row_scale, row_offset + BORDER, col_scale, col_offset + BORDER


def _repeat_border(bordered: np.ndarray) -> None:
    """Fill the border: beyond a pole the image goes on half a turn away."""
    inside = bordered[BORDER:-BORDER, BORDER:-BORDER]
    half_turn = inside.shape[1] // 2
    bordered[:BORDER, BORDER:-BORDER] = np.roll(inside[:BORDER], half_turn, axis=1)[::-1]
    bordered[-BORDER:, BORDER:-BORDER] = np.roll(inside[-BORDER:], half_turn, axis=1)[::-1]
    bordered[:, :BORDER] = bordered[:, -2 * BORDER : -BORDER]
    bordered[:, -BORDER:] = bordered[:, BORDER : 2 * BORDER]
