"""What the fusion network sees, as a differentiable function of two renderings, for training behind a depth network.

The same planes as :class:`omnisyn_cli.fusion.planes.PlaneMaker` makes of renderings of its own size, with gradients to
their colours and inverse depths through weights and planes; but for what holes are filled with, which is a constant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from omnisyn_cli.fusion import planes as plane
from omnisyn_cli.fusion.fill import HoleFiller
from omnisyn_cli.fusion.geometric import hiding_strength
from omnisyn_cli.fusion.kernels import FAR_PREFERENCE
from omnisyn_cli.fusion.network_kernels import DIFFERENT, LEAST_SHARE, PLAIN
from omnisyn_cli.fusion.options import BlendOptions
from omnisyn_cli.geometry.sphere import direction_tables, pixel_directions
from omnisyn_cli.networks.layers import wrap_columns
from omnisyn_cli.types import BELIEF, UNSEEN

__all__ = ["Seen", "fusion_planes"]

LINEAR = 1e-4
"""Inverse depth × baseline below which its root is a straight line, so that its slope stays bounded."""

TINY = 1e-9

LEAST_WORTH = float(UNSEEN)


@dataclass(frozen=True)
class Seen:
    """What the target sees of one view.

    Attributes:
        colour: 0 where nothing is seen.
        inverse_depth: in 1/baseline, from the target; negative where nothing is seen.
        worth: of the colours in a blend, in [0, 1]; 0 where nothing is seen, no gradient.
        position: of the view in the frame of the target, in baselines.
    """

    colour: Float[Tensor, "height width 3"]
    inverse_depth: Float[Tensor, "height width"]
    worth: Float[Tensor, "height width"]
    position: Float[np.ndarray, " 3"]


def fusion_planes(first: Seen, second: Seen, t: float) -> Float[Tensor, "planes height width"]:
    """All planes of :mod:`omnisyn_cli.fusion.planes` at a share ``t`` of a way that is one baseline long."""
    options = BlendOptions()
    seen = [view.worth > LEAST_WORTH for view in (first, second)]
    both, hole = seen[0] & seen[1], ~(seen[0] | seen[1])
    near = [view.inverse_depth.clamp(min=0.0) for view in (first, second)]
    gap = _gap(near[0], near[1], options.disagreement) * both
    weights = _weights(first, second, near, gap, t, options)
    log_ratio = _log_ratio(*weights, both)
    doubt = _doubt(gap)
    relevance = torch.where(both, doubt * _relevance(first.colour - second.colour), hole.to(gap.dtype))
    like = torch.ones_like(gap)
    height, width = gap.shape
    latitude = torch.as_tensor(direction_tables(height, width)[1]).to(gap)[:, None]
    columns = [
        first.colour.permute(2, 0, 1),
        second.colour.permute(2, 0, 1),
        _fused(first, second, weights, near, hole),
        torch.stack([first.worth, second.worth]),
        torch.stack([_root(rho) for rho in near]),
        (log_ratio / plane.GREATEST_LOG).clamp(-1.0, 1.0)[None],
        (gap / plane.GREATEST_GAP).clamp(-1.0, 1.0)[None],
        torch.stack(seen).to(gap.dtype),
        relevance[None],
        (2.0 * t - 1.0) * like[None],
        (latitude * like)[None],
    ]
    return torch.cat(columns)


def _gap(near_a: Tensor, near_b: Tensor, disagreement: float) -> Tensor:
    """Difference of inverse depth in units of what counts as a disagreement."""
    return (near_a - near_b) / (torch.maximum(near_a, near_b) * disagreement + TINY)


def _weights(
    first: Seen, second: Seen, near: list[Tensor], gap: Tensor, t: float, options: BlendOptions
) -> tuple[Tensor, Tensor]:
    """Those of the geometric fusion, see :func:`omnisyn_cli.fusion.kernels.view_weights`."""
    hidden = options.hidden ** hiding_strength(t, options.ends)
    rays = torch.as_tensor(pixel_directions(*gap.shape)).to(gap)
    a, b = (
        torch.where(view.worth > LEAST_WORTH, view.worth * _nearness(rho, rays, view.position), torch.zeros_like(rho))
        for view, rho in zip((first, second), near, strict=True)
    )
    both = (first.worth > LEAST_WORTH) & (second.worth > LEAST_WORTH)
    believed = (BELIEF * torch.where(gap > 0, first.worth, second.worth)).clamp(max=1.0)
    rest = 1.0 - believed * (1.0 - torch.exp(-gap.square()).clamp(min=hidden))
    one = torch.ones_like(rest)
    of_first = (1.0 - t) * torch.where(gap < 0, rest, one)
    of_second = t * torch.where(gap < 0, one, rest)
    return torch.where(both, a * of_first, a), torch.where(both, b * of_second, b)


def _nearness(rho: Tensor, rays: Tensor, position: np.ndarray) -> Tensor:
    """(Distance from the target / distance from the source) of what is seen, cubed."""
    squared = (rays - rho[..., None] * torch.as_tensor(position).to(rho)).square().sum(-1) + 1e-8
    return squared ** (-1.5)


def _log_ratio(a: Tensor, b: Tensor, both: Bool[Tensor, "height width"]) -> Tensor:
    """log(a / b), bounded where one of them is next to nothing; 0 unless both views see."""
    one, least = torch.ones_like(a), float(LEAST_SHARE)
    a, b = torch.where(both, a, one), torch.where(both, b, one)
    return torch.log((a + least * b) / (b + least * a))


def _relevance(difference: Float[Tensor, "height width 3"]) -> Float[Tensor, "height width"]:
    """How much it matters which of two colours is shown: from 0 (they are alike) to 1, smooth."""
    plain, different = float(PLAIN), float(DIFFERENT)
    size = difference.square().mean(-1).clamp(min=plain**2).sqrt()
    x = ((size - plain) / (different - plain)).clamp(0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def _doubt(gap: Float[Tensor, "height width"]) -> Float[Tensor, "height width"]:
    """See :func:`omnisyn_cli.fusion.planes.doubt_of`."""
    reach, soft = plane.REACH // 2, plane.SOFTNESS // 2
    wide = wrap_columns(-torch.expm1(-gap.square())[None, None], reach + soft, reach + soft)
    around = functional.max_pool2d(wide, plane.REACH, stride=1, padding=(reach, 0))
    rows = functional.pad(around, (0, 0, soft, soft), mode="replicate")
    return functional.avg_pool2d(rows, plane.SOFTNESS, stride=1)[0, 0]


def _root(near: Tensor) -> Tensor:
    """Square root of inverse depth × baseline, at most what the planes hold."""
    above = near.clamp(LINEAR, plane.GREATEST_ROOT**2).sqrt()
    return torch.where(near < LINEAR, near / LINEAR**0.5, above)


def _fused(
    first: Seen, second: Seen, weights: tuple[Tensor, Tensor], near: list[Tensor], hole: Tensor
) -> Float[Tensor, "3 height width"]:
    """The geometric fusion, holes filled with constants."""
    total = torch.where(hole, torch.ones_like(weights[0]), weights[0] + weights[1])
    share_a, share_b = (weight / total for weight in weights)
    fused = (share_a[..., None] * first.colour + share_b[..., None] * second.colour).clamp(min=0.0)
    with torch.no_grad():
        far = FAR_PREFERENCE / (share_a * near[0] + share_b * near[1] + FAR_PREFERENCE)
        image, weight = (x.float().cpu().numpy().copy() for x in (fused, far**4 * ~hole))
        HoleFiller(weight.shape, threads=1)(image, weight)
        filled = torch.from_numpy(image).to(fused)
    return torch.where(hole[..., None], filled, fused).permute(2, 0, 1)
