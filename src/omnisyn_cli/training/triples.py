"""Training data for depth and fusion together: two panoramas, their depth, and what is to be seen between them.

Three views of a scene of a pool (see :mod:`omnisyn_cli.training.data`) lie on one line; the outer ones are the pair,
the inner one is the truth. The depth network sees the pair as two cameras might have photographed it; what is rendered
from are the colours as they are, so that the fused picture can be compared with the truth at all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from omnisyn_cli.errors import InputError
from omnisyn_cli.networks.joint import exchanged_panoramas
from omnisyn_cli.training.data import (
    Augmentation,
    PoolScene,
    at_block_centres,
    check_pool_size,
    load_scene,
    vary_colours,
)
from omnisyn_cli.training.frames import turned_colours, turned_roots

__all__ = ["Triples", "draw_triples"]

LEAST_VIEWS = 3


@dataclass(frozen=True)
class Triples:
    """Pairs for one step, with the view between; everything has one size.

    Attributes:
        first, second: ``(batch, 3, height, width)`` colours in [0, 1] for the depth network, in its frame.
        first_texture, second_texture: the same as they are shown.
        roots: ``(2, batch, 1, height, width)`` square roots of inverse depth × baseline of the first, and of the second
            as it looks with the roles of both exchanged; NaN where the truth is not known.
        middle: ``(batch, 3, height, width)`` the view between, always in the forward frame.
        share: ``(batch,)`` of the way from the first to the second that it was taken at.
        baseline: ``(batch,)`` metres.
    """

    first: Float[Tensor, "batch 3 height width"]
    second: Float[Tensor, "batch 3 height width"]
    first_texture: Float[Tensor, "batch 3 height width"]
    second_texture: Float[Tensor, "batch 3 height width"]
    roots: Float[Tensor, "2 batch 1 height width"]
    middle: Float[Tensor, "batch 3 height width"]
    share: Float[Tensor, " batch"]
    baseline: Float[Tensor, " batch"]

    def to(self, device: torch.device) -> Triples:
        """The same on another device."""
        return replace(self, **{name: value.to(device) for name, value in vars(self).items()})


def draw_triples(
    pool: list[Path],
    rng: np.random.Generator,
    batch: int,
    size: tuple[int, int],
    frame: str,
    augmentation: Augmentation | None = None,
    greatest_root: float = 2.0,
) -> Triples:
    """Random threes of views of random scenes; read from either end and mirrored at random.

    Args:
        pool: files of scenes.
        rng: decides everything.
        batch: how many.
        size: of the depth network's images, of the renderings and of the truth; its height divides the pool's.
        frame: of the depth network, ``epipole`` or ``forward``.
        augmentation: of colours; None leaves them as they are.
        greatest_root: of the true roots.

    Raises:
        InputError: a scene has fewer than three views, or the pool's size is not a multiple of ``size``.
    """
    whole = (size[0], 2 * size[0])
    drawn = [_draw(pool[rng.integers(len(pool))], rng, whole, augmentation) for _ in range(batch)]
    inputs, textures, roots = (np.stack(column, axis=1) for column in zip(*(one.pair for one in drawn), strict=True))
    images = [_tensor(views) for views in (*inputs, *textures)]
    roots = roots.clip(max=greatest_root)
    if frame == "forward":
        images = [turned_colours(image, whole, size) for image in images]
        roots = np.stack([[turned_roots(root, size) for root in one] for one in roots])
    root = torch.from_numpy(roots).unsqueeze(2)
    middle = _tensor(np.stack([one.middle for one in drawn]))
    first, second, first_texture, second_texture = images
    return Triples(
        first, second, first_texture, second_texture,
        roots=torch.stack([root[0], exchanged_panoramas(root[1], frame)]),
        middle=turned_colours(middle, (middle.shape[-2], middle.shape[-1]), size),
        share=torch.tensor([one.share for one in drawn]),
        baseline=torch.tensor([one.baseline for one in drawn]),
    )  # fmt: skip


@dataclass(frozen=True)
class _Drawn:
    """Three views in the epipole frame.

    Attributes:
        pair: colours of the outer ones for the network, colours as they are, roots; each of both.
        middle: colours of the inner one, at the size of the pool.
        share: of the way.
        baseline: metres.
    """

    pair: tuple[np.ndarray, np.ndarray, np.ndarray]
    middle: np.ndarray
    share: float
    baseline: float


def _draw(path: Path, rng: np.random.Generator, size: tuple[int, int], augmentation: Augmentation | None) -> _Drawn:
    scene = load_scene(path)
    check_pool_size(scene, size)
    if len(scene.along) < LEAST_VIEWS:
        raise InputError(
            f"expected scenes of at least {LEAST_VIEWS} views, got {len(scene.along)} in {path}; "
            "make them with `omnisyn train pool`"
        )
    chosen = np.sort(rng.choice(len(scene.along), LEAST_VIEWS, replace=False))
    views, inverse_depths, along = _read(scene, chosen, rng)
    colours = views.astype(np.float32) / np.float32(255.0)
    if augmentation is not None:
        colours = _lit(colours, rng, augmentation)
    outer = textures = np.stack([_reduced(image, size) for image in colours[[0, -1]]])
    if augmentation is not None:
        outer = vary_colours(textures, rng, replace(augmentation, exposure=0.0, gamma=0.0))
    baseline = abs(float(along[-1] - along[0]))
    rho = np.stack([at_block_centres(one, size) for one in inverse_depths[[0, -1]]])
    root = np.sqrt(rho * baseline).astype(np.float32)
    return _Drawn((outer, textures, root), colours[1], abs(float(along[1] - along[0])) / baseline, baseline)


def _read(scene: PoolScene, chosen: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Views, inverse depths and places of a way, walked in either direction and mirrored at random."""
    views, inverse_depths, along = scene.images[chosen], scene.inverse_depth[chosen], scene.along[chosen]
    if rng.random() < 0.5:  # from the other end: the frame turned by 180° about the azimuth of the ground
        views, inverse_depths, along = views[::-1, ::-1, ::-1], inverse_depths[::-1, ::-1, ::-1], along[::-1]
    if rng.random() < 0.5:
        views, inverse_depths = views[:, :, ::-1], inverse_depths[:, :, ::-1]
    return views, inverse_depths, along


def _lit(
    views: Float32[np.ndarray, "views height width 3"], rng: np.random.Generator, augmentation: Augmentation
) -> Float32[np.ndarray, "views height width 3"]:
    """Another light, the same for all views."""
    gain = (1 + augmentation.exposure * rng.uniform(-1, 1)) * (1 + augmentation.relative * rng.uniform(-1, 1, 3))
    gamma = np.float32(1 + augmentation.gamma * rng.uniform(-1, 1))
    return np.asarray(np.clip(views * gain.astype(np.float32), 1e-4, 1.0) ** gamma, np.float32)


def _reduced(image: Float32[np.ndarray, "rows cols 3"], size: tuple[int, int]) -> Float32[np.ndarray, "height width 3"]:
    """Means over blocks."""
    if image.shape[:2] == size:
        return image
    return np.asarray(cv2.resize(np.ascontiguousarray(image), size[::-1], interpolation=cv2.INTER_AREA))


def _tensor(images: Float32[np.ndarray, "batch height width 3"]) -> Float32[Tensor, "batch 3 height width"]:
    return torch.from_numpy(np.ascontiguousarray(images)).permute(0, 3, 1, 2).contiguous()
