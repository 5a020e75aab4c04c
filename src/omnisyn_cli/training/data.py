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

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float32, Shaped, UInt8
from torch import Tensor

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.sampling import add_border
from omnisyn_cli.geometry.sphere import direction_tables
from omnisyn_cli.io.outputs import write_errors

REQUIRED_ARRAYS = {"pool": "along", "recipe": "positions", "evidence": "sqrt_inv_depth_0", "fusion-pool": "truth_0"}
"""By the command that makes a kind of pool, an array that only its files have."""

WINDOW_DIVISOR = 4
"""Windows have this fraction of the columns of a sample: most pixels teach nothing, and steps get shorter."""

MIN_RELEVANCE = 1e-3
"""Relevance of a column without any, so that windows are drawn there as well, now and then."""

MAX_SURFACE_STEP = 0.1
"""Relative difference of inverse depth between neighbouring pixels of one surface."""

LEVEL_UP = np.array([0.0, 0.0, 1.0], np.float32)
"""Up in the epipole frame of a level line: the seam."""


@dataclass(frozen=True)
class TrainingScene:
    """Views of one scene along a line, see the module's docstring."""

    images: UInt8[np.ndarray, "views height width 3"]
    inverse_depth: Float[np.ndarray, "views height width"]
    along: Float[np.ndarray, " views"]
    up: Float[np.ndarray, " 3"] = field(default_factory=lambda: LEVEL_UP)


@dataclass(frozen=True)
class Batch:
    """Pairs for one step.

    Attributes:
        first, second: ``(batch, 3, height, width)`` colours in [0, 1] in the epipole frame of each pair.
        sqrt_inv_depth: ``(batch, 1, height, width)`` √(inverse depth × baseline) of the first.
        baseline: ``(batch,)`` metres.
    """

    first: Float[Tensor, "batch 3 height width"]
    second: Float[Tensor, "batch 3 height width"]
    sqrt_inv_depth: Float[Tensor, "batch 1 height width"]
    baseline: Float[Tensor, " batch"]

    @property
    def inputs(self) -> tuple[Tensor, ...]:
        """What a network sees."""
        return self.first, self.second


@dataclass(frozen=True)
class FeatureBatch:
    """Stereo features of panoramas and the truth.

    Attributes:
        channels: ``(batch, channels, height, width)``, see
            :func:`omnisyn_cli.stereo.stereo_features.completion_channels`.
        sqrt_inv_depth: ``(batch, 1, height, width)`` true √(inverse depth × baseline); NaN where it is not known.
        baseline: ``(batch,)`` metres.
    """

    channels: Float[Tensor, "batch channels height width"]
    sqrt_inv_depth: Float[Tensor, "batch 1 height width"]
    baseline: Float[Tensor, " batch"]

    @property
    def inputs(self) -> tuple[Tensor, ...]:
        """What a network sees."""
        return (self.channels,)


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


def save_scene(path: Path, scene: TrainingScene) -> None:
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

    Raises WriteError: the disk is full, or the folder went away.
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


def save_samples(path: Path, samples: Sequence[Any]) -> None:
    """Write dataclasses of arrays and numbers; the file has a ``NAME_k`` for every field of the one at ``k``.

    Arrays are in half precision.
    """
    arrays = {
        f"{name}_{k}": np.asarray(value, np.float16 if np.ndim(value) else np.float32)
        for k, sample in enumerate(samples)
        for name, value in vars(sample).items()
    }
    save_arrays(path, arrays)


def load_samples(
    path: Path, kind: type[Any], which: int | None = None, dtype: type[np.floating] = np.float32
) -> list[Any]:
    """All samples of a file, or the one at ``which``, counted on beyond the last from the first again."""
    names = [entry.name for entry in fields(kind)]
    with np.load(path) as file:
        count = len(file.files) // len(names)
        return [
            kind(*(file[f"{name}_{k}"].astype(dtype, copy=False) for name in names))
            for k in (range(count) if which is None else (which % count,))
        ]


def stack_fields(samples: Sequence[Any]) -> list[Tensor]:
    """Each field of all samples, as tensors."""
    columns = zip(*(vars(sample).values() for sample in samples), strict=True)
    return [torch.from_numpy(np.stack(column)) for column in columns]


def window_columns(relevance: Shaped[np.ndarray, "height width"], rng: np.random.Generator) -> np.ndarray:
    """A quarter of the columns side by side, across the seam or not, where there is much of what matters."""
    height, width = relevance.shape
    columns = direction_tables(height, width)[0] @ relevance + MIN_RELEVANCE
    sums = np.concatenate([[0.0], np.cumsum(np.concatenate([columns, columns]), dtype=np.float64)])
    inside = sums[width // WINDOW_DIVISOR :][:width] - sums[:width]
    begin = int(rng.choice(width, p=inside / inside.sum()))
    return np.asarray((begin + np.arange(width // WINDOW_DIVISOR)) % width)


def load_scene(path: Path) -> TrainingScene:
    """Read one file of a pool."""
    with np.load(path) as file:
        up = file.get("up", LEVEL_UP)
        return TrainingScene(file["images"], file["inverse_depth"].astype(np.float32), file["along"], up)


def list_scene_files(folder: Path, *makers: str) -> list[Path]:
    """All scenes of a pool in a fixed order.

    Args:
        folder: of the pool.
        makers: commands that such pools are made by, of :data:`REQUIRED_ARRAYS`; `pool` unless said otherwise.

    Raises InputError: there are none, or of another kind.
    """
    paths = sorted(folder.glob("*.npz"))
    makers = makers or ("pool",)
    command = " or ".join(f"`omnisyn train {maker}`" for maker in makers)
    if not paths:
        raise InputError(f"expected a pool of training scenes in {folder}, found no .npz; make one with {command}")
    if not any(is_made_by(maker, paths[0]) for maker in makers):
        raise InputError(
            f"expected scenes made by {command} in {folder}, got scenes for another network; name its pool"
        )
    return paths


def is_made_by(maker: str, path: Path) -> bool:
    """Whether a scene is of the pools that a command makes, one of :data:`REQUIRED_ARRAYS`.

    Raises InputError: the file is damaged.
    """
    try:
        with np.load(path) as file:
            return REQUIRED_ARRAYS[maker] in file
    except (OSError, ValueError, EOFError, BadZipFile) as error:
        raise InputError(f"expected a scene in {path}, got '{error!s:.80}'; delete the file") from error


def check_height(pool: list[Path], multiple: int) -> None:
    """Refuse a pool of renderings, which are learned from at the size they have.

    Args:
        pool: from :func:`list_scene_files`; all scenes of a pool have one size.
        multiple: that the height has to be of.

    Raises InputError: it is not.
    """
    with np.load(pool[0]) as file:
        height = file["channels_0"].shape[-2]
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
    max_sqrt_inv_depth: float = 2.0,
) -> Batch:
    """Random pairs of random scenes at ``size`` (a whole fraction of the pool's size).

    Without an augmentation the colours stay as they are; pairs are still read from either end and mirrored at random.

    Raises InputError: the pool's size is not a multiple of ``size``.
    """
    pairs = [_draw_pair(load_scene(pool[rng.integers(len(pool))]), rng, size, augmentation) for _ in range(batch)]
    colours, inverse_depth, baseline = (np.stack(column) for column in zip(*pairs, strict=True))
    sqrt_inv_depth = np.sqrt(inverse_depth * baseline[:, None, None]).clip(max=max_sqrt_inv_depth)
    return Batch(
        first=as_tensor(colours[:, 0]),
        second=as_tensor(colours[:, 1]),
        sqrt_inv_depth=torch.from_numpy(sqrt_inv_depth.astype(np.float32)).unsqueeze(1),
        baseline=torch.from_numpy(baseline),
    )


def _draw_pair(
    scene: TrainingScene, rng: np.random.Generator, size: tuple[int, int], augmentation: Augmentation | None
) -> tuple[np.ndarray, np.ndarray, np.float32]:
    """Colours of both, inverse depth of the first, metres."""
    check_scene_size(scene, size)
    images, inverse_depths, along = draw_ordered_views(scene, 2, rng)
    colours = np.stack([reduced(image, size).astype(np.float32) for image in images]) / np.float32(255.0)
    if augmentation is not None:
        colours = vary_colours(colours, rng, augmentation)
    return colours, at_block_centres(inverse_depths[0], size), np.float32(abs(along[1] - along[0]))


def draw_ordered_views(
    scene: TrainingScene, views: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Images, inverse depths and places of some views, in order from either end, mirrored or not."""
    chosen = np.sort(rng.choice(len(scene.along), views, replace=False))
    images, inverse_depths, along = scene.images[chosen], scene.inverse_depth[chosen], scene.along[chosen]
    if rng.random() < 0.5:  # from the other end: the frame turned by 180° about the azimuth of the ground
        images, inverse_depths, along = images[::-1, ::-1, ::-1], inverse_depths[::-1, ::-1, ::-1], along[::-1]
    if rng.random() < 0.5:
        images, inverse_depths = images[:, :, ::-1], inverse_depths[:, :, ::-1]
    return images, inverse_depths, along


def check_scene_size(scene: TrainingScene, size: tuple[int, int]) -> None:
    """InputError unless views are a whole multiple of ``size``."""
    rows = scene.images.shape[1]
    if rows % size[0]:
        raise InputError(f"expected a pool of a multiple of {size[0]} rows, got {rows}; render another")


def reduced(image: Shaped[np.ndarray, "rows cols 3"], size: tuple[int, int]) -> Shaped[np.ndarray, "height width 3"]:
    """Means over blocks."""
    if image.shape[:2] == size:
        return image
    return np.asarray(cv2.resize(np.ascontiguousarray(image), size[::-1], interpolation=cv2.INTER_AREA))


def as_tensor(images: Float32[np.ndarray, "batch height width 3"]) -> Float32[Tensor, "batch 3 height width"]:
    """Colours first, as networks see them."""
    return torch.from_numpy(np.ascontiguousarray(images)).permute(0, 3, 1, 2).contiguous()


def at_block_centres(inverse_depth: Float[np.ndarray, "height width"], size: tuple[int, int]) -> np.ndarray:
    """Values at the centres of the blocks that :func:`reduced` averages over.

    The centre of an even block lies between four pixels: it has their mean if they are of one surface, else the
    nearest of them, because a mean of two surfaces lies on neither.
    """
    stride = inverse_depth.shape[0] // size[0]
    sides = ((stride - 1) // 2, stride // 2)
    around = np.stack([inverse_depth[row::stride, col::stride] for row in sides for col in sides])
    nearest = around.max(axis=0)
    one_surface = around.min(axis=0) >= (1.0 - MAX_SURFACE_STEP) * nearest
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
            image[:] = _blur(image, rng.uniform(0.4, 1.2))
    sigma = f32(a.noise * rng.random() ** 2)
    varied = np.clip(varied + sigma * rng.standard_normal(varied.shape, dtype=f32), 0.0, 1.0)
    for image in varied:
        if rng.random() < a.jpeg:
            image[:] = _compress_jpeg(image, int(rng.integers(40, 96)))
    return np.asarray(varied, dtype=f32)


def _blur(image: Float32[np.ndarray, "height width 3"], sigma: float) -> np.ndarray:
    reach = 4
    return np.asarray(cv2.GaussianBlur(add_border(image, reach), (0, 0), sigma))[reach:-reach, reach:-reach]


def _compress_jpeg(image: Float32[np.ndarray, "height width 3"], quality: int) -> np.ndarray:
    eight_bit = (image * 255.0 + 0.5).astype(np.uint8)
    _, data = cv2.imencode(".jpg", eight_bit, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.float32) / np.float32(255.0)
