"""Soft points with gradients: from a target's features to the features and the inverse depths of the source.

Which points a pixel sees, and in which order, is found without gradients by :mod:`omnisyn_cli.baselines.soft_points`;
their distances, opacities and blend follow again, with gradients, from the formulas there. A disc's opacity is 0 at its
rim, so nothing jumps where a point enters or leaves a pixel; where two points change places in depth it does, and that
step has no gradient.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from omnisyn_cli.baselines import soft_points
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import normalize, pixel_directions


def splat_torch(
    features: Sequence[Float[Tensor, "channels height width"]],
    inverse_depths: Sequence[Float[Tensor, "height width"]], target_from_sources: Sequence[Pose],
    size: tuple[int, int], *, radius: float = soft_points.POINT_RADIUS_ROWS, most: int = soft_points.POINTS_PER_PIXEL,
) -> Float[Tensor, "channels+1 rows cols"]:  # fmt: skip
    """:func:`omnisyn_cli.baselines.soft_points.splat`, channels first, on the source's device and in its precision."""
    depths = [inverse_depth.detach().cpu().numpy() for inverse_depth in inverse_depths]
    lists = soft_points.list_visible(depths, target_from_sources, size, radius=radius, most=most)
    found = torch.from_numpy(lists.found).to(inverse_depths[0].device).view(-1, most)
    centres = torch.cat(list(map(_directions, inverse_depths, target_from_sources)))
    shares, opacity = _shares(centres, found, size, radius)
    values = torch.cat([each.flatten(1) for each in features], dim=1).T.to(centres.dtype)
    blended = functional.embedding_bag(found.clamp(min=0), values, mode="sum", per_sample_weights=shares)
    return torch.cat([blended, opacity[:, None]], dim=1).T.reshape(-1, *size)


def _directions(inverse_depth: Float[Tensor, "height width"], target_from_source: Pose) -> Float[Tensor, "points 3"]:
    """Where the target sees every pixel."""
    rotation, translation = (
        torch.from_numpy(array).to(inverse_depth)
        for array in (target_from_source.rotation, target_from_source.position)
    )
    own = torch.from_numpy(pixel_directions(*inverse_depth.shape)).to(inverse_depth)
    moved: Tensor = normalize(own @ rotation.T + inverse_depth[..., None] * translation)
    return moved.view(-1, 3)


def _shares(
    centres: Float[Tensor, "points 3"], found: Int[Tensor, "pixels most"], size: tuple[int, int], radius: float
) -> tuple[Float[Tensor, "pixels most"], Float[Tensor, " pixels"]]:
    """What part of its pixel every listed point is, and the sum."""
    rays = torch.from_numpy(pixel_directions(*size)).to(centres).view(-1, 1, 3)
    apart = functional.embedding(found.clamp(min=0), centres) - rays
    largest = 2.0 * math.sin(0.5 * soft_points.disc_angle(radius, size[0]))
    square = apart.square().sum(dim=-1) / largest**2
    alpha = (1.0 - square.clamp(soft_points.MIN_DIVISOR_OPACITY, 1.0).sqrt()) * (found >= 0)
    left = (1.0 - alpha).cumprod(dim=1)
    before = torch.cat([torch.ones_like(left[:, :1]), left[:, :-1]], dim=1)
    return alpha * before, 1.0 - left[:, -1]
