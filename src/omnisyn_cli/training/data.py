"""Training data on disk, and what is done to pictures before networks see them.

A *pool* is a folder of ``NNNNNNNN.npz`` files, one per scene, with samples, dataclasses of arrays: ``NAME_k`` is a
field of the one at ``k``. Files of walks have one (:class:`Walk`), those for completion and fusion networks several. A
batch depends on the seed, the step and the pool alone, so a run can stop and go on anywhere.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar
from zipfile import BadZipFile

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float32, UInt8

from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.grouping import median_depth
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import add_border
from omnisyn_cli.io.outputs import make_folder, replaced_when_complete
from omnisyn_cli.types import DepthEstimate, View

Array = Any  # numpy.ndarray in a sample, torch.Tensor in a batch

Sample = TypeVar("Sample")

# By the command that makes a kind of pool, an array that only its files have.
REQUIRED_ARRAYS = {"pool": "positions_0", "evidence": "sqrt_inv_depth_0", "fusion-pool": "truth_0"}
BLUR_REACH = 4  # Pixels that a blurred panorama is continued by
MAX_SURFACE_STEP = 0.1  # Relative difference of inverse depth between neighbouring pixels of one surface


@dataclass(frozen=True)
class Walk:
    """Upright panoramas of one scene and heading along a line, any two a stereo pair; floats in half precision."""

    images: UInt8[np.ndarray, "views height width 3"]
    inverse_depth: Float[np.ndarray, "views height width"]  # 1/metre, 0 = nothing there, NaN = not known
    positions: Float32[np.ndarray, "views 3"]  # metres, y up, −z ahead, in the order of the line
    is_mesh: bool = False

    def baseline_ratios(self) -> Float[np.ndarray, "views views"]:
        """Distance of any two views over the median depth of the first one."""
        depths = np.array([median_depth(each.astype(np.float32)) for each in self.inverse_depth])
        distances = np.linalg.norm(self.positions[:, None] - self.positions[None], axis=-1)
        return np.asarray(distances / depths[:, None])


@dataclass(frozen=True)
class Augmentation:
    """How far the colours of a pair are varied; ranges are half widths around "unchanged"."""

    exposure: float = 0.35  # common factor of both panoramas
    relative: float = 0.08  # factor of one panorama and channel against the other (exposure and white balance)
    gamma: float = 0.3  # common exponent
    noise: float = 0.025  # greatest standard deviation
    blur: float = 0.15  # chance that one panorama is blurred
    jpeg: float = 0.3  # chance that one panorama went through JPEG


def save_samples(path: Path, samples: Sequence[Any]) -> None:
    """Write dataclasses of arrays and numbers, whole or not at all. WriteError: full; OutputPathError: no folder."""
    arrays = {f"{name}_{k}": value for k, sample in enumerate(samples) for name, value in vars(sample).items()}
    make_folder(path.parent, "a pool")
    with replaced_when_complete(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)


def load_samples(
    path: Path, kind: type[Sample], which: int | None = None, dtype: type[np.floating] = np.float32
) -> list[Sample]:
    """All samples of a file, or that at ``which``, counted on from the first; half precision becomes ``dtype``."""
    names = [entry.name for entry in fields(kind)]  # type: ignore[arg-type]
    with np.load(path) as file:
        count = [array.rpartition("_")[0] for array in file.files].count(names[0])
        arrays = [
            [file[f"{name}_{k}"] for name in names] for k in (range(count) if which is None else (which % count,))
        ]
    return [kind(*(x.astype(dtype) if x.dtype == np.float16 != dtype else x for x in sample)) for sample in arrays]


def load_walk(path: Path) -> Walk:
    """Read one file of a pool of walks."""
    (walk,) = load_samples(path, Walk)
    return walk


def draw_walk(pool: list[Path], rng: np.random.Generator, height: int = 1, least_views: int = 2) -> Walk:
    """A random walk; InputError: its rows are no multiple of ``height``, or it has fewer views."""
    path = pool[rng.integers(len(pool))]
    walk = load_walk(path)
    views, rows = walk.images.shape[:2]
    if rows % height:
        raise InputError(f"expected scenes of a multiple of {height} rows, got {rows} in {path}; make others")
    if views < least_views:
        raise InputError(
            f"expected scenes of at least {least_views} views, got {views} in {path}; make them with `omnisyn train "
            "pool`"
        )
    return walk


def walk_views(walk: Walk) -> list[View]:
    """The panoramas of a walk with their true depth, the first at the origin."""
    valid = np.ones(walk.inverse_depth.shape[1:], np.float32)
    return [
        View(
            image.astype(np.float32) / np.float32(255.0),
            Pose(np.eye(3), (position - walk.positions[0]).astype(np.float64)),
            known_depth=DepthEstimate(inverse_depth, valid),
        )
        for image, position, inverse_depth in zip(walk.images, walk.positions, walk.inverse_depth, strict=True)
    ]


def stacked(samples: Sequence[Sample]) -> Sample:
    """Dataclasses of arrays and numbers as one of tensors, with an axis more: a batch."""
    columns = zip(*(vars(sample).values() for sample in samples), strict=True)
    return type(samples[0])(*(torch.from_numpy(np.stack(column)) for column in columns))


def list_scene_files(folder: Path, maker: str = "pool") -> list[Path]:
    """All scenes of a pool that ``maker`` made, in order; InputError: none, of another kind, or the first damaged."""
    command, paths = f"`omnisyn train {maker}`", scene_files(folder)
    if not paths:
        raise InputError(f"expected a pool of training scenes in {folder}, found no .npz; make one with {command}")
    if not is_made_by(maker, paths[0]):
        raise InputError(
            f"expected scenes made by {command} in {folder}, got scenes for another network; name its pool"
        )
    return paths


def list_walks(folder: Path) -> list[Path]:
    """The files of a folder of walks, in order; none where it holds something else."""
    paths = scene_files(folder)
    return paths if paths and is_made_by("pool", paths[0]) else []


def scene_files(folder: Path) -> list[Path]:
    """In order, without those that are being written."""
    return sorted(folder.glob("[!.]*.npz"))


def is_made_by(maker: str, path: Path) -> bool:
    """Whether a scene is of the pools that a command makes, one of :data:`REQUIRED_ARRAYS`; InputError: damaged."""
    try:
        with np.load(path) as file:
            return REQUIRED_ARRAYS[maker] in file
    except (OSError, ValueError, EOFError, BadZipFile) as error:
        raise InputError(f"expected a scene in {path}, got '{error!s:.80}'; delete the file") from error


def check_height(pool: list[Path], multiple: int) -> None:
    """Refuse (InputError) a pool of renderings, which are learned from at the size they have, by its first scene."""
    with np.load(pool[0]) as file:
        height = file["channels_0"].shape[-2]
    if height % multiple:
        raise InputError(
            f"expected scenes whose height is a multiple of {multiple} in {pool[0].parent}, got {height}; make others "
            "(--height)"
        )


def at_block_centres(inverse_depth: Float[np.ndarray, "height width"], size: tuple[int, int]) -> np.ndarray:
    """Values at block centres: of an even block the mean of four pixels on one surface, else the nearest of them."""
    stride = inverse_depth.shape[0] // size[0]
    sides = ((stride - 1) // 2, stride // 2)
    around = np.stack([inverse_depth[row::stride, col::stride] for row in sides for col in sides])
    nearest = around.max(axis=0)
    one_surface = around.min(axis=0) >= (1.0 - MAX_SURFACE_STEP) * nearest
    return np.asarray(np.where(one_surface, around.mean(axis=0), nearest))


def relit(
    colours: Float32[np.ndarray, "views height width 3"], rng: np.random.Generator, augmentation: Augmentation,
    tints: tuple[int, ...],
) -> Float32[np.ndarray, "views height width 3"]:  # fmt: skip
    """Another light, the same for all views but for ``tints``, the shape of the factors that are drawn."""
    a = augmentation
    gain = (1 + a.exposure * rng.uniform(-1, 1)) * (1 + a.relative * rng.uniform(-1, 1, tints))
    gamma = np.float32(1 + a.gamma * rng.uniform(-1, 1))
    return np.asarray(np.clip(colours * gain.astype(np.float32), 1e-4, 1.0) ** gamma, np.float32)


def vary_colours(
    colours: Float32[np.ndarray, "2 height width 3"], rng: np.random.Generator, augmentation: Augmentation
) -> Float32[np.ndarray, "2 height width 3"]:
    """What differs between photographs of the same place: light, white balance, gamma, focus, noise, compression."""
    a, f32 = augmentation, np.float32
    varied = relit(colours, rng, a, (2, 1, 1, 3))
    for image in varied:
        if rng.random() < a.blur:
            blurred = cv2.GaussianBlur(add_border(image, BLUR_REACH), (0, 0), rng.uniform(0.4, 1.2))
            image[:] = blurred[BLUR_REACH:-BLUR_REACH, BLUR_REACH:-BLUR_REACH]
    sigma = f32(a.noise * rng.random() ** 2)
    varied = np.clip(varied + sigma * rng.standard_normal(varied.shape, dtype=f32), 0.0, 1.0)
    for image in varied:
        if rng.random() < a.jpeg:
            quality, eight_bit = int(rng.integers(40, 96)), (image * 255.0 + 0.5).astype(np.uint8)
            _, data = cv2.imencode(".jpg", eight_bit, [cv2.IMWRITE_JPEG_QUALITY, quality])
            image[:] = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=f32) / f32(255.0)
    return np.asarray(varied, dtype=f32)
