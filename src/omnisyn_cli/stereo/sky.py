"""The sky: infinitely far, found by its parallax and not by its colour."""

import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.geometry.regions import connected_regions

MAX_SKY_INVERSE_DEPTH = 0.02  # in 1/baselines: a matching resolution of a few hundred rows cannot tell this from 0
MIN_SKY_TEXTURE_SHARE = 0.05  # share of the sky where texture must have shown that there is no parallax; chosen by eye
MIN_SKY_SHARE = 0.01  # share of the sphere: a smaller region is no sky; chosen by eye
MAX_SKY_GAP_SHARE = 0.003  # share of the sphere: smaller gaps in the sky are closed; chosen by eye
ZENITH_SINE = 0.9  # sine of the elevation (64°) above which a region reaches the zenith


def find_sky(
    inverse_depth: Float[np.ndarray, "height width"], valid: Bool[np.ndarray, "height width"],
    sin_elevation: Float[np.ndarray, "height width"], solid_angle: Float[np.ndarray, "height width"],
) -> Bool[np.ndarray, "height width"]:  # fmt: skip
    """Where the panorama shows the sky, given inverse depth in 1/baselines, valid where matching measured it.

    A bright wall, an overexposed ceiling or a lamp is as smooth as a cloudless sky. The sky reaches the zenith, and
    wherever it has texture (clouds, a gradient, the rims of what stands before it) that texture has no parallax.
    """
    is_above = sin_elevation > 0.0
    is_far = (inverse_depth < MAX_SKY_INVERSE_DEPTH) & is_above
    labels = connected_regions(is_far, is_diagonal=False)
    at_zenith = np.unique(labels[(sin_elevation > ZENITH_SINE) & is_far])
    region = np.isin(labels, at_zenith[at_zenith > 0])
    area, textured_area = (solid_angle * region).sum(), (solid_angle * (region & valid)).sum()
    if area < MIN_SKY_SHARE * solid_angle.sum() or textured_area < MIN_SKY_TEXTURE_SHARE * area:
        return np.zeros_like(is_far)
    labels = connected_regions(~region & is_above, is_diagonal=False)
    is_gap = np.bincount(labels.ravel(), solid_angle.ravel()) < MAX_SKY_GAP_SHARE * solid_angle.sum()
    is_gap[0] = False
    return np.asarray(region | is_gap[labels])
