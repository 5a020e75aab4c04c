"""Training data for the fusion network: renderings as the program makes them, and the truth.

A pool is a folder of ``NNNNNNNN.npz`` files, one per scene. The ends of a straight way through the scene are
photographed, their depth is estimated or, for a few, known, both surfaces are rendered from places in between. For each
place ``k``:

* ``planes_k`` ``(planes, height, width)`` float16, see :mod:`omnisyn_cli.fusion.planes` and
  :mod:`omnisyn_cli.fusion.second_look`,
* ``truth_k`` ``(3, height, width)`` float16, the scene as it is seen from there, in [0, 1].

Renderings are made at four times that size and reduced as in the program; some poses are a little wrong, as in life.
Every place is there at half that size as well, since presets have the network look at either; their order is random.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Float32
from torch import Tensor

from omnisyn_cli.fusion import planes as plane
from omnisyn_cli.fusion import second_look as look
from omnisyn_cli.fusion.geometric import Confidence, Picture
from omnisyn_cli.fusion.network import NetworkFuser
from omnisyn_cli.geometry.pose import Pose, interpolate_pose
from omnisyn_cli.geometry.sphere import direction_tables
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.scenes import Scene, render_panorama
from omnisyn_cli.synthesis.frames import synthesize
from omnisyn_cli.synthesis.making import make_estimator
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.presets import DEFAULT_PRESET, PRESETS
from omnisyn_cli.synthesis.recipe import DepthSource, Recipe
from omnisyn_cli.synthesis.segments import SynthesisOptions
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.training.data import load_samples, save_samples, stacked, window_columns
from omnisyn_cli.training.pool import TiltedConfig, as_told, held_askew, scene_path
from omnisyn_cli.types import DepthEstimate, DepthEstimator, Rendering, View

__all__ = ["FusionPoolConfig", "make_fusion_scene"]

OVERSIZE = 4
"""Photographs and renderings are this many times as high as the planes."""

PAIRS_OF_VIEWS = (
    (plane.FIRST, plane.SECOND, 3),
    (plane.WEIGHT, plane.WEIGHT + 1, 1),
    (plane.ROOT, plane.ROOT + 1, 1),
    (plane.SEEN, plane.SEEN + 1, 1),
    (look.CONFRONTED, look.CONFRONTED + 6, 6),
    *((begin, begin + 3, 3) for begin in (look.CANDIDATES, look.CANDIDATES + 6)),
    *((begin, begin + 1, 1) for begin in (look.CONTRADICTED, look.CONTRADICTED + 2)),
)
"""Of the first view, of the second, and how many: what changes places when the views do."""

COLOURED = (
    plane.FIRST, plane.SECOND, plane.FUSED, look.CONFRONTED, look.CONFRONTED + 6,
    *range(look.CANDIDATES, look.SUPPOSED, 3),
)  # fmt: skip
"""First of three planes that are a picture."""

DIFFERENCES = (look.CONFRONTED + 3, look.CONFRONTED + 9, look.UNLIKE, look.UNLIKE + 1)
"""Planes that are differences of colours."""

ONE_SURFACE, MINOR = 0.05, 0.3
"""Difference of roots from which on two supposed surfaces are worth a look, and how much beside a contradiction."""

SIGNED = (plane.LOG_RATIO, plane.GAP, plane.TIME)
"""What changes its sign then."""


@dataclass(frozen=True)
class FusionPoolConfig(TiltedConfig):
    """How scenes are rendered.

    Attributes:
        places: per scene.
        shares: of the way, between which the places lie.
        preset: whose depth and renderer they are made with.
        matched: share of scenes whose depth comes from matching alone instead.
        known: share of scenes whose depth is the true one.
        rows: that depth is looked for at.
    """

    places: int = 3
    shares: tuple[float, float] = (0.1, 0.9)
    preset: str = DEFAULT_PRESET
    matched: float = 0.1
    known: float = 0.1
    rows: int = 1024
    size: tuple[int, int] = (128, 256)


@dataclass(frozen=True)
class FusionSample:
    """One place: what the network sees, and what there is to be seen."""

    planes: Float32[np.ndarray, "planes height width"]
    truth: Float32[np.ndarray, "3 height width"]


@dataclass(frozen=True)
class Window(FusionSample):
    """A place, or some of its columns, with the mean squared error of the geometric fusion of the whole place."""

    usual: Float32[np.ndarray, ""]

    @staticmethod
    def of(sample: FusionSample) -> Window:
        """The whole place."""
        sines = direction_tables(*sample.truth.shape[1:])[0]
        error = np.square(sample.planes[plane.FUSED : plane.FUSED + 3] - sample.truth).mean(axis=0)
        return Window(sample.planes, sample.truth, np.asarray(error.mean(axis=1) @ sines / sines.sum(), np.float32))


@dataclass(frozen=True)
class FusionBatch:
    """Windows for one step: ``(batch, planes, height, width)``, ``(batch, 3, height, width)`` and ``(batch,)``."""

    planes: Float[Tensor, "batch planes height width"]
    truth: Float[Tensor, "batch 3 height width"]
    usual: Float[Tensor, " batch"]


class _Recorder:
    """Stands in for the network: keeps what it is shown, corrects nothing."""

    def __init__(self) -> None:
        self.planes: list[np.ndarray] = []

    def __call__(self, planes: np.ndarray) -> np.ndarray:
        self.planes.append(planes)
        return np.zeros_like(planes[:4])


class _Recording:
    """Fuses as a network does that looks at several sizes, and says what it is shown.

    Args:
        size: height and width of the frames.
        heights: that it looks at; those that frames are too small for, or it, say nothing.
    """

    def __init__(self, size: tuple[int, int], heights: Sequence[int]) -> None:
        self.recorders = [_Recorder() for _ in heights]
        self.fusers = [
            NetworkFuser(size, recorder, rows, threads=1)
            for recorder, rows in zip(self.recorders, heights, strict=True)
        ]

    def __call__(
        self, first: Rendering, second: Rendering, t: float, out: Picture | None = None,
        confidence: Confidence | None = None,
    ) -> Picture:  # fmt: skip
        """See :class:`omnisyn_cli.types.Fuser`."""
        pictures = [fuser(first, second, t, out, confidence) for fuser in self.fusers]
        return pictures[-1]

    def shown(self) -> list[np.ndarray]:
        """The planes since it was asked the last time."""
        return [recorder.planes.pop() for recorder in self.recorders if recorder.planes]


def make_fusion_scene(folder: Path, seed: int, config: FusionPoolConfig) -> Path | None:
    """Render the scene of a seed into a pool; None if it has no room for a path, or shows nothing to be decided."""
    found = config.scene(seed, 2)
    if found is None:
        return None
    rng = np.random.default_rng([23, seed])
    recipe = replace(PRESETS[config.preset].recipe, depth=_depth_source(rng.random(), config))
    samples = list(_samples(*found, recipe, rng, config))
    if not samples:
        return None
    file = scene_path(folder, seed)
    save_samples(file, [samples[k] for k in rng.permutation(len(samples))])
    return file


def _depth_source(draw: float, config: FusionPoolConfig) -> DepthSource:
    """What a number drawn from [0, 1) decides."""
    if draw < config.matched:
        return DepthSource("matching", config.rows)
    if draw < config.matched + config.known:
        return DepthSource("file")
    return replace(PRESETS[config.preset].recipe.depth, rows=config.rows)


@lru_cache(maxsize=3)
def _estimator(depth: DepthSource) -> DepthEstimator:
    return make_estimator(depth, device="cpu", threads=1)


def _samples(
    scene: Scene, ends: Sequence[Pose], recipe: Recipe, rng: np.random.Generator, config: FusionPoolConfig
) -> Iterator[FusionSample]:
    size = (OVERSIZE * config.size[0], OVERSIZE * config.size[1])
    tilt, error = float(rng.choice(config.tilts)), config.pose_error(rng)
    views = [_photograph(scene, end.position, tilt, error, size, rng) for end in ends]
    fuser = _Recording(size, (config.size[0], config.size[0] // 2))
    first, second = (view.pose for view in views)
    shares = np.sort(rng.uniform(*config.shares, config.places))
    path = [Waypoint(0, share, interpolate_pose(first, second, share)) for share in shares]
    options = SynthesisOptions(size, recipe.renderer, Cut(recipe.cut, recipe.cut_metres), threads=1)
    for made in synthesize(views, path, SurfaceMethod(_estimator(recipe.depth), options, fuser)):
        if shown := fuser.shown():
            truth = render_panorama(scene, made.waypoint.pose, size, supersample=1, threads=1)[0]
            for planes in shown:
                small = cv2.resize(truth, planes.shape[:0:-1], interpolation=cv2.INTER_AREA)
                yield FusionSample(planes, np.ascontiguousarray(small.transpose(2, 0, 1), np.float32))


def _photograph(
    scene: Scene, position: np.ndarray, tilt: float, error: float, size: tuple[int, int], rng: np.random.Generator
) -> View:
    """A panorama with the pose that it is said to have, and its true depth."""
    pose = Pose(held_askew(rng, tilt), position)
    image, depth = render_panorama(scene, pose, size, supersample=1, threads=1)
    known = DepthEstimate((1.0 / depth).astype(np.float32), np.ones(size, np.float32))
    return View(np.asarray(image, np.float32), as_told(pose, error, rng), known_depth=known)


def draw_fusion(pool: list[Path], rng: np.random.Generator, batch: int) -> FusionBatch:
    """Windows of random places of random scenes, varied at random in ways that change nothing about the geometry.

    They are mirrored, lit and tinted otherwise, and the views change places. A window has all rows and a quarter of the
    columns; it lies, across the seam or not, preferably where the views contradict each other. All are of one size,
    that of the first that is drawn: a pool may hold scenes of several.
    """
    drawn: list[Window] = []
    while len(drawn) < batch:
        path, which = pool[rng.integers(len(pool))], int(rng.integers(1 << 16))
        sample = load_samples(path, FusionSample, which)[0]
        if not drawn or sample.truth.shape[-2] == drawn[0].truth.shape[-2]:
            drawn.append(_varied(Window.of(sample), rng))
    return FusionBatch(*stacked(drawn))


def stored_fusion(path: Path, which: int) -> FusionBatch:
    """A place of a scene as it is."""
    return FusionBatch(*stacked([Window.of(sample) for sample in load_samples(path, FusionSample, which)]))


def _varied(sample: Window, rng: np.random.Generator) -> Window:
    """All that is done to colours is linear, so that blends of varied colours are varied blends."""
    farthest, nearest = sample.planes[look.SUPPOSED : look.SUPPOSED + 2]
    columns = window_columns(sample.planes[plane.RELEVANCE] + MINOR * (nearest - farthest > ONE_SURFACE), rng)
    planes, truth = (x[..., columns] for x in (sample.planes, sample.truth))
    tint = (rng.uniform(0.7, 1.05) * rng.uniform(0.9, 1.1, 3)).astype(np.float32)[:, None, None]
    order = rng.permutation(3) if rng.random() < 0.3 else np.arange(3)
    for begin in COLOURED:
        planes[begin : begin + 3] = (planes[begin : begin + 3] * tint)[order]
    planes[list(DIFFERENCES)] *= tint.mean()
    truth = (truth * tint)[order]
    if rng.random() < 0.5:
        planes = exchanged(planes)
    if rng.random() < 0.5:
        planes, truth = planes[..., ::-1], truth[..., ::-1]
    usual = sample.usual * np.square(tint).mean()
    return Window(np.ascontiguousarray(planes), np.ascontiguousarray(truth), usual)


def exchanged(planes: Float32[np.ndarray, "planes height width"]) -> Float32[np.ndarray, "planes height width"]:
    """What the network sees when the views change places and the way is walked from its other end."""
    other = planes.copy()
    for first, second, count in PAIRS_OF_VIEWS:
        other[first : first + count] = planes[second : second + count]
        other[second : second + count] = planes[first : first + count]
    other[list(SIGNED)] *= -1.0
    return other
