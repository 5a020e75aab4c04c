"""Training data for the doubting network: finished estimates of procedural scenes, with the truth beside them.

A pool is a folder of ``NNNNNNNN.npz`` files, one per scene, which is photographed from two places on a line. For either
panorama ``k``:

* ``planes_k`` ``(planes, height, width)`` float16, see :func:`omnisyn_cli.stereo.doubt.doubt_planes`,
* ``edges_k`` ``(height, width)`` float16, true square root of inverse depth × baseline at the centres of pixels,
* ``metres_k``, the baseline.

Estimates are made at twice the size of the planes, and shrunk. Some photographs have half as many rows as the estimate:
there edges are softer. Colours are varied before matching, and some poses are a little wrong, as in life.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.stereo.doubt import COLOURED, DIFFERENCES, EAST_PLANE, ROWS, doubt_planes, middles, shrunk
from omnisyn_cli.stereo.evidence import root_of
from omnisyn_cli.synthesis.making import make_estimator
from omnisyn_cli.synthesis.presets import DEFAULT_PRESET, PRESETS
from omnisyn_cli.training.data import (
    Augmentation,
    EvidenceBatch,
    load_samples,
    save_samples,
    stacked,
    vary_colours,
    window_columns,
)
from omnisyn_cli.training.pool import STOPS, TiltedConfig, photographed, scene_path
from omnisyn_cli.types import DepthEstimator, View

__all__ = ["DoubtPoolConfig", "make_doubt"]

WAYS = ((0, STOPS - 1), (0, STOPS - 1), (0, STOPS // 2), (2, STOPS - 1))
"""Stops of the path that a scene draws a pair of."""

BLIND = 0.5
"""Share of windows without pictures."""

STEP = 0.04
"""Difference of neighbouring roots at a silhouette."""


@dataclass(frozen=True)
class DoubtPoolConfig(TiltedConfig):
    """How scenes are rendered and estimated.

    Attributes:
        size: of the planes; estimates and most photographs have twice as many rows.
        halved: share of scenes whose photographs have half as many rows.
    """

    size: tuple[int, int] = (ROWS, 2 * ROWS)
    halved: float = 0.35


@dataclass(frozen=True)
class DoubtSample:
    """One panorama of a pair: input planes, true roots, metres."""

    planes: Float32[np.ndarray, "planes height width"]
    edges: Float32[np.ndarray, "height width"]
    metres: float


def make_doubt(folder: Path, seed: int, config: DoubtPoolConfig) -> Path | None:
    """Render and estimate the scene of a seed into a pool; None if the scene has no room for a path."""
    found = config.scene(seed, STOPS)
    if found is None:
        return None
    scene, path = found
    rng = np.random.default_rng([91, seed])
    tilt, error = float(rng.choice(config.tilts)), config.pose_error(rng)
    divisor = 2 if rng.random() < config.halved else 1
    whole = (2 * config.size[0], 2 * config.size[1])
    size = (whole[0] // divisor, whole[1] // divisor)
    colours, truths, poses = zip(
        *(
            photographed(scene, path[stop].position, tilt, error, rng, size, whole)
            for stop in WAYS[int(rng.integers(len(WAYS)))]
        ),
        strict=True,
    )
    varied = vary_colours(np.stack(colours), rng, Augmentation())
    views = (View(varied[0], poses[0]), View(varied[1], poses[1]))
    one, other = _estimator(2 * whole[0])(*views)
    estimates = (shrunk(one, config.size[0]), shrunk(other, config.size[0]))
    baseline = float(np.linalg.norm(poses[1].position - poses[0].position))
    roots = [root_of(middles(truth, config.size) * baseline).astype(np.float32) for truth in truths]
    orders = ((views, estimates), (views[::-1], estimates[::-1]))
    samples = [DoubtSample(doubt_planes(*order), root, baseline) for order, root in zip(orders, roots, strict=True)]
    file = scene_path(folder, seed)
    save_samples(file, samples)
    return file


@lru_cache(maxsize=1)
def _estimator(rows: int) -> DepthEstimator:
    """The default preset's, without what is taught here."""
    usual = PRESETS[DEFAULT_PRESET].recipe.depth
    return make_estimator(replace(usual, rows=rows, doubt=None), device="cpu", threads=1)


def draw_doubt(pool: list[Path], rng: np.random.Generator, batch: int) -> EvidenceBatch:
    """Windows of random panoramas, of all rows and a quarter of the columns, preferably where depth jumps.

    They are mirrored and lit otherwise at random, and channels of colour change places. Every other one is seen without
    any pictures, but with their differences: what is learned of evidence holds elsewhere, what of pictures less.
    """
    drawn = []
    for _ in range(batch):
        path, which = pool[rng.integers(len(pool))], int(rng.integers(2))
        drawn.append(_varied(load_samples(path, DoubtSample, which)[0], rng))
    return _batch(drawn)


def stored_doubt(path: Path, which: int) -> EvidenceBatch:
    """A panorama of a scene as it is."""
    return _batch(load_samples(path, DoubtSample, which))


def _batch(samples: list[DoubtSample]) -> EvidenceBatch:
    planes, edges, metres = stacked(samples)
    return EvidenceBatch(planes, edges.unsqueeze(1), metres)


def _varied(sample: DoubtSample, rng: np.random.Generator) -> DoubtSample:
    jumps = np.abs(sample.edges - np.roll(sample.edges, 1, axis=1)) > STEP
    columns = window_columns(jumps, rng)
    planes, edges = sample.planes[..., columns], sample.edges[..., columns]
    gain = np.float32(rng.uniform(0.8, 1.2))
    order = rng.permutation(3) if rng.random() < 0.3 else np.arange(3)
    is_seen = rng.random() >= BLIND
    for first in COLOURED:
        planes[first : first + 3] = is_seen * gain * planes[first : first + 3][order]
    planes[DIFFERENCES] *= gain
    if rng.random() < 0.5:
        planes, edges = planes[..., ::-1].copy(), edges[..., ::-1].copy()
        planes[EAST_PLANE] *= -1.0
    return DoubtSample(planes, edges, sample.metres)
