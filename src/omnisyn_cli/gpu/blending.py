"""Two renderings of some rows made one picture, by the rules of :mod:`omnisyn_cli.fusion` and photometry.

Everything here is about single pixels; what is decided about a whole frame comes as numbers and tables.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float32, UInt8
from torch import Tensor

from omnisyn_cli.fusion.kernels import FAR_PREFERENCE
from omnisyn_cli.photometry.matching import CLIPPING
from omnisyn_cli.types import BELIEF, UNSEEN

__all__ = ["BlendRule", "Exposure", "Shown", "blend", "expose", "samples_of"]


@dataclass(frozen=True)
class Exposure:
    """How a view's stored values change.

    Attributes:
        table: new values for values from 0 to 1, evenly; others go on in proportion to its ends.
        loss: share of its worth that a white pixel loses.
    """

    table: Float32[Tensor, "3 entries"]
    loss: float


@dataclass(frozen=True)
class Shown:
    """Some rows of one view's rendering.

    Attributes:
        colour: RGB and worth.
        inverse_depth: 1/metre from the target, negative where nothing is seen.
        offset: position of the view in the frame of the target.
    """

    colour: Float32[Tensor, "rows width 4"]
    inverse_depth: Float32[Tensor, "rows width"]
    offset: Float32[Tensor, " 3"]


@dataclass(frozen=True)
class BlendRule:
    """What decides between two views, see :class:`omnisyn_cli.fusion.options.BlendOptions`.

    Attributes:
        t: share of the way.
        disagreement: relative difference of inverse depth at which the farther surface has lost most of its weight.
        hidden: the least share of its weight that it keeps.
    """

    t: float
    disagreement: float
    hidden: float


def expose(colour: Float32[Tensor, "*pixels 4"], exposure: Exposure | None) -> Float32[Tensor, "*pixels 4"]:
    """Colours of another exposure; what was cut off loses a share of its worth."""
    if exposure is None:
        return colour
    value, worth = colour[..., :3], colour[..., 3:]
    clipping = float(CLIPPING)
    cut_off = ((value.amax(-1, keepdim=True) - clipping) / (1.0 - clipping)).clamp(0.0, 1.0)
    last = exposure.table.shape[1] - 1
    place = value.clamp(0.0, 1.0) * last
    index = place.to(torch.int64).clamp_max(last - 1)
    channel = torch.arange(3, device=colour.device)
    low, high = exposure.table[channel, index], exposure.table[channel, index + 1]
    found = low + (place - index) * (high - low)
    found = torch.where(value <= 0.0, value * exposure.table[:, 1] * last, found)
    found = torch.where(value >= 1.0, value * exposure.table[:, last], found)
    return torch.cat([found, worth * (1.0 - exposure.loss * cut_off)], dim=-1)


def blend(
    first: Shown, second: Shown, rays: Float32[Tensor, "rows width 3"], rule: BlendRule
) -> tuple[Float32[Tensor, "rows width 3"], Float32[Tensor, "rows width"]]:
    """Weighted mean, and its weight: 0 in holes, elsewhere large where the surface is far.

    See :func:`omnisyn_cli.fusion.kernels.blend_rows`.
    """
    a, b = _weights(first, second, rays, rule)
    total = a + b
    smaller = torch.minimum(a, b) / total.clamp_min(1e-37)  # the larger share is 1 minus this: 1 if the other is 0
    share = torch.where(a < b, smaller, 1.0 - smaller)
    other = torch.where(a < b, 1.0 - smaller, smaller)
    mixed = share[..., None] * first.colour[..., :3] + other[..., None] * second.colour[..., :3]
    rho = share * first.inverse_depth.clamp_min(0.0) + other * second.inverse_depth.clamp_min(0.0)
    far = FAR_PREFERENCE / (rho + FAR_PREFERENCE)
    is_seen = total > 0.0
    return torch.where(is_seen[..., None], mixed.clamp_min(0.0), 0.0), torch.where(is_seen, far**4, 0.0)


def _weights(first: Shown, second: Shown, rays: Tensor, rule: BlendRule) -> tuple[Tensor, Tensor]:
    """Of both views, not normalised, see :func:`omnisyn_cli.fusion.kernels.view_weights`."""
    worth_a, worth_b = first.colour[..., 3], second.colour[..., 3]
    near_a, near_b = first.inverse_depth.clamp_min(0.0), second.inverse_depth.clamp_min(0.0)
    a = torch.where(worth_a > float(UNSEEN), worth_a * _nearness(near_a, rays, first.offset), 0.0)
    b = torch.where(worth_b > float(UNSEEN), worth_b * _nearness(near_b, rays, second.offset), 0.0)
    gap = (near_a - near_b) / (torch.maximum(near_a, near_b) * rule.disagreement + 1e-9)
    believed = (BELIEF * torch.where(gap > 0.0, worth_a, worth_b)).clamp_max(1.0)
    rest = 1.0 - believed * (1.0 - torch.exp(-gap * gap).clamp_min(rule.hidden))
    is_both = torch.minimum(a, b) > 0.0
    shared_a = (1.0 - rule.t) * a * torch.where(gap < 0.0, rest, 1.0)
    shared_b = rule.t * b * torch.where(gap < 0.0, 1.0, rest)
    return torch.where(is_both, shared_a, a), torch.where(is_both, shared_b, b)


def _nearness(rho: Tensor, rays: Tensor, offset: Tensor) -> Float32[Tensor, "rows width"]:
    """(Distance from the target / distance from the source) of what is seen, cubed."""
    squared = (rays - rho[..., None] * offset).square().sum(-1) + 1e-8
    return 1.0 / (squared * squared.sqrt())


def samples_of(image: Float32[Tensor, "height width 3"]) -> UInt8[Tensor, "height width 3"]:
    """Numbers in [0, 1] as one of 256 levels, rounded."""
    return (image.clamp(0.0, 1.0) * 255.0 + 0.5).to(torch.uint8)
