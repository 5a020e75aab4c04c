"""Depth and fusion trained together: both panoramas' depth, both meshes, the view between, one loss behind all of it.

The depth network estimates both panoramas of a pair. Each becomes a mesh, cut at discontinuities, and is rendered from
a place between (:mod:`omnisyn_cli.render.rasterize_torch`): gradients flow back to inverse depths through what a pixel
shows and how far away it is; which face it sees is a constant. The fusion network makes one picture of both, and its L1
is added to that of the depth. Lengths are in baselines, the view between is in the forward frame.
Source: OmniSyn, section 3.6.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from omnisyn_cli.fusion import input_channels as channel
from omnisyn_cli.fusion.blend_rule import BlendRule, LayerArrays
from omnisyn_cli.fusion.fill import HoleFiller
from omnisyn_cli.fusion.input_channels import fusion_input_channels
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.networks.fusion import FusionConfig, build_fusion
from omnisyn_cli.networks.paper import PaperConfig, PaperNetwork, PaperPrediction
from omnisyn_cli.render.mesh import build_mesh
from omnisyn_cli.render.quad_blocks import FACES_PER_QUARTER
from omnisyn_cli.render.rasterize import rasterize
from omnisyn_cli.render.rasterize_torch import render_fragments
from omnisyn_cli.training.losses import depth_scores, fusion_loss, fusion_scores, network_inputs, paper_loss
from omnisyn_cli.training.pairs import Triples, swap_cameras
from omnisyn_cli.training.pictures import as_array, depth_pictures

FUSION_WEIGHT = 1.0  # Weight of the picture's loss beside that of the depth: both count the same
BASELINE_DIRECTION = np.array([0.0, 0.0, -1.0])  # Direction from the first to the second camera in the forward frame


@dataclass(frozen=True)
class JointConfig:
    """Which networks; the fusion network is one that paints: the others need the photographs."""

    depth: PaperConfig
    fusion: FusionConfig

    @property
    def size(self) -> tuple[int, int]:
        """``(height, width)`` that the depth network is exported at."""
        return self.depth.size

    @property
    def size_multiple(self) -> int:
        """Heights and widths have to be a multiple of this."""
        return math.lcm(self.depth.size_multiple, self.fusion.size_multiple)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for a checkpoint; the depth network is under the kind that its own checkpoints name."""
        return {"paper": self.depth.as_dict(), "fusion": self.fusion.as_dict()}

    @staticmethod
    def from_dict(values: dict[str, Any]) -> "JointConfig":
        """The inverse of :meth:`as_dict`; unknown and missing keys are errors."""
        return JointConfig(PaperConfig.from_dict(values["paper"]), FusionConfig.from_dict(values["fusion"]))


@dataclass(frozen=True)
class PairPrediction:
    """What the depth network says about both panoramas of each pair."""

    stacked: PaperPrediction  # the network's own: all first panoramas, then all second ones with swapped cameras
    inverse_depth: Float[Tensor, "2 batch height width"]  # × baseline, of the first and the second, in the pair's frame
    confidence: Float[Tensor, "2 batch height width"]  # the same of the confidence, without gradients


class JointNetwork(nn.Module):
    """Both networks; called with pairs it answers with the depth of both panoramas."""

    def __init__(self, config: JointConfig) -> None:
        super().__init__()
        self.config = config
        self.depth = PaperNetwork(config.depth)
        self.fusion = build_fusion(config.fusion)

    def forward(
        self, first: Float[Tensor, "batch 3 height width"], second: Float[Tensor, "batch 3 height width"]
    ) -> PairPrediction:
        """Estimate the depth of both panoramas, called like the depth network."""
        other_way = [swap_cameras(x) for x in (second, first)]
        stacked = self.depth(torch.cat([first, other_way[0]]), torch.cat([second, other_way[1]]))
        halves = (x.squeeze(1).chunk(2) for x in (stacked.inverse_depth(), stacked.confidence().detach()))
        return PairPrediction(stacked, *(torch.stack([one, swap_cameras(other)]) for one, other in halves))


@dataclass(frozen=True)
class JointAnswer:
    """The predictions of both networks: depth, the inputs of the fusion network, and its pictures."""

    prediction: PairPrediction
    channels: Float[Tensor, "batch channels height width"]
    picture: Float[Tensor, "batch 3 height width"]


def joint_answer(network: JointNetwork, triples: Triples) -> JointAnswer:
    """Depth of both panoramas, both renderings from the place of the view between, and the fused picture."""
    prediction = network(triples.first, triples.second)
    with torch.autocast(triples.first.device.type, enabled=False):
        channels = channels_between(
            prediction.inverse_depth.float(),
            prediction.confidence.float(),
            torch.stack([triples.first_texture, triples.second_texture]),
            triples.position,
        )
    return JointAnswer(prediction, channels, network.fusion(network_inputs(network.fusion.config, channels)))


def joint_loss(answer: JointAnswer, triples: Triples) -> Tensor:
    """The loss of both panoramas' depth and that of the picture, a scalar."""
    depth = paper_loss(answer.prediction.stacked, triples.sqrt_inv_depths.flatten(0, 1))
    return depth + FUSION_WEIGHT * fusion_loss(answer.picture, triples.middle)


def joint_scores(answer: JointAnswer, triples: Triples) -> dict[str, float]:
    """Figures of both panoramas' depth and of the picture."""
    depths = depth_scores(answer.prediction.stacked, triples.sqrt_inv_depths.flatten(0, 1), triples.baseline.repeat(2))
    geometric = answer.channels[:, channel.FUSED_RGB : channel.FUSED_RGB + 3]
    return depths | fusion_scores(answer.picture, answer.channels, triples.middle, geometric)


def joint_pictures(answer: JointAnswer, triples: Triples) -> dict[str, np.ndarray]:
    """The first panorama's depth, both renderings, and the picture made of them."""
    colours = {
        "first": answer.channels[0, channel.FIRST_RGB :][:3],
        "second": answer.channels[0, channel.SECOND_RGB :][:3],
        "fused": answer.picture[0],
        "between": triples.middle[0],
    }
    sqrt_inv_depth = answer.prediction.inverse_depth[0, 0].sqrt()
    shown = depth_pictures(triples.first[0], sqrt_inv_depth, triples.sqrt_inv_depth[0, 0])
    return shown | {name: as_array(picture.clamp(0.0, 1.0)) for name, picture in colours.items()}


def channels_between(
    inverse_depth: Float[Tensor, "2 batch rows cols"], confidence: Float[Tensor, "2 batch rows cols"],
    textures: Float[Tensor, "2 batch 3 rows cols"], position: Float[Tensor, " batch"],
) -> Float[Tensor, "batch channels rows cols"]:  # fmt: skip
    """What fusion networks see from shares of the way between pairs; gradients flow to inverse depth and textures."""
    channels = []
    for k, t in enumerate(position.tolist()):
        first, second = (render_between(inverse_depth[i, k], confidence[i, k], textures[i, k], t - i) for i in range(2))
        channels.append(fusion_input_channels(first, second, BlendRule.at(t), 1.0, filled))
    return torch.stack(channels)


def filled(image: Float[Tensor, "height width 3"], weight: Float[Tensor, "height width"]) -> Tensor:
    """The picture with constants in its holes, where ``weight`` is 0; see :mod:`omnisyn_cli.fusion.fill`."""
    with torch.no_grad():
        numbers, weights = (values.float().cpu().numpy().copy() for values in (image, weight))
        HoleFiller(weights.shape, threads=1)(numbers, weights)
    return torch.where((weight == 0.0)[..., None], torch.from_numpy(numbers).to(image), image)


def render_between(
    inverse_depth: Float[Tensor, "rows cols"], confidence: Float[Tensor, "rows cols"],
    texture: Float[Tensor, "3 rows cols"], ahead: float,
) -> LayerArrays:  # fmt: skip
    """One panorama as it is seen, in the forward frame, from ``ahead`` baselines further on, at its own size."""
    surface = inverse_depth.detach().cpu().numpy()
    mesh = build_mesh(surface, confidence=confidence.cpu().numpy())
    pose = Pose(np.eye(3), -ahead * BASELINE_DIRECTION)
    fragments = rasterize(mesh, pose, (surface.shape[0], surface.shape[1]), threads=1)
    shown = render_fragments(fragments, mesh, inverse_depth, texture.permute(1, 2, 0), pose)
    surface_confidence = np.append(mesh.surface_confidence.ravel(), np.float32(1.0))  # the caps have all of it
    quarter = np.minimum(fragments.face // FACES_PER_QUARTER, mesh.surface_confidence.size)
    weights = np.where(fragments.visibility, surface_confidence[quarter], np.float32(0.0))
    weight = torch.from_numpy(weights).to(inverse_depth)
    return LayerArrays(shown.colour, weight, shown.inverse_depth, torch.as_tensor(pose.position).to(inverse_depth))
