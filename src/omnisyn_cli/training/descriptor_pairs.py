"""What the descriptor network is shown, taught and judged by.

Both views of a pair are rectified as matching does it. For pixels that both see, drawn by solid angle, the distances to
all rows of their column in the other view are log-likelihoods of a match, of which the true row is taught.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from omnisyn_cli.geometry.sampling import rotated_directions, sample_nearest
from omnisyn_cli.stereo.disparity import DisparityMap, left_right_check
from omnisyn_cli.stereo.rectify import RectifiedPair, rectify
from omnisyn_cli.training import data
from omnisyn_cli.training.data import Array, Augmentation, Walk
from omnisyn_cli.training.guided_depth import choose_views
from omnisyn_cli.types import View

SAMPLES = 24  # pixels of a column that are compared
SHOWN_SHARE = 2  # one of so many columns of the panorama is shown at a time
SEEN_ROWS = 1.0, 2.0  # by which true disparities of both views may differ where both see a surface: far and near
RIGHT_ROWS = 1.5  # distance from the true row up to which a match is right
OUTLIERS = 0.05  # share of the pixels that may match anywhere
SHARP_WEIGHT, MAX_SHARP = 0.2, 8.0  # of the log-loss of the very row, and its limit for a pixel


@dataclass(frozen=True)
class DescriptorBatch:
    """Parts of rectified pairs, as tensors; one of them, without the first axis, as arrays."""

    first: Float[Array, "*batch 3 height width"]  # colours in [0, 1]
    second: Float[Array, "*batch 3 height width"]
    rows: Int[Array, "*batch cols samples"]  # of pixels of the first, in rows of descriptors, by column
    targets: Float[Array, "*batch cols samples"]  # rows where the second shows them; NaN where it does not


def draw_descriptors(
    pool: list[Path], rng: np.random.Generator, pairs: int, size: tuple[int, int], augmentation: Augmentation | None
) -> DescriptorBatch:
    """Random pairs of random walks; ``size`` of the panoramas is a fraction of the pool's, else InputError."""
    walks = (data.draw_walk(pool, rng, size[0]) for _ in range(pairs))
    return data.stacked([_pair(walk, rng, size, augmentation) for walk in walks])


def _pair(
    walk: Walk, rng: np.random.Generator, size: tuple[int, int], augmentation: Augmentation | None
) -> DescriptorBatch:
    (first, second, _), known = choose_views(walk, rng), data.walk_views(walk)
    views = [known[first], known[second]]
    if augmentation is not None:
        colours = data.vary_colours(np.stack([view.image for view in views]), rng, augmentation)
        views = [replace(view, image=image) for view, image in zip(views, colours, strict=True)]
    fine = rectify(views[0], views[1], size)
    pair = fine.resized((size[0] // 2, size[1] // 2))
    truth = _true_disparity(pair, views[0]), _true_disparity(pair.reversed(), views[1])
    seen = np.where(left_right_check(truth, *SEEN_ROWS)[0].valid, truth[0].disparity, np.nan)
    shown, turn = seen.shape[1] // SHOWN_SHARE, int(rng.integers(seen.shape[1]))
    mirror = -1 if rng.random() < 0.5 else 1
    seen = np.roll(seen, turn, axis=1)[:, :shown][:, ::mirror]
    shown_first, shown_second = (
        np.roll(image, 2 * turn, axis=1)[:, : 2 * shown][:, ::mirror].transpose(2, 0, 1).astype(np.float32)
        for image in (fine.first, fine.second)
    )
    weight = np.where(np.isfinite(seen), np.sin(pair.grid.polar_angle), 1e-9).cumsum(axis=0)
    rows = (weight[None] < weight[-1] * rng.random((SAMPLES, 1, shown))).sum(axis=1)
    targets = rows + np.take_along_axis(seen, rows, axis=0)
    return DescriptorBatch(shown_first, shown_second, rows.T.astype(np.int64), targets.T.astype(np.float32))


def _true_disparity(pair: RectifiedPair, view: View) -> DisparityMap:
    """Of the first image of a pair; not valid where the depth of its view is not known."""
    if view.known_depth is None:
        raise ValueError("expected a view with its depth, got one without")
    directions = rotated_directions(pair.size, view.pose.rotation, pair.world_from_frame)
    inverse_depth = sample_nearest(view.known_depth.inverse_depth, directions) * pair.baseline
    return DisparityMap(pair.grid.disparity(np.nan_to_num(inverse_depth)), np.isfinite(inverse_depth))


def log_likelihoods(
    answer: tuple[Tensor, Tensor], batch: DescriptorBatch
) -> tuple[Float[Tensor, "batch cols samples rows"], Float[Tensor, "batch cols samples rows"]]:
    """Of a match of each pixel with every row of its column, and how far these are from the true row.

    No depth leads up, so rows above the pixel are ruled out.
    """
    own, other = (each.float().permute(0, 3, 2, 1) for each in answer)  # a column's descriptors side by side
    index = batch.rows[..., None].expand(-1, -1, -1, own.shape[-1])
    own = own.gather(2, index)
    products = own @ other.transpose(2, 3)
    distance = own.square().sum(-1)[..., None] + other.square().sum(-1)[:, :, None] - 2.0 * products
    row = torch.arange(other.shape[2], device=own.device)
    is_behind = row < batch.rows[..., None] - 2
    likelihood = torch.log_softmax((-distance).masked_fill(is_behind, -1e4), dim=-1)
    return likelihood, (row - batch.targets.nan_to_num()[..., None]).abs()


def descriptor_loss(answer: tuple[Tensor, Tensor], batch: DescriptorBatch) -> Tensor:
    """Mean of −log of the probability near the true row, with outliers; and of the log-loss of the very row."""
    likelihood, away = log_likelihoods(answer, batch)
    near = (likelihood.exp() * (away < RIGHT_ROWS)).sum(-1)
    loss = -torch.log((1.0 - OUTLIERS) * near + OUTLIERS / away.shape[-1])
    sharp = -((1.0 - away).clamp(min=0.0) * likelihood).sum(-1)
    return _mean_of_known(loss + SHARP_WEIGHT * sharp.clamp(max=MAX_SHARP), batch)


@torch.no_grad()
def descriptor_scores(answer: tuple[Tensor, Tensor], batch: DescriptorBatch) -> dict[str, float]:
    """``right``: the share of pixels whose best match, each chosen alone, lies at the true row or next to it."""
    likelihood, away = log_likelihoods(answer, batch)
    found = away.gather(-1, likelihood.argmax(-1, keepdim=True))[..., 0]
    return {"right": float(_mean_of_known((found <= RIGHT_ROWS).float(), batch))}


def _mean_of_known(values: Tensor, batch: DescriptorBatch) -> Tensor:
    known = torch.isfinite(batch.targets)
    return (values * known).sum() / known.sum().clamp(min=1)
