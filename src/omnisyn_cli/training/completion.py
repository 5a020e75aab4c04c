"""Training data for the completion network: simulated stereo features of rendered scenes.

Exact depth says what the other camera cannot see, and colours say where there is no texture. So matches can be
simulated in a hundredth of the time that matching takes, and differently every time a scene is drawn. Of the rest some
is left out, some is wrong, and some of the wrong passes for consistent. Views come from the pool of the depth networks.
They are turned from the epipole frame to a camera held nearly upright, as real stereo features are
(:mod:`omnisyn_cli.stereo.stereo_features`). Real ones (:mod:`omnisyn_cli.training.feature_scenes`) come last, as
fine-tuning.
"""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Float32

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.geometry.sampling import add_border, filter_across_seam
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.geometry.sweep import sweep_directions
from omnisyn_cli.geometry.tolerances import MAX_SQRT_INV_DEPTH
from omnisyn_cli.stereo.filling import fill_with_planes
from omnisyn_cli.stereo.matching_estimator import INCONSISTENT_MATCH_WEIGHT
from omnisyn_cli.stereo.stereo_features import StereoFeatures, completion_channels, sqrt_inv_depth
from omnisyn_cli.training.data import Augmentation, FeatureBatch, TrainingScene, is_made_by, load_scene, vary_colours
from omnisyn_cli.training.feature_scenes import draw_feature_pair
from omnisyn_cli.training.line_scenes import random_rotation

TILT_STDS_RADIANS = (0.0, 0.02, 0.1)
"""Standard deviations of pitch and roll that a pair draws one of: on a tripod, by hand, askew."""

MAX_VISIBLE_RATIO = 1.08
"""Ratio of inverse depths up to which the other view shows the same point."""

UNKNOWN_INVERSE_DEPTH = np.float32(1e-6)
"""Inverse depth × baseline where the truth is not known: next to nothing, but no sky."""

MIN_SILHOUETTE_STEP = 0.03
"""Difference of √(inverse depth × baseline) between two sides of a silhouette."""

ZENITH = np.array([0.0, 1.0, 0.0])
"""Direction of the later cameras on the line in the epipole frame."""


@dataclass(frozen=True)
class _UprightView:
    """A view held nearly upright.

    Attributes:
        image: the picture.
        inverse_depth: in 1/baselines; next to nothing where it is not known, so that it is no sky.
        towards: direction to the other camera.
        is_known: where there is a truth.
    """

    image: Float32[np.ndarray, "height width 3"]
    inverse_depth: Float32[np.ndarray, "height width"]
    to_other: Float[np.ndarray, " 3"]
    is_known: Bool[np.ndarray, "height width"]


def draw_completion(
    pool: list[Path],
    rng: np.random.Generator,
    pairs: int,
    size: tuple[int, int],
    augmentation: Augmentation | None = None,
) -> FeatureBatch:
    """Random pairs of random scenes; every pair gives two samples.

    Args:
        pool: from :func:`omnisyn_cli.training.data.list_scene_files`, of rendered scenes, of matched ones, or of both.
        rng: random numbers.
        pairs: how many.
        size: ``(height, width)``, at most that of the pool.
        augmentation: of the colours; None leaves them as they are. Matched scenes, whose photographs differ already,
            are varied by rules of their own.
    """
    batches = [_draw_pair_features(pool[rng.integers(len(pool))], rng, size, augmentation) for _ in range(pairs)]
    columns = (
        torch.cat([getattr(batch, name) for batch in batches]) for name in ("channels", "sqrt_inv_depth", "baseline")
    )
    return FeatureBatch(*columns)


def _draw_pair_features(
    path: Path, rng: np.random.Generator, size: tuple[int, int], augmentation: Augmentation | None
) -> FeatureBatch:
    if is_made_by("evidence", path):
        return draw_feature_pair(path, rng, size, augment=augmentation is not None)
    return completion_pair(load_scene(path), rng, size, augmentation)


def completion_pair(
    scene: TrainingScene, rng: np.random.Generator, size: tuple[int, int], augmentation: Augmentation | None = None
) -> FeatureBatch:
    """Two views of a scene, and what matching might have made of them.

    Raises InputError: the views are smaller than ``size``.
    """
    if scene.images.shape[1] < size[0]:
        raise InputError(f"expected a pool of at least {size[0]} rows, got {scene.images.shape[1]}; render another")
    near, far = sorted(rng.choice(len(scene.along), 2, replace=False))
    baseline = float(scene.along[far] - scene.along[near])
    turn = _upright(scene.up, rng)
    views = [_upright_view(scene, index, turn, size, baseline, sign) for index, sign in ((near, 1.0), (far, -1.0))]
    if augmentation is not None:
        colours = vary_colours(np.stack([view.image for view in views]), rng, augmentation)
        views = [replace(view, image=colour) for colour, view in zip(colours, views, strict=True)]
    up = turn.T @ scene.up
    first, second = (_simulate_features(*order, up, rng) for order in ((views[0], views[1]), (views[1], views[0])))
    channels = [completion_channels(first, second), completion_channels(second, first)]
    sqrt_depths = [
        np.where(view.is_known, sqrt_inv_depth(view.inverse_depth), np.float32(np.nan))[None] for view in views
    ]
    if rng.random() < 0.5:  # a mirror image: no channel changes its sign
        channels, sqrt_depths = ([x[..., ::-1] for x in each] for each in (channels, sqrt_depths))
    return FeatureBatch(
        torch.from_numpy(np.stack(channels)),
        torch.from_numpy(np.stack(sqrt_depths)),
        torch.full((2,), baseline, dtype=torch.float32),
    )


def _upright(up: Float[np.ndarray, " 3"], rng: np.random.Generator) -> Float[np.ndarray, "3 3"]:
    """Rotation to the epipole frame from a camera with a random heading and a small tilt."""
    side = np.cross(up, ZENITH)
    length = float(np.linalg.norm(side))
    side = side / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    level = np.stack([side, up, np.cross(side, up)], axis=1)
    tilt = float(rng.choice(TILT_STDS_RADIANS))
    return np.asarray(level @ random_rotation(rng, tilt))


def _upright_view(
    scene: TrainingScene, index: int, turn: np.ndarray, size: tuple[int, int], baseline: float, sign: float
) -> _UprightView:
    image, inverse_depth = scene.images[index], np.asarray(scene.inverse_depth[index], np.float32)
    turned = RemapTable.for_directions(pixel_directions(*size) @ turn.T, inverse_depth.shape)
    colours, depth = turned.bilinear(image).astype(np.float32) / np.float32(255.0), turned.nearest(inverse_depth)
    is_known = np.isfinite(depth)
    scaled = np.where(is_known, depth * np.float32(baseline), UNKNOWN_INVERSE_DEPTH)
    return _UprightView(colours, scaled, sign * turn.T @ ZENITH, is_known)


def _simulate_features(
    view: _UprightView, other: _UprightView, up: np.ndarray, rng: np.random.Generator
) -> StereoFeatures:
    """What matching might know of a view: some of the truth, and some that is wrong."""
    size = view.inverse_depth.shape
    usable = _random_nadir_mask(up, size, rng)
    left_right_consistent = _simulate_consistency(view, other, rng) & usable & view.is_known
    matched = _simulate_matches(view.inverse_depth, left_right_consistent, rng)
    left_right_consistent, matched = _add_false_islands(
        *_fatten_silhouettes(view.inverse_depth, left_right_consistent, matched, rng), rng
    )
    sky = (view.inverse_depth == 0) & (usable | (rng.random() < 0.5))
    sky &= _smooth_noise(size, 8, rng) > rng.choice([0.0, 0.0, 0.4])
    left_right_consistent &= usable & ~sky & (view.inverse_depth > 0) & view.is_known
    weight = np.where(sky, 0.0, np.where(left_right_consistent, 1.0, INCONSISTENT_MATCH_WEIGHT * usable))
    filled = np.where(sky, 0.0, fill_with_planes(matched.astype(np.float64), weight, view.image, usable))
    motion = Pose(np.eye(3), -view.to_other)
    return StereoFeatures(view.image, matched, left_right_consistent, sky, filled, usable, motion, up)


def _simulate_consistency(
    view: _UprightView, other: _UprightView, rng: np.random.Generator
) -> Bool[np.ndarray, "height width"]:
    """Where matching would be sure: seen by both, with texture, off the epipoles, not too near, and lucky."""
    size, sqrt_depth = view.inverse_depth.shape, sqrt_inv_depth(view.inverse_depth)
    directions = pixel_directions(*size)
    found = _is_visible_to_other(view, other, directions)
    found &= np.abs(directions @ view.to_other) < np.cos(np.radians(rng.uniform(3.0, 14.0)))
    coarse, fine = (int(rng.choice([4, 8, 16])) for _ in range(2))
    found &= (_local_contrast(view.image) > rng.uniform(0.0, 0.01)) | (
        _smooth_noise(size, 8, rng) > rng.uniform(0.0, 0.6)
    )
    found &= (sqrt_depth < rng.uniform(0.7, 1.5)) | (_smooth_noise(size, coarse, rng) > rng.uniform(0.0, 0.6))
    found &= _smooth_noise(size, fine, rng) > rng.uniform(-0.4, 0.25)
    if rng.random() < 0.6:  # windows that lie across an edge match neither side
        found = cv2.erode(found.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    if rng.random() < 0.3:
        jumps = cv2.morphologyEx(sqrt_depth, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0.1
        found &= ~jumps
    return np.asarray(found)


def _is_visible_to_other(
    view: _UprightView, other: _UprightView, directions: np.ndarray
) -> Bool[np.ndarray, "height width"]:
    """Whether the other camera sees the same point."""
    moved = sweep_directions(directions, view.inverse_depth.astype(np.float64), Pose(np.eye(3), -view.to_other))
    nearest = RemapTable.for_directions(moved, view.inverse_depth.shape).nearest(other.inverse_depth)
    expected = view.inverse_depth / np.maximum(np.linalg.norm(moved, axis=-1), 1e-6)
    return np.asarray(nearest <= MAX_VISIBLE_RATIO * expected + 0.004)


def _local_contrast(image: Float32[np.ndarray, "height width 3"]) -> Float32[np.ndarray, "height width"]:
    """Standard deviation of grey within 5×5 pixels."""
    grey = image.mean(axis=-1)
    mean, square = cv2.blur(grey, (5, 5)), cv2.blur(grey * grey, (5, 5))
    return np.asarray(np.sqrt(np.maximum(square - mean * mean, 0.0)))


def _smooth_noise(size: tuple[int, ...], rows: int, rng: np.random.Generator) -> Float32[np.ndarray, "height width"]:
    """Smooth random numbers, mostly in [0, 1], that vary over the height ``rows`` times; the same over the seam."""
    coarse = rng.random((rows, 2 * rows), dtype=np.float32)
    height, width = size
    scale = height // rows
    wide = cv2.resize(
        add_border(coarse, 2), ((2 * rows + 4) * scale, (rows + 4) * scale), interpolation=cv2.INTER_CUBIC
    )
    return np.asarray(wide[2 * scale : 2 * scale + height, 2 * scale : 2 * scale + width])


def _simulate_matches(
    truth: Float32[np.ndarray, "height width"],
    left_right_consistent: Bool[np.ndarray, "height width"],
    rng: np.random.Generator,
) -> Float32[np.ndarray, "height width"]:
    """The best match of every pixel: nearly right where matching is sure, elsewhere right, too far or anything."""
    size, sqrt_depth = truth.shape, sqrt_inv_depth(truth)
    exact = sqrt_depth * (1.0 + rng.uniform(0.002, 0.015) * rng.standard_normal(size, dtype=np.float32))
    behind = cv2.erode(sqrt_depth, np.ones((9, 9), np.uint8)) * (1.0 + 0.3 * (_smooth_noise(size, 16, rng) - 0.5))
    anything = _smooth_noise(size, 16, rng) * rng.uniform(0.3, 1.5)
    luck = _smooth_noise(size, 16, rng)
    guess = np.where(luck < 0.35, exact, np.where(luck < 0.65, behind, anything))
    return np.asarray(
        np.square(np.clip(np.where(left_right_consistent, exact, guess), 0.0, MAX_SQRT_INV_DEPTH)), np.float32
    )


def _fatten_silhouettes(
    truth: Float32[np.ndarray, "height width"],
    left_right_consistent: Bool[np.ndarray, "height width"],
    matched: Float32[np.ndarray, "height width"],
    rng: np.random.Generator,
) -> tuple[Bool[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]:
    """What windows make of silhouettes: near things grow by some pixels, thin ones are lost, and much of it is sure."""
    sqrt_depth, size = sqrt_inv_depth(truth), truth.shape
    wide, thin = (np.ones((int(rng.integers(*sides)),) * 2, np.uint8) for sides in ((2, 9), (1, 6)))
    grown = filter_across_seam(partial(cv2.dilate, kernel=wide), sqrt_depth, len(wide))
    opened = filter_across_seam(partial(cv2.morphologyEx, op=cv2.MORPH_OPEN, kernel=thin), sqrt_depth, 2 * len(thin))
    for wrong, most in ((grown, 1.0), (opened, 0.8)):
        is_wrong = (np.abs(wrong - sqrt_depth) > MIN_SILHOUETTE_STEP) & (
            _smooth_noise(size, 16, rng) < rng.uniform(0.3, most)
        )
        noisy = wrong * (1.0 + 0.01 * rng.standard_normal(size, dtype=np.float32))
        matched = np.where(is_wrong, np.square(np.clip(noisy, 0.0, MAX_SQRT_INV_DEPTH)), matched)
        left_right_consistent = np.where(
            is_wrong, _smooth_noise(size, 32, rng) < rng.uniform(0.3, 1.0), left_right_consistent
        )
    return left_right_consistent, matched.astype(np.float32)


def _add_false_islands(
    left_right_consistent: Bool[np.ndarray, "height width"],
    matched: Float32[np.ndarray, "height width"],
    rng: np.random.Generator,
) -> tuple[Bool[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]:
    """Islands that pass for sure and are wrong."""
    height, width = left_right_consistent.shape
    for _ in range(int(rng.integers(0, 6))):
        island = np.zeros((height, width), np.uint8)
        centre, reach = (int(rng.integers(width)), int(rng.integers(height))), height / 128.0
        axes = int(rng.uniform(1, 14) * reach) + 1, int(rng.uniform(1, 8) * reach) + 1
        cv2.ellipse(island, centre, axes, float(rng.uniform(0, 180)), 0, 360, 1, -1)
        is_wrong = island > 0
        matched = np.where(is_wrong, np.clip(matched * rng.uniform(0.1, 4.0), 0.0, MAX_SQRT_INV_DEPTH**2), matched)
        left_right_consistent = left_right_consistent | (is_wrong & (rng.random() < 0.6))
    return left_right_consistent, matched.astype(np.float32)


def _random_nadir_mask(
    up: np.ndarray, size: tuple[int, ...], rng: np.random.Generator
) -> Bool[np.ndarray, "height width"]:
    """Now and then a mask hides what stands at the nadir."""
    if rng.random() < 0.8:
        return np.ones(size, np.bool_)
    elevation = pixel_directions(*size) @ up
    return np.asarray(elevation > -np.cos(rng.uniform(0.15, 0.6)))
