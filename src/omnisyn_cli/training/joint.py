"""Depth and fusion trained together: both panoramas' depth, both meshes, the view between, one loss behind all of it.

1. The depth network estimates both panoramas of a pair.
2. Each becomes a mesh, cut at discontinuities as the renderer does it, and is rendered from a place between
   (:mod:`omnisyn_cli.render.rasterize_torch`): gradients flow back to inverse depths through what a pixel shows and how
   far away it is; which face it sees is a constant.
3. The fusion network makes one picture of both renderings, which is compared with the true view from there.

What both networks are told is added: L1 of the depth, and L1 of the picture. Everything is counted in baselines, and
the view between is held in the forward frame, in which up is as far up as it can be.

Source: OmniSyn, section 3.6.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.networks.depth import DepthPrediction
from omnisyn_cli.networks.joint import JointNetwork, PairPrediction
from omnisyn_cli.render.mesh import Mesh, build_mesh
from omnisyn_cli.render.quads import FACES_PER_QUARTER
from omnisyn_cli.render.rasterize import Fragments, rasterize
from omnisyn_cli.render.rasterize_torch import render_fragments
from omnisyn_cli.training.checkpoint import load_checkpoint
from omnisyn_cli.training.frames import EPIPOLE_FROM_FORWARD
from omnisyn_cli.training.fusion_losses import fused_by, fusion_loss
from omnisyn_cli.training.joint_planes import Seen, fusion_planes
from omnisyn_cli.training.losses import depth_loss, paper_loss
from omnisyn_cli.training.triples import Triples

__all__ = ["JointAnswer", "Part", "joint_answer", "joint_loss", "part_of", "parts_of", "planes_between", "view_between"]

FUSION_WEIGHT = 1.0
"""Of the loss of the picture beside that of the depth."""

ALONG = np.array([0.0, 0.0, -1.0])
"""From the first to the second camera in the forward frame."""


@dataclass(frozen=True)
class JointAnswer:
    """What both networks make of some pairs: depth, the planes that the fusion network saw, and its pictures."""

    prediction: PairPrediction
    planes: Float[Tensor, "batch planes height width"]
    picture: Float[Tensor, "batch 3 height width"]


def joint_answer(network: JointNetwork, triples: Triples) -> JointAnswer:
    """Depth of both panoramas, both renderings from the place of the view between, and the fused picture."""
    prediction = network(triples.first, triples.second)
    with torch.autocast(triples.first.device.type, enabled=False):
        planes = planes_between(
            prediction.inverse_depth.float(),
            prediction.confidence.float(),
            torch.stack([triples.first_texture, triples.second_texture]),
            triples.share,
            network.depth.frame,
        )
    return JointAnswer(prediction, planes, fused_by(network.fusion, planes))


def joint_loss(answer: JointAnswer, triples: Triples) -> Tensor:
    """The loss of both panoramas' depth and that of the picture, a scalar."""
    return depth_part(answer.prediction, triples) + FUSION_WEIGHT * fusion_loss(answer.picture, triples.middle)


def depth_part(prediction: PairPrediction, triples: Triples) -> Tensor:
    """What the depth network is told by itself, of both panoramas."""
    roots = triples.roots.flatten(0, 1)
    if isinstance(prediction.stacked, DepthPrediction):
        return depth_loss(prediction.stacked, roots)
    return paper_loss(prediction.stacked, roots)


def planes_between(
    inverse_depth: Float[Tensor, "2 batch rows cols"],
    confidence: Float[Tensor, "2 batch rows cols"],
    textures: Float[Tensor, "2 batch 3 rows cols"],
    share: Float[Tensor, " batch"],
    frame: str,
) -> Float[Tensor, "batch planes rows cols"]:
    """What the fusion network sees of pairs, from places between them.

    Args:
        inverse_depth: × baseline, of both panoramas; gradients flow to it.
        confidence: of it, in [0, 1].
        textures: their colours; gradients flow to them.
        share: of the way, of each pair.
        frame: that the panoramas are held in, ``epipole`` or ``forward``.
    """
    planes = []
    for k, t in enumerate(share.tolist()):
        first, second = (
            view_between(inverse_depth[i, k], confidence[i, k], textures[i, k], t - i, frame) for i in range(2)
        )
        planes.append(fusion_planes(first, second, t))
    return torch.stack(planes)


def view_between(
    inverse_depth: Float[Tensor, "rows cols"],
    confidence: Float[Tensor, "rows cols"],
    texture: Float[Tensor, "3 rows cols"],
    ahead: float,
    frame: str,
) -> Seen:
    """One panorama as it is seen, in the forward frame, from ``ahead`` baselines further on, at its own size."""
    surface = inverse_depth.detach().cpu().numpy()
    mesh = build_mesh(surface, confidence=confidence.cpu().numpy())
    rotation = EPIPOLE_FROM_FORWARD.T if frame == "epipole" else np.eye(3)
    pose = Pose(rotation, -ahead * ALONG)
    fragments = rasterize(mesh, pose, (surface.shape[0], surface.shape[1]), threads=1)
    shown = render_fragments(fragments, mesh, inverse_depth, texture.permute(1, 2, 0), pose)
    return Seen(shown.colour, shown.inverse_depth, _worth(fragments, mesh).to(inverse_depth), pose.position)


def _worth(fragments: Fragments, mesh: Mesh) -> Float[Tensor, "height width"]:
    """Trust in the quarters of quads that are seen; all of it in the caps."""
    trust = np.append(mesh.trust.ravel(), np.float32(1.0))
    quarter = np.minimum(fragments.face // FACES_PER_QUARTER, mesh.trust.size)
    return torch.from_numpy(np.where(fragments.visibility, trust[quarter], np.float32(0.0)))


@dataclass(frozen=True)
class Part:
    """One network of a checkpoint.

    Attributes:
        kind: ``depth``, ``paper``, ``fusion``, …
        config: as a checkpoint holds it.
        average: its averaged weights.
    """

    kind: str
    config: dict[str, Any]
    average: dict[str, Tensor]


def parts_of(state: dict[str, Any]) -> list[Part]:
    """The networks in a checkpoint: both of a joint one, the one of any other."""
    if state["kind"] != "joint":
        return [Part(state["kind"], state["network"], state["average"])]
    return [
        Part(kind, config, _below(state["average"], "fusion." if kind == "fusion" else "depth."))
        for kind, config in state["network"].items()
    ]


def part_of(path: Path, kinds: tuple[str, ...]) -> Part:
    """The network of one of these kinds in a checkpoint, joint or not.

    Raises:
        InputError: no checkpoint, or it has none.
    """
    state = load_checkpoint(path)
    found = parts_of(state)
    for part in found:
        if part.kind in kinds:
            return part
    held = " and ".join(part.kind for part in found) or "none"
    raise InputError(f"expected a {' or '.join(kinds)} network in {path}, got {held}; name another checkpoint")


def _below(weights: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in weights.items() if name.startswith(prefix)}
