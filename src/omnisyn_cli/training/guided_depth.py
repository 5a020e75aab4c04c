"""What the guided depth network is shown, taught and judged by.

A pair is two views of a walk, turned so that the other camera is ahead. Pairs of narrow, medium and wide baselines are
drawn equally often, where a walk has them. Cameras are a bit askew, poses a bit wrong, some tripods capped, as in use.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Float32
from torch import Tensor

from omnisyn_cli.evaluation.grouping import BASELINE_BINS, baseline_bin
from omnisyn_cli.geometry.pose import rotation_from_rotation_vector
from omnisyn_cli.networks.guided_depth import GuidedDepthPrediction
from omnisyn_cli.training import data
from omnisyn_cli.training.data import Array, Augmentation, Walk
from omnisyn_cli.training.losses import polar_weights, signed_error
from omnisyn_cli.training.pairs import turned_table
from omnisyn_cli.training.walks import draw_pose_error, facing_the_other

MAX_BASELINE_RATIO = 2.5  # Baselines over median depth above this are not drawn
MIN_BASELINE_RATIO = 0.03  # Baselines over median depth below this are not drawn where there are others
# Share of the pairs whose cameras are held askew, and the standard deviation of pitch and roll, radians.
TILT_SHARE, TILT = 0.35, 0.03
# Share of the pairs with a cap of one colour at the nadir, and its least and greatest radius in degrees.
CAP_SHARE, CAP_RADII = 0.25, (4.0, 26.0)
# Of the loss at coarse scales, of gradients and of the Laplace scale, beside 1. Set by hand.
COARSE_WEIGHT, GRADIENT_WEIGHT, SCALE_WEIGHT = 0.35, 0.5, 0.02
# Errors count more where √(inverse depth × baseline), s, is small: the weight is 1 + weight / (floor + s).
RELATIVE_FLOOR, RELATIVE_WEIGHT = 0.1, 0.15
GRADIENT_SCALES = 4  # Gradients are compared at strides 1, 2, 4, …
MIN_JUDGED = 0.03  # √(inverse depth × baseline) below which nothing is judged by its ratio


@dataclass(frozen=True)
class GuidedBatch:
    """Pairs for one step, as tensors; one of them, without the first axis, as arrays."""

    first: Float[Array, "*batch 3 height width"]  # colours in [0, 1]
    second: Float[Array, "*batch 3 height width"]
    towards: Float[Array, "*batch 3 1 1"]  # unit vector to the other camera
    sqrt_inv_depth: Float[Array, "*batch 1 height width"]  # √(inverse depth × baseline); NaN where it is not known
    ratio: Float[Array, "*batch"]  # baseline over median depth
    is_mesh: Bool[Array, "*batch"]  # whether the scene is a mesh


def draw_guided(
    pool: list[Path], rng: np.random.Generator, pairs: int, size: tuple[int, int], max_sqrt_inv_depth: float,
    augmentation: Augmentation | None = None,
) -> GuidedBatch:  # fmt: skip
    """Random pairs of random walks, with targets clipped; augmentation None varies nothing.

    InputError: ``size`` is no whole fraction of the pool's.
    """
    walks = (data.draw_walk(pool, rng, size[0]) for _ in range(pairs))
    return data.stacked([_pair(walk, rng, size, max_sqrt_inv_depth, augmentation) for walk in walks])


def _pair(
    walk: Walk, rng: np.random.Generator, size: tuple[int, int], most: float, augmentation: Augmentation | None
) -> GuidedBatch:
    first, second, ratio = choose_views(walk, rng)
    images, inverse_depth = walk.images[[first, second]], walk.inverse_depth[[first]]
    motion = walk.positions[second].astype(np.float64) - walk.positions[first]
    baseline = float(np.linalg.norm(motion))
    towards = motion / baseline
    (inverse_depth,), _ = facing_the_other(inverse_depth, towards)
    images, towards = facing_the_other(images, towards)
    if rng.random() < 0.5:
        images, inverse_depth, towards = images[:, :, ::-1], inverse_depth[:, ::-1], towards * [-1.0, 1.0, 1.0]
    if augmentation is not None:
        images, inverse_depth, towards = _held_by_hand(images, inverse_depth, towards, rng)
    colours = np.stack(
        [cv2.resize(np.ascontiguousarray(image), size[::-1], interpolation=cv2.INTER_AREA) for image in images]
    ).astype(np.float32) / np.float32(255.0)
    if augmentation is not None:
        colours = with_cap(data.vary_colours(colours, rng, augmentation), rng)
    sqrt_inv_depth = np.sqrt(data.at_block_centres(inverse_depth * np.float32(baseline), size)).clip(max=most)
    return GuidedBatch(
        first=colours[0].transpose(2, 0, 1), second=colours[1].transpose(2, 0, 1),
        towards=towards.astype(np.float32)[:, None, None],
        sqrt_inv_depth=sqrt_inv_depth.astype(np.float32)[None], ratio=np.float32(ratio), is_mesh=np.bool_(walk.is_mesh),
    )  # fmt: skip


def choose_views(walk: Walk, rng: np.random.Generator) -> tuple[int, int, float]:
    """Two views, and their baseline over the median depth of the first; all bins that there are equally often."""
    ratios = np.ndenumerate(walk.baseline_ratios())
    found = [(first, second, float(ratio)) for (first, second), ratio in ratios if first != second]
    in_range = [pair for pair in found if MIN_BASELINE_RATIO <= pair[2] <= MAX_BASELINE_RATIO] or found
    bins = {name: [pair for pair in in_range if baseline_bin(pair[2]) == name] for name in BASELINE_BINS}
    filled = [pairs for pairs in bins.values() if pairs]
    chosen = filled[rng.integers(len(filled))]
    return chosen[rng.integers(len(chosen))]


def with_cap(
    colours: Float32[np.ndarray, "2 height width 3"], rng: np.random.Generator
) -> Float32[np.ndarray, "2 height width 3"]:
    """Both pictures, some with a tripod's cap of one colour each."""
    if rng.random() < CAP_SHARE:
        rows = colours.shape[1]
        first_row = round(rows * (1.0 - rng.uniform(*CAP_RADII) / 180.0))
        colours[:, first_row:] = (0.7 * rng.random((2, 1, 1, 1)) + 0.3 * rng.random((2, 1, 1, 3))).astype(np.float32)
    return colours


def _held_by_hand(
    images: np.ndarray, inverse_depth: np.ndarray, towards: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cameras not quite upright, and poses not quite right."""
    is_tilted = rng.random() < TILT_SHARE
    tilt = rng.normal(0.0, TILT, 3) * [1.0, 0.0, 1.0] * is_tilted
    error, wrong = draw_pose_error(rng)
    held = rotation_from_rotation_vector(tilt)
    first, second = images
    if is_tilted:
        first = turned_table(first.shape[:2], held).bilinear(np.ascontiguousarray(first))
        inverse_depth = turned_table(inverse_depth.shape, held).nearest(np.ascontiguousarray(inverse_depth))
    if is_tilted or wrong.any():
        turn = held @ error
        second = turned_table(second.shape[:2], turn).bilinear(np.ascontiguousarray(second))
    noisy_direction = held.T @ towards + wrong
    return np.stack([first, second]), inverse_depth, noisy_direction / np.linalg.norm(noisy_direction)


def guided_loss(prediction: GuidedDepthPrediction, batch: GuidedBatch) -> Tensor:
    """By solid angle: L1 at all scales and of gradients, log-loss of the Laplace scale by errors it cannot change."""
    target, known = batch.sqrt_inv_depth.nan_to_num(), torch.isfinite(batch.sqrt_inv_depth).float()
    weight = known * polar_weights(target) * (1.0 + RELATIVE_WEIGHT / (RELATIVE_FLOOR + target))
    error = signed_error(prediction.estimate, target)
    loss = _weighted_mean(error.abs(), weight) + GRADIENT_WEIGHT * _gradient_error(error, known)
    for coarse in prediction.coarse:
        stride = target.shape[-1] // coarse.shape[-1]
        thin = (..., slice(stride // 2, None, stride), slice(stride // 2, None, stride))
        share = COARSE_WEIGHT / len(prediction.coarse)
        loss = loss + share * _weighted_mean(signed_error(coarse, target[thin]).abs(), weight[thin])
    log_loss = error.detach().abs() * torch.exp(-prediction.log_scale) + prediction.log_scale
    return loss + SCALE_WEIGHT * _weighted_mean(log_loss, known * polar_weights(target))


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


@torch.no_grad()
def guided_scores(prediction: GuidedDepthPrediction, batch: GuidedBatch) -> dict[str, float]:
    """Figures of one pair, by solid angle; NaN for the bins that it is not of.

    Mean absolute ``error`` of √(inverse depth × baseline); shares within a factor of 1.25 (``delta_25``) and 1.05; the
    same by relative baseline (``error_wide``, …) and of meshes (``error_mesh``, …); ``brier``, the mean of
    (confidence − (within a factor of 1.1))².
    """
    target, known = batch.sqrt_inv_depth.nan_to_num(), torch.isfinite(batch.sqrt_inv_depth)
    area = polar_weights(target) * known
    estimate = prediction.estimate.clamp(min=0.0)
    ratio = (torch.maximum(estimate, target) / torch.minimum(estimate, target).clamp(min=1e-6)).square()
    judged = area * (target > MIN_JUDGED)

    def within(factor: float) -> float:
        return float(_weighted_mean((ratio < factor).float(), judged))

    figures = {
        "error": float(_weighted_mean(signed_error(prediction.estimate, target).abs(), area)),
        "delta_25": within(1.25),
        "delta_5": within(1.05),
    }
    scores = dict(figures)
    own = {baseline_bin(float(batch.ratio[0]))} | ({"mesh"} if bool(batch.is_mesh[0]) else set())
    for group in (*BASELINE_BINS, "mesh"):
        scores |= {f"{name}_{group}": value if group in own else math.nan for name, value in figures.items()}
    right = (ratio < 1.1).float()
    scores["brier"] = float(_weighted_mean((prediction.confidence() - right).square(), judged))
    return scores
