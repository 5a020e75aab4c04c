"""Where a picture is wrong: errors and areas by kind of pixel, weighted by solid angle."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool

from omnisyn_cli.evaluation.metrics.image import Picture, decibels, squared_error
from omnisyn_cli.geometry.sphere import row_weights

Masks = Mapping[str, Bool[np.ndarray, "height width"]]


def end_masks(size: tuple[int, int]) -> Masks:
    """``top`` and ``bottom``: the eighth of the rows around either pole, one row at least."""
    height, _ = size
    rows = np.arange(height) < max(1, height // 8)
    return {"top": _rows(rows, size), "bottom": _rows(rows[::-1], size)}


def _rows(is_in: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    return np.broadcast_to(is_in[:, None], size)


def kind_figures(image: Picture, truth: Picture, kinds: Masks) -> dict[str, dict[str, float]]:
    """What is measured of every kind that there are pixels of: a figure -> a kind -> a number.

    ``psnr`` is the peak signal-to-noise ratio in dB of the pixels of a kind, ``area`` their share of the sphere,
    ``error`` their share of the squared error of the whole picture (0 where that has none). Pixels count by their
    solid angle.

    Args:
        image: RGB in [0, 1].
        truth: RGB in [0, 1], of the same size.
        kinds: where pixels of each kind are; kinds may overlap.
    """
    squared = squared_error(image, truth).mean(axis=-1)
    weights = np.broadcast_to(row_weights(len(truth))[:, None], squared.shape)
    weights = weights / weights.sum()
    squared = squared * weights
    total = float(squared.sum())
    area = {kind: float(weights[mask].sum()) for kind, mask in kinds.items() if mask.any()}
    error = {kind: float(squared[kinds[kind]].sum()) for kind in area}
    return {
        "psnr": {kind: decibels(error[kind] / area[kind]) for kind in area},
        "area": area,
        "error": {kind: error[kind] / total if total > 0.0 else 0.0 for kind in area},
    }
