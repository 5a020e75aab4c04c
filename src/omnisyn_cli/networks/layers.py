"""Building blocks for networks on equirectangular images.

Every convolution wraps around left and right (the seam) by slice and concat, which every ONNX runtime knows, and sees
zeros beyond the poles. Upsampling is nearest or convex, so that rolling the columns of an input by a multiple of the
coarsest stride rolls the output: nothing here knows where the seam is.
"""

import math
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from omnisyn_cli.geometry.sphere import pixel_to_angles

__all__ = ["WrappedConv"]

LEAK = 0.1
"""Slope of every LeakyReLU below zero."""

PATCH_FLOOR = 0.03
"""Added to the norm of a patch: contrast below this (RMS·k, of values in [0, 1]) counts as plain."""


def wrap_columns(x: Float[Tensor, "*batch height width"], left: int, right: int) -> Tensor:
    """Columns continued around the seam: ``left`` of them before the first and ``right`` after the last."""
    pieces = [x[..., -left:]] if left else []
    pieces += [x, x[..., :right]] if right else [x]
    return torch.cat(pieces, dim=-1) if len(pieces) > 1 else x


class WrappedConv(nn.Conv2d):
    """A 3×3 convolution that wraps around the seam and sees zeros beyond the poles."""

    def __init__(self, inputs: int, outputs: int, stride: tuple[int, int] = (1, 1)) -> None:
        super().__init__(inputs, outputs, kernel_size=3, stride=stride, padding=(1, 0))

    def forward(self, x: Float[Tensor, "batch inputs height width"]) -> Tensor:
        """``(batch, outputs, height / stride, width / stride)``."""
        return super().forward(wrap_columns(x, 1, 1))


class ResidualBlock(nn.Module):
    """Two convolutions around a shortcut, no normalisation layer."""

    def __init__(self, inputs: int, outputs: int, stride: tuple[int, int] = (1, 1)) -> None:
        super().__init__()
        self.first = WrappedConv(inputs, outputs, stride)
        self.second = WrappedConv(outputs, outputs)
        same = inputs == outputs and stride == (1, 1)
        self.shortcut: nn.Module = nn.Identity() if same else nn.Conv2d(inputs, outputs, 1, stride)

    def forward(self, x: Float[Tensor, "batch inputs height width"]) -> Tensor:
        """``(batch, outputs, height / stride, width / stride)``."""
        inner = functional.leaky_relu(self.first(x), LEAK)
        return functional.leaky_relu(self.second(inner) + self.shortcut(x), LEAK)


def at_least_single(x: Tensor) -> Tensor:
    """The same values in single precision, where they came in half precision (autocast)."""
    return x.float() if x.dtype in (torch.bfloat16, torch.float16) else x


def sizes(x: Tensor) -> tuple[int, ...]:
    """The shape as plain numbers, so that a traced network holds constants."""
    return tuple(int(size) for size in x.shape)


def initialise(module: nn.Module, gain: float = 0.7) -> None:
    """Kaiming weights for LeakyReLU times ``gain``, zero biases; without it nothing learns (no normalisation)."""
    for layer in module.modules():
        if isinstance(layer, nn.Conv2d | nn.Conv3d):
            nn.init.kaiming_normal_(layer.weight, a=LEAK)
            with torch.no_grad():
                layer.weight.mul_(gain)
            if layer.bias is not None:
                nn.init.zeros_(layer.bias)


def begin_small(*layers: Any, std: float = 0.01) -> None:
    """Random weights of a small standard deviation for last layers, so that answers begin near where they should."""
    for layer in layers:
        nn.init.normal_(layer.weight, std=std)


def coordinate_channels(like: Float[Tensor, "batch channels height width"]) -> Float[Tensor, "batch 2 height width"]:
    """CoordConv for the epipole frame: the polar angle scaled to [−1, 1], and the cosine of the azimuth.

    The ground lies at azimuth 0. The sine is left out: it would tell a scene from its mirror image.
    """
    batch, _, height, width = sizes(like)
    row, col = torch.arange(height, dtype=like.dtype), torch.arange(width, dtype=like.dtype)
    azimuth, polar_angle = pixel_to_angles(row, col, (height, width))
    polar_angle = (polar_angle * (2.0 / math.pi) - 1.0).to(like.device)
    cosine = torch.cos(azimuth).to(like.device)
    grid = torch.stack([polar_angle[:, None].expand(height, width), cosine[None, :].expand(height, width)])
    return grid.expand(batch, 2, height, width)


def upsample_nearest(x: Float[Tensor, "batch channels height width"]) -> Tensor:
    """Every pixel becomes 2×2 equal ones."""
    return functional.interpolate(x, scale_factor=2.0, mode="nearest")


def convex_upsample(
    x: Float[Tensor, "batch channels height width"], logits: Float[Tensor, "batch 36 height width"]
) -> Float[Tensor, "batch channels 2*height 2*width"]:
    """Twice the size: each fine pixel is a weighted mean of the 3×3 coarse pixels around it, edges stay sharp.

    Args:
        x: values; the answer lies between the smallest and the largest of each neighbourhood.
        logits: for each coarse pixel 9 logits for each of its 2×2 fine pixels, neighbour first.

    Source: RAFT (Teed and Deng, 2020), section 3.3.
    """
    batch, channels, height, width = sizes(x)
    padded = wrap_columns(torch.cat([x[..., :1, :], x, x[..., -1:, :]], dim=-2), 1, 1)
    shifts = [padded[..., i : i + height, j : j + width] for i in range(3) for j in range(3)]
    weights = logits.view(batch, 1, 9, 4, height, width).softmax(dim=2)
    fine = (weights * torch.stack(shifts, dim=2).unsqueeze(3)).sum(dim=2)  # (batch, channels, 4, height, width)
    return functional.pixel_shuffle(fine.reshape(batch, channels * 4, height, width), 2)


def unit_groups(
    features: Float[Tensor, "batch channels height width"], groups: int
) -> Float[Tensor, "batch groups channels_per_group height width"]:
    """Channels in groups, each group of each pixel a vector of length one."""
    batch, channels, height, width = sizes(features)
    return functional.normalize(features.view(batch, groups, channels // groups, height, width), dim=2)


def normalised_patches(
    image: Float[Tensor, "batch 3 height width"], patch: int, stride: tuple[int, int]
) -> Float[Tensor, "batch patch*patch rows cols"]:
    """Grey patches of ``patch × patch`` pixels less their mean, of length one (less where there is no contrast).

    The product of two of them is the classical zero-mean normalised cross-correlation. Patches are centred on blocks
    of ``stride`` pixels; they wrap at the seam and repeat the last row at a pole.
    """
    grey = image.mean(dim=1, keepdim=True)
    above, left = (patch - stride[0]) // 2, (patch - stride[1]) // 2
    below, right = patch - stride[0] - above, patch - stride[1] - left
    height = sizes(grey)[-2]
    rows = torch.arange(-above, height + below, device=image.device).clamp(0, height - 1)
    padded = wrap_columns(grey.index_select(-2, rows), left, right)
    pick = torch.eye(patch * patch, dtype=image.dtype, device=image.device).view(-1, 1, patch, patch)
    patches = functional.conv2d(padded, pick, stride=stride)
    centred = patches - patches.mean(dim=1, keepdim=True)
    unit: Tensor = centred / (torch.linalg.vector_norm(centred, dim=1, keepdim=True) + PATCH_FLOOR)
    return unit
