"""A depth network and a fusion network that are trained together, with one loss behind both.

This only holds the two; what lies between them, meshes and their rendering, is in :mod:`omnisyn_cli.training.joint`.

Source: OmniSyn, section 3.6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from omnisyn_cli.networks.depth import DepthNetwork, DepthPrediction
from omnisyn_cli.networks.depth_config import DepthConfig
from omnisyn_cli.networks.fusion import FusionConfig, build_fusion
from omnisyn_cli.networks.paper import PaperConfig, PaperNetwork, PaperPrediction

__all__ = ["JointConfig", "JointNetwork", "PairPrediction", "exchanged_panoramas"]


@dataclass(frozen=True)
class JointConfig:
    """Which networks; a depth network of either kind, and any fusion network."""

    depth: DepthConfig | PaperConfig
    fusion: FusionConfig

    @property
    def name(self) -> str:
        """Of both variants."""
        return f"{self.depth.name}-{self.fusion.name}"

    @property
    def size_multiple(self) -> int:
        """Heights and widths have to be a multiple of this."""
        return math.lcm(self.depth.size_multiple, self.fusion.size_multiple)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for a checkpoint; the depth network is under the kind that its own checkpoints name."""
        kind = "paper" if isinstance(self.depth, PaperConfig) else "depth"
        return {kind: self.depth.as_dict(), "fusion": self.fusion.as_dict()}

    @staticmethod
    def from_dict(values: dict[str, Any]) -> JointConfig:
        """The inverse of :meth:`as_dict`; unknown and missing keys are errors."""
        fusion = FusionConfig.from_dict(values["fusion"])
        if "paper" in values:
            return JointConfig(PaperConfig.from_dict(values["paper"]), fusion)
        return JointConfig(DepthConfig.from_dict(values["depth"]), fusion)


@dataclass(frozen=True)
class PairPrediction:
    """What the depth network says about both panoramas of each pair.

    Attributes:
        stacked: the network's own answer: all first panoramas, then all second ones as they look with the roles of both
            exchanged (:func:`exchanged_panoramas`).
        inverse_depth: ``(2, batch, height, width)`` × baseline of the first and of the second, in the pair's frame.
        confidence: the same of the confidence, without gradients.
    """

    stacked: DepthPrediction | PaperPrediction
    inverse_depth: Float[Tensor, "2 batch height width"]
    confidence: Float[Tensor, "2 batch height width"]


class JointNetwork(nn.Module):
    """Both networks; called with pairs it answers with the depth of both panoramas."""

    def __init__(self, config: JointConfig) -> None:
        super().__init__()
        self.config = config
        self.depth: DepthNetwork | PaperNetwork = (
            PaperNetwork(config.depth) if isinstance(config.depth, PaperConfig) else DepthNetwork(config.depth)
        )
        self.fusion = build_fusion(config.fusion)

    def forward(
        self, first: Float[Tensor, "batch 3 height width"], second: Float[Tensor, "batch 3 height width"]
    ) -> PairPrediction:
        """Estimate the depth of both panoramas.

        Args:
            first: colours in [0, 1], in the frame of the depth network.
            second: the same for the other camera, in the same frame.

        Raises:
            ValueError: the depth network does not take the size.
        """
        frame = self.depth.frame
        other_way = [exchanged_panoramas(x, frame) for x in (second, first)]
        stacked = self.depth(torch.cat([first, other_way[0]]), torch.cat([second, other_way[1]]))
        both = [_in_one_frame(x, frame) for x in (stacked.inverse_depth(), stacked.confidence().detach())]
        return PairPrediction(stacked, *both)


def exchanged_panoramas(x: Float[Tensor, "*batch height width"], frame: str) -> Float[Tensor, "*batch height width"]:
    """Panoramas of a frame as they look when the roles of both cameras are exchanged; its own inverse.

    See :func:`omnisyn_cli.geometry.sweep.exchanged_in_epipole_frame` and ``exchanged_in_forward_frame``.
    """
    return x.flip((-2, -1)) if frame == "epipole" else x.roll(x.shape[-1] // 2, -1)


def _in_one_frame(stacked: Tensor, frame: str) -> Float[Tensor, "2 batch height width"]:
    first, second = stacked.squeeze(1).chunk(2)
    return torch.stack([first, exchanged_panoramas(second, frame)])
