"""Fusion networks: the paper's direct UNet, and a smaller one that corrects the geometric fusion.

``paper`` predicts colours from two renderings and their visibility masks, at one resolution. ``residual`` sees
:mod:`omnisyn_cli.fusion.input_channels` and the backward-warped candidates of
:mod:`omnisyn_cli.fusion.warp_candidates`, and predicts the weight of each candidate in a pixel, small ones at first.
Candidates are photographs: frames stay as sharp as these. Source: OmniSyn, section 3.5.
"""

import itertools
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from omnisyn_cli.networks.interface import Network, Ports, RefinementUNet, RefinementUNetConfig, check_multiple
from omnisyn_cli.networks.layers import WrappedConv, at_least_single, initialise
from omnisyn_cli.networks.paper import RGB_CHANNELS, Block, upsample_linear

# Input channels: where either layer shows anything; whether it matters which one is shown; √(inverse depth × baseline)
# of the depth hypotheses.
SEEN_SLICE, RELEVANCE_CHANNEL, HYPOTHESIS_SLICE = slice(15, 17), 17, slice(44, 46)
MIN_SURFACE_DIFFERENCE = 0.06  # Relative difference of inverse depth between two depth hypotheses of different surfaces
# Floor of inverse depth × baseline in relative differences: a thousandth moves a pixel by nothing.
MIN_INVERSE_DEPTH = 1e-3
INITIAL_LOGIT_GAP = 4.0  # A fresh network gives each candidate e to minus this, 2 %, of what it leaves as it is
LOGIT_SCALE = 8.0  # Factor on the output of the last convolution, which begins at zero: it leaves that sooner


@dataclass(frozen=True)
class FusionConfig(RefinementUNetConfig):
    """The sizes of a fusion network; ``fine`` is of the residual one.

    A direct network (``is_direct``) predicts colours, as in the paper, others weights of candidates. Its widths begin
    at full resolution and end at the bottleneck.
    """

    fine: int = 0
    is_direct: bool = False

    @property
    def size_multiple(self) -> int:
        """Heights and widths have to be a multiple of this."""
        return int(2 ** (len(self.widths) - self.is_direct))


# The networks by name; the last is the paper's with a quarter of the channels.
FUSION_VARIANTS = {
    "residual": FusionConfig("residual", channels=52, widths=(48, 64, 96, 128, 128), fine=24),
    "paper": FusionConfig("paper", channels=8, widths=(16, 32, 64, 128, 256, 512, 1024), is_direct=True),
    "paper-narrow": FusionConfig("paper-narrow", channels=8, widths=(4, 8, 16, 32, 64, 128, 256), is_direct=True),
}


class ResidualFusionUNet(RefinementUNet):
    """Input channels in, weights of candidates out; any size that is a multiple of ``config.size_multiple``."""

    output_names = ("shares",)

    def __init__(self, config: FusionConfig) -> None:
        super().__init__(config, outputs=4)
        nn.init.zeros_(self.head.weight)

    def forward(self, channels: Float[Tensor, "batch channels height width"]) -> Float[Tensor, "batch 4 height width"]:
        """The weights of the backward-warped candidates; the geometric fusion has the rest of 1."""
        candidates = LOGIT_SCALE * self.predict(channels) - INITIAL_LOGIT_GAP
        logits = torch.cat([torch.zeros_like(candidates[:, :1]), candidates], dim=1)
        return depth_ambiguity(channels) * logits.softmax(dim=1)[:, 1:]


def depth_ambiguity(channels: Float[Tensor, "batch channels height width"]) -> Float[Tensor, "batch 1 height width"]:
    """From 0 to 1: by how different depth hypotheses are where one layer is alone or the choice matters; 1 in holes."""
    farthest, nearest = at_least_single(channels[:, HYPOTHESIS_SLICE]).square().chunk(2, dim=1)
    apart = (nearest - farthest) / (MIN_SURFACE_DIFFERENCE * nearest.clamp(min=MIN_INVERSE_DEPTH))
    first, second = at_least_single(channels[:, SEEN_SLICE]).chunk(2, dim=1)
    matters = torch.maximum(channels[:, RELEVANCE_CHANNEL : RELEVANCE_CHANNEL + 1], 1.0 - first * second)
    return torch.maximum((1.0 - torch.exp(-apart.square())) * matters, (1.0 - first) * (1.0 - second))


class DirectFusionUNet(Network):
    """The paper's UNet: colours of two renderings and two visibility masks in, colours out."""

    def __init__(self, config: FusionConfig) -> None:
        super().__init__()
        self.config = config
        *widths, middle = config.widths
        downwards = itertools.pairwise([config.channels, *widths])
        down = [Block(a, b, has_row=False) for a, b in downwards]
        self.middle = Block(widths[-1], middle, has_row=False)
        inputs, outputs = [middle, *(2 * width for width in widths[-2::-1])], [*widths[-2::-1], widths[0]]
        up = [Block(a, b, has_row=False) for a, b in zip(inputs, outputs, strict=True)]
        self.down, self.up = nn.ModuleList(down), nn.ModuleList(up)
        self.head = WrappedConv(widths[0], RGB_CHANNELS)
        initialise(self, gain=1.0)
        self._init_as_mean(down[0], up[-1])

    @torch.no_grad()
    def _init_as_mean(self, first: Block, last: Block) -> None:
        """Three channels of a fresh network carry the mean of both renderings; the rest is learned around it.

        With random weights everywhere the narrow network painted in grey for thousands of steps.
        """
        first.init_identity(RGB_CHANNELS, 0)
        for channel in range(RGB_CHANNELS):
            first.first.weight[channel, [channel, RGB_CHANNELS + channel], 1, 1] = 0.5
        last.init_identity(RGB_CHANNELS, self.config.widths[0])
        self.head.weight.zero_()
        self.head.weight[range(RGB_CHANNELS), range(RGB_CHANNELS), 1, 1] = 1.0

    @property
    def ports(self) -> Ports:
        """Input channels of any size."""
        return Ports({"planes": self.config.channels}, ("colour",))

    def forward(self, channels: Float[Tensor, "batch channels height width"]) -> Float[Tensor, "batch 3 height width"]:
        """The fused picture; ValueError for a size that is no multiple of ``config.size_multiple``."""
        check_multiple(channels, self.config.size_multiple)
        x, skips = channels, []
        for block in self.down:
            x = block(x)
            skips.append(x)
            x = functional.avg_pool2d(x, 2)
        x = self.up[0](upsample_linear(self.middle(x), 2))
        for block, skip in zip(self.up[1:], skips[-2::-1], strict=True):
            x = block(torch.cat([upsample_linear(x, 2), skip], dim=1))
        return at_least_single(self.head(x))


def build_fusion(config: FusionConfig) -> ResidualFusionUNet | DirectFusionUNet:
    """A fresh network of a configuration."""
    return DirectFusionUNet(config) if config.is_direct else ResidualFusionUNet(config)
