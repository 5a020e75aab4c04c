"""The sky: infinitely far, recognised by what both views say about it and not by its colour.

A bright wall, an overexposed ceiling or a lamp is as smooth as a cloudless sky. What sets the sky apart is that it
reaches the zenith, and that wherever it does show something (clouds, a gradient, the rims of what stands before it)
that something has no parallax.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float

NO_PARALLAX = 0.02
"""Inverse depth in 1/baselines that a working resolution of a few hundred rows cannot tell from 0."""

EVIDENCE = 0.05
"""Share of the region where texture must have decided for no parallax."""

LEAST = 0.01
"""Share of the sphere: a smaller region is no sky."""

SPOT = 0.003
"""Share of the sphere: openings in the sky smaller than this are closed."""


def find_sky(
    inverse_depth: Float[np.ndarray, "height width"],
    seen: Bool[np.ndarray, "height width"],
    rise: Float[np.ndarray, "height width"],
    solid_angle: Float[np.ndarray, "height width"],
) -> Bool[np.ndarray, "height width"]:
    """Where the panorama shows the sky.

    Args:
        inverse_depth: in 1/baselines.
        seen: where texture decided about it.
        rise: sine of the elevation above the horizon.
        solid_angle: of every pixel.
    """
    far = (inverse_depth < NO_PARALLAX) & (rise > 0.0)
    region: np.ndarray = _touching_zenith(far, rise)
    size, evidence = (solid_angle * region).sum(), (solid_angle * (region & seen)).sum()
    if size < LEAST * solid_angle.sum() or evidence < EVIDENCE * size:
        return np.zeros_like(far)
    return np.asarray(region | _spots(~region & (rise > 0.0), solid_angle))


def _touching_zenith(mask: np.ndarray, rise: np.ndarray) -> np.ndarray:
    labels = _components(mask)
    inside = np.unique(labels[(rise > 0.9) & mask])
    return np.asarray(np.isin(labels, inside[inside > 0]))


def _spots(mask: np.ndarray, solid_angle: np.ndarray) -> np.ndarray:
    """Small components of a mask."""
    labels = _components(mask)
    size = np.bincount(labels.ravel(), solid_angle.ravel())
    small = size < SPOT * solid_angle.sum()
    small[0] = False
    return np.asarray(small[labels])


def _components(mask: np.ndarray) -> np.ndarray:
    """Connected components across the seam; 0 is outside."""
    _, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)
    parent = np.arange(labels.max() + 1)
    for left, right in zip(labels[:, 0], labels[:, -1], strict=True):
        if left and right:
            low, high = sorted((parent[left], parent[right]))
            parent[parent == high] = low
    return np.asarray(parent[labels])
