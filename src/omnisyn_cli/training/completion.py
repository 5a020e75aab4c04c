"""Training data for the completion network: what matching makes of procedural scenes, with the truth beside it.

A scene is seen from three places on a line, with headings of their own; two of the pairs are matched, both ways, with
varied colours and some wrong poses, as in life. Arrays are in half precision. The truth is that of the centres of
pixels: the nearest of all surfaces in a pixel would teach silhouettes to grow.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import distance_between
from omnisyn_cli.runtime.image_networks import DescriptorSession
from omnisyn_cli.runtime.session import open_model
from omnisyn_cli.stereo.matching_estimator import MatchingDepthEstimator, MatchingOptions
from omnisyn_cli.stereo.stereo_features import completion_channels, sqrt_inv_depth
from omnisyn_cli.training.data import Array, Augmentation, load_samples, save_samples, stacked, vary_colours
from omnisyn_cli.training.scene_makers import PATH_STOPS, SceneConfig, scene_path, take_photograph
from omnisyn_cli.types import View

ORDERED_PAIRS = 4  # Ordered pairs per scene
COLOUR_CHANNELS = (0, 8, 11)  # First of the three channels of each picture


@dataclass(frozen=True)
class FeatureBatch:
    """Stereo features of panoramas and the truth, as tensors; those of one, without the first axis, as arrays."""

    channels: Float[Array, "*batch channels height width"]  # see stereo_features
    sqrt_inv_depth: Float[Array, "*batch 1 height width"]  # true √(inverse depth × baseline); NaN where it is not known
    baseline: Float[Array, "*batch"]  # metres


def make_feature_scene(folder: Path, seed: int, config: SceneConfig) -> Path | None:
    """Render and match the scene of a seed into a pool; None if the scene has no room for a path."""
    found = config.scene(seed, PATH_STOPS)
    if found is None:
        return None
    scene, path = found
    rng = np.random.default_rng([21, seed])
    tilt, error = float(rng.choice(config.tilts)), config.pose_error(rng)
    size = (2 * config.size[0], 2 * config.size[1])  # features have half
    shown = [
        take_photograph(scene, path[stop].position, tilt, error, rng, size, config.size, supersample=2)
        for stop in (0, int(rng.integers(2, PATH_STOPS - 2)), PATH_STOPS - 1)
    ]
    inner = ((0, 1), (1, 2))[int(rng.integers(2))]
    descriptors = DescriptorSession(open_model("descriptors", device="cpu", threads=1))
    estimator = MatchingDepthEstimator(MatchingOptions(size=size), threads=1, descriptors=descriptors)
    pairs = [pair for i, j in ((0, 2), inner) for pair in _match_pair(shown[i], shown[j], estimator, rng)]
    file = scene_path(folder, seed)
    save_samples(file, pairs)
    return file


def _match_pair(
    one: View, other: View, estimator: MatchingDepthEstimator, rng: np.random.Generator
) -> list[FeatureBatch]:
    """Both panoramas of a pair, photographed with different cameras."""
    colours = vary_colours(np.stack([one.image, other.image]), rng, Augmentation())
    first, second = estimator.features(View(colours[0], one.pose), View(colours[1], other.pose))
    baseline, samples = distance_between(other.pose, one.pose), []
    for view, channels in ((one, completion_channels(first, second)), (other, completion_channels(second, first))):
        if view.known_depth is not None:
            truth = sqrt_inv_depth(view.known_depth.inverse_depth * baseline)
            half = channels.astype(np.float16), truth[None].astype(np.float16)
            samples.append(FeatureBatch(*half, np.float32(baseline)))
    return samples


def draw_completion(
    pool: list[Path], rng: np.random.Generator, pairs: int, size: tuple[int, int], *, augment: bool
) -> FeatureBatch:
    """Random pairs of random scenes, each of two samples, turned and mirrored at random, with colours varied or not.

    ``size`` is ``(height, width)`` of the pool or half of it, where things look larger; InputError: it is neither.
    """
    drawn = []
    for _ in range(pairs):
        path, first = pool[rng.integers(len(pool))], 2 * int(rng.integers(ORDERED_PAIRS // 2))
        for which in (first, first + 1):
            (stored,) = load_samples(path, FeatureBatch, which)
            rows = stored.channels.shape[-2]
            if rows not in (size[0], 2 * size[0]):
                wanted = f"{size[0]} or {2 * size[0]} rows"
                raise InputError(f"expected evidence of {wanted} in {path}, got {rows}; choose another --height")
            sample = stored if rows == size[0] else _halve(stored, rng)
            if augment:
                sample = _jitter_colours(sample, rng)
            # a mirror image changes no channel's sign, and no channel depends on the seam
            flip, turn = (-1 if rng.random() < 0.5 else 1), int(rng.integers(sample.sqrt_inv_depth.shape[-1]))
            channels, sqrt_depth = (
                np.roll(x[..., ::flip], turn, axis=-1) for x in (sample.channels, sample.sqrt_inv_depth)
            )
            drawn.append(FeatureBatch(channels, sqrt_depth, sample.baseline))
    return stacked(drawn)


def _jitter_colours(pair: FeatureBatch, rng: np.random.Generator) -> FeatureBatch:
    channels = pair.channels.copy()
    gain, gamma = np.float32(rng.uniform(0.8, 1.2)), np.float32(rng.uniform(0.8, 1.2))
    tint = rng.uniform(0.95, 1.05, (3, 1, 1)).astype(np.float32)
    order = rng.permutation(3) if rng.random() < 0.3 else np.arange(3)
    for begin in COLOUR_CHANNELS:
        colour = np.clip(channels[begin : begin + 3] * gain, 1e-4, 1.0) ** gamma
        channels[begin : begin + 3] = (colour * tint if begin else colour)[order]
    return replace(pair, channels=channels)


def _halve(pair: FeatureBatch, rng: np.random.Generator) -> FeatureBatch:
    """One of four pixels, the same in all channels and the truth; colours are averaged instead."""
    height, width = pair.sqrt_inv_depth.shape[-2:]
    row, col = rng.integers(2, size=2)
    channels = pair.channels[:, row::2, col::2].copy()
    for begin in COLOUR_CHANNELS:
        colours = pair.channels[begin : begin + 3].reshape(3, height // 2, 2, width // 2, 2)
        channels[begin : begin + 3] = colours.mean(axis=(2, 4))
    return FeatureBatch(channels, pair.sqrt_inv_depth[:, row::2, col::2], pair.baseline)
