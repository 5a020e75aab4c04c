"""What the networks of the paper are made of: UNets of convolutions that wrap around, with the row as a channel.

Source: OmniSyn, section 3.1.
"""

import math
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from omnisyn_cli.geometry.sphere import pixel_to_angles
from omnisyn_cli.networks.layers import sizes, wrap_columns

LEAK = 0.01
"""Slope of the LeakyReLU below zero."""


class UNet(nn.Module):
    """Blocks downwards with average pooling, and upwards with linear enlargement and skips; of images or volumes.

    As in the authors' network the first block on the way up has no skip, and every block there has half the channels of
    the level that it comes from. ``widths`` are channels of the levels downwards; the last is the bottleneck. The way
    up ends at level ``finest``; where it is 0 there is one output channel.
    """

    def __init__(self, inputs: int, widths: tuple[int, ...], *, finest: int, volumetric: bool = False) -> None:
        super().__init__()
        self.finest, self.deepest = finest, len(widths) - 2
        self.pool: nn.Module = nn.AvgPool3d(2) if volumetric else nn.AvgPool2d(2)
        entering = (inputs, *widths[:-1])
        self.down = nn.ModuleList(Block(a, b, volumetric=volumetric) for a, b in zip(entering, widths, strict=True))
        self.up = nn.ModuleList(
            Block(
                widths[-1] if level == self.deepest else 2 * widths[level],
                widths[level - 1] if level else 1,
                volumetric=volumetric,
            )
            for level in range(self.deepest, finest - 1, -1)
        )

    @property
    def blocks(self) -> list[Any]:
        """All of them, in the order in which they are used."""
        return [*self.down, *self.up]

    def forward(self, x: Tensor) -> Tensor:
        """``(batch, channels, *sizes)``, smaller by ``2 ** finest`` than the input."""
        skips = []
        for block in self.down[:-1]:
            skips.append(block(x))
            x = self.pool(skips[-1])
        x = self.down[-1](x)
        for level, block in zip(range(self.deepest, self.finest - 1, -1), self.up, strict=True):
            x = upsample_linear(x, 2)
            x = block(x if level == self.deepest else torch.cat([x, skips[level].to(x.dtype)], dim=1))
        return x


class Block(nn.Module):
    """Two 3×3 (or 3×3×3) convolutions with LeakyReLU; columns wrap, the other sides see zeros.

    With ``has_row`` the row is one more channel of the input; with ``enlarge`` that becomes twice as large first. A
    slope ``leak`` of 1 leaves both convolutions linear.
    """

    def __init__(
        self, inputs: int, outputs: int, *, has_row: bool = True, volumetric: bool = False, enlarge: bool = False,
        leak: float = LEAK,
    ) -> None:  # fmt: skip
        super().__init__()
        convolution = nn.Conv3d if volumetric else nn.Conv2d
        padding = (1, 1, 0) if volumetric else (1, 0)
        self.has_row, self.enlarge, self.leak = has_row, enlarge, leak
        self.first = convolution(inputs + has_row, outputs, 3, padding=padding)  # type: ignore[arg-type]
        self.second = convolution(outputs, outputs, 3, padding=padding)  # type: ignore[arg-type]

    @torch.no_grad()
    def init_identity(self, channels: int, begin: int) -> None:
        """Make the first outputs what the inputs from ``begin`` on are, as far as these are not negative."""
        for convolution, source in ((self.first, begin), (self.second, 0)):
            middle = (1,) * (convolution.weight.ndim - 2)
            for channel in range(channels):
                convolution.weight[channel] = 0.0
                convolution.weight[(channel, source + channel, *middle)] = 1.0

    def forward(self, x: Tensor) -> Tensor:
        """``(batch, outputs, *sizes)``."""
        if self.has_row:
            x = torch.cat([x, row_channel(x)], dim=1)
        if self.enlarge:
            x = upsample_linear(x, 2)
        for convolution in (self.first, self.second):
            x = functional.leaky_relu(convolution(wrap_columns(x, 1, 1)), self.leak)
        return x


def row_channel(like: Tensor) -> Tensor:
    """CoordConv: one channel with the polar angle as a share of a half turn, in (0, 1); rows and columns come last."""
    *_, height, width = sizes(like)
    row = torch.arange(height, dtype=torch.float32, device=like.device)
    polar_angle: Tensor = pixel_to_angles(row, row, (height, width))[1] / math.pi
    return polar_angle.to(like.dtype)[:, None].expand_as(like[:, :1])  # an exported file holds one column of it


def upsample_linear(x: Tensor, factor: int) -> Tensor:
    """Linear interpolation between the centres of cells, across the seam, in all dimensions but batch and channels."""
    mode = "trilinear" if x.ndim == 5 else "bilinear"
    wide: Tensor = functional.interpolate(wrap_columns(x, 1, 1), scale_factor=float(factor), mode=mode)
    return wide[..., factor:-factor]
