"""Where near things end: a network that gives every pixel beside an edge to the surface before it or behind it.

Matching compares windows, so near things grow by half of one, thin ones break, and what is hidden from the other
panorama beside an edge takes on the depth of what hides it. The network sees the finished map with the picture at full
size, and what the other panorama shows if a pixel has the depth it has, that of the nearest surface around it or that
of the farthest (:func:`omnisyn_cli.stereo.silhouettes.silhouette_planes`). It chooses one of the three: a pixel that
keeps its depth keeps it exactly; of the other two it may correct the value a little.

Source: two modes at edges instead of one value between them: Tosi et al., SMD-Nets: Stereo mixture density networks,
2021. That they are given by the map and chosen by what the other picture shows is ours.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from omnisyn_cli.networks.interface import DepthAnswer
from omnisyn_cli.networks.layers import begin_small
from omnisyn_cli.networks.unet import CorrectingConfig, CorrectingUNet

__all__ = ["ROOT_PLANE", "SILHOUETTE_VARIANTS", "SilhouetteConfig", "SilhouetteNetwork", "SilhouettePrediction"]

ROOT_PLANE = 3
"""Of the input: the root of the map. After it, how far the nearest and the farthest around are from it."""

CHOICES = 3
"""The map as it is, the nearest surface around, the farthest."""

KEEPING = 1.5
"""Logit of a fresh network for the map as it is."""

MOST_CORRECTED = 0.1
"""Of the roots of the surfaces around."""


@dataclass(frozen=True)
class SilhouetteConfig(CorrectingConfig):
    """What makes one silhouette network differ from another."""


SILHOUETTE_VARIANTS = {"balanced": SilhouetteConfig("balanced", planes=27, widths=(32, 48, 64, 96), fine=24)}
"""The networks by name."""


@dataclass(frozen=True)
class SilhouettePrediction(DepthAnswer):
    """Three roots for every pixel, which of them is right, and how far that may be trusted.

    Attributes:
        logits: ``(batch, 3, height, width)``; their softmax is the probability of each.
        roots: ``(batch, 3, height, width)`` the map's own, and those of the surfaces around.
        confidence_logit: ``(batch, 1, height, width)``; its sigmoid is the probability that the depth is within 10 %.
    """

    logits: Tensor
    roots: Tensor
    confidence_logit: Tensor

    def root(self) -> Float[Tensor, "batch 1 height width"]:
        """The likeliest one."""
        own, near, far = torch.split(self.roots, 1, dim=1)
        keep, nearer, farther = torch.split(self.logits, 1, dim=1)
        moved = torch.where(nearer > farther, near, far)
        return torch.where(torch.maximum(nearer, farther) > keep, moved, own)


class SilhouetteNetwork(CorrectingUNet):
    """Planes in, three roots per pixel out; any size that is a multiple of ``config.size_multiple``."""

    def __init__(self, config: SilhouetteConfig) -> None:
        super().__init__(config, answers=2 * CHOICES + 1)
        begin_small(self.answer)
        with torch.no_grad():
            self.answer.bias[0] = KEEPING  # type: ignore[index]

    def forward(self, planes: Float[Tensor, "batch planes height width"]) -> SilhouettePrediction:
        """Choose; see :meth:`answers`."""
        logits, corrections, confidence = torch.split(self.answers(planes), [CHOICES, CHOICES, 1], dim=1)
        own, nearer, farther = torch.split(planes[:, ROOT_PLANE : ROOT_PLANE + CHOICES], 1, dim=1)
        near, far = (MOST_CORRECTED * torch.tanh(corrections[:, k : k + 1]) for k in (1, 2))
        roots = torch.cat([own, own + nearer + near, own - farther + far], dim=1)
        return SilhouettePrediction(logits, roots.clamp(min=0.0), confidence)
