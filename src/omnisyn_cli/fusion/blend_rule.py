"""The blend rule: how much each of two layers counts for a pixel, for numpy arrays and torch tensors.

The weight of a layer is the product of

* its share of the way, so that both ends are the photographs themselves (of what both layers show);
* the weight of its colour (alpha, confidence of its depth, cut edges);
* its proximity, (distance from the target / distance from the source)³: a nearer photograph is sharper there;
* visibility: where the inverse depths differ, the nearer surface hides the farther one.

On ray-traced scenes with true depth the share alone has 30.8 dB, with proximity 31.1 dB; a factor for the angle at
which a surface was seen lost 0.1 dB.

Its twin for one pixel in kernels is :func:`omnisyn_cli.fusion.blend_kernels.view_weights`; a test ties the two.
"""

from dataclasses import dataclass
from typing import Any

from array_api_compat import array_namespace
from jaxtyping import Float

from omnisyn_cli.geometry.tolerances import OCCLUSION_SCALE
from omnisyn_cli.types import DEPTH_CONFIDENCE_GAIN, MIN_VISIBLE_WEIGHT

Array = Any  # numpy.ndarray or torch.Tensor

# 1/metre added to inverse depths before hole filling compares them: 100 m are as good as infinity. Set by hand.
FAR_WEIGHT_OFFSET = 0.01
HIDDEN_WEIGHT = 0.003  # least share of its weight that a hidden surface keeps. Set by hand.
RAMP_SHARE = 0.1  # of the way at either end, over which visibility sets in, so that nothing pops up there. Set by hand.


@dataclass(frozen=True)
class BlendRule:
    """The rule at one place of the way."""

    t: float  # share of the way
    disagreement: float  # relative difference of inverse depth at which a hidden surface is down to 1/e of its weight
    hidden_weight: float  # the least share of its weight that a hidden surface keeps here: all of it at both ends
    occlusion_strength: float  # how strictly the nearer surface wins: 0 at both ends of the way, 1 in between

    @staticmethod
    def at(t: float) -> "BlendRule":
        """At a share ``t`` of the way; visibility sets in by a smooth step from either end."""
        x = min(1.0, min(t, 1.0 - t) / RAMP_SHARE)
        occlusion_strength = x * x * (3.0 - 2.0 * x)
        return BlendRule(t, OCCLUSION_SCALE, HIDDEN_WEIGHT**occlusion_strength, occlusion_strength)


@dataclass(frozen=True)
class LayerArrays:
    """Pixels of one layer as plain arrays, numpy or torch."""

    colour: Float[Array, "*pixels 3"]  # RGB
    weight: Float[Array, "*pixels"]  # blend weight; 0 where nothing is seen
    inverse_depth: Float[Array, "*pixels"]  # from the target; negative where nothing is seen
    offset: Float[Array, " 3"]  # position of the view in the frame of the target, in the unit of depth

    @property
    def clipped_inverse_depth(self) -> Float[Array, "*pixels"]:
        """Inverse depth, 0 where nothing is seen."""
        return array_namespace(self.inverse_depth).clip(self.inverse_depth, min=0.0)

    @property
    def is_seen(self) -> Array:
        """Where the layer shows something."""
        return self.weight > float(MIN_VISIBLE_WEIGHT)


def view_weights(
    first: LayerArrays, second: LayerArrays, directions: Float[Array, "*pixels 3"], rule: BlendRule
) -> tuple[Float[Array, "*pixels"], Float[Array, "*pixels"]]:
    """Weights of two layers, not normalised, 0 where one shows nothing; ``directions`` are the target's unit rays."""
    xp = array_namespace(first.weight)
    zero, one = xp.zeros_like(first.weight), xp.ones_like(first.weight)
    a, b = (
        xp.where(layer.is_seen, layer.weight * _inverse_distance_weight(layer, directions), zero)
        for layer in (first, second)
    )
    gap = normalized_depth_gap(first, second, rule.disagreement)
    # A surface hides another only as far as its own depth is reliable.
    depth_confidence = xp.clip(DEPTH_CONFIDENCE_GAIN * xp.where(gap > 0.0, first.weight, second.weight), max=1.0)
    rest = 1.0 - depth_confidence * (1.0 - xp.clip(xp.exp(-gap * gap), min=rule.hidden_weight))
    is_both = first.is_seen & second.is_seen
    shared_a = (1.0 - rule.t) * a * xp.where(gap < 0.0, rest, one)
    shared_b = rule.t * b * xp.where(gap < 0.0, one, rest)
    return xp.where(is_both, shared_a, a), xp.where(is_both, shared_b, b)


def normalized_depth_gap(first: LayerArrays, second: LayerArrays, disagreement: float) -> Float[Array, "*pixels"]:
    """Relative difference of inverse depth, in units of ``disagreement``; positive where the first layer is nearer."""
    xp = array_namespace(first.weight)
    rho_a, rho_b = first.clipped_inverse_depth, second.clipped_inverse_depth
    return (rho_a - rho_b) / (xp.maximum(rho_a, rho_b) * disagreement + 1e-9)


def _inverse_distance_weight(layer: LayerArrays, directions: Float[Array, "*pixels 3"]) -> Float[Array, "*pixels"]:
    """(Distance from the target / distance from the source) of what is seen, cubed."""
    xp = array_namespace(layer.weight)
    from_source = directions - layer.clipped_inverse_depth[..., None] * layer.offset
    squared = xp.sum(from_source * from_source, axis=-1) + 1e-8
    return 1.0 / (squared * xp.sqrt(squared))


def blend_layers(
    first: LayerArrays, second: LayerArrays, weights: tuple[Float[Array, "*pixels"], Float[Array, "*pixels"]]
) -> tuple[Float[Array, "*pixels 3"], Float[Array, "*pixels"]]:
    """The mean by such weights, never negative, and its weight for holes around it: 0 in holes, large where far."""
    a, b = weights
    xp = array_namespace(a)
    total, nothing = a + b, xp.zeros_like(a)
    is_seen = total > 0.0
    # the larger share is 1 minus the smaller one: exactly 1 where the other is 0
    smaller = xp.minimum(a, b) / xp.where(is_seen, total, xp.ones_like(a))
    share_a, share_b = xp.where(a < b, smaller, 1.0 - smaller), xp.where(a < b, 1.0 - smaller, smaller)
    mixed = xp.clip(share_a[..., None] * first.colour + share_b[..., None] * second.colour, min=0.0)
    far = FAR_WEIGHT_OFFSET / (
        share_a * first.clipped_inverse_depth + share_b * second.clipped_inverse_depth + FAR_WEIGHT_OFFSET
    )
    return xp.where(is_seen[..., None], mixed, nothing[..., None]), xp.where(is_seen, far**4, nothing)
