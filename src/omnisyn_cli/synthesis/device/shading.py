"""The photograph looked up where each visible point was seen from, by the rule of :mod:`omnisyn_cli.render.shade`.

Catmull-Rom where the photograph is magnified, else two mip levels, read bilinearly and mixed; the fourth channel is
alpha times confidence. Memory: about 0.2 kB for each pixel that is looked up together.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float32, Integer
from torch import Tensor

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.render.shade import ConfidenceMap
from omnisyn_cli.render.shade_kernels import MAX_FULL_RESOLUTION_LEVEL, MIP_BIAS
from omnisyn_cli.render.texture import Texture


@dataclass(frozen=True)
class GpuTexture:
    """A :class:`omnisyn_cli.render.texture.Texture` on a device.

    Attributes:
        rows: of the full resolution.
        texels: all levels one after the other, with borders, float32 or 8 bits.
        begin: of each level in ``texels``.
        stride: texels per row of each level.
        place: of each level, scale and offset that take texel rows and columns at full resolution to its own.
        angle: row scale, row offset, column scale and column offset of polar angle and azimuth at full resolution.
        unit: what texels are multiplied by.
    """

    rows: int
    texels: Tensor
    begin: Integer[Tensor, " levels"]
    stride: Integer[Tensor, " levels"]
    place: Float32[Tensor, "levels 4"]
    angle: tuple[float, ...]
    unit: float


@dataclass(frozen=True)
class GpuConfidenceMap:
    """A :class:`omnisyn_cli.render.shade.ConfidenceMap` on a device.

    Attributes:
        values: of the quarters; empty where all of it is 1.
        place: scale and offset from texel rows to rows of values, the same for columns.
        stride: values per row.
    """

    values: Float32[Tensor, " values"]
    place: tuple[float, ...]
    stride: int

    def at(self, row: Float32[Tensor, "*pixels"], col: Float32[Tensor, "*pixels"]) -> Float32[Tensor, "*pixels"]:
        """Trust at texture coordinates."""
        row_scale, row_zero, col_scale, col_zero = self.place
        i, j = (row * row_scale + row_zero).to(torch.int64), (col * col_scale + col_zero).to(torch.int64)
        return self.values[i * self.stride + j]


def confidence_on(surface_confidence: ConfidenceMap, device: torch.device) -> GpuConfidenceMap:
    """The same confidence."""
    *place, stride = surface_confidence.layout.tolist()
    return GpuConfidenceMap(torch.from_numpy(surface_confidence.values).to(device), tuple(place), int(stride))


def texture_on(texture: Texture, device: torch.device) -> GpuTexture:
    """The same texture, its texels as they are."""
    layout = texture.layout
    scale = layout[:, [2, 4]] / layout[0, [2, 4]]
    offset = layout[:, [3, 5]] - layout[0, [3, 5]] * scale
    place = np.stack([scale[:, 0], offset[:, 0], scale[:, 1], offset[:, 1]], axis=1).astype(np.float32)
    starts = (layout[:, :2] / 4).astype(np.int64)
    return GpuTexture(
        texture.size[0], torch.from_numpy(texture.texels).to(device).reshape(-1, 4),
        torch.from_numpy(starts[:, 0].copy()).to(device), torch.from_numpy(starts[:, 1].copy()).to(device),
        torch.from_numpy(place).to(device), tuple(layout[0, 2:6].tolist()), float(layout[0, 6]),
    )  # fmt: skip


def shade(
    inverse_depth: Float32[Tensor, "rows width"],
    surface_confidence: GpuConfidenceMap,
    rays: Float32[Tensor, "rows width 3"],
    texture: GpuTexture,
    target_from_source: Pose,
    target_rows: int,
) -> Float32[Tensor, "rows width 4"]:
    """Colour and weight of some rows of a target; all 0 where nothing is seen.

    Args:
        inverse_depth: 1/metre from the target, negative where nothing is seen.
        surface_confidence: of the surface.
        rays: unit vectors through the pixels, in the frame of the target.
        texture: the photograph.
        target_from_source: the transform.
        target_rows: height of the whole target.
    """
    rotation, translation = (
        torch.as_tensor(part, dtype=torch.float32, device=rays.device)
        for part in (target_from_source.rotation, target_from_source.position)
    )
    moved = rays - inverse_depth.clamp_min(0.0)[..., None] * translation
    x, y, z = ((moved * rotation[:, axis]).sum(-1) for axis in range(3))
    flat = x * x + z * z
    row_scale, row_zero, col_scale, col_zero = texture.angle
    row = torch.atan2(flat.sqrt(), y) * row_scale + row_zero
    col = torch.atan2(x, -z) * col_scale + col_zero
    footprint = (texture.rows / target_rows) ** 2 / (flat + y * y + 1e-20)
    level = 0.5 * torch.log2(footprint)
    level = torch.maximum((1.0 - float(MIP_BIAS)) * level, level - float(MIP_BIAS)).clamp_max(
        float(len(texture.begin) - 1)
    )
    is_minified = (level > float(MAX_FULL_RESOLUTION_LEVEL))[..., None]
    colour = torch.where(is_minified, _between_levels(texture, row, col, level), _bicubic(texture, row, col))
    colour = colour * texture.unit
    if len(surface_confidence.values):
        colour[..., 3] *= surface_confidence.at(row, col)
    return torch.where((inverse_depth >= 0.0)[..., None], colour, 0.0)


def _bicubic(texture: GpuTexture, row: Tensor, col: Tensor) -> Float32[Tensor, "*pixels 4"]:
    """Four by four texels of the full resolution; borders are as wide as they reach."""
    i, j = row.to(torch.int64), col.to(torch.int64)
    down, across = _cubic_weights(row - i), _cubic_weights(col - j)
    stride = texture.stride[0]
    at = (i - 1) * stride + j - 1
    colour = torch.zeros((*row.shape, 4), device=row.device)
    for m in range(4):
        line = torch.zeros_like(colour)
        for n in range(4):
            line += across[n][..., None] * texture.texels[at + n]
        colour += down[m][..., None] * line
        at = at + stride
    return colour


def _cubic_weights(x: Float32[Tensor, "*pixels"]) -> list[Float32[Tensor, "*pixels"]]:
    """Catmull-Rom weights at offsets −1, 0, 1, 2 of fractions in [0, 1)."""
    x2 = x * x
    x3 = x2 * x
    return [
        0.5 * (2.0 * x2 - x3 - x),
        0.5 * (3.0 * x3 - 5.0 * x2 + 2.0),
        0.5 * (4.0 * x2 - 3.0 * x3 + x),
        0.5 * (x3 - x2),
    ]


def _between_levels(texture: GpuTexture, row: Tensor, col: Tensor, level: Tensor) -> Float32[Tensor, "*pixels 4"]:
    """Two mip levels, mixed by the logarithm of the texels that fall on one pixel."""
    level = level.clamp_min(0.0)
    finer = level.to(torch.int64)
    coarser = (finer + 1).clamp_max(len(texture.begin) - 1)
    colour = _bilinear(texture, finer, row, col)
    return colour + (_bilinear(texture, coarser, row, col) - colour) * (level - finer)[..., None]


def _bilinear(texture: GpuTexture, level: Tensor, row: Tensor, col: Tensor) -> Float32[Tensor, "*pixels 4"]:
    """A read of each pixel's level at the place that has these coordinates at full resolution."""
    place, stride = texture.place[level], texture.stride[level]
    row, col = row * place[..., 0] + place[..., 1], col * place[..., 2] + place[..., 3]
    i, j = row.to(torch.int64), col.to(torch.int64)
    at = texture.begin[level] + i * stride + j
    down, across = (row - i)[..., None], (col - j)[..., None]
    left, right = (_lerp(texture.texels[at + k], texture.texels[at + stride + k], down) for k in (0, 1))
    return _lerp(left, right, across)


def _lerp(first: Tensor, second: Tensor, share: Tensor) -> Tensor:
    first = first.to(torch.float32)
    return first + (second.to(torch.float32) - first) * share
