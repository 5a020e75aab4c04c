"""Training data for the completion network: what matching makes of procedural scenes, with the truth beside it.

A pool is a folder of ``NNNNNNNN.npz`` files, one per scene. A scene is seen from three places on a line, upright but
for small tilts, each with a heading of its own; two of the pairs are matched, both ways. For ``k`` from 0 to 3:

* ``planes_k`` ``(planes, height, width)`` float16, see :func:`omnisyn_cli.stereo.stereo_features.completion_channels`,
* ``root_k`` ``(height, width)`` float16, true square root of inverse depth × baseline,
* ``baseline_k`` metres.

The colours are varied before matching, and some poses are a little wrong, as in life. The truth is that of the centres
of pixels: the nearest of all surfaces in a pixel would teach silhouettes to grow.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.stereo.stereo_features import completion_channels, sqrt_inv_depth
from omnisyn_cli.stereo.matching_estimator import MatchingDepthEstimator, MatchingOptions
from omnisyn_cli.training.data import Augmentation, EvidenceBatch, load_samples, save_samples, stacked, vary_colours
from omnisyn_cli.training.pool import STOPS, TiltedConfig, photographed, scene_path
from omnisyn_cli.types import View

__all__ = ["make_evidence"]

PAIRS = 4
"""Ordered pairs per scene."""

COLOURED = (0, 8, 11)
"""First of three planes that hold a picture."""


@dataclass(frozen=True)
class EvidencePair:
    """One panorama of a matched pair: input planes, true roots, metres."""

    planes: Float32[np.ndarray, "planes height width"]
    root: Float32[np.ndarray, "height width"]
    baseline: float


def make_evidence(folder: Path, seed: int, config: TiltedConfig) -> Path | None:
    """Render and match the scene of a seed into a pool; None if the scene has no room for a path."""
    found = config.scene(seed, STOPS)
    if found is None:
        return None
    scene, path = found
    rng = np.random.default_rng([21, seed])
    tilt, error = float(rng.choice(config.tilts)), config.pose_error(rng)
    height, width = config.size
    shown = [
        photographed(scene, path[stop].position, tilt, error, rng, (2 * height, 2 * width), config.size)
        for stop in (0, int(rng.integers(2, STOPS - 2)), STOPS - 1)
    ]
    inner = ((0, 1), (1, 2))[int(rng.integers(2))]
    estimator = MatchingDepthEstimator(MatchingOptions(size=(2 * height, 2 * width)), threads=1)  # evidence has half
    pairs = [pair for i, j in ((0, 2), inner) for pair in _matched(shown[i], shown[j], estimator, rng)]
    file = scene_path(folder, seed)
    save_samples(file, pairs)
    return file


def _matched(
    one: tuple[np.ndarray, np.ndarray, Pose],
    other: tuple[np.ndarray, np.ndarray, Pose],
    estimator: MatchingDepthEstimator,
    rng: np.random.Generator,
) -> list[EvidencePair]:
    """Both panoramas of a pair, photographed with different cameras."""
    colours = vary_colours(np.stack([one[0], other[0]]), rng, Augmentation())
    first, second = estimator.features(View(colours[0], one[2]), View(colours[1], other[2]))
    baseline = float(np.linalg.norm(one[2].position - other[2].position))
    roots = [sqrt_inv_depth(x[1] * baseline) for x in (one, other)]
    return [
        EvidencePair(completion_channels(first, second), roots[0], baseline),
        EvidencePair(completion_channels(second, first), roots[1], baseline),
    ]


def evidence_pair(path: Path, rng: np.random.Generator, size: tuple[int, int], *, is_recoloured: bool) -> EvidenceBatch:
    """Both panoramas of a random pair of a scene, turned and mirrored at random.

    Args:
        path: of the scene.
        rng: random numbers.
        size: ``(height, width)``, that of the pool or half of it: things look larger there.
        is_recoloured: whether colours are varied as well, all pictures of the pair alike.

    Raises:
        InputError: the pool is of another size.
    """
    first, drawn = 2 * int(rng.integers(PAIRS // 2)), []
    for which in (first, first + 1):
        stored = load_samples(path, EvidencePair, which)[0]
        if stored.root.shape[0] not in (size[0], 2 * size[0]):
            raise InputError(
                f"expected evidence of {size[0]} or {2 * size[0]} rows in {path}, got {stored.root.shape[0]}; "
                "choose another --height"
            )
        pair = stored if stored.root.shape == size else _halved(stored, rng)
        drawn.append(_turned(_recoloured(pair, rng) if is_recoloured else pair, rng))
    planes, root, baseline = stacked(drawn)
    return EvidenceBatch(planes, root.unsqueeze(1), baseline)


def _recoloured(pair: EvidencePair, rng: np.random.Generator) -> EvidencePair:
    planes = pair.planes.copy()
    gain, gamma = np.float32(rng.uniform(0.8, 1.2)), np.float32(rng.uniform(0.8, 1.2))
    tint = rng.uniform(0.95, 1.05, (3, 1, 1)).astype(np.float32)
    order = rng.permutation(3) if rng.random() < 0.3 else np.arange(3)
    for begin in COLOURED:
        colour = np.clip(planes[begin : begin + 3] * gain, 1e-4, 1.0) ** gamma
        planes[begin : begin + 3] = (colour * tint if begin else colour)[order]
    return replace(pair, planes=planes)


def _turned(pair: EvidencePair, rng: np.random.Generator) -> EvidencePair:
    """All planes are even in a mirror, and none knows where the seam is."""
    flip, turn = (-1 if rng.random() < 0.5 else 1), int(rng.integers(pair.root.shape[1]))
    planes, root = (np.roll(x[..., ::flip], turn, axis=-1) for x in (pair.planes, pair.root))
    return EvidencePair(planes, root, pair.baseline)


def _halved(pair: EvidencePair, rng: np.random.Generator) -> EvidencePair:
    """One of four pixels, the same in all planes and the truth; but colours are averaged."""
    height, width = pair.root.shape
    row, col = rng.integers(2, size=2)
    planes = pair.planes[:, row::2, col::2].copy()
    for begin in COLOURED:
        colours = pair.planes[begin : begin + 3].reshape(3, height // 2, 2, width // 2, 2)
        planes[begin : begin + 3] = colours.mean(axis=(2, 4))
    return EvidencePair(planes, pair.root[row::2, col::2], pair.baseline)
