"""How close two pictures are: signal-to-noise ratio, structural similarity and the seam; where they differ, by kind.

And how close a frame is to a photograph that was left out of a tour: its light differs, and its camera stands in it.
Pictures are RGB in [0, 1], both of one size, and at least 11×11 pixels for structural similarity; ValueError for
others. The names with ``ws_`` weight every pixel by its share of the sphere.
"""

import math
from collections.abc import Mapping

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from omnisyn_cli.baselines.cross_fade import moved, optical_flow
from omnisyn_cli.geometry.sampling import add_border
from omnisyn_cli.geometry.sphere import mean_over_sphere, row_weights, solid_angles

Picture = Float[np.ndarray, "height width 3"]
Masks = Mapping[str, Bool[np.ndarray, "height width"]]

PEAK = 1.0  # the greatest value of an image
# Pixels along the side of the Gaussian window, and its standard deviation (Wang et al., 2004).
SSIM_WINDOW, SSIM_SIGMA = 11, 1.5
LUMINANCE_FLOOR = (0.01 * PEAK) ** 2
CONTRAST_FLOOR = (0.03 * PEAK) ** 2  # C1 and C2 of Wang et al., 2004.


def psnr(image: Picture, truth: Picture) -> float:
    """Peak signal-to-noise ratio in dB for values in [0, 1]; infinite where both are the same."""
    return decibels(float(squared_error(image, truth).mean()))


def end_psnr(image: Picture, truth: Picture, *, is_bottom: bool) -> float:
    """PSNR in dB of the top or the bottom eighth of the rows, where WS-PSNR looks away: every pixel counts alike."""
    rows = max(1, len(truth) // 8)
    end = slice(-rows, None) if is_bottom else slice(rows)
    return psnr(image[end], truth[end])


def ws_psnr(image: Picture, truth: Picture) -> float:
    """PSNR in dB weighted by share of the sphere. Source: Sun, Lu and Yu, Weighted-to-spherically-uniform …, 2017."""
    return decibels(mean_over_sphere(squared_error(image, truth)))


def ssim(image: Picture, truth: Picture) -> float:
    """Mean structural similarity, 1 for equal pictures, over the pixels whose whole window lies in the picture.

    Flat, channels averaged, population variances. Source: Wang et al., Image quality assessment, 2004.
    """
    _check_window(image, truth)
    return float(similarity(image, truth).mean())


def ws_ssim(image: Picture, truth: Picture) -> float:
    """SSIM by share of the sphere, over seam and poles (Zhou et al., Weighted-to-spherically-uniform SSIM, 2018)."""
    _check_window(image, truth)
    return mean_over_sphere(similarity(add_border(image, SSIM_WINDOW // 2), add_border(truth, SSIM_WINDOW // 2)))


def lrce(image: Picture, truth: Picture) -> float:
    """Left-right consistency error: how much the step across the seam differs from the true one; 0 is perfect.

    ``mean |(image_first − image_last) − (truth_first − truth_last)|`` of columns: a real edge at the seam is no error.
    Source: the metric of Shen et al., PanoFormer, 2022, there of depth, here of colour, as an absolute mean.
    """
    check_same_size(image, truth)
    error = image.astype(np.float64) - truth
    return float(np.abs(error[:, 0] - error[:, -1]).mean())


def check_same_size(image: np.ndarray, truth: np.ndarray) -> None:
    """ValueError unless both arrays have one shape."""
    if image.shape != truth.shape:
        raise ValueError(f"expected two pictures of one size, got {image.shape} and {truth.shape}; resize one of them")


def _check_window(image: np.ndarray, truth: np.ndarray) -> None:
    check_same_size(image, truth)
    if min(image.shape[:2]) < SSIM_WINDOW:
        height, width = image.shape[:2]
        raise ValueError(
            f"expected pictures of at least {SSIM_WINDOW}×{SSIM_WINDOW} pixels, got {width}×{height}; use PSNR"
        )


def squared_error(image: np.ndarray, truth: np.ndarray) -> Float[np.ndarray, "height width 3"]:
    """Of every channel of every pixel; ValueError unless both are of one size."""
    check_same_size(image, truth)
    return np.asarray((image.astype(np.float64) - truth) ** 2)


def decibels(mean_squared_error: float) -> float:
    """The peak signal-to-noise ratio that a mean squared error is; infinite for none."""
    return math.inf if mean_squared_error == 0 else 10.0 * math.log10(PEAK**2 / mean_squared_error)


def similarity(image: np.ndarray, truth: np.ndarray) -> Float[np.ndarray, "inner_height inner_width 3"]:
    """SSIM of every window that lies in the picture; 5 pixels less on each side."""
    x, y = image.astype(np.float64), truth.astype(np.float64)
    mean_x, mean_y = _blurred(x), _blurred(y)
    variances = _blurred(x * x + y * y) - mean_x**2 - mean_y**2
    covariance = _blurred(x * y) - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + LUMINANCE_FLOOR) / (mean_x**2 + mean_y**2 + LUMINANCE_FLOOR)
    return np.asarray(luminance * (2 * covariance + CONTRAST_FLOOR) / (variances + CONTRAST_FLOOR))


def _blurred(values: np.ndarray) -> np.ndarray:
    """Means under the Gaussian window wherever it fits."""
    reach = SSIM_WINDOW // 2
    return np.asarray(cv2.GaussianBlur(values, (SSIM_WINDOW, SSIM_WINDOW), SSIM_SIGMA))[reach:-reach, reach:-reach]


def end_masks(size: tuple[int, int]) -> Masks:
    """``top`` and ``bottom``: the eighth of the rows around either pole, one row at least."""
    height, _ = size
    top = np.broadcast_to(np.arange(height)[:, None] < max(1, height // 8), size)
    return {"top": top, "bottom": top[::-1]}


def kind_figures(image: Picture, truth: Picture, kinds: Masks) -> dict[str, dict[str, float]]:
    """What is measured of every kind that there are pixels of: a figure -> a kind -> a number.

    ``psnr`` in dB, ``area`` (share of the sphere), ``error`` (share of the picture's squared error, 0 where it has
    none). Pixels count by their solid angle; kinds may overlap.
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


# Displacement up to which a frame is aligned with the photograph. Farther away it shows something else.
MAX_FLOW_DEG = 4.0
CAMERA_DEG = 40.0  # around the nadir nothing is compared: a tripod, a hood or an operator is there in most photographs

Usable = Bool[np.ndarray, "height width"]


def photograph_scores(image: Picture, truth: Picture, usable: Usable) -> dict[str, float]:
    """Scores after a gain and an offset per channel, on the pixels of the photograph that may be compared.

    ``ws_psnr``, ``ws_ssim`` (from 11 rows on), both aligned (``aligned_psnr``, …), ``misplacement`` (median degrees).
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
