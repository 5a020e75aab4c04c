"""Building blocks for networks on equirectangular images.

Every convolution wraps around left and right (the seam) by slice and concat, which every ONNX runtime knows, and sees
zeros beyond the poles. Upsampling is nearest, so that rolling the columns of an input by a multiple of the
coarsest stride rolls the output: nothing here knows where the seam is.
"""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

LEAK = 0.1  # Slope of every LeakyReLU below zero


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


def init_small(*layers: Any) -> None:
    """Random weights of a small standard deviation for last layers, so that answers begin near where they should."""
    for layer in layers:
        nn.init.normal_(layer.weight, std=0.01)
