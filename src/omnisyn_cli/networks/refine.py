"""Depth made better by a network that knows rooms and streets: a residual on what matching found out.

Matching is exact where there is texture and both panoramas look; elsewhere its map is a guess carried on from the
surroundings. The network sees the picture, the map, how sure matching was, and what the other panorama shows where the
map says that the same point is (:func:`omnisyn_cli.stereo.evidence.evidence_planes`), all in the upright frame of the
camera, where floors are below and skies above. It answers for each pixel with a mixture of two Laplace distributions
of the root of inverse depth × baseline and takes the mode of the denser one: at an edge it decides for the near or for
the far surface instead of for a place between them.

Source: mixtures: Tosi et al., SMD-Nets: Stereo mixture density networks, 2021; monocular skip: OmniSyn, section 3.3.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import asdict, dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from omnisyn_cli.networks.layers import LEAK, ResidualBlock, WrappedConv, initialise, sizes, upsample_nearest

__all__ = ["REFINE_VARIANTS", "RefineConfig", "RefineNetwork", "RefinePrediction"]

LEAST_SCALE = 0.003
"""Of a Laplace distribution of roots: no answer is surer than a fraction of a pixel of parallax."""

FILLED_PLANE = 3
"""Of the input: the root that the answer starts from."""

STEPS = (0.1, 1.0)
"""How far the two modes move from it: the first corrects what matching found, the second replaces it."""


@dataclass(frozen=True)
class RefineConfig:
    """What makes one refinement network differ from another.

    Attributes:
        name: of the variant.
        planes: input channels, the evidence.
        widths: channels at strides 2, 4, 8, …
        fine: channels at full resolution.
    """

    name: str
    planes: int
    widths: tuple[int, ...]
    fine: int

    @property
    def size_multiple(self) -> int:
        """Heights and widths have to be a multiple of this."""
        return int(2 ** len(self.widths))

    def as_dict(self) -> dict[str, Any]:
        """Plain values for a checkpoint."""
        return asdict(self)

    @staticmethod
    def from_dict(values: dict[str, Any]) -> RefineConfig:
        """The inverse of :meth:`as_dict`; unknown and missing keys are errors."""
        plain: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in values.items()}
        return RefineConfig(**plain)


REFINE_VARIANTS = {"balanced": RefineConfig("balanced", planes=19, widths=(32, 48, 80, 128, 192), fine=24)}
"""The networks by name."""


@dataclass(frozen=True)
class RefinePrediction:
    """A mixture of two Laplace distributions of the root, and how far it may be trusted.

    Attributes:
        roots: ``(batch, 2, height, width)`` modes; slightly negative values mean "infinitely far".
        log_scales: ``(batch, 2, height, width)``.
        choice: ``(batch, 1, height, width)`` logit of the first one's share.
        confidence_logit: ``(batch, 1, height, width)``; its sigmoid is the probability that the depth is within 10 %.
    """

    roots: Tensor
    log_scales: Tensor
    choice: Tensor
    confidence_logit: Tensor

    def log_shares(self) -> Float[Tensor, "batch 2 height width"]:
        """Logarithms of the shares of both distributions."""
        return torch.cat([functional.logsigmoid(self.choice), functional.logsigmoid(-self.choice)], dim=1)

    def root(self) -> Float[Tensor, "batch 1 height width"]:
        """The mode whose density is greater."""
        density = self.log_shares() - self.log_scales
        return torch.where(density[:, :1] >= density[:, 1:], self.roots[:, :1], self.roots[:, 1:])

    def inverse_depth(self) -> Float[Tensor, "batch 1 height width"]:
        """Inverse depth × baseline: never negative, exactly 0 where nothing is there."""
        return self.root().clamp(min=0.0).square()

    def confidence(self) -> Float[Tensor, "batch 1 height width"]:
        """Probability that the depth is within 10 % of the truth."""
        return self.confidence_logit.sigmoid()


class RefineNetwork(nn.Module):
    """Evidence planes in, a mixture per pixel out; any size that is a multiple of ``config.size_multiple``."""

    def __init__(self, config: RefineConfig) -> None:
        super().__init__()
        self.config = config
        widths = config.widths
        self.stem = ResidualBlock(4 * config.planes, widths[0])
        self.down = nn.ModuleList(ResidualBlock(a, b, (2, 2)) for a, b in itertools.pairwise(widths))
        self.middle = ResidualBlock(widths[-1], widths[-1])
        self.project = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in itertools.pairwise(widths))
        self.up = nn.ModuleList(ResidualBlock(a, a) for a in widths[:-1])
        self.spread = nn.Conv2d(widths[0], 4 * config.fine, 1)
        self.look = WrappedConv(config.planes, config.fine)
        self.fine = ResidualBlock(config.fine, config.fine)
        self.answer = WrappedConv(config.fine, 6)
        initialise(self)
        nn.init.normal_(self.answer.weight, std=0.01)
        with torch.no_grad():
            self.answer.bias.copy_(torch.tensor([0.0, 0.0, -3.0, -2.0, 1.0, 0.0]))  # type: ignore[union-attr]

    def forward(self, planes: Float[Tensor, "batch planes height width"]) -> RefinePrediction:
        """Refine.

        Raises:
            ValueError: the size is not a multiple of ``config.size_multiple``.
        """
        multiple = self.config.size_multiple
        if any(size % multiple for size in sizes(planes)[-2:]):
            raise ValueError(f"expected a size of multiples of {multiple}, got {sizes(planes)[-2:]}")
        x = self.stem(functional.pixel_unshuffle(planes, 2))
        skips = []
        for block in self.down:
            skips.append(x)
            x = block(x)
        x = self.middle(x)
        for block, project, skip in reversed(list(zip(self.up, self.project, skips, strict=True))):
            x = block(functional.leaky_relu(upsample_nearest(project(x)) + skip, LEAK))
        x = functional.pixel_shuffle(self.spread(x), 2)
        x = self.fine(functional.leaky_relu(x + self.look(planes), LEAK))
        roots, log_scales, choice, confidence = self.answer(x).split([2, 2, 1, 1], dim=1)
        roots = planes[:, FILLED_PLANE : FILLED_PLANE + 1] + roots * roots.new_tensor(STEPS).view(1, 2, 1, 1)
        return RefinePrediction(roots, log_scales.clamp(min=math.log(LEAST_SCALE)), choice, confidence)
