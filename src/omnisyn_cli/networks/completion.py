"""Depth where matching cannot know: completed from what it is sure of, with the whole sphere in view.

Much of what matching leaves open is hidden from the other panorama, has no texture or lies around the epipoles. Nothing
can be matched there, but a room tells much about its hidden parts. The network sees the picture, what matching is sure
of, planes carried on from there (:mod:`omnisyn_cli.stereo.filling`), what the other panorama shows where the map says
that the same point is, where the other camera is and where up is, all in the upright frame of the camera
(:func:`omnisyn_cli.stereo.stereo_features.completion_channels`). It corrects the filled map everywhere, as some of what passes for
sure is wrong.

It answers with two roots for each pixel and with which of them is the more likely one: at an edge one follows the near
surface and one the far, and the answer never lies between them. At its coarsest stride every place attends to every
other; how much depends on the angle between them, not on where the seam is, so that rolling the columns of the input
rolls the answer.

Source: two modes instead of one value at edges: Tosi et al., SMD-Nets: Stereo mixture density networks, 2021; monocular
skip: OmniSyn, section 3.3; attention: Vaswani et al., Attention is all you need, 2017.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from omnisyn_cli.geometry.sphere import angles_to_direction, pixel_to_angles
from omnisyn_cli.networks.interface import DepthAnswer
from omnisyn_cli.networks.layers import ResidualBlock, at_least_single, begin_small, initialise
from omnisyn_cli.networks.unet import CorrectingConfig, CorrectingUNet

__all__ = [
    "COMPLETION_VARIANTS",
    "FILLED_PLANE",
    "CompletionConfig",
    "CompletionNetwork",
    "CompletionPrediction",
    "where_sure",
]

FILLED_PLANE = 3
"""Of the input: the root that is corrected."""

AGREED_PLANE, SKY_PLANE = 5, 6
"""Of the input: where matching is sure."""

CORRECTION = 0.3
"""Scale of the corrections, so that a fresh network leaves the filled map nearly as it is."""

POWERS = 4
"""Of the cosine between two places, that attention is drawn from."""


@dataclass(frozen=True)
class CompletionConfig(CorrectingConfig):
    """What makes one completion network differ from another; its planes are the evidence.

    Attributes:
        heads: of the attention at the last stride.
        looks: how often every place attends to every other.
    """

    heads: int
    looks: int


COMPLETION_VARIANTS = {
    "balanced": CompletionConfig("balanced", planes=19, widths=(32, 64, 96, 144, 192), fine=24, heads=6, looks=2)
}
"""The networks by name."""


@dataclass(frozen=True)
class CompletionPrediction(DepthAnswer):
    """Two roots for every pixel, which of them is right, and how far that may be trusted.

    Attributes:
        roots: ``(batch, 2, height, width)``.
        logit: ``(batch, 1, height, width)``; its sigmoid is the share of the first.
        confidence_logit: ``(batch, 1, height, width)``; its sigmoid is the probability that the depth is within 10 %.
    """

    roots: Tensor
    logit: Tensor
    confidence_logit: Tensor

    def root(self) -> Float[Tensor, "batch 1 height width"]:
        """The more likely one."""
        return torch.where(self.logit > 0, self.roots[:, :1], self.roots[:, 1:])


class SphereAttention(nn.Module):
    """Every place of a coarse map looks at every other one, then thinks for itself; both are added to what was there.

    Args:
        channels: of the map, a multiple of ``heads``.
        heads: looks at once.
    """

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.before, self.between = nn.LayerNorm(channels), nn.LayerNorm(channels)
        self.ask = nn.Linear(channels, 3 * channels)
        self.near = nn.Linear(POWERS, heads)
        self.take = nn.Linear(channels, channels)
        self.think = nn.Sequential(nn.Linear(channels, 2 * channels), nn.GELU(), nn.Linear(2 * channels, channels))
        for last in (self.take, self.think[2]):
            nn.init.zeros_(last.weight)  # type: ignore[arg-type]
            nn.init.zeros_(last.bias)  # type: ignore[arg-type]

    def forward(self, x: Float[Tensor, "batch channels height width"]) -> Float[Tensor, "batch channels height width"]:
        """The same size."""
        places = x.flatten(2).transpose(1, 2)  # (batch, n, channels)
        places = places + self.take(self._seen(self.before(places), _directions(x)))
        places = places + self.think(self.between(places))
        answer: Tensor = places.transpose(1, 2).reshape(x.shape)
        return answer

    def _seen(
        self, places: Float[Tensor, "batch n channels"], directions: Float[Tensor, "n 3"]
    ) -> Float[Tensor, "batch n channels"]:
        """Values of all places, mixed; a place counts by its solid angle."""
        asked, offered, values = self.ask(places).unflatten(-1, (3, self.heads, -1)).permute(2, 0, 3, 1, 4).unbind(0)
        cosine = directions @ directions.T
        nearness = self.near(torch.stack([cosine**k for k in range(1, POWERS + 1)], dim=-1)).permute(2, 0, 1)
        area = 0.5 * torch.log((1.0 - directions[:, 1].square()).clamp(min=1e-6))
        logits = asked @ offered.transpose(-1, -2) * asked.shape[-1] ** -0.5
        shares = (at_least_single(logits) + at_least_single(nearness) + area).softmax(dim=-1)
        seen: Tensor = (shares.to(values.dtype) @ values).transpose(1, 2).flatten(2)
        return seen


def where_sure(planes: Float[Tensor, "batch planes height width"]) -> Float[Tensor, "batch 1 height width"]:
    """1 where matching is sure, else 0."""
    return torch.maximum(planes[:, AGREED_PLANE : AGREED_PLANE + 1], planes[:, SKY_PLANE : SKY_PLANE + 1])


def _directions(x: Float[Tensor, "batch channels height width"]) -> Float[Tensor, "n 3"]:
    """Unit vectors of all places, row by row.

    Rows and columns are counted with sums, as fractions of a picture of one pixel: a size that is written as a number
    would be the only one that an exported network takes.
    """
    one = torch.ones_like(at_least_single(x[0, 0]))
    row, col = ((one.cumsum(axis) - 0.5) / one.sum(axis, keepdim=True) - 0.5 for axis in (0, 1))
    directions: Tensor = angles_to_direction(*pixel_to_angles(row, col, (1, 1))).flatten(0, 1)
    return directions


class CompletionNetwork(CorrectingUNet):
    """Evidence planes in, two roots per pixel out; any size that is a multiple of ``config.size_multiple``."""

    def __init__(self, config: CompletionConfig) -> None:
        super().__init__(config, answers=4)
        coarsest = config.widths[-1]
        blocks = [ResidualBlock(coarsest, coarsest) for _ in range(2)]
        for block in blocks:
            initialise(block)
        looks = [SphereAttention(coarsest, config.heads) for _ in range(config.looks)]
        self.middle = nn.Sequential(blocks[0], *looks, blocks[1])
        begin_small(self.answer)

    def forward(self, planes: Float[Tensor, "batch planes height width"]) -> CompletionPrediction:
        """Complete; see :meth:`answers`."""
        corrections, logit, confidence = torch.split(self.answers(planes), [2, 1, 1], dim=1)
        filled = planes[:, FILLED_PLANE : FILLED_PLANE + 1]
        return CompletionPrediction(filled + CORRECTION * corrections, logit, confidence)
