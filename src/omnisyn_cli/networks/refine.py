"""Depth made better by a network that knows rooms and streets: a choice among what matching suggests.

Matching is exact where there is texture and both panoramas look; elsewhere its map is a guess carried on from the
surroundings, and edges lie a few pixels off. The right value is nearly always close by, though: the pixel's own, that
of its best match, or the nearest or the farthest one within a few pixels. The network sees the picture, the map, how
sure matching was, and what the other panorama shows where the map says that the same point is
(:func:`omnisyn_cli.stereo.evidence.evidence_planes`), all in the upright frame of the camera, where floors are below
and skies above. It gives each candidate a share and answers with the candidate of the least expected error, their
weighted median, plus a small correction: at an edge it decides for the near or for the far surface, never for a place
between them. Where matching is sure, its answer stays.

Source: choosing instead of averaging at edges: Tosi et al., SMD-Nets: Stereo mixture density networks, 2021; monocular
skip: OmniSyn, section 3.3.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from omnisyn_cli.networks.interface import DepthAnswer
from omnisyn_cli.networks.layers import begin_small, sizes, wrap_columns
from omnisyn_cli.networks.unet import CorrectingConfig, CorrectingUNet

__all__ = ["FILLED_PLANE", "REFINE_VARIANTS", "RefineConfig", "RefineNetwork", "RefinePrediction", "where_sure"]

FILLED_PLANE, MATCHED_PLANE = 3, 4
"""Of the input: the roots that candidates come from."""

AGREED_PLANE, SKY_PLANE = 5, 6
"""Of the input: where matching is sure."""

WINDOWS = (3, 7, 15)
"""Sides in pixels of the squares whose nearest and farthest values are candidates."""

SUGGESTED = 2 + 2 * len(WINDOWS)

CANDIDATES = SUGGESTED + 1
"""Those of matching, and one that the network makes up."""

SURE = 50.0
"""Added to the logit of the filled root where matching is sure."""

CAUTION = 0.3
"""Factor of the logits when an answer is chosen: networks are too sure of themselves, and evener shares move the
weighted median towards the middle of the candidates. Measured in frames: 0.1 to 0.2 dB."""

DRAW = 1e-3
"""Expected errors of roots that differ by less are a draw, and the answer lies between the two: without that the last
bit of a sum could decide for one surface or the other."""

FIRST_CHOICE = 1.0
"""Logit of the filled root in a fresh network."""

CORRECTION = 0.1
"""Scale of the correction, so that a fresh network leaves the candidates nearly as they are."""


class RefineConfig(CorrectingConfig):
    """What makes one refinement network differ from another; its planes are the evidence."""


REFINE_VARIANTS = {"balanced": RefineConfig("balanced", planes=19, widths=(32, 48, 80, 128, 192), fine=24)}
"""The networks by name."""


@dataclass(frozen=True)
class RefinePrediction(DepthAnswer):
    """Candidates for the root, a share for each, and how far the answer may be trusted.

    Attributes:
        candidates: ``(batch, candidates, height, width)`` roots; the last one is the network's own.
        logits: ``(batch, candidates, height, width)`` of their shares.
        correction: ``(batch, 1, height, width)`` is added to the candidate that is chosen; 0 where matching is sure.
        confidence_logit: ``(batch, 1, height, width)``; its sigmoid is the probability that the depth is within 10 %.
        sure: ``(batch, 1, height, width)`` 1 where matching is sure, else 0.
    """

    candidates: Tensor
    logits: Tensor
    correction: Tensor
    confidence_logit: Tensor
    sure: Tensor

    def root(self) -> Float[Tensor, "batch 1 height width"]:
        """The candidate of least expected error, corrected."""
        shares = (CAUTION * self.logits).softmax(dim=1)
        expected = torch.cat(
            [
                (shares * (self.candidates - self.candidates[:, k : k + 1]).abs()).sum(dim=1, keepdim=True)
                for k in range(sizes(self.candidates)[1])
            ],
            dim=1,
        )
        chosen = (-expected / DRAW).softmax(dim=1)
        answer = (chosen * self.candidates).sum(dim=1, keepdim=True) + self.correction
        return torch.where(self.sure > 0, self.candidates[:, :1], answer)


def candidates_of(planes: Float[Tensor, "batch planes height width"]) -> Float[Tensor, "batch candidates height width"]:
    """The filled and the matched root, then the nearest and the farthest filled root within each window."""
    filled = planes[:, FILLED_PLANE : FILLED_PLANE + 1]
    found = [filled, planes[:, MATCHED_PLANE : MATCHED_PLANE + 1]]
    for window in WINDOWS:
        found += [_greatest(filled, window), -_greatest(-filled, window)]
    return torch.cat(found, dim=1)


def where_sure(planes: Float[Tensor, "batch planes height width"]) -> Float[Tensor, "batch 1 height width"]:
    """1 where matching is sure, else 0."""
    return torch.maximum(planes[:, AGREED_PLANE : AGREED_PLANE + 1], planes[:, SKY_PLANE : SKY_PLANE + 1])


def _greatest(x: Tensor, window: int) -> Tensor:
    """Maximum over squares; around the seam, but not beyond the poles."""
    reach = window // 2
    along = functional.max_pool2d(wrap_columns(x, reach, reach), (1, window), stride=1)
    return functional.max_pool2d(along, (window, 1), stride=1, padding=(reach, 0))


class RefineNetwork(CorrectingUNet):
    """Evidence planes in, a choice per pixel out; any size that is a multiple of ``config.size_multiple``."""

    def __init__(self, config: RefineConfig) -> None:
        super().__init__(config, answers=CANDIDATES + 3, added=SUGGESTED - 2)
        begin_small(self.answer)
        with torch.no_grad():
            self.answer.bias[0] = FIRST_CHOICE  # type: ignore[index]

    def forward(self, planes: Float[Tensor, "batch planes height width"]) -> RefinePrediction:
        """Refine; see :meth:`answers`."""
        candidates = candidates_of(planes)
        seen = torch.cat([planes, candidates[:, 2:] - candidates[:, :1]], dim=1)
        logits, free, correction, confidence = torch.split(self.answers(seen), [CANDIDATES, 1, 1, 1], dim=1)
        sure = where_sure(planes)
        candidates = torch.cat([candidates, candidates[:, :1] + free], dim=1)
        logits = torch.cat([logits[:, :1] + SURE * sure, logits[:, 1:]], dim=1)
        return RefinePrediction(candidates, logits, CORRECTION * correction * (1.0 - sure), confidence, sure)
