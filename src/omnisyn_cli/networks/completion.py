"""Depth completion: a UNet with attention corrects the depth that matching found and filled.

Matching fails where the other panorama sees nothing, without texture and around the epipoles; the rest of the scene
says much about such places. It predicts two modes of √(inverse depth × baseline) for each pixel, corrections of the
filled map, and which is likelier: at an edge one follows the near surface and the other the far one, so the estimate
never lies between them. At the coarsest stride each position attends to all others, biased by the angle between them.
For inputs see :func:`omnisyn_cli.stereo.stereo_features.completion_channels`.

Source: Tosi et al., SMD-Nets, 2021; OmniSyn, 3.3 (monocular skip); Vaswani et al., Attention is all you need, 2017.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from omnisyn_cli.geometry.sphere import angles_to_direction, pixel_to_angles
from omnisyn_cli.networks.interface import DepthPrediction, RefinementUNet, RefinementUNetConfig
from omnisyn_cli.networks.layers import ResidualBlock, at_least_single, init_small, initialise

FILLED_CHANNEL = 3  # Input channel with the filled √(inverse depth × baseline) that is corrected
CONSISTENT_CHANNEL, SKY_CHANNEL = 5, 6  # Input channels where matching is reliable: left-right consistent, or sky
# Scale of the corrections. A small one lets a fresh network leave the filled map nearly as it is.
CORRECTION_SCALE = 0.3
# Powers of the cosine between two positions that the attention bias is a linear function of: a smooth falloff.
COSINE_POWERS = 4


@dataclass(frozen=True)
class CompletionConfig(RefinementUNetConfig):
    """The sizes of a completion network, among them heads and number of attention layers at the last stride."""

    heads: int
    attention_layers: int


# The networks by name.
COMPLETION_VARIANTS = {
    "balanced": CompletionConfig(
        "balanced", channels=19, widths=(32, 64, 96, 144, 192), fine=24, heads=6, attention_layers=2
    )
}


@dataclass(frozen=True)
class CompletionPrediction(DepthPrediction):
    """Two modes for every pixel, which of them is right, and the confidence."""

    modes: Tensor  # ``(batch, 2, height, width)`` √(inverse depth × baseline)
    mode_logit: Tensor  # ``(batch, 1, height, width)``; its sigmoid is the probability of the first
    # ``(batch, 1, height, width)``; its sigmoid is the probability that the depth is within 10 %
    confidence_logit: Tensor

    def sqrt_inv_depth(self) -> Float[Tensor, "batch 1 height width"]:
        """The likelier mode."""
        return torch.where(self.mode_logit > 0, self.modes[:, :1], self.modes[:, 1:])


class SphereAttention(nn.Module):
    """A pre-norm transformer layer on coarse pixels, biased by their angle; channels are a multiple of ``heads``."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm_attention, self.norm_mlp = nn.LayerNorm(channels), nn.LayerNorm(channels)
        self.qkv = nn.Linear(channels, 3 * channels)
        self.position_bias = nn.Linear(COSINE_POWERS, heads)
        self.proj = nn.Linear(channels, channels)
        self.mlp = nn.Sequential(nn.Linear(channels, 2 * channels), nn.GELU(), nn.Linear(2 * channels, channels))
        for last in (self.proj, self.mlp[2]):
            nn.init.zeros_(last.weight)  # type: ignore[arg-type]
            nn.init.zeros_(last.bias)  # type: ignore[arg-type]

    def forward(self, x: Float[Tensor, "batch channels height width"]) -> Float[Tensor, "batch channels height width"]:
        """The same size."""
        tokens = x.flatten(2).transpose(1, 2)  # (batch, n, channels)
        tokens = tokens + self.proj(self._attend(self.norm_attention(tokens), _directions(x)))
        tokens = tokens + self.mlp(self.norm_mlp(tokens))
        output: Tensor = tokens.transpose(1, 2).reshape(x.shape)
        return output

    def _attend(
        self, tokens: Float[Tensor, "batch n channels"], directions: Float[Tensor, "n 3"]
    ) -> Float[Tensor, "batch n channels"]:
        """Attention over all positions, weighted by their solid angles."""
        queries, keys, values = self.qkv(tokens).unflatten(-1, (3, self.heads, -1)).permute(2, 0, 3, 1, 4).unbind(0)
        cosine = directions @ directions.T
        powers = torch.stack([cosine**k for k in range(1, COSINE_POWERS + 1)], dim=-1)
        bias = self.position_bias(powers).permute(2, 0, 1)
        log_area = 0.5 * torch.log((1.0 - directions[:, 1].square()).clamp(min=1e-6))  # of the sine of the polar angle
        logits = queries @ keys.transpose(-1, -2) * queries.shape[-1] ** -0.5
        weights = (at_least_single(logits) + at_least_single(bias) + log_area).softmax(dim=-1)
        mixed: Tensor = (weights.to(values.dtype) @ values).transpose(1, 2).flatten(2)
        return mixed


def reliable_mask(channels: Float[Tensor, "batch channels height width"]) -> Float[Tensor, "batch 1 height width"]:
    """1 where matching is reliable, else 0."""
    consistent, sky = (channels[:, k : k + 1] for k in (CONSISTENT_CHANNEL, SKY_CHANNEL))
    return torch.maximum(consistent, sky)


def _directions(x: Float[Tensor, "batch channels height width"]) -> Float[Tensor, "n 3"]:
    """Unit vectors, row by row; sizes are sums, as an exported network is bound to one that is written as a number."""
    one = torch.ones_like(at_least_single(x[0, 0]))
    row, col = ((one.cumsum(axis) - 0.5) / one.sum(axis, keepdim=True) - 0.5 for axis in (0, 1))
    directions: Tensor = angles_to_direction(*pixel_to_angles(row, col, (1, 1))).flatten(0, 1)
    return directions


class CompletionNetwork(RefinementUNet):
    """Stereo features in, two modes per pixel out, at any size that is a multiple of ``config.size_multiple``."""

    def __init__(self, config: CompletionConfig) -> None:
        super().__init__(config, outputs=4)
        coarsest = config.widths[-1]
        blocks = nn.ModuleList(ResidualBlock(coarsest, coarsest) for _ in range(2))
        initialise(blocks)
        attention_layers = [SphereAttention(coarsest, config.heads) for _ in range(config.attention_layers)]
        self.middle = nn.Sequential(blocks[0], *attention_layers, blocks[1])
        init_small(self.head)

    def forward(self, channels: Float[Tensor, "batch channels height width"]) -> CompletionPrediction:
        """Complete; see :meth:`predict`."""
        corrections, mode_logit, confidence = torch.split(self.predict(channels), [2, 1, 1], dim=1)
        filled = channels[:, FILLED_CHANNEL : FILLED_CHANNEL + 1]
        return CompletionPrediction(filled + CORRECTION_SCALE * corrections, mode_logit, confidence)
