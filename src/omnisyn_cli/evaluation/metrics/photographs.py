"""How close a frame is to a photograph that was left out of a tour: its light differs, and its camera stands in it."""

import cv2
import numpy as np
from jaxtyping import Bool, Float32

from omnisyn_cli.baselines.cross_fade import moved, optical_flow
from omnisyn_cli.evaluation.metrics.image import SSIM_WINDOW, Picture, decibels, similarity, squared_error
from omnisyn_cli.geometry.sampling import add_border
from omnisyn_cli.geometry.sphere import row_weights, solid_angles

# Displacement up to which a frame is aligned with the photograph. Farther away it shows something else.
MAX_FLOW_DEG = 4.0
CAMERA_DEG = 40.0  # around the nadir nothing is compared: a tripod, a hood or an operator is there in most photographs

Usable = Bool[np.ndarray, "height width"]


def photograph_scores(image: Picture, truth: Picture, usable: Usable) -> dict[str, float]:
    """Scores after a gain and an offset per channel, on the pixels of the photograph that may be compared.

    ``ws_psnr``, ``ws_ssim`` (from 11 rows on), both aligned (``aligned_psnr``, …), ``misplacement``: its median
    degrees.
    """
    lit, aligned, degrees = _fit_to_photograph(image, truth, usable)
    weights = solid_angles(*usable.shape)[usable]
    order = np.argsort(degrees[usable])
    half = np.searchsorted(np.cumsum(weights[order]), 0.5 * weights.sum())
    scores = {"misplacement": float(degrees[usable][order][half])}
    for prefix, found in (("ws_", lit), ("aligned_", aligned)):
        error = squared_error(found, truth)[usable].mean(axis=-1)
        scores[f"{prefix}psnr"] = decibels(float(np.average(error, weights=weights)))
        if len(truth) >= SSIM_WINDOW:
            whole = (add_border(picture, SSIM_WINDOW // 2) for picture in (found, truth.astype(np.float32)))
            scores[f"{prefix}ssim"] = float(np.average(similarity(*whole)[usable].mean(axis=-1), weights=weights))
    return scores


def _fit_to_photograph(
    image: Picture, truth: Picture, usable: Usable
) -> tuple[Picture, Picture, Float32[np.ndarray, "height width"]]:
    """The frame relit; the same aligned by flow up to :data:`MAX_FLOW_DEG`; degrees moved. Elsewhere the photograph."""
    weights = solid_angles(*usable.shape)[usable]
    lit = np.array(truth, np.float32)
    for channel in range(3):
        values, wanted = image[..., channel][usable], truth[..., channel][usable]
        mean, target = np.average(values, weights=weights), np.average(wanted, weights=weights)
        spread = np.average((values - mean) ** 2, weights=weights)
        gain = np.average((values - mean) * (wanted - target), weights=weights) / max(spread, 1e-6)
        lit[..., channel][usable] = np.clip(target + gain * (values - mean), 0.0, 1.0)
    flow = optical_flow(np.asarray(truth), lit)
    height = len(truth)
    degrees = np.hypot(flow[..., 0], flow[..., 1] * row_weights(height)[:, None]) * (180.0 / height)
    bounded = flow * np.minimum(1.0, MAX_FLOW_DEG / np.maximum(degrees, 1e-6))[..., None]
    aligned = np.where(usable[..., None], np.clip(moved(lit, bounded.astype(np.float32)), 0.0, 1.0), lit)
    return lit, aligned.astype(np.float32), np.minimum(degrees, MAX_FLOW_DEG).astype(np.float32)


def comparable_pixels(size: tuple[int, int], *masks: Usable | None) -> Usable:
    """Pixels of a photograph that may be compared: away from the nadir, and in none of the masks (False: left out)."""
    usable = np.ones(size, bool)
    usable[round(size[0] * (1.0 - CAMERA_DEG / 180.0)) :] = False
    for mask in masks:
        if mask is not None:
            usable &= cv2.resize(mask.astype(np.uint8), size[::-1], interpolation=cv2.INTER_AREA) > 0
    return usable
