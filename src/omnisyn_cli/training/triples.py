"""Training data for depth and fusion together: two panoramas, their depth, and what is to be seen between them.

Three views of a scene of a pool (see :mod:`omnisyn_cli.training.data`) lie on one line; the outer ones are the pair,
the inner one is the truth. The depth network sees the pair as two cameras might have photographed it; what is rendered
from are the colours as they are, so that the fused picture can be compared with the truth at all.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.training import data

EPIPOLE_FROM_FORWARD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""The same rotation for every pair: straight ahead becomes the zenith, up becomes the rear (the seam's middle)."""

MAX_SURFACE_STEP = 0.05
"""Relative difference of interpolated and nearest depth up to which both are of one surface."""


def swap_cameras(x: Float[Tensor, "*batch height width"]) -> Float[Tensor, "*batch height width"]:
    """Panoramas of the forward frame as they look with swapped cameras; its own inverse.

    See :func:`omnisyn_cli.geometry.sweep.swap_cameras_in_forward_frame`.
    """
    return x.roll(x.shape[-1] // 2, -1)


def draw_pairs(
    pool: list[Path], rng: np.random.Generator, batch: int, size: tuple[int, int],
    augmentation: data.Augmentation | None = None, max_sqrt_inv_depth: float = 2.0,
) -> data.Batch:  # fmt: skip
    """Random pairs in the forward frame, see :func:`omnisyn_cli.training.data.draw_batch`."""
    return forward_batch(
        data.draw_batch(pool, rng, batch, (size[0], 2 * size[0]), augmentation, max_sqrt_inv_depth), size
    )


def forward_batch(batch: data.Batch, size: tuple[int, int]) -> data.Batch:
    """A batch in the epipole frame, turned into the forward frame and taken to ``size``, which may be square.

    Colours are interpolated with cubic weights, depth linearly on surfaces and not at all across edges.
    """
    height = batch.first.shape[-2]
    first, second = (
        images_to_forward_frame(images, (height, 2 * height), size) for images in (batch.first, batch.second)
    )
    sqrt_inv_depth = np.stack(
        [depths_to_forward_frame(sqrt_inv_depth, size) for sqrt_inv_depth in batch.sqrt_inv_depth[:, 0].numpy()]
    )
    return replace(batch, first=first, second=second, sqrt_inv_depth=torch.from_numpy(sqrt_inv_depth).unsqueeze(1))


def images_to_forward_frame(
    images: Float32[Tensor, "batch 3 rows cols"], turned: tuple[int, int], size: tuple[int, int]
) -> Float32[Tensor, "batch 3 height width"]:
    """Panoramas of the epipole frame in the forward frame, by way of ``turned``, 1:2, reduced to ``size``."""
    made = []
    for image in images.permute(0, 2, 3, 1).numpy():
        sharp = np.clip(_forward(image.shape, turned).bicubic(image), 0.0, 1.0)
        made.append(sharp if size == turned else cv2.resize(sharp, size[::-1], interpolation=cv2.INTER_AREA))
    return torch.from_numpy(np.stack(made)).permute(0, 3, 1, 2).contiguous()


def depths_to_forward_frame(
    sqrt_inv_depth: Float32[np.ndarray, "rows cols"], size: tuple[int, int]
) -> Float32[np.ndarray, "height width"]:
    """Roots of the epipole frame in the forward frame, of ``size``; what is not known (NaN) stays so."""
    forward = _forward(sqrt_inv_depth.shape, size)
    smooth, nearest = forward.bilinear(sqrt_inv_depth), forward.nearest(sqrt_inv_depth)
    return np.where(
        np.abs(smooth - nearest) <= MAX_SURFACE_STEP * nearest, smooth, nearest
    )  # what is unknown stays unknown


@lru_cache(maxsize=4)
def _forward(source: tuple[int, ...], size: tuple[int, int]) -> RemapTable:
    """Where images of the epipole frame show what those of the forward frame show in their pixels."""
    return RemapTable.for_directions(pixel_directions(*size) @ EPIPOLE_FROM_FORWARD.T, source)


MIN_VIEWS = 3
"""Of a scene: the pair, and the view between."""


@dataclass(frozen=True)
class Triples:
    """Pairs for one step, with the view between; everything has one size.

    Attributes:
        first, second: ``(batch, 3, height, width)`` colours in [0, 1] for the depth network, in the forward frame.
        first_texture, second_texture: the same as they are shown.
        sqrt_inv_depths: ``(2, batch, 1, height, width)`` √(inverse depth × baseline) of the first, and of the second
            with swapped cameras; NaN where the truth is not known.
        middle: ``(batch, 3, height, width)`` the view between.
        position: ``(batch,)`` of the way from the first to the second that it was taken at.
        baseline: ``(batch,)`` metres.
    """

    first: Float[Tensor, "batch 3 height width"]
    second: Float[Tensor, "batch 3 height width"]
    first_texture: Float[Tensor, "batch 3 height width"]
    second_texture: Float[Tensor, "batch 3 height width"]
    sqrt_inv_depths: Float[Tensor, "2 batch 1 height width"]
    middle: Float[Tensor, "batch 3 height width"]
    position: Float[Tensor, " batch"]
    baseline: Float[Tensor, " batch"]


def draw_triples(
    pool: list[Path],
    rng: np.random.Generator,
    batch: int,
    size: tuple[int, int],
    augmentation: data.Augmentation | None = None,
    max_sqrt_inv_depth: float = 2.0,
) -> Triples:
    """Random threes of views of random scenes; read from either end and mirrored at random.

    Args:
        pool: files of scenes.
        rng: decides everything.
        batch: how many.
        size: of the depth network's images, of the renderings and of the truth; its height divides the pool's.
        augmentation: of colours; None leaves them as they are.
        max_sqrt_inv_depth: that targets are clipped to.

    Raises InputError: a scene has fewer than three views, or the pool's size is not a multiple of ``size``.
    """
    whole = (size[0], 2 * size[0])
    drawn = [_draw(pool[rng.integers(len(pool))], rng, whole, augmentation) for _ in range(batch)]
    outer, sqrt_inv_depths, middle, position, baseline = (np.stack(column) for column in zip(*drawn, strict=True))
    sqrt_inv_depths = sqrt_inv_depths.swapaxes(0, 1).clip(max=max_sqrt_inv_depth)
    sqrt_inv_depths = np.stack(
        [[depths_to_forward_frame(sqrt_inv_depth, size) for sqrt_inv_depth in one] for one in sqrt_inv_depths]
    )
    first, second, first_texture, second_texture = (
        images_to_forward_frame(data.as_tensor(outer[:, k]), whole, size) for k in range(outer.shape[1])
    )
    sqrt_inv_depth = torch.from_numpy(sqrt_inv_depths).unsqueeze(2)
    middle_view = data.as_tensor(middle)
    return Triples(
        first, second, first_texture, second_texture,
        sqrt_inv_depths=torch.stack([sqrt_inv_depth[0], swap_cameras(sqrt_inv_depth[1])]),
        middle=images_to_forward_frame(middle_view, (middle_view.shape[-2], middle_view.shape[-1]), size),
        position=torch.from_numpy(position.astype(np.float32)),
        baseline=torch.from_numpy(baseline.astype(np.float32)),
    )  # fmt: skip


def _draw(
    path: Path, rng: np.random.Generator, size: tuple[int, int], augmentation: data.Augmentation | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float, float]:
    """Of three views in the epipole frame.

    Colours of the outer ones for the network, then as they are; √(inverse depth × baseline) of both; colours of the
    inner one, at the size of the pool; its position; metres.
    """
    scene = data.load_scene(path)
    data.check_scene_size(scene, size)
    if len(scene.along) < MIN_VIEWS:
        raise InputError(
            f"expected scenes of at least {MIN_VIEWS} views, got {len(scene.along)} in {path}; "
            "make them with `omnisyn train pool`"
        )
    views, inverse_depths, along = data.draw_ordered_views(scene, MIN_VIEWS, rng)
    colours = views.astype(np.float32) / np.float32(255.0)
    if augmentation is not None:
        colours = _relight(colours, rng, augmentation)
    outer = textures = np.stack([data.reduced(image, size) for image in colours[[0, -1]]])
    if augmentation is not None:
        outer = data.vary_colours(textures, rng, replace(augmentation, exposure=0.0, gamma=0.0))
    baseline = abs(float(along[-1] - along[0]))
    rho = np.stack([data.at_block_centres(one, size) for one in inverse_depths[[0, -1]]])
    sqrt_inv_depth = np.sqrt(rho * baseline).astype(np.float32)
    return (
        np.concatenate([outer, textures]),
        sqrt_inv_depth,
        colours[1],
        abs(float(along[1] - along[0])) / baseline,
        baseline,
    )


def _relight(
    views: Float32[np.ndarray, "views height width 3"], rng: np.random.Generator, augmentation: data.Augmentation
) -> Float32[np.ndarray, "views height width 3"]:
    """Another light, the same for all views."""
    gain = (1 + augmentation.exposure * rng.uniform(-1, 1)) * (1 + augmentation.relative * rng.uniform(-1, 1, 3))
    gamma = np.float32(1 + augmentation.gamma * rng.uniform(-1, 1))
    return np.asarray(np.clip(views * gain.astype(np.float32), 1e-4, 1.0) ** gamma, np.float32)
