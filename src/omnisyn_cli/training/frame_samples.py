"""Training pairs in the frame of a network: pools have the other camera at the zenith, the paper straight ahead."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from omnisyn_cli.geometry.sampling import add_border
from omnisyn_cli.geometry.sphere import direction_to_pixel, pixel_directions
from omnisyn_cli.training.data import Augmentation, Batch, draw_batch

EPIPOLE_FROM_FORWARD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""The same rotation for every pair: straight ahead becomes the zenith, up becomes the rear (the seam's middle)."""

EDGE = 0.05
"""Where interpolation differs from the nearest pixel by more than this share, the nearest pixel is taken."""

BORDER = 3
"""Pixels from over the seam and the poles that interpolation may reach for."""


def exchanged_panoramas(x: Float[Tensor, "*batch height width"], frame: str) -> Float[Tensor, "*batch height width"]:
    """Panoramas of a frame as they look when the roles of both cameras are exchanged; its own inverse.

    See :func:`omnisyn_cli.geometry.sweep.exchanged_in_epipole_frame` and ``exchanged_in_forward_frame``.
    """
    return x.flip((-2, -1)) if frame == "epipole" else x.roll(x.shape[-1] // 2, -1)


def draw_pairs(
    pool: list[Path], rng: np.random.Generator, batch: int, size: tuple[int, int], frame: str,
    augmentation: Augmentation | None = None, greatest_root: float = 2.0,
) -> Batch:  # fmt: skip
    """Random pairs in a frame, see :func:`omnisyn_cli.training.data.draw_batch`."""
    drawn = draw_batch(pool, rng, batch, (size[0], 2 * size[0]), augmentation, greatest_root)
    return forward_batch(drawn, size) if frame == "forward" else drawn


def forward_batch(batch: Batch, size: tuple[int, int]) -> Batch:
    """A batch in the epipole frame, turned into the forward frame and taken to ``size``, which may be square.

    Colours are interpolated with cubic weights, roots linearly on surfaces and not at all across edges.
    """
    height = batch.first.shape[-2]
    first, second = (turned_colours(images, (height, 2 * height), size) for images in (batch.first, batch.second))
    root = np.stack([turned_roots(root, size) for root in batch.root[:, 0].numpy()])
    return replace(batch, first=first, second=second, root=torch.from_numpy(root).unsqueeze(1))


def turned_colours(
    images: Float32[Tensor, "batch 3 rows cols"], turned: tuple[int, int], size: tuple[int, int]
) -> Float32[Tensor, "batch 3 height width"]:
    """Panoramas of the epipole frame in the forward frame, by way of ``turned``, 1:2, reduced to ``size``."""
    made = []
    for image in images.permute(0, 2, 3, 1).numpy():
        sharp = np.clip(_remapped(image, turned, cv2.INTER_CUBIC), 0.0, 1.0)
        made.append(sharp if size == turned else cv2.resize(sharp, size[::-1], interpolation=cv2.INTER_AREA))
    return torch.from_numpy(np.stack(made)).permute(0, 3, 1, 2).contiguous()


def turned_roots(root: Float32[np.ndarray, "rows cols"], size: tuple[int, int]) -> Float32[np.ndarray, "height width"]:
    """Roots of the epipole frame in the forward frame, of ``size``; what is not known (NaN) stays so."""
    smooth, nearest = (_remapped(root, size, kind) for kind in (cv2.INTER_LINEAR, cv2.INTER_NEAREST))
    return np.where(np.abs(smooth - nearest) <= EDGE * nearest, smooth, nearest)  # what is unknown stays unknown


def _remapped(
    image: Float32[np.ndarray, "rows cols *channels"], size: tuple[int, int], interpolation: int
) -> np.ndarray:
    row_map, col_map = _maps((image.shape[0], image.shape[1]), size)
    return np.asarray(cv2.remap(add_border(image, BORDER), col_map, row_map, interpolation))


@lru_cache(maxsize=4)
def _maps(source: tuple[int, int], size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the bordered source that pixels of the turned image look at."""
    row, col = direction_to_pixel(pixel_directions(*size) @ EPIPOLE_FROM_FORWARD.T, source)
    return (row + BORDER).astype(np.float32), (col + BORDER).astype(np.float32)
