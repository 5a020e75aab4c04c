"""Pairs of walks for the paper's depth network, and with the view between for depth and fusion together.

All is held in the forward frame of the pair. Three views of a walk lie on one line; the outer ones are the pair, the
inner one is the truth. The depth network sees the pair as two cameras might have photographed it; what is rendered from
are the colours as they are, so that the fused picture can be compared with the truth at all.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.geometry.resize import resize_area
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.geometry.sweep import forward_frame, swap_cameras_in_forward_frame
from omnisyn_cli.training import data
from omnisyn_cli.training.data import Array, Augmentation, Walk

MAX_SURFACE_STEP = 0.05  # Relative difference of interpolated and nearest depth up to which both are of one surface


@dataclass(frozen=True)
class Batch:
    """Pairs for one step, as tensors; one of them, without the first axis, as arrays."""

    first: Float[Array, "*batch 3 height width"]  # colours in [0, 1] for the depth network
    second: Float[Array, "*batch 3 height width"]
    sqrt_inv_depth: Float[Array, "*batch 1 height width"]  # √(inverse depth × baseline) of the first; NaN: not known
    baseline: Float[Array, "*batch"]  # metres


@dataclass(frozen=True)
class Triples(Batch):
    """Pairs with the view between; everything has one size."""

    first_texture: Float[Array, "*batch 3 height width"]  # colours of the pair as they are shown
    second_texture: Float[Array, "*batch 3 height width"]
    second_sqrt_inv_depth: Float[Array, "*batch 1 height width"]  # of the second, with swapped cameras
    middle: Float[Array, "*batch 3 height width"]  # the view between
    position: Float[Array, "*batch"]  # of the way from the first to the second that it was taken at

    @property
    def sqrt_inv_depths(self) -> Float[Tensor, "2 batch 1 height width"]:
        """Of the first, and of the second with swapped cameras."""
        return torch.stack([self.sqrt_inv_depth, self.second_sqrt_inv_depth])


Drawn = TypeVar("Drawn", bound=Batch)


def swap_cameras(x: Float[Tensor, "*batch height width"]) -> Float[Tensor, "*batch height width"]:
    """:func:`omnisyn_cli.geometry.sweep.swap_cameras_in_forward_frame` of tensors, by their last axis."""
    return x.roll(x.shape[-1] // 2, -1)


def draw_pairs(
    kind: type[Drawn], pool: list[Path], rng: np.random.Generator, batch: int, size: tuple[int, int],
    augmentation: Augmentation | None = None, max_sqrt_inv_depth: float = 2.0,
) -> Drawn:  # fmt: skip
    """Random pairs of random walks, :class:`Triples` with the view between; from either end and mirrored at random.

    The height of ``size`` (maybe square) divides the pool's, and a walk has two or three views, else InputError.
    Targets are clipped to ``max_sqrt_inv_depth``.
    """
    views = 3 if kind is Triples else 2
    walks = (data.draw_walk(pool, rng, size[0], views) for _ in range(batch))
    return data.stacked([kind(**_pair(walk, views, rng, size, augmentation, max_sqrt_inv_depth)) for walk in walks])


def _pair(
    walk: Walk, views: int, rng: np.random.Generator, size: tuple[int, int], augmentation: Augmentation | None,
    most: float,
) -> dict[str, Any]:  # fmt: skip
    """The fields of :class:`Batch`, and of three views those of :class:`Triples`."""
    images, inverse_depths, positions = _ordered_views(walk, views, rng)
    first, last = (Pose(np.eye(3), position) for position in positions[[0, -1]])
    frame, _, baseline = forward_frame(first, last)
    colours, whole = images.astype(np.float32) / np.float32(255.0), (size[0], 2 * size[0])
    if augmentation is not None:
        colours = data.relit(colours, rng, augmentation, (3,))
    shown = textures = np.stack([resize_area(image, whole) for image in colours[[0, -1]]])
    if augmentation is not None:
        shown = data.vary_colours(textures, rng, replace(augmentation, exposure=0.0, gamma=0.0))
    depths = [
        turned_depth(np.sqrt(data.at_block_centres(each, whole) * baseline).clip(max=most), frame.rotation, size)
        for each in inverse_depths[[0, -1]]
    ]
    table = turned_table(whole, frame.rotation)
    pair = {
        "first": turned_image(shown[0], table, size),
        "second": turned_image(shown[1], table, size),
        "sqrt_inv_depth": depths[0][None],
        "baseline": np.float32(baseline),
    }
    if views == 2:
        return pair
    return pair | {
        "first_texture": turned_image(textures[0], table, size),
        "second_texture": turned_image(textures[1], table, size),
        "second_sqrt_inv_depth": swap_cameras_in_forward_frame(depths[1])[None],
        "middle": turned_image(colours[1], turned_table(colours.shape[1:3], frame.rotation), size),
        "position": np.float32(np.linalg.norm(positions[1] - positions[0]) / baseline),
    }


def _ordered_views(walk: Walk, views: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Images, inverse depths and places of some views, in order from either end, mirrored or not."""
    chosen = np.sort(rng.choice(len(walk.positions), views, replace=False))
    if rng.random() < 0.5:
        chosen = chosen[::-1]
    images, inverse_depths, positions = walk.images[chosen], walk.inverse_depth[chosen], walk.positions[chosen]
    if rng.random() < 0.5:
        return images[:, :, ::-1], inverse_depths[:, :, ::-1], positions * [-1.0, 1.0, 1.0]
    return images, inverse_depths, positions.astype(np.float64)


def turned_table(size: tuple[int, ...], rotation: np.ndarray, source: tuple[int, ...] | None = None) -> RemapTable:
    """Where a panorama, of a size ``source`` or of the same, shows what a turned camera sees in its pixels."""
    return RemapTable.for_directions(pixel_directions(size[0], size[1]) @ rotation.T, source or size)


def turned_image(
    image: Float32[np.ndarray, "rows cols 3"], table: RemapTable, size: tuple[int, int]
) -> Float32[np.ndarray, "3 height width"]:
    """A panorama as a turned camera sees it, channels first: by cubic weights at its own size, then reduced."""
    return resize_area(np.clip(table.bicubic(image), 0.0, 1.0), size).transpose(2, 0, 1)


def turned_depth(
    sqrt_inv_depth: Float32[np.ndarray, "rows cols"], rotation: Float[np.ndarray, "3 3"], size: tuple[int, int]
) -> Float32[np.ndarray, "height width"]:
    """√(inverse depth × baseline) as a turned camera sees it: linear on surfaces, not across edges; NaN stays NaN."""
    table = turned_table(size, rotation, sqrt_inv_depth.shape)
    source = np.ascontiguousarray(sqrt_inv_depth, np.float32)
    smooth, nearest = table.bilinear(source), table.nearest(source)
    return np.where(np.abs(smooth - nearest) <= MAX_SURFACE_STEP * nearest, smooth, nearest)
