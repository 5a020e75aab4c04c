"""Input channels of fusion networks, part 1: both layers at the network's size, and the geometric fusion of them.

Channels, in this order (``INPUT_CHANNELS`` of them, float32). Part 2 is in :mod:`omnisyn_cli.fusion.warp_candidates`.

* ``FIRST_RGB``, ``SECOND_RGB``: colours of both layers, 0 where they show nothing (3 each),
* ``FUSED_RGB``: the geometric fusion, holes filled (3),
* ``BLEND_WEIGHTS``: of both colours (2),
* ``SQRT_INVERSE_DEPTHS``: √(inverse depth × baseline) of both, at most ``MAX_SQRT_INV_DEPTH`` (2),
* ``LOG_WEIGHT_RATIO``: of the geometric weights, over ``MAX_LOG_RATIO``, in [−1, 1]; positive where the first counts
  more,
* ``DEPTH_GAP``: normalised difference of inverse depth, over ``MAX_GAP``, in [−1, 1],
* ``SEEN_MASKS``: 1 where the first, and where the second, shows anything (2),
* ``RELEVANCE``: whether the choice between both layers matters, in [0, 1]: their colours differ, and their depths do
  nearby; 1 in holes,
* ``PATH_POSITION``: 2t − 1,
* ``LATITUDE``: 1 at the top of the frame, −1 at its bottom.

The function takes numpy arrays or torch tensors, with gradients to colours and inverse depths.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from array_api_compat import array_namespace, device
from jaxtyping import Float, Float32

from omnisyn_cli.fusion.blend_rule import BlendRule, LayerArrays, blend_layers, normalized_depth_gap, view_weights
from omnisyn_cli.fusion.window_filters import box_filter, dilate
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.geometry.tolerances import MAX_SQRT_INV_DEPTH

Array = Any  # numpy.ndarray or torch.Tensor

# First channel of each group, and their number, see :func:`fusion_input_channels`. Checkpoints depend on them.
FIRST_RGB, SECOND_RGB, FUSED_RGB, BLEND_WEIGHTS, SQRT_INVERSE_DEPTHS = 0, 3, 6, 9, 11
LOG_WEIGHT_RATIO, DEPTH_GAP, SEEN_MASKS, RELEVANCE, PATH_POSITION, LATITUDE, INPUT_CHANNELS = 13, 14, 15, 17, 18, 19, 20
# Clips of channels. Beyond a log ratio of 8 (1:3000) or 4 gaps (weight e⁻¹⁶) one layer alone is visible anyway.
MAX_LOG_RATIO, MAX_GAP = 8.0, 4.0
# Root mean square difference of two colours up to which the choice between them does not matter, and from which on it
# matters fully. Set by hand.
ALIKE_RMS, DIFFERENT_RMS = 0.01, 0.06
MIN_WEIGHT_RATIO = 1e-9  # keeps the logarithm finite where one of two weights is 0; far beyond :data:`MAX_LOG_RATIO`
# Inverse depth × baseline below which its square root is replaced by a line, so that its slope stays bounded.
SQRT_LINEAR_LIMIT = 1e-4
# Pixels by which a disagreement of depth is dilated and then blurred. Set by hand.
DISAGREEMENT_RADIUS, DISAGREEMENT_BLUR_RADIUS = 4, 2

# Returns a picture with its holes filled, given how much every pixel counts for the holes around it: 0 in holes.
Fill = Callable[[Array, Array], Array]


def fusion_input_channels(
    first: LayerArrays, second: LayerArrays, rule: BlendRule, baseline: float, fill: Fill
) -> Float[Array, "channels height width"]:
    """All of the list above; ``baseline`` in the unit of depth, ``fill`` fills the holes of the geometric fusion."""
    xp, like = array_namespace(first.weight), first.weight
    both = first.is_seen & second.is_seen
    one, is_both = xp.ones_like(like), xp.astype(both, like.dtype)
    holes = xp.astype(~(first.is_seen | second.is_seen), like.dtype)
    directions = xp.asarray(_directions(*like.shape), dtype=like.dtype, device=device(like))
    gap = normalized_depth_gap(first, second, rule.disagreement) * is_both
    weights = view_weights(first, second, directions, rule)
    a, b = (xp.where(both, weight, one) for weight in weights)
    log_ratio = xp.log((a + MIN_WEIGHT_RATIO * b) / (b + MIN_WEIGHT_RATIO * a))  # bounded where one is next to nothing
    channels = [
        *(first.colour[..., k] for k in range(3)), *(second.colour[..., k] for k in range(3)),
        *xp.moveaxis(fill(*blend_layers(first, second, weights)), -1, 0), first.weight, second.weight,
        *(sqrt_inverse_depth(layer.clipped_inverse_depth * baseline) for layer in (first, second)),
        xp.clip(log_ratio / MAX_LOG_RATIO, min=-1.0, max=1.0), xp.clip(gap / MAX_GAP, min=-1.0, max=1.0),
        *(xp.astype(layer.is_seen, like.dtype) for layer in (first, second)),
        is_both * disagreement_mask(gap) * _colour_relevance(first.colour - second.colour) + holes,
        (2.0 * rule.t - 1.0) * one, directions[..., 1],
    ]  # fmt: skip
    return xp.stack(channels)


def needs_no_network(channels: Float32[Array, "channels height width"]) -> bool:
    """Whether both layers see everything, and their difference is irrelevant everywhere."""
    return bool(channels[SEEN_MASKS : SEEN_MASKS + 2].all()) and not bool(channels[RELEVANCE].any())


_directions = lru_cache(maxsize=2)(pixel_directions)


def _colour_relevance(difference: Float[Array, "height width 3"]) -> Float[Array, "height width"]:
    """How much the choice between two colours matters: a smooth step from 0 (they are alike) to 1."""
    xp = array_namespace(difference)
    squared = xp.sum(difference * difference, axis=-1) / 3.0
    # The clip before the root keeps its gradient finite where the colours are equal.
    rms = xp.sqrt(xp.clip(squared, min=ALIKE_RMS**2))
    x = xp.clip((rms - ALIKE_RMS) / (DIFFERENT_RMS - ALIKE_RMS), min=0.0, max=1.0)
    return x * x * (3.0 - 2.0 * x)


def sqrt_inverse_depth(scaled: Float[Array, "*maps height width"]) -> Float[Array, "*maps height width"]:
    """Square root of inverse depth × baseline, linear near 0 and clipped to :data:`MAX_SQRT_INV_DEPTH`."""
    xp = array_namespace(scaled)
    above = xp.sqrt(xp.clip(scaled, min=SQRT_LINEAR_LIMIT, max=MAX_SQRT_INV_DEPTH**2))
    return xp.where(scaled < SQRT_LINEAR_LIMIT, scaled / SQRT_LINEAR_LIMIT**0.5, above)


def disagreement_mask(gap: Float32[Array, "height width"]) -> Float32[Array, "height width"]:
    """In [0, 1], 1 where depths differ by a :func:`normalized_depth_gap` and around there; wraps at the seam."""
    disagreement = -array_namespace(gap).expm1(-gap * gap)
    return box_filter(dilate(disagreement, DISAGREEMENT_RADIUS), DISAGREEMENT_BLUR_RADIUS, mirror_poles=False)
