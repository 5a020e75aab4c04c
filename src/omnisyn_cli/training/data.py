"""Training data for the depth network: a pool of rendered scenes on disk, and batches drawn and varied from it.

A *pool* is a folder of ``NNNNNNNN.npz`` files, one per scene, each with a few views along one straight line, all in
the epipole frame of that line (row 0 looks along it):

* ``images`` ``(views, height, width, 3)`` uint8,
* ``inverse_depth`` ``(views, height, width)`` float16, 1/metre, 0 = nothing there,
* ``along`` ``(views,)`` float32, metres along the line, ascending,
* ``up`` ``(3,)`` float32, the world's up in that frame; files without it are of level lines.

Any two views are a stereo pair of some baseline; read from the other end (turned by 180°) they are another.
A batch depends on the seed, the step and the pool alone, so a run can stop and go on anywhere.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from zipfile import BadZipFile

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float32, UInt8
from torch import Tensor

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.border import add_border
from omnisyn_cli.io.paths import write_errors

__all__ = [
    "Augmentation",
    "Batch",
    "PoolScene",
    "check_height",
    "draw_batch",
    "list_pool",
    "load_scene",
    "save_arrays",
    "save_scene",
]

TELLTALES = {"pool": "images", "evidence": "root_0", "fusion-pool": "truth_0"}
"""By the command that makes pools of a kind, an array that only these have."""

ONE_SURFACE = 0.1
"""Relative difference of inverse depth between neighbouring pixels that still belong together."""

UP_OF_LEVEL_LINES = np.array([0.0, 0.0, 1.0], np.float32)
"""The seam of the epipole frame."""


@dataclass(frozen=True)
class PoolScene:
    """Views of one scene along a line, see the module's docstring."""

    images: UInt8[np.ndarray, "views height width 3"]
    inverse_depth: Float[np.ndarray, "views height width"]
    along: Float[np.ndarray, " views"]
    up: Float[np.ndarray, " 3"] = field(default_factory=lambda: UP_OF_LEVEL_LINES)


@dataclass(frozen=True)
class Batch:
    """Pairs for one step.

    Attributes:
        first, second: ``(batch, 3, height, width)`` colours in [0, 1] in the epipole frame of each pair.
        root: ``(batch, 1, height, width)`` square root of the first's inverse depth × baseline.
        baseline: ``(batch,)`` metres.
    """

    first: Float[Tensor, "batch 3 height width"]
    second: Float[Tensor, "batch 3 height width"]
    root: Float[Tensor, "batch 1 height width"]
    baseline: Float[Tensor, " batch"]


@dataclass(frozen=True)
class Augmentation:
    """How far the colours of a pair are varied; ranges are half widths around "unchanged".

    Attributes:
        exposure: common factor of both panoramas.
        relative: factor of one panorama and channel against the other (exposure and white balance).
        gamma: common exponent.
        noise: greatest standard deviation.
        blur: chance that one panorama is blurred.
        jpeg: chance that one panorama went through JPEG.
    """

    exposure: float = 0.35
    relative: float = 0.08
    gamma: float = 0.3
    noise: float = 0.025
    blur: float = 0.15
    jpeg: float = 0.3


def save_scene(path: Path, scene: PoolScene) -> None:
    """Write one file of a pool, see :func:`save_arrays`."""
    arrays = {
        "images": scene.images,
        "inverse_depth": scene.inverse_depth.astype(np.float16),
        "along": scene.along.astype(np.float32),
        "up": scene.up.astype(np.float32),
    }
    save_arrays(path, arrays)


def save_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays by name, whole or not at all; a kill leaves no partial file under the name.

    Raises:
        WriteError: the disk is full, or the folder went away.
    """
    partial = path.with_suffix(f".{os.getpid()}.partial")
    with write_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with partial.open("wb") as file:
                np.savez(file, **arrays)  # type: ignore[arg-type]
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)


def load_scene(path: Path) -> PoolScene:
    """Read one file of a pool."""
    with np.load(path) as file:
        up = file.get("up", UP_OF_LEVEL_LINES)
        return PoolScene(file["images"], file["inverse_depth"].astype(np.float32), file["along"], up)


def list_pool(folder: Path, maker: str = "pool") -> list[Path]:
    """All scenes of a pool in a fixed order.

    Args:
        folder: of the pool.
        maker: command that such pools are made by, one of :data:`TELLTALES`.

    Raises:
        InputError: there are none, or of another kind.
    """
    paths = sorted(folder.glob("*.npz"))
    command = f"`omnisyn train {maker}`"
    if not paths:
        raise InputError(f"expected a pool of training scenes in {folder}, found no .npz; make one with {command}")
    try:
        with np.load(paths[0]) as file:
            is_of_kind = TELLTALES[maker] in file
    except (OSError, ValueError, EOFError, BadZipFile) as error:
        raise InputError(f"expected a scene in {paths[0]}, got '{error!s:.80}'; delete the file") from error
    if not is_of_kind:
        raise InputError(
            f"expected scenes made by {command} in {folder}, got scenes for another network; name its pool"
        )
    return paths


def check_height(pool: list[Path], multiple: int) -> None:
    """Refuse a pool of evidence or of renderings, which are learned from at the size they have.

    Args:
        pool: from :func:`list_pool`; all scenes of a pool have one size.
        multiple: that the height has to be of.

    Raises:
        InputError: it is not.
    """
    with np.load(pool[0]) as file:
        height = file["planes_0"].shape[-2]
    if height % multiple:
        raise InputError(
            f"expected scenes whose height is a multiple of {multiple} in {pool[0].parent}, got {height}; make others "
            "(--height)"
        )


def draw_batch(
    pool: list[Path],
    rng: np.random.Generator,
    batch: int,
    size: tuple[int, int],
    augmentation: Augmentation | None = None,
    greatest_root: float = 2.0,
) -> Batch:
    """Random pairs of random scenes at ``size`` (a whole fraction of the pool's size).

    Without an augmentation the colours stay as they are; pairs are still read from either end and mirrored at random.

    Raises:
        InputError: the pool's size is not a multiple of ``size``.
    """
    pairs = [_draw_pair(load_scene(pool[rng.integers(len(pool))]), rng, size, augmentation) for _ in range(batch)]
    first, second, inverse_depth, baseline = (np.stack(column) for column in zip(*pairs, strict=True))
    root = np.sqrt(inverse_depth * baseline[:, None, None]).clip(max=greatest_root)
    return Batch(
        first=torch.from_numpy(first).permute(0, 3, 1, 2).contiguous(),
        second=torch.from_numpy(second).permute(0, 3, 1, 2).contiguous(),
        root=torch.from_numpy(root.astype(np.float32)).unsqueeze(1),
        baseline=torch.from_numpy(baseline),
    )


def _draw_pair(
    scene: PoolScene, rng: np.random.Generator, size: tuple[int, int], augmentation: Augmentation | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.float32]:
    check_pool_size(scene, size)
    near, far = sorted(rng.choice(len(scene.along), 2, replace=False))
    baseline = np.float32(scene.along[far] - scene.along[near])
    first, second, inverse_depth = scene.images[near], scene.images[far], scene.inverse_depth[near]
    if rng.random() < 0.5:  # from the other end: the frame turned by 180° about the azimuth of the ground
        first, second, inverse_depth = (x[::-1, ::-1] for x in (second, first, scene.inverse_depth[far]))
    if rng.random() < 0.5:
        first, second, inverse_depth = (x[:, ::-1] for x in (first, second, inverse_depth))
    colours = np.stack([_shrink(first, size), _shrink(second, size)])
    if augmentation is not None:
        colours = vary_colours(colours, rng, augmentation)
    return colours[0], colours[1], at_block_centres(inverse_depth, size), baseline


def check_pool_size(scene: PoolScene, size: tuple[int, int]) -> None:
    """InputError unless views are a whole multiple of ``size``."""
    rows = scene.images.shape[1]
    if rows % size[0]:
        raise InputError(f"expected a pool of a multiple of {size[0]} rows, got {rows}; render another")


def _shrink(image: UInt8[np.ndarray, "height width 3"], size: tuple[int, int]) -> Float32[np.ndarray, "h w 3"]:
    """Mean over blocks, in [0, 1]."""
    if image.shape[0] != size[0]:
        image = cv2.resize(np.ascontiguousarray(image), size[::-1], interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(image, dtype=np.float32) / np.float32(255.0)


def at_block_centres(inverse_depth: Float[np.ndarray, "height width"], size: tuple[int, int]) -> np.ndarray:
    """Values at the centres of the blocks that :func:`_shrink` averages over.

    The centre of an even block lies between four pixels: it has their mean if they are of one surface, else the
    nearest of them, because a mean of two surfaces lies on neither.
    """
    stride = inverse_depth.shape[0] // size[0]
    sides = ((stride - 1) // 2, stride // 2)
    around = np.stack([inverse_depth[row::stride, col::stride] for row in sides for col in sides])
    nearest = around.max(axis=0)
    one_surface = around.min(axis=0) >= (1.0 - ONE_SURFACE) * nearest
    return np.asarray(np.where(one_surface, around.mean(axis=0), nearest))


def vary_colours(
    colours: Float32[np.ndarray, "2 height width 3"], rng: np.random.Generator, augmentation: Augmentation
) -> Float32[np.ndarray, "2 height width 3"]:
    """What differs between photographs of the same place: light, white balance, gamma, focus, noise, compression."""
    a, f32 = augmentation, np.float32
    gain = (1 + a.exposure * rng.uniform(-1, 1)) * (1 + a.relative * rng.uniform(-1, 1, (2, 1, 1, 3)))
    varied = np.clip(colours * gain.astype(f32), 1e-4, 1.0) ** f32(1 + a.gamma * rng.uniform(-1, 1))
    for image in varied:
        if rng.random() < a.blur:
            image[:] = _blurred(image, rng.uniform(0.4, 1.2))
    sigma = f32(a.noise * rng.random() ** 2)
    varied = np.clip(varied + sigma * rng.standard_normal(varied.shape, dtype=f32), 0.0, 1.0)
    for image in varied:
        if rng.random() < a.jpeg:
            image[:] = _through_jpeg(image, int(rng.integers(40, 96)))
    return np.asarray(varied, dtype=f32)


def _blurred(image: Float32[np.ndarray, "height width 3"], sigma: float) -> np.ndarray:
    reach = 4
    return np.asarray(cv2.GaussianBlur(add_border(image, reach), (0, 0), sigma))[reach:-reach, reach:-reach]


def _through_jpeg(image: Float32[np.ndarray, "height width 3"], quality: int) -> np.ndarray:
    eight_bit = (image * 255.0 + 0.5).astype(np.uint8)
    _, data = cv2.imencode(".jpg", eight_bit, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.float32) / np.float32(255.0)
