"""What the fusion network is told about its pictures, and the figures it is judged by."""

import torch
from jaxtyping import Float
from torch import Tensor

from omnisyn_cli.fusion import planes as plane
from omnisyn_cli.fusion.second_look import CANDIDATES, SUPPOSED
from omnisyn_cli.networks.fusion import FusionConfig, FusionCorrections, FusionNetwork, PaintingNetwork
from omnisyn_cli.training.losses import polar_weights

SQUARED_WEIGHT = 4.0
"""Of squared errors beside absolute ones: both count alike at an error of a quarter."""

LEAST_ERROR = 1e-10


def inputs_of(
    config: FusionConfig, planes: Float[Tensor, "batch planes height width"]
) -> Float[Tensor, "batch inputs height width"]:
    """What a network takes of the planes: all, or as in the paper both renderings and both visibility masks."""
    if not config.paints:
        return planes
    return torch.cat([planes[:, plane.FIRST : plane.SECOND + 3], planes[:, plane.SEEN : plane.SEEN + 2]], dim=1)


def fused_by(
    network: FusionNetwork | PaintingNetwork, planes: Float[Tensor, "batch planes height width"]
) -> Float[Tensor, "batch 3 height width"]:
    """The picture that a network makes of the planes."""
    answer = network(inputs_of(network.config, planes))
    return corrected(planes, answer) if isinstance(answer, FusionCorrections) else answer


def corrected(
    planes: Float[Tensor, "batch planes height width"], corrections: FusionCorrections
) -> Float[Tensor, "batch 3 height width"]:
    """The geometric fusion with shifted weights and shares of other candidates, as the program corrects it."""
    first, second = planes[:, plane.FIRST : plane.FIRST + 3], planes[:, plane.SECOND : plane.SECOND + 3]
    both = planes[:, plane.SEEN : plane.SEEN + 2].prod(dim=1, keepdim=True)
    relevance = planes[:, plane.RELEVANCE : plane.RELEVANCE + 1]
    log_ratio = plane.GREATEST_LOG * planes[:, plane.LOG_RATIO : plane.LOG_RATIO + 1]
    more = torch.sigmoid(log_ratio + relevance * corrections.shift) - torch.sigmoid(log_ratio)
    fused = planes[:, plane.FUSED : plane.FUSED + 3] + both * more * (first - second)
    picture = fused
    for k, candidate in enumerate(torch.split(planes[:, CANDIDATES:SUPPOSED], 3, dim=1)):
        picture = picture + corrections.shares[:, k : k + 1] * (candidate - fused)
    return picture


def fusion_loss(picture: Float[Tensor, "batch 3 height width"], truth: Tensor) -> Tensor:
    """Absolute and squared differences from the truth, weighted by the sine of the polar angle; a scalar.

    Source: OmniSyn, section 3.6; the squares, which make large errors dear, are ours.
    """
    error = (picture - truth).abs()
    return ((error + SQUARED_WEIGHT * error.square()) * polar_weights(truth)).mean()


@torch.no_grad()
def fusion_scores(
    picture: Float[Tensor, "1 3 height width"], planes: Float[Tensor, "1 planes height width"], truth: Tensor
) -> dict[str, float]:
    """Compare a picture, and the geometric fusion, with the truth.

    Returns:
        ``ws_psnr`` in dB; ``gain``, dB more than the geometric fusion; ``hole_error``, the mean absolute error in
        holes, NaN where there are none; ``hole_gain``, by how much it is less than that of the geometric fusion.
    """
    geometric = planes[:, plane.FUSED : plane.FUSED + 3]
    hole = (planes[:, plane.SEEN : plane.SEEN + 2].sum(dim=1, keepdim=True) == 0).expand_as(truth)
    ours, theirs = (_decibels(x, truth) for x in (picture, geometric))
    errors = [float((x - truth).abs()[hole].mean()) for x in (picture, geometric)]
    return {"ws_psnr": ours, "gain": ours - theirs, "hole_error": errors[0], "hole_gain": errors[1] - errors[0]}


def _decibels(picture: Tensor, truth: Tensor) -> float:
    squared = ((picture.clamp(0.0, 1.0) - truth).square() * polar_weights(truth)).mean()
    return float(-10.0 * torch.log10(squared.clamp(min=LEAST_ERROR)))
