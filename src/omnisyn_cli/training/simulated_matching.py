"""What classical matching would say of a pair, made up from the truth for a thousandth of its time.

Matching is right where both cameras see a point that has texture, away from the epipoles and not too near. Elsewhere it
is right by luck, too far, or anything. Some of what is wrong passes the left-right check: islands, and the borders of
near things, which windows make wider. How much of each there is differs from pair to pair.
"""

import math

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.geometry.sampling import add_border
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.geometry.sweep import sweep_directions

__all__ = ["simulated_matching"]

VISIBILITY_RATIO, VISIBILITY_SLACK = 1.08, 0.004
"""Factor, and inverse depth, within which the other view has to have the same surface for a point to be seen there."""

EPIPOLES = (3.0, 14.0)
"""Degrees around the epipoles in which nothing is measured."""

MAX_MATCHED = (0.7, 1.5)
"""√(inverse depth × baseline) from which on little is found."""

NOISE = (0.003, 0.02)
"""Relative error of √(inverse depth) where it is right."""

MAX_UNMATCHED_CONTRAST = 0.012
"""Contrast (standard deviation of grey) up to which nothing may be found."""

BORDER_JUMP = 0.03
"""Difference of √(inverse depth × baseline) that a border makes."""

MAX_ISLANDS = 6
"""Wrong islands that pass the left-right check, fewer than this per pair. Set by hand."""

AMBIGUITY = 0.35
"""Largest peak ratio of what is wrong; what is right is between this and 1."""


def simulated_matching(
    image: Float32[np.ndarray, "height width 3"],
    inverse_depth: Float32[np.ndarray, "height width"],
    other: Float32[np.ndarray, "height width"],
    towards: Float[np.ndarray, " 3"],
    rng: np.random.Generator,
) -> Float32[np.ndarray, "4 height width"]:
    """Root of the best match, whether it is valid, whether it is left-right consistent, and its peak ratio.

    Args:
        image: of the first camera, RGB in [0, 1].
        inverse_depth: of the first camera, 1/baselines; NaN where it is not known.
        other: of the second camera, which is held alike.
        towards: unit vector from the first to the second camera.
        rng: random numbers.

    Returns:
        All four are zero where matching gives up.
    """
    size = inverse_depth.shape
    is_known = np.isfinite(inverse_depth)
    truth = np.sqrt(np.where(is_known, inverse_depth, 0.0)).astype(np.float32)
    found = _is_found(image, truth, np.nan_to_num(other), towards, rng) & is_known
    right = truth * (1.0 + rng.uniform(*NOISE) * rng.standard_normal(size, dtype=np.float32))
    behind = cv2.erode(truth, np.ones((5, 5), np.uint8)) * (1.0 + 0.3 * (_blobs(size, 16, rng) - 0.5))
    anything = _blobs(size, 16, rng) * rng.uniform(0.3, 1.5)
    luck = _blobs(size, 16, rng)
    guess = np.where(luck < 0.3, right, np.where(luck < 0.65, behind, anything))
    sqrt_inv_depth, consistent = np.where(found, right, guess), found
    for wrong, passes in (_widened(truth, rng), _islands(sqrt_inv_depth, rng)):
        is_wrong = np.abs(wrong - sqrt_inv_depth) > BORDER_JUMP
        sqrt_inv_depth = np.where(is_wrong, wrong, sqrt_inv_depth)
        consistent = np.where(is_wrong, passes, consistent)
        found = found & ~is_wrong
    valid = (consistent | (_blobs(size, 8, rng) > rng.uniform(0.1, 0.7))) & is_known
    ratio = np.where(found, AMBIGUITY + (1.0 - AMBIGUITY) * _blobs(size, 32, rng), AMBIGUITY * _blobs(size, 32, rng))
    ratio = np.where(consistent & ~found, np.maximum(ratio, rng.random(size, dtype=np.float32)), ratio)
    channels = np.stack([sqrt_inv_depth, np.ones(size), consistent, np.clip(ratio, 0.0, 1.0)]) * valid
    return np.asarray(channels, np.float32)


def _is_found(
    image: Float32[np.ndarray, "height width 3"],
    sqrt_inv_depth: Float32[np.ndarray, "height width"],
    other: Float32[np.ndarray, "height width"],
    towards: Float[np.ndarray, " 3"],
    rng: np.random.Generator,
) -> Bool[np.ndarray, "height width"]:
    """Where matching would be right."""
    size, directions = sqrt_inv_depth.shape, pixel_directions(*sqrt_inv_depth.shape)
    moved = sweep_directions(directions, np.square(sqrt_inv_depth, dtype=np.float64), Pose(np.eye(3), -towards))
    there = RemapTable.for_directions(moved, size).nearest(np.ascontiguousarray(other))
    expected = np.square(sqrt_inv_depth) / np.maximum(np.linalg.norm(moved, axis=-1), 1e-6)
    found = there <= VISIBILITY_RATIO * expected + VISIBILITY_SLACK
    found &= np.abs(directions @ towards) < math.cos(math.radians(rng.uniform(*EPIPOLES)))
    found &= (_contrast(image) > rng.uniform(0.0, MAX_UNMATCHED_CONTRAST)) | (
        _blobs(size, 8, rng) > rng.uniform(0.2, 0.9)
    )
    found &= (sqrt_inv_depth < rng.uniform(*MAX_MATCHED)) | (_blobs(size, 8, rng) > rng.uniform(0.0, 0.6))
    found &= _blobs(size, int(rng.choice([4, 8, 16])), rng) > rng.uniform(-0.4, 0.25)
    return np.asarray(found)


def _contrast(image: Float32[np.ndarray, "height width 3"]) -> Float32[np.ndarray, "height width"]:
    """Standard deviation of grey within 3×3 pixels."""
    grey = image.mean(axis=-1)
    mean, square = cv2.blur(grey, (3, 3)), cv2.blur(grey * grey, (3, 3))
    return np.asarray(np.sqrt(np.maximum(square - mean * mean, 0.0)))


def _widened(truth: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Roots with the borders of near things too wide here and there, and where that passes the left-right check."""
    size, window = truth.shape, np.ones((int(rng.integers(2, 5)),) * 2, np.uint8)
    is_wide = _blobs(size, 16, rng) < rng.uniform(0.3, 1.0)
    return np.where(is_wide, cv2.dilate(truth, window), truth), _blobs(size, 32, rng) < rng.uniform(0.3, 1.0)


def _islands(sqrt_inv_depth: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Roots with spots that are wrong altogether, and whether those pass the left-right check."""
    height, width = sqrt_inv_depth.shape
    wrong, passes = sqrt_inv_depth.copy(), np.zeros(sqrt_inv_depth.shape, np.bool_)
    for _ in range(int(rng.integers(0, MAX_ISLANDS))):
        spot = np.zeros((height, width), np.uint8)
        axes = int(rng.uniform(1, 14) * height / 128) + 1, int(rng.uniform(1, 8) * height / 128) + 1
        centre = int(rng.integers(width)), int(rng.integers(height))
        cv2.ellipse(spot, centre, axes, float(rng.uniform(0, 180)), 0, 360, 1, -1)
        wrong = np.where(spot > 0, sqrt_inv_depth * rng.uniform(0.3, 2.0), wrong)
        passes |= (spot > 0) & (rng.random() < 0.6)
    return wrong, passes


def _blobs(size: tuple[int, ...], rows: int, rng: np.random.Generator) -> Float32[np.ndarray, "height width"]:
    """Smooth random numbers, mostly in [0, 1], that vary over the height ``rows`` times; the same over the seam."""
    height, width = size
    border = 2
    coarse = add_border(rng.random((rows, 2 * rows), dtype=np.float32), border)
    scale = -(-height // rows)
    wide = cv2.resize(coarse, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    return np.asarray(wide[border * scale :, border * scale :][:height, :width])
