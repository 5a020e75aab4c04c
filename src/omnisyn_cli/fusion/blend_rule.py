"""How much each of two views counts for a pixel: the rule of the geometric fusion, for numpy arrays and torch tensors.

A view counts in proportion to

* the share of the way, so that both ends are the photographs themselves (what only one of the two shows is taken from
  that one, at the ends as well);
* the weight of its colour (masks, confidence of its depth, cut edges);
* how near it was taken to what is seen, cubed: its picture of that place is the sharper one and its parallax is small;
* agreement: where the two inverse depths differ, the nearer surface hides the farther one.

Measured on ray-traced scenes with true depth (mean of nine frames): share alone 30.8 dB, with the nearness 31.1 dB. A
further factor for the angle at which a surface was seen lost 0.1 dB and is left out.

What is stated here serves ghosts, devices and training, with gradients; the kernels have a twin of it for one pixel,
:func:`omnisyn_cli.fusion.blend_kernels.view_weights`, and a test ties the two.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from array_api_compat import array_namespace
from jaxtyping import Float

from omnisyn_cli.types import DEPTH_CONFIDENCE_GAIN, MIN_VISIBLE_WEIGHT

__all__ = ["FAR_WEIGHT_OFFSET", "BlendOptions", "BlendRule", "LayerArrays", "blended", "view_weights"]

Array = Any  # numpy.ndarray or torch.Tensor

FAR_WEIGHT_OFFSET = 0.01
"""1/metre added before inverse depths are compared in a hole: what is a hundred metres away is as good as infinity."""


@dataclass(frozen=True)
class BlendOptions:
    """What decides between two views that see different things.

    Attributes:
        disagreement: relative difference of inverse depth at which the farther surface has lost most of its weight.
        hidden: the least share of its weight that a hidden surface keeps.
        ends: share of the way at either end over which the rule sets in, so that nothing pops up next to an end.
    """

    disagreement: float = 0.06
    hidden: float = 0.003
    ends: float = 0.1


@dataclass(frozen=True)
class BlendRule:
    """The rule at one place of the way.

    Attributes:
        t: share of the way.
        disagreement: see :class:`BlendOptions`.
        hidden: the least share of its weight that a hidden surface keeps here: all of it at both ends.
        strictness: how strictly the nearer surface wins: 0 at both ends of the way, 1 in between.
    """

    t: float
    disagreement: float
    hidden: float
    strictness: float

    @staticmethod
    def at(t: float, options: BlendOptions) -> BlendRule:
        """At a share ``t`` of the way; it sets in smoothly from either end."""
        x = min(1.0, min(t, 1.0 - t) / options.ends)
        strictness = x * x * (3.0 - 2.0 * x)
        return BlendRule(t, options.disagreement, options.hidden**strictness, strictness)


@dataclass(frozen=True)
class LayerArrays:
    """What a target sees of one view, numpy arrays or torch tensors.

    Attributes:
        colour: RGB.
        weight: of the colours in a blend; 0 where nothing is seen.
        inverse_depth: from the target; negative where nothing is seen.
        offset: position of the view in the frame of the target, in the unit that depth is measured in.
    """

    colour: Float[Array, "*pixels 3"]
    weight: Float[Array, "*pixels"]
    inverse_depth: Float[Array, "*pixels"]
    offset: Float[Array, " 3"]

    @property
    def near(self) -> Float[Array, "*pixels"]:
        """Its inverse depth, 0 where nothing is seen."""
        return array_namespace(self.inverse_depth).clip(self.inverse_depth, min=0.0)

    @property
    def is_seen(self) -> Array:
        """Where it shows something."""
        return self.weight > float(MIN_VISIBLE_WEIGHT)


def view_weights(
    first: LayerArrays, second: LayerArrays, directions: Float[Array, "*pixels 3"], rule: BlendRule
) -> tuple[Float[Array, "*pixels"], Float[Array, "*pixels"]]:
    """Weights of what two views show, not normalised; 0 for a view that shows nothing.

    Args:
        first: of the first view.
        second: of the second view.
        directions: unit vectors through the target's pixels.
        rule: at its place of the way.
    """
    xp = array_namespace(first.weight)
    nothing, all_of_it = xp.zeros_like(first.weight), xp.ones_like(first.weight)
    a, b = (xp.where(view.is_seen, view.weight * _nearness(view, directions), nothing) for view in (first, second))
    gap = normalized_depth_gap(first, second, rule.disagreement)
    believed = xp.clip(DEPTH_CONFIDENCE_GAIN * xp.where(gap > 0.0, first.weight, second.weight), max=1.0)
    rest = 1.0 - believed * (1.0 - xp.clip(xp.exp(-gap * gap), min=rule.hidden))
    is_both = first.is_seen & second.is_seen
    shared_a = (1.0 - rule.t) * a * xp.where(gap < 0.0, rest, all_of_it)
    shared_b = rule.t * b * xp.where(gap < 0.0, all_of_it, rest)
    return xp.where(is_both, shared_a, a), xp.where(is_both, shared_b, b)


def normalized_depth_gap(first: LayerArrays, second: LayerArrays, disagreement: float) -> Float[Array, "*pixels"]:
    """Difference of inverse depth in units of what counts as a disagreement; positive where the first is nearer."""
    xp = array_namespace(first.weight)
    near_a, near_b = first.near, second.near
    return (near_a - near_b) / (xp.maximum(near_a, near_b) * disagreement + 1e-9)


def _nearness(view: LayerArrays, directions: Float[Array, "*pixels 3"]) -> Float[Array, "*pixels"]:
    """(Distance from the target / distance from the source) of what is seen, cubed."""
    xp = array_namespace(view.weight)
    away = directions - view.near[..., None] * view.offset
    squared = xp.sum(away * away, axis=-1) + 1e-8
    return 1.0 / (squared * xp.sqrt(squared))


def blended(
    first: LayerArrays, second: LayerArrays, weights: tuple[Float[Array, "*pixels"], Float[Array, "*pixels"]]
) -> tuple[Float[Array, "*pixels 3"], Float[Array, "*pixels"]]:
    """Weighted mean, never negative, and how much it counts for holes around it: 0 in holes, much where it is far.

    Args:
        first: of the first view.
        second: of the second view.
        weights: of :func:`view_weights`.
    """
    a, b = weights
    xp = array_namespace(a)
    total, nothing = a + b, xp.zeros_like(a)
    is_seen = total > 0.0
    # the larger share is 1 minus the smaller one: exactly 1 where the other is 0
    smaller = xp.minimum(a, b) / xp.where(is_seen, total, xp.ones_like(a))
    share_a, share_b = xp.where(a < b, smaller, 1.0 - smaller), xp.where(a < b, 1.0 - smaller, smaller)
    mixed = xp.clip(share_a[..., None] * first.colour + share_b[..., None] * second.colour, min=0.0)
    far = FAR_WEIGHT_OFFSET / (share_a * first.near + share_b * second.near + FAR_WEIGHT_OFFSET)
    return xp.where(is_seen[..., None], mixed, nothing[..., None]), xp.where(is_seen, far**4, nothing)
