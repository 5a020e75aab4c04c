"""What the guided depth network is shown, taught and judged by.

A pair is two views of a walk, turned so that the other camera is ahead. Pairs of narrow, medium and wide baselines are
drawn equally often, where a walk has them. Cameras are held slightly askew, and poses are slightly wrong, as in use.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.grouping import BASELINE_BINS, baseline_bin, median_depth
from omnisyn_cli.geometry.pose import rotation_from_rotation_vector
from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.geometry.sphere import pixel_directions, row_weights
from omnisyn_cli.networks.guided_depth import GUIDANCE_CHANNELS, STRIDE, GuidedDepthPrediction
from omnisyn_cli.training.data import Augmentation, as_tensor, at_block_centres, reduced, vary_colours
from omnisyn_cli.training.simulated_matching import simulated_matching
from omnisyn_cli.training.walks import Walk, load_walk

__all__ = ["GuidedBatch", "draw_guided", "guided_loss", "guided_scores"]

MAX_BASELINE_RATIO = 2.5
"""Baselines over median depth above this are not drawn."""

MIN_BASELINE_RATIO = 0.03
"""Baselines over median depth below this are not drawn where there are others."""

TILT_SHARE, TILT = 0.35, 0.03
"""Share of the pairs whose cameras are held askew, and the standard deviation of pitch and roll, radians."""

POSE_ERROR_SHARE, TURN_ERROR, DIRECTION_ERROR = 0.4, 0.003, 0.008
"""Share of the pairs with pose errors, and the standard deviations of the rotation and of the direction, radians."""

COARSE_WEIGHT, GRADIENT_WEIGHT, SCALE_WEIGHT = 0.35, 0.5, 0.02
"""Of the loss at coarse scales, of gradients and of the Laplace scale, beside 1. Set by hand."""

GRADIENT_SCALES = 4
"""Gradients are compared at strides 1, 2, 4, …"""

RELATIVE_FLOOR, RELATIVE_WEIGHT = 0.1, 0.15
"""Errors count more where √(inverse depth × baseline), s, is small: the weight is 1 + weight / (floor + s)."""

MATCHING_CHANNELS, HAS_MATCHING = 4, 6
"""Of the guidance: how many channels are of matching, and the one that says that they are there."""

MIN_JUDGED = 0.03
"""√(inverse depth × baseline) below which nothing is judged by its ratio."""


@dataclass(frozen=True)
class GuidedBatch:
    """Pairs for one step.

    Attributes:
        first, second: ``(batch, 3, height, width)`` colours in [0, 1].
        towards: ``(batch, 3, 1, 1)`` unit vector to the other camera.
        guidance: ``(batch, 8, height / 4, width / 4)``, see :data:`GUIDANCE_CHANNELS`.
        sqrt_inv_depth: ``(batch, 1, height, width)`` √(inverse depth × baseline); NaN where it is not known.
        ratio: ``(batch,)`` baseline over median depth.
        is_mesh: ``(batch,)`` whether the scene is a mesh.
    """

    first: Float[Tensor, "batch 3 height width"]
    second: Float[Tensor, "batch 3 height width"]
    towards: Float[Tensor, "batch 3 1 1"]
    guidance: Float[Tensor, "batch 8 rows cols"]
    sqrt_inv_depth: Float[Tensor, "batch 1 height width"]
    ratio: Float[Tensor, " batch"]
    is_mesh: Tensor

    @property
    def inputs(self) -> tuple[Tensor, ...]:
        """What the network sees."""
        return self.first, self.second, self.towards, self.guidance


@dataclass(frozen=True)
class _Pair:
    """One sample, as arrays."""

    colours: Float32[np.ndarray, "2 height width 3"]
    inverse_depth: Float32[np.ndarray, "height width"]
    towards: Float[np.ndarray, " 3"]
    guidance: Float32[np.ndarray, "8 rows cols"]
    ratio: float
    is_mesh: bool


def draw_guided(
    pool: list[Path],
    rng: np.random.Generator,
    pairs: int,
    size: tuple[int, int],
    max_sqrt_inv_depth: float,
    augmentation: Augmentation | None = None,
    guided: float = 0.0,
) -> GuidedBatch:
    """Random pairs of random walks.

    Args:
        pool: of walks, see :mod:`omnisyn_cli.training.walks`.
        rng: random numbers.
        pairs: how many.
        size: ``(height, width)``, a whole fraction of the pool's.
        max_sqrt_inv_depth: that targets are clipped to.
        augmentation: of colours; without one, nothing is varied and poses are exact.
        guided: share of the pairs that are shown with what matching would say.

    Raises:
        InputError: the pool's size is not a multiple of ``size``.
    """
    drawn = [
        _draw_pair(load_walk(pool[rng.integers(len(pool))]), rng, size, augmentation, guided) for _ in range(pairs)
    ]
    colours = np.stack([pair.colours for pair in drawn])
    sqrt_inv_depth = np.sqrt(np.stack([pair.inverse_depth for pair in drawn])).clip(max=max_sqrt_inv_depth)
    return GuidedBatch(
        first=as_tensor(colours[:, 0]),
        second=as_tensor(colours[:, 1]),
        towards=torch.tensor(np.stack([pair.towards for pair in drawn]), dtype=torch.float32)[..., None, None],
        guidance=torch.from_numpy(np.stack([pair.guidance for pair in drawn])),
        sqrt_inv_depth=torch.from_numpy(sqrt_inv_depth.astype(np.float32)).unsqueeze(1),
        ratio=torch.tensor([pair.ratio for pair in drawn]),
        is_mesh=torch.tensor([pair.is_mesh for pair in drawn]),
    )


def _draw_pair(
    walk: Walk, rng: np.random.Generator, size: tuple[int, int], augmentation: Augmentation | None, guided: float
) -> _Pair:
    rows = walk.images.shape[1]
    if rows % size[0]:
        raise InputError(f"expected walks of a multiple of {size[0]} rows, got {rows}; make others")
    first, second, ratio = _choose(walk, rng)
    images, inverse_depths = walk.images[[first, second]], walk.inverse_depth[[first, second]]
    motion = walk.positions[second].astype(np.float64) - walk.positions[first]
    baseline = float(np.linalg.norm(motion))
    towards = motion / baseline
    if rng.random() < 0.5:
        images, inverse_depths = images[:, :, ::-1], inverse_depths[:, :, ::-1]
        towards = towards * [-1.0, 1.0, 1.0]
    images, inverse_depths, towards = facing_the_other(images, inverse_depths, towards)
    if augmentation is not None:
        images, inverse_depths, towards = _held_by_hand(images, inverse_depths, towards, rng)
    colours = np.stack([reduced(image, size) for image in images]).astype(np.float32) / np.float32(255.0)
    if augmentation is not None:
        colours = vary_colours(colours, rng, augmentation)
    scaled = inverse_depths * np.float32(baseline)
    guidance = np.zeros((GUIDANCE_CHANNELS, size[0] // STRIDE, size[1] // STRIDE), np.float32)
    if rng.random() < guided:
        guidance[:MATCHING_CHANNELS] = _matching(colours[0], scaled, towards, rng)
        guidance[HAS_MATCHING] = 1.0
    return _Pair(colours, at_block_centres(scaled[0], size), towards, guidance, ratio, walk.is_mesh)


def _matching(
    colours: Float32[np.ndarray, "height width 3"],
    inverse_depths: Float32[np.ndarray, "2 height width"],
    towards: Float[np.ndarray, " 3"],
    rng: np.random.Generator,
) -> Float32[np.ndarray, "4 rows cols"]:
    """What matching would say, at the size of the guidance."""
    rows, cols = colours.shape[0] // STRIDE, colours.shape[1] // STRIDE
    own, other = (at_block_centres(each, (rows, cols)) for each in inverse_depths)
    return simulated_matching(reduced(colours, (rows, cols)), own, other, towards, rng)


def _choose(walk: Walk, rng: np.random.Generator) -> tuple[int, int, float]:
    """Two views, and their baseline over the median depth of the first; all bins that there are equally often."""
    median = [median_depth(inverse_depth) for inverse_depth in walk.inverse_depth]
    distances = np.linalg.norm(walk.positions[:, None] - walk.positions[None], axis=-1)
    found = [
        (first, second, float(distances[first, second] / median[first]))
        for first in range(len(median))
        for second in range(len(median))
        if first != second
    ]
    in_range = [pair for pair in found if MIN_BASELINE_RATIO <= pair[2] <= MAX_BASELINE_RATIO] or found
    bins = {name: [pair for pair in in_range if baseline_bin(pair[2]) == name] for name in BASELINE_BINS}
    filled = [pairs for pairs in bins.values() if pairs]
    pairs = filled[rng.integers(len(filled))]
    return pairs[rng.integers(len(pairs))]


def facing_the_other(
    images: np.ndarray, inverse_depths: np.ndarray, towards: Float[np.ndarray, " 3"]
) -> tuple[np.ndarray, np.ndarray, Float[np.ndarray, " 3"]]:
    """Rolled by whole columns so that the other camera is ahead, and the direction to it in that frame."""
    width = images.shape[2]
    heading = math.atan2(towards[0], -towards[2])
    columns = round(heading / (2.0 * math.pi) * width)
    turn = columns / width * 2.0 * math.pi
    cosine, sine = math.cos(turn), math.sin(turn)
    ahead = np.array([cosine * towards[0] + sine * towards[2], towards[1], cosine * towards[2] - sine * towards[0]])
    return np.roll(images, -columns, axis=2), np.roll(inverse_depths, -columns, axis=2), ahead


def _held_by_hand(
    images: np.ndarray, inverse_depths: np.ndarray, towards: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cameras not quite upright, and poses not quite right."""
    is_tilted, is_misplaced = rng.random() < TILT_SHARE, rng.random() < POSE_ERROR_SHARE
    tilt = rng.normal(0.0, TILT, 3) * [1.0, 0.0, 1.0] * is_tilted
    error = rng.normal(0.0, TURN_ERROR, 3) * is_misplaced
    wrong = rng.normal(0.0, DIRECTION_ERROR, 3) * is_misplaced
    held = rotation_from_rotation_vector(tilt)
    first, second = zip(images, inverse_depths, strict=True)
    if is_tilted:
        first = _turned(*first, held)
    if is_tilted or is_misplaced:
        second = _turned(*second, held @ rotation_from_rotation_vector(error))
    noisy_direction = held.T @ towards + wrong
    pictures, depths = zip(first, second, strict=True)
    return np.stack(pictures), np.stack(depths), noisy_direction / np.linalg.norm(noisy_direction)


def _turned(image: np.ndarray, inverse_depth: np.ndarray, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A view as a camera turned by a rotation would have it."""
    table = RemapTable.for_directions(pixel_directions(*inverse_depth.shape) @ rotation.T, inverse_depth.shape)
    return table.bilinear(np.ascontiguousarray(image)), table.nearest(np.ascontiguousarray(inverse_depth))


def guided_loss(prediction: GuidedDepthPrediction, batch: GuidedBatch) -> Tensor:
    """L1 of √(inverse depth × baseline) at all scales, L1 of its gradients, log-loss of the Laplace scale; a scalar.

    Errors are weighted by solid angle. The Laplace scale learns from errors that it cannot change.
    """
    target, known = batch.sqrt_inv_depth.nan_to_num(), torch.isfinite(batch.sqrt_inv_depth).float()
    weight = known * polar_weights(target) * (1.0 + RELATIVE_WEIGHT / (RELATIVE_FLOOR + target))
    error = _signed_error(prediction.estimate, target)
    loss = _weighted_mean(error.abs(), weight) + GRADIENT_WEIGHT * _gradient_error(error, known)
    for coarse in prediction.coarse:
        stride = target.shape[-1] // coarse.shape[-1]
        thin = (..., slice(stride // 2, None, stride), slice(stride // 2, None, stride))
        share = COARSE_WEIGHT / len(prediction.coarse)
        loss = loss + share * _weighted_mean(_signed_error(coarse, target[thin]).abs(), weight[thin])
    log_loss = error.detach().abs() * torch.exp(-prediction.log_scale) + prediction.log_scale
    return loss + SCALE_WEIGHT * _weighted_mean(log_loss, known * polar_weights(target))


def _signed_error(sqrt_inv_depth: Tensor, target: Tensor) -> Tensor:
    """An estimate below zero is right where nothing is there."""
    return torch.where(target > 0, sqrt_inv_depth - target, sqrt_inv_depth.clamp(min=0.0))


def _weighted_mean(values: Tensor, weight: Tensor) -> Tensor:
    return (values * weight).sum() / weight.sum().clamp(min=1e-6)


def _gradient_error(error: Tensor, known: Tensor) -> Tensor:
    """Mean absolute difference of neighbouring errors, summed over scales."""
    total = error.new_zeros(())
    for scale in range(GRADIENT_SCALES):
        step = 2**scale
        e, k = error[..., ::step, ::step], known[..., ::step, ::step]
        weight = polar_weights(e)
        across = (e.roll(-1, -1) - e).abs()
        down = (e[..., 1:, :] - e[..., :-1, :]).abs()
        total = total + _weighted_mean(across, k * k.roll(-1, -1) * weight)
        total = total + _weighted_mean(down, k[..., 1:, :] * k[..., :-1, :] * weight[1:])
    return total / GRADIENT_SCALES


def polar_weights(like: Float[Tensor, "*batch height width"]) -> Float[Tensor, "height 1"]:
    """Sine of the polar angle of every row, divided by its mean."""
    weights = row_weights(like.shape[-2])
    return torch.as_tensor(weights / weights.mean(), dtype=torch.float32, device=like.device)[:, None]


@torch.no_grad()
def guided_scores(prediction: GuidedDepthPrediction, batch: GuidedBatch) -> dict[str, float]:
    """Figures of one pair, by solid angle; NaN for the bins that it is not of.

    Returns:
        ``error``, the mean absolute error of √(inverse depth × baseline); ``delta_25`` and ``delta_5``, the shares
        whose depth is within a factor of 1.25 and 1.05. The same of groups: by baseline over median depth
        (``error_wide``, …), for meshes (``error_mesh``, …) and for pairs with guidance (``error_guided``, …).
        ``brier``, the mean of (confidence − (within a factor of 1.1))².
    """
    target, known = batch.sqrt_inv_depth.nan_to_num(), torch.isfinite(batch.sqrt_inv_depth)
    area = polar_weights(target) * known
    estimate = prediction.estimate.clamp(min=0.0)
    ratio = torch.maximum(estimate, target) / torch.minimum(estimate, target).clamp(min=1e-6)
    ratio = ratio.square()
    judged = area * (target > MIN_JUDGED)

    def within(factor: float) -> float:
        return float(_weighted_mean((ratio < factor).float(), judged))

    figures = {
        "error": float(_weighted_mean(_signed_error(prediction.estimate, target).abs(), area)),
        "delta_25": within(1.25),
        "delta_5": within(1.05),
    }
    scores = dict(figures)
    own = {baseline_bin(float(batch.ratio[0]))} | ({"mesh"} if bool(batch.is_mesh[0]) else set())
    own |= {"guided"} if bool(batch.guidance.any()) else set()
    for group in (*BASELINE_BINS, "mesh", "guided"):
        scores |= {f"{name}_{group}": value if group in own else math.nan for name, value in figures.items()}
    right = (ratio < 1.1).float()
    scores["brier"] = float(_weighted_mean((prediction.confidence() - right).square(), judged))
    return scores
