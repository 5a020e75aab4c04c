"""Classes of pixels by what both layers show there; evaluation reports errors by them.

Every pixel is of exactly one of four classes: both layers agree, they disagree, one of them shows something, neither
does. Besides, it may lie near a silhouette, where a frame shows two surfaces next to each other.
"""

from typing import Any, NamedTuple

from array_api_compat import array_namespace
from jaxtyping import Bool, Float

from omnisyn_cli.geometry.tolerances import SAME_SURFACE_TOLERANCE
from omnisyn_cli.types import MIN_VISIBLE_WEIGHT, Layer

Array = Any  # numpy.ndarray or torch.Tensor


# 1/metre that differences are relative to at least: two surfaces beyond 1000 km are one, whatever their ratio.
MIN_INVERSE_DEPTH = 1e-6
# Pixels from a depth discontinuity up to which errors count as those of the silhouette. Set by hand.
SILHOUETTE_PIXELS = 2


class PixelClasses(NamedTuple):
    """Masks ``(height, width)``: both layers show something, at one depth or at different ones; one does; neither."""

    agree: Bool[Array, "height width"]
    disagree: Bool[Array, "height width"]
    one_view: Bool[Array, "height width"]
    hole: Bool[Array, "height width"]


def classify_pixels(first: Layer, second: Layer) -> PixelClasses:
    """The classes of all pixels of two layers of one size, of numpy arrays or torch tensors."""
    (seen_a, rho_a), (seen_b, rho_b) = _seen_depth(first), _seen_depth(second)
    both, differs = seen_a & seen_b, is_other_surface(rho_a, rho_b)
    return PixelClasses(both & ~differs, both & differs, seen_a ^ seen_b, ~(seen_a | seen_b))


def silhouette_mask(first: Layer, second: Layer) -> Bool[Array, "height width"]:
    """Pixels at most :data:`SILHOUETTE_PIXELS` (square) from a jump of the nearer surface; columns wrap, rows end."""
    rho_a, rho_b = _seen_depth(first)[1], _seen_depth(second)[1]
    xp = array_namespace(rho_a)
    nearer = xp.maximum(rho_a, rho_b)
    across = is_other_surface(nearer, xp.roll(nearer, -1, axis=1))
    across = across | xp.roll(across, 1, axis=1)
    down = is_other_surface(nearer[:-1], nearer[1:])
    no_row = xp.zeros_like(across[:1])
    found = across | xp.concat([down, no_row]) | xp.concat([no_row, down])
    for _ in range(SILHOUETTE_PIXELS):
        found = found | xp.roll(found, 1, axis=1) | xp.roll(found, -1, axis=1)
        found = found | xp.concat([found[1:], no_row]) | xp.concat([no_row, found[:-1]])
    return found


def _seen_depth(layer: Layer) -> tuple[Bool[Array, "height width"], Float[Array, "height width"]]:
    """Where a layer shows something, and its inverse depth, 0 where it shows nothing."""
    xp, is_seen = array_namespace(layer.inverse_depth), layer.colour[..., 3] > float(MIN_VISIBLE_WEIGHT)
    return is_seen, xp.where(is_seen, xp.clip(layer.inverse_depth, min=0.0), xp.zeros_like(layer.inverse_depth))


def is_other_surface(one: Float[Array, "*pixels"], other: Float[Array, "*pixels"]) -> Bool[Array, "*pixels"]:
    """Whether inverse depths, 1/metre and >= 0, are those of different surfaces."""
    xp = array_namespace(one)
    return xp.abs(one - other) > SAME_SURFACE_TOLERANCE * xp.clip(xp.maximum(one, other), min=MIN_INVERSE_DEPTH)
