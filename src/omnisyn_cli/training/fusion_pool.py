"""Training data for the fusion network: renderings as the program makes them, and the truth.

A pool is a folder of ``NNNNNNNN.npz`` files, one per scene. The ends of a straight way through the scene are
photographed, their depth is estimated or, for a few, known, both surfaces are rendered from places in between. For each
place ``k``:

* ``planes_k`` ``(planes, height, width)`` float16, see :mod:`omnisyn_cli.fusion.input_channels` and
  :mod:`omnisyn_cli.fusion.warp_candidates`,
* ``shown_k`` ``(15, rows, cols)`` float16, at twice the size of the pool: what the geometric fusion makes of it, then
  the four candidates,
* ``truth_k`` ``(3, rows, cols)`` float16, the scene as it is seen from there, in [0, 1],
* ``usual_k``, the mean squared error of the geometric fusion.

Photographs and renderings are made at twice that size again. Every place is there for a network that looks at the size
of the pool and for one that looks at half of it, since presets have it look at either; their order is random. Some
poses are a little wrong, as in life.
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

from omnisyn_cli.fusion import input_channels as channel
from omnisyn_cli.fusion import warp_candidates as warp
from omnisyn_cli.fusion.residual import ResidualFuser
from omnisyn_cli.fusion.warp_candidates import WarpCandidates
from omnisyn_cli.geometry.pose import Pose, interpolate_pose
from omnisyn_cli.geometry.sphere import mean_over_sphere
from omnisyn_cli.pipeline.config import DepthSource, Recipe
from omnisyn_cli.pipeline.depth_sources import make_estimator
from omnisyn_cli.pipeline.presets import DEFAULT_PRESET, PRESETS
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.scenes import Scene, render_panorama
from omnisyn_cli.synthesis.synthesize import synthesize
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.training.data import load_samples, save_samples, stacked, window_columns
from omnisyn_cli.training.pool import TiltedConfig, as_told, held_askew, scene_path
from omnisyn_cli.types import DepthEstimate, DepthEstimator, Layer, View

__all__ = ["FusionPoolConfig", "make_fusion_scene"]

OVERSIZE, PICTURE = 4, 2
"""So many times as high as a pool are the photographs and renderings of its scenes, and the pictures that are kept."""

PAIRS_OF_VIEWS = (
    (channel.FIRST_RGB, channel.SECOND_RGB, 3),
    (channel.BLEND_WEIGHTS, channel.BLEND_WEIGHTS + 1, 1),
    (channel.SQRT_INVERSE_DEPTHS, channel.SQRT_INVERSE_DEPTHS + 1, 1),
    (channel.SEEN_MASKS, channel.SEEN_MASKS + 1, 1),
    (warp.CROSS_VIEW, warp.CROSS_VIEW + 6, 6),
    *((begin, begin + 3, 3) for begin in (warp.CANDIDATE_RGB, warp.CANDIDATE_RGB + 6)),
    *((begin, begin + 1, 1) for begin in (warp.HYPOTHESIS_OCCLUSION, warp.HYPOTHESIS_OCCLUSION + 2)),
)
"""Of the first view, of the second, and how many: what changes places when the views do."""

COLOURED = (
    channel.FIRST_RGB, channel.SECOND_RGB, channel.FUSED_RGB, warp.CROSS_VIEW, warp.CROSS_VIEW + 6,
    *range(warp.CANDIDATE_RGB, warp.HYPOTHESIS_DEPTHS, 3),
)  # fmt: skip
"""First of three planes that are a picture."""

DIFFERENCES = (warp.CROSS_VIEW + 3, warp.CROSS_VIEW + 9, warp.CANDIDATE_DIFFERENCE, warp.CANDIDATE_DIFFERENCE + 1)
"""Planes that are differences of colours."""

ONE_SURFACE, MINOR = 0.05, 0.3
"""Difference of roots from which on two supposed surfaces are worth a look, and how much beside a contradiction."""

EXCHANGED = [*range(3), *range(6, 9), *range(3, 6), *range(12, 15), *range(9, 12)]
"""Where the channels of what a network chooses from are then."""

SIGNED = (channel.LOG_WEIGHT_RATIO, channel.DEPTH_GAP, channel.PATH_POSITION)
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
    """One place, or some of its columns: what the network sees, what it chooses from, and what there is to be seen."""

    planes: Float32[np.ndarray, "planes height width"]
    shown: Float32[np.ndarray, "15 rows cols"]
    truth: Float32[np.ndarray, "3 rows cols"]
    usual: Float32[np.ndarray, ""]


@dataclass(frozen=True)
class FusionBatch:
    """Windows for one step, stacked."""

    planes: Float[Tensor, "batch planes height width"]
    shown: Float[Tensor, "batch 15 rows cols"]
    truth: Float[Tensor, "batch 3 rows cols"]
    usual: Float[Tensor, " batch"]


class _Recorder(ResidualFuser):
    """Fuses by rules, and keeps what a network would be shown and what it would choose from.

    Args:
        size: height and width of the frames.
        rows: that the network would look at.
        kept: height and width of the pictures that are kept.
    """

    def __init__(self, size: tuple[int, int], rows: int, kept: tuple[int, int]) -> None:
        super().__init__(size, lambda planes: planes[:4], rows, threads=1)
        self._kept = kept
        self.seen: list[tuple[np.ndarray, np.ndarray]] = []

    def correct(self, channels: np.ndarray, candidates: WarpCandidates, strength: np.ndarray, picture: np.ndarray) -> None:
        """See :class:`omnisyn_cli.fusion.residual.ResidualFuser`; nothing is corrected."""
        pictures = [picture, *candidates.candidates(self.size)[..., :3]]
        self.seen.append((channels, np.concatenate([small_planes(each, self._kept) for each in pictures])))


class _Recording:
    """Fuses by rules, and keeps what networks that look at several sizes would be shown.

    Args:
        size: height and width of the frames.
        heights: that they look at; those that frames are too small for, or it, say nothing.
        kept: height and width of the pictures that are kept.
    """

    def __init__(self, size: tuple[int, int], heights: Sequence[int], kept: tuple[int, int]) -> None:
        self.recorders = [_Recorder(size, rows, kept) for rows in heights]

    def __call__(
        self, first: Layer, second: Layer, t: float, out: np.ndarray | None = None,
        confidence: np.ndarray | None = None,
    ) -> np.ndarray:  # fmt: skip
        """See :class:`omnisyn_cli.types.Fuser`."""
        pictures = [recorder(first, second, t, out, confidence) for recorder in self.recorders]
        return pictures[-1]

    def seen(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """The planes and pictures since it was asked the last time."""
        return [recorder.seen.pop() for recorder in self.recorders if recorder.seen]


def small_planes(
    picture: Float32[np.ndarray, "height width 3"], size: tuple[int, int]
) -> Float32[np.ndarray, "3 rows cols"]:
    """A picture at a smaller size, channels first."""
    small = cv2.resize(np.ascontiguousarray(picture, np.float32), size[::-1], interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(small.transpose(2, 0, 1))


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
    kept = (PICTURE * config.size[0], PICTURE * config.size[1])
    fuser = _Recording(size, (config.size[0], config.size[0] // 2), kept)
    first, second = (view.pose for view in views)
    shares = np.sort(rng.uniform(*config.shares, config.places))
    path = [Waypoint(0, share, interpolate_pose(first, second, share)) for share in shares]
    options = SynthesisOptions(size, recipe.renderer_strategy.load(), Cut(recipe.cut, recipe.cut_metres), threads=1)
    for made in synthesize(views, path, SurfaceMethod(_estimator(recipe.depth), options, fuser)):
        if seen := fuser.seen():
            scenery = render_panorama(scene, made.waypoint.pose, size, supersample=1, threads=1)[0]
            truth = small_planes(scenery, kept)
            for planes, shown in seen:
                yield FusionSample(planes, shown, truth, _squared_error(shown[:3], truth))


def _squared_error(
    picture: Float32[np.ndarray, "3 rows cols"], truth: Float32[np.ndarray, "3 rows cols"]
) -> Float32[np.ndarray, ""]:
    """Mean over the sphere."""
    return np.asarray(mean_over_sphere(np.square(picture - truth).transpose(1, 2, 0)), np.float32)


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
    drawn: list[FusionSample] = []
    while len(drawn) < batch:
        path, which = pool[rng.integers(len(pool))], int(rng.integers(1 << 16))
        sample = load_samples(path, FusionSample, which, np.float16)[0]
        if not drawn or sample.planes.shape[-2] == drawn[0].planes.shape[-2]:
            drawn.append(_varied(sample, rng))
    return FusionBatch(*stacked(drawn))


def stored_fusion(path: Path, which: int) -> FusionBatch:
    """A place of a scene as it is."""
    return FusionBatch(*stacked(load_samples(path, FusionSample, which)))


def _varied(sample: FusionSample, rng: np.random.Generator) -> FusionSample:
    """All that is done to colours is linear, so that blends of varied colours are varied blends."""
    planes, shown, truth = _window(sample, rng)
    tint = (rng.uniform(0.7, 1.05) * rng.uniform(0.9, 1.1, 3)).astype(np.float32)[:, None, None]
    order = rng.permutation(3) if rng.random() < 0.3 else np.arange(3)
    for begin in COLOURED:
        planes[begin : begin + 3] = (planes[begin : begin + 3] * tint)[order]
    planes[list(DIFFERENCES)] *= tint.mean()
    shown, truth = ((x.reshape(-1, 3, *x.shape[1:]) * tint)[:, order].reshape(x.shape) for x in (shown, truth))
    if rng.random() < 0.5:
        planes, shown = exchanged(planes), shown[EXCHANGED]
    if rng.random() < 0.5:
        planes, shown, truth = (x[..., ::-1] for x in (planes, shown, truth))
    usual = np.asarray(sample.usual * np.square(tint).mean(), np.float32)
    planes, shown, truth = map(np.ascontiguousarray, (planes, shown, truth))
    return FusionSample(planes, shown, truth, usual)


def _window(sample: FusionSample, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Planes and pictures of a quarter of the columns, in single precision."""
    relevance, farthest, nearest = (
        sample.planes[k].astype(np.float32) for k in (channel.RELEVANCE, warp.HYPOTHESIS_DEPTHS, warp.HYPOTHESIS_DEPTHS + 1)
    )
    columns = window_columns(relevance + MINOR * (nearest - farthest > ONE_SURFACE), rng)
    finer = sample.truth.shape[-1] // sample.planes.shape[-1]
    fine = (finer * columns[:, None] + np.arange(finer)).ravel()
    planes, shown, truth = (
        x[..., some].astype(np.float32)
        for x, some in ((sample.planes, columns), (sample.shown, fine), (sample.truth, fine))
    )
    return planes, shown, truth


def exchanged(planes: Float32[np.ndarray, "planes height width"]) -> Float32[np.ndarray, "planes height width"]:
    """What the network sees when the views change places and the way is walked from its other end."""
    other = planes.copy()
    for first, second, count in PAIRS_OF_VIEWS:
        other[first : first + count] = planes[second : second + count]
        other[second : second + count] = planes[first : first + count]
    other[list(SIGNED)] *= -1.0
    return other
