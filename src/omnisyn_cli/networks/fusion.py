"""Two renderings become one picture: the paper's UNet, and a smaller network that corrects the geometric fusion.

``paper`` paints: renderings and visibility masks in, colours out, at one resolution. ``residual`` sees more (inverse
depth, the position on the way, what the geometric fusion makes of it, see :mod:`omnisyn_cli.fusion.input_channels`; and what
the photographs show at other distances, see :mod:`omnisyn_cli.fusion.warp_candidates`) and answers less: the shares of a
pixel that are to be what the photographs show there. A fresh network has small shares: it nearly is the geometric
fusion; and because photographs are chosen from, not painted, the frames are as sharp as they are, at any size.

Source: OmniSyn, section 3.5.
"""

import itertools
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from omnisyn_cli.networks.interface import Network, Ports, check_multiple
from omnisyn_cli.networks.layers import WrappedConv, at_least_single, initialise
from omnisyn_cli.networks.paper_layers import Block, enlarged
from omnisyn_cli.networks.unet import CorrectingConfig, CorrectingUNet

__all__ = ["FUSION_VARIANTS", "FusionConfig", "FusionNetwork", "PaintingNetwork", "build_fusion"]

SEEN_CHANNELS, RELEVANCE_CHANNEL, HYPOTHESIS_CHANNELS = slice(15, 17), 17, slice(44, 46)
"""Of the input: 1 where the first, and where the second, shows anything; whether it matters which one is shown; the
roots of the supposed surfaces."""

APART = 0.06
"""Relative difference of inverse depth at which two supposed surfaces are different ones."""

LEAST_NEAR = 1e-3
"""Inverse depth × baseline that is next to nothing."""

SELDOM = 4.0
"""A fresh network gives each candidate e to minus this of what it leaves as it is."""

COLOURS = 3
"""Of a rendering: a network that paints sees those of the first, then those of the second."""

PACE = 8.0
"""Answers are this many times what the last convolution says, so that they leave zero soon."""


@dataclass(frozen=True)
class FusionConfig(CorrectingConfig):
    """What makes one fusion network differ from another.

    Attributes:
        fine: channels at full resolution of a network that does not paint.
        paints: whether it answers with colours, as in the paper, or with corrections; its widths then begin at full
            resolution and end in the middle.
    """

    fine: int = 0
    paints: bool = False

    @property
    def size_multiple(self) -> int:
        """Heights and widths have to be a multiple of this."""
        return int(2 ** (len(self.widths) - self.paints))


FUSION_VARIANTS = {
    "residual": FusionConfig("residual", planes=52, widths=(48, 64, 96, 128, 128), fine=24),
    "paper": FusionConfig("paper", planes=8, widths=(16, 32, 64, 128, 256, 512, 1024), paints=True),
    "paper-narrow": FusionConfig("paper-narrow", planes=8, widths=(4, 8, 16, 32, 64, 128, 256), paints=True),
}
"""The networks by name; the last is the paper's with a quarter of the channels."""


class FusionNetwork(CorrectingUNet):
    """Planes in, shares of candidates out; any size that is a multiple of ``config.size_multiple``."""

    def __init__(self, config: FusionConfig) -> None:
        super().__init__(config, answers=4)
        nn.init.zeros_(self.answer.weight)

    @property
    def ports(self) -> Ports:
        """Planes of any size."""
        return Ports({"planes": self.config.planes}, ("shares",))

    def forward(self, planes: Float[Tensor, "batch planes height width"]) -> Float[Tensor, "batch 4 height width"]:
        """The shares of the candidates of a second look; what they leave of 1 stays as it is."""
        wanted = PACE * self.answers(planes) - SELDOM
        logits = torch.cat([torch.zeros_like(wanted[:, :1]), wanted], dim=1)
        return is_open(planes) * logits.softmax(dim=1)[:, 1:]


def is_open(planes: Float[Tensor, "batch planes height width"]) -> Float[Tensor, "batch 1 height width"]:
    """From 0 to 1: how far it is open what a pixel shows.

    All of it in holes; where one view alone sees anything, or it matters which of both is shown, as far as different
    surfaces are around.
    """
    farthest, nearest = at_least_single(planes[:, HYPOTHESIS_CHANNELS]).square().chunk(2, dim=1)
    apart = (nearest - farthest) / (APART * nearest.clamp(min=LEAST_NEAR))
    first, second = at_least_single(planes[:, SEEN_CHANNELS]).chunk(2, dim=1)
    matters = torch.maximum(planes[:, RELEVANCE_CHANNEL : RELEVANCE_CHANNEL + 1], 1.0 - first * second)
    return torch.maximum((1.0 - torch.exp(-apart.square())) * matters, (1.0 - first) * (1.0 - second))


class PaintingNetwork(Network):
    """The UNet of the paper: colours of two renderings and two visibility masks in, colours out."""

    def __init__(self, config: FusionConfig) -> None:
        super().__init__()
        self.config = config
        *widths, middle = config.widths
        downwards = itertools.pairwise([config.planes, *widths])
        down = [Block(a, b, has_row=False) for a, b in downwards]
        self.middle = Block(widths[-1], middle, has_row=False)
        inputs, outputs = [middle, *(2 * width for width in widths[-2::-1])], [*widths[-2::-1], widths[0]]
        up = [Block(a, b, has_row=False) for a, b in zip(inputs, outputs, strict=True)]
        self.down, self.up = nn.ModuleList(down), nn.ModuleList(up)
        self.answer = WrappedConv(widths[0], COLOURS)
        initialise(self, gain=1.0)
        self._begin_with_mean(down[0], up[-1])

    @torch.no_grad()
    def _begin_with_mean(self, first: Block, last: Block) -> None:
        """Three channels of a fresh network carry the mean of both renderings; the rest is learned around it.

        With random weights everywhere the narrow network painted in grey for thousands of steps.
        """
        first.pass_on(COLOURS, 0)
        for channel in range(COLOURS):
            first.first.weight[channel, [channel, COLOURS + channel], 1, 1] = 0.5
        last.pass_on(COLOURS, self.config.widths[0])
        self.answer.weight.zero_()
        self.answer.weight[range(COLOURS), range(COLOURS), 1, 1] = 1.0

    @property
    def ports(self) -> Ports:
        """Planes of any size."""
        return Ports({"planes": self.config.planes}, ("colour",))

    def forward(self, planes: Float[Tensor, "batch planes height width"]) -> Float[Tensor, "batch 3 height width"]:
        """Paint.

        Raises:
            ValueError: the size is not a multiple of ``config.size_multiple``.
        """
        check_multiple(planes, self.config.size_multiple)
        x, skips = planes, []
        for block in self.down:
            x = block(x)
            skips.append(x)
            x = functional.avg_pool2d(x, 2)
        x = self.up[0](enlarged(self.middle(x), 2))
        for block, skip in zip(self.up[1:], skips[-2::-1], strict=True):
            x = block(torch.cat([enlarged(x, 2), skip], dim=1))
        return at_least_single(self.answer(x))


def build_fusion(config: FusionConfig) -> FusionNetwork | PaintingNetwork:
    """A fresh network of a configuration."""
    return PaintingNetwork(config) if config.paints else FusionNetwork(config)
