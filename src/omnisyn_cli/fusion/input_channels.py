"""What fusion networks see: two renderings at their own size, and what the geometric fusion makes of them.

Planes, in this order (``PLANES`` of them, float32):

* ``FIRST``, ``SECOND``: colours of both renderings, 0 where they show nothing (3 each),
* ``FUSED``: the geometric fusion, holes filled (3),
* ``WEIGHT``: of both colours (2),
* ``ROOT``: square root of inverse depth × baseline of both, at most ``GREATEST_ROOT`` (2),
* ``LOG_RATIO``: of the geometric weights, over ``GREATEST_LOG``, in [−1, 1]; positive where the first counts more,
* ``GAP``: difference of inverse depth over what counts as a disagreement, over ``GREATEST_GAP``, in [−1, 1],
* ``SEEN``: 1 where the first, and where the second, shows anything (2),
* ``RELEVANCE``: whether it matters which one is shown, from 0 to 1: they differ in colour, and near by in distance; 1
  in holes,
* ``TIME``: 2t − 1,
* ``LATITUDE``: 1 at the top of the picture, −1 at its bottom.

They are a function of numpy arrays and of torch tensors, with gradients to colours and inverse depths.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from array_api_compat import array_namespace, device
from jaxtyping import Float, Float32

from omnisyn_cli.fusion.blend_rule import BlendRule, LayerArrays, blended, normalized_depth_gap, view_weights
from omnisyn_cli.fusion.ghost_grid import greatest_near, mean_near
from omnisyn_cli.geometry.sphere import pixel_directions

__all__ = ["fusion_input_channels"]

Array = Any  # numpy.ndarray or torch.Tensor

FIRST, SECOND, FUSED, WEIGHT, ROOT, LOG_RATIO, GAP = 0, 3, 6, 9, 11, 13, 14
SEEN, RELEVANCE, TIME, LATITUDE, PLANES = 15, 17, 18, 19, 20

GREATEST_ROOT, GREATEST_LOG, GREATEST_GAP = 2.0, 8.0, 4.0

PLAIN, DIFFERENT = 0.01, 0.06
"""Root mean square of the difference of two colours up to which it does not matter which of them is shown, and from
which on it matters wholly."""

LEAST_RATIO = 1e-9
"""Of two weights: beyond it their logarithm is not looked at."""

LINEAR = 1e-4
"""Inverse depth × baseline below which its root is a straight line, so that its slope stays bounded."""

REACH, SOFTNESS = 4, 2
"""Pixels to every side within which a disagreement is near, and over which doubt about the weights fades."""

Fill = Callable[[Array, Array], Array]
"""Answers a picture with its holes filled, given how much every pixel counts for the holes around it: 0 in holes."""


def fusion_input_channels(
    first: LayerArrays, second: LayerArrays, rule: BlendRule, baseline: float, fill: Fill
) -> Float[Array, "planes height width"]:
    """All planes of what two views show.

    Args:
        first: of the first view.
        second: of the second view.
        rule: at its place of the way.
        baseline: how far apart both views are, in the unit that depth is measured in.
        fill: fills the holes of the geometric fusion.
    """
    xp, like = array_namespace(first.weight), first.weight
    both = first.is_seen & second.is_seen
    one, is_both = xp.ones_like(like), xp.astype(both, like.dtype)
    holes = xp.astype(~(first.is_seen | second.is_seen), like.dtype)
    directions = xp.asarray(_directions(*like.shape), dtype=like.dtype, device=device(like))
    gap = normalized_depth_gap(first, second, rule.disagreement) * is_both
    weights = view_weights(first, second, directions, rule)
    log_ratio = _log_ratio(*(xp.where(both, weight, one) for weight in weights))
    planes = [
        *(first.colour[..., k] for k in range(3)),
        *(second.colour[..., k] for k in range(3)),
        *xp.moveaxis(fill(*blended(first, second, weights)), -1, 0),
        first.weight,
        second.weight,
        *(sqrt_inverse_depth(view.near * baseline) for view in (first, second)),
        xp.clip(log_ratio / GREATEST_LOG, min=-1.0, max=1.0),
        xp.clip(gap / GREATEST_GAP, min=-1.0, max=1.0),
        *(xp.astype(view.is_seen, like.dtype) for view in (first, second)),
        is_both * disagreement_mask(gap) * _relevance(first.colour - second.colour) + holes,
        (2.0 * rule.t - 1.0) * one,
        directions[..., 1],
    ]
    return xp.stack(planes)


def needs_no_network(planes: Float32[Array, "planes height width"]) -> bool:
    """Whether there is nothing to decide: both views see everything, and nothing differs between them."""
    return bool(planes[SEEN : SEEN + 2].all()) and not bool(planes[RELEVANCE].any())


_directions = lru_cache(maxsize=2)(pixel_directions)


def _log_ratio(a: Array, b: Array) -> Float[Array, "height width"]:
    """log(a / b), bounded where one of them is next to nothing."""
    return array_namespace(a).log((a + LEAST_RATIO * b) / (b + LEAST_RATIO * a))


def _relevance(difference: Float[Array, "height width 3"]) -> Float[Array, "height width"]:
    """How much it matters which of two colours is shown: from 0 (they are alike) to 1, smooth."""
    xp = array_namespace(difference)
    squared = xp.sum(difference * difference, axis=-1) / 3.0
    x = xp.clip((xp.sqrt(xp.clip(squared, min=PLAIN**2)) - PLAIN) / (DIFFERENT - PLAIN), min=0.0, max=1.0)
    return x * x * (3.0 - 2.0 * x)


def sqrt_inverse_depth(near: Float[Array, "*maps height width"]) -> Float[Array, "*maps height width"]:
    """Square root of inverse depth × baseline, at most what the planes hold."""
    xp = array_namespace(near)
    above = xp.sqrt(xp.clip(near, min=LINEAR, max=GREATEST_ROOT**2))
    return xp.where(near < LINEAR, near / LINEAR**0.5, above)


def disagreement_mask(gap: Float32[Array, "height width"]) -> Float32[Array, "height width"]:
    """Smooth, from 0 to 1: 1 where the views disagree about the distance, and around there; wraps at the seam.

    Where they agree, the one that was nearer shows it sharper, and a mixture would only blur it.

    Args:
        gap: difference of inverse depth, in units of what counts as a disagreement.
    """
    return mean_near(greatest_near(-array_namespace(gap).expm1(-gap * gap), REACH), SOFTNESS, is_mirrored=False)
