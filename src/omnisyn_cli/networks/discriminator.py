"""What tells true pictures from made ones while a generator learns: patches at several scales, on the sphere.

Source: Wang et al., pix2pixHD (CVPR 2018), section 3.2, as SynSin uses it; spectral norms instead of instance norms.
"""

from __future__ import annotations

import itertools

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.parametrizations import spectral_norm

from omnisyn_cli.networks.layers import WrappedConv
from omnisyn_cli.networks.paper_layers import row_channel

__all__ = ["PatchDiscriminator"]

LEAK = 0.2

COLOURS = 3


class PatchDiscriminator(nn.Module):
    """Panoramas in, for each scale the features of every layer and last the verdicts on patches (positive: true).

    Args:
        widths: channels of the layers, each half as high and wide as the one before.
        scales: how often it is asked, each time about a picture of half the size.
    """

    def __init__(self, widths: tuple[int, ...] = (24, 48, 96), scales: int = 2) -> None:
        super().__init__()
        self.scales = nn.ModuleList(_scale(widths) for _ in range(scales))

    def forward(self, image: Float[Tensor, "batch 3 height width"]) -> list[list[Tensor]]:
        """Look at pictures whose height and width can be halved often enough."""
        answers = []
        for layers in self.scales:
            x, seen = torch.cat([image - 0.5, row_channel(image)], dim=1), []
            for layer in layers:  # type: ignore[attr-defined]
                x = layer(x)
                seen.append(x)
                x = functional.leaky_relu(x, LEAK)
            answers.append(seen)
            image = functional.avg_pool2d(image, 2)
        return answers


def _scale(widths: tuple[int, ...]) -> nn.ModuleList:
    halving = [WrappedConv(a, b, (2, 2)) for a, b in itertools.pairwise((COLOURS + 1, *widths))]
    return nn.ModuleList(spectral_norm(layer) for layer in (*halving, WrappedConv(widths[-1], 1)))
