"""What the renderings of two views say of each other, pixel by pixel: the kinds of pixels that errors are told by.

Every pixel is of exactly one of four kinds: both views agree, they disagree, one of them shows something, neither does.
Of whichever kind, it may lie beside a silhouette, where a frame shows two surfaces next to each other.
"""

from typing import Any, NamedTuple

from array_api_compat import array_namespace
from jaxtyping import Bool, Float

from omnisyn_cli.types import MIN_VISIBLE_WEIGHT, Layer

__all__ = ["DISAGREEMENT", "PixelClasses", "classify_pixels", "silhouette_mask"]

Array = Any  # numpy.ndarray or torch.Tensor

DISAGREEMENT = 0.1
"""Relative difference of inverse depth above which two surfaces are different ones."""

FARTHEST = 1e-6
"""1/metre; below it inverse depths are alike whatever their ratio is."""

BESIDE = 2
"""Pixels from a jump of depth, across and along rows, up to which errors count as those of the silhouette."""


class PixelClasses(NamedTuple):
    """Where pixels of each kind are, ``(height, width)`` each: every pixel is of exactly one.

    Attributes:
        agree: both views show something, at one distance.
        disagree: both show something, at different distances.
        one_view: one of them shows something.
        hole: neither does.
    """

    agree: Bool[Array, "height width"]
    disagree: Bool[Array, "height width"]
    one_view: Bool[Array, "height width"]
    hole: Bool[Array, "height width"]


def classify_pixels(first: Layer, second: Layer) -> PixelClasses:
    """The kinds of the pixels of a target that two views are seen from, of numpy's arrays or torch's.

    Args:
        first: of the first view.
        second: of the second view; of the same size.
    """
    (is_seen_a, near_a), (is_seen_b, near_b) = _shown(first), _shown(second)
    both, apart = is_seen_a & is_seen_b, is_other_surface(near_a, near_b)
    return PixelClasses(both & ~apart, both & apart, is_seen_a ^ is_seen_b, ~(is_seen_a | is_seen_b))


def silhouette_mask(first: Layer, second: Layer) -> Bool[Array, "height width"]:
    """Pixels at most :data:`BESIDE` pixels from where the nearer of both surfaces jumps; arguments as above."""
    near_a, near_b = _shown(first)[1], _shown(second)[1]
    return near_depth_edges(array_namespace(near_a).maximum(near_a, near_b), BESIDE)


def _shown(view: Layer) -> tuple[Bool[Array, "height width"], Float[Array, "height width"]]:
    """Where a view shows something, and its inverse depth, 0 where it shows nothing."""
    xp, is_seen = array_namespace(view.inverse_depth), view.colour[..., 3] > float(MIN_VISIBLE_WEIGHT)
    return is_seen, xp.where(is_seen, xp.clip(view.inverse_depth, min=0.0), xp.zeros_like(view.inverse_depth))


def is_other_surface(one: Float[Array, "*pixels"], other: Float[Array, "*pixels"]) -> Bool[Array, "*pixels"]:
    """Whether inverse depths, 1/metre and >= 0, are those of different surfaces."""
    xp = array_namespace(one)
    return xp.abs(one - other) > DISAGREEMENT * xp.clip(xp.maximum(one, other), min=FARTHEST)


def near_depth_edges(inverse_depth: Float[Array, "height width"], reach: int) -> Bool[Array, "height width"]:
    """Pixels within the square of ``reach`` pixels around one that neighbours another surface; columns wrap, rows end.

    Args:
        inverse_depth: 1/metre, >= 0.
        reach: 0 for the two pixels on both sides of a jump alone.
    """
    xp = array_namespace(inverse_depth)
    across = is_other_surface(inverse_depth, xp.roll(inverse_depth, -1, axis=1))
    across = across | xp.roll(across, 1, axis=1)
    down = is_other_surface(inverse_depth[:-1], inverse_depth[1:])
    beyond = xp.zeros_like(across[:1])
    found = across | xp.concat([down, beyond]) | xp.concat([beyond, down])
    for _ in range(reach):
        found = found | xp.roll(found, 1, axis=1) | xp.roll(found, -1, axis=1)
        found = found | xp.concat([found[1:], beyond]) | xp.concat([beyond, found[:-1]])
    return found
