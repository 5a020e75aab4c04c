"""Training data for the completion network: what matching would know of rendered scenes, without any matching.

Exact depth says what the other camera cannot see, and colours where nothing can be told apart; so what matching is sure
of can be made up for a hundredth of the time that matching takes, and differently every time a scene is seen. Of the
rest some is given up by chance, some is wrong, and some of what is wrong passes for sure. Views come from the pool of
the depth networks and are turned from the frame of the epipoles to a camera held nearly upright, as the evidence of
real matching is (:mod:`omnisyn_cli.stereo.stereo_features`). Real evidence (:mod:`omnisyn_cli.training.evidence_pool`) comes
last, as fine-tuning.
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
from omnisyn_cli.training.data import Augmentation, EvidenceBatch, PoolScene, is_made_by, load_scene, vary_colours
from omnisyn_cli.training.evidence_pool import evidence_pair
from omnisyn_cli.training.pool import held_askew

TILTS = (0.0, 0.02, 0.1)
"""Standard deviations of pitch and roll in radians that a pair draws one of."""

SEEN_WITHIN = 1.08
"""Factor within which the other view has to have the same inverse depth for a point to be seen there."""

UNKNOWN = np.float32(1e-6)
"""Inverse depth in 1/baselines where the truth is not known."""

APART = 0.03
"""Difference of roots between two sides of a silhouette."""

ZENITH = np.array([0.0, 1.0, 0.0])
"""Of the epipole frame: where the later cameras on the line are."""


@dataclass(frozen=True)
class _Turned:
    """A view held nearly upright.

    Attributes:
        image: the picture.
        inverse_depth: in 1/baselines; next to nothing where it is not known, so that it is no sky.
        towards: direction to the other camera.
        is_known: where there is a truth.
    """

    image: Float32[np.ndarray, "height width 3"]
    inverse_depth: Float32[np.ndarray, "height width"]
    towards: Float[np.ndarray, " 3"]
    is_known: Bool[np.ndarray, "height width"]


def draw_completion(
    pool: list[Path],
    rng: np.random.Generator,
    pairs: int,
    size: tuple[int, int],
    augmentation: Augmentation | None = None,
) -> EvidenceBatch:
    """Random pairs of random scenes; every pair gives two samples.

    Args:
        pool: from :func:`omnisyn_cli.training.data.list_pool`, of rendered scenes, of evidence, or of both.
        rng: random numbers.
        pairs: how many.
        size: ``(height, width)``, at most that of the pool.
        augmentation: of the colours; None leaves them as they are. Those of evidence, whose photographs differ already,
            are varied by rules of their own.
    """
    batches = [_drawn(pool[rng.integers(len(pool))], rng, size, augmentation) for _ in range(pairs)]
    columns = (torch.cat([getattr(batch, name) for batch in batches]) for name in ("planes", "root", "baseline"))
    return EvidenceBatch(*columns)


def _drawn(
    path: Path, rng: np.random.Generator, size: tuple[int, int], augmentation: Augmentation | None
) -> EvidenceBatch:
    if is_made_by("evidence", path):
        return evidence_pair(path, rng, size, is_recoloured=augmentation is not None)
    return completion_pair(load_scene(path), rng, size, augmentation)


def completion_pair(
    scene: PoolScene, rng: np.random.Generator, size: tuple[int, int], augmentation: Augmentation | None = None
) -> EvidenceBatch:
    """Two views of a scene, and what matching might have made of them.

    Raises:
        InputError: the views are smaller than ``size``.
    """
    if scene.images.shape[1] < size[0]:
        raise InputError(f"expected a pool of at least {size[0]} rows, got {scene.images.shape[1]}; render another")
    near, far = sorted(rng.choice(len(scene.along), 2, replace=False))
    baseline = float(scene.along[far] - scene.along[near])
    turn = _upright(scene.up, rng)
    views = [_turned(scene, index, turn, size, baseline, sign) for index, sign in ((near, 1.0), (far, -1.0))]
    if augmentation is not None:
        colours = vary_colours(np.stack([view.image for view in views]), rng, augmentation)
        views = [replace(view, image=colour) for colour, view in zip(colours, views, strict=True)]
    up = turn.T @ scene.up
    there, back = (_evidence(*order, up, rng) for order in ((views[0], views[1]), (views[1], views[0])))
    planes = [completion_channels(there, back), completion_channels(back, there)]
    roots = [np.where(view.is_known, sqrt_inv_depth(view.inverse_depth), np.float32(np.nan))[None] for view in views]
    if rng.random() < 0.5:  # in a mirror: all planes are even in it
        planes, roots = ([x[..., ::-1] for x in each] for each in (planes, roots))
    return EvidenceBatch(
        torch.from_numpy(np.stack(planes)),
        torch.from_numpy(np.stack(roots)),
        torch.full((2,), baseline, dtype=torch.float32),
    )


def _upright(up: Float[np.ndarray, " 3"], rng: np.random.Generator) -> Float[np.ndarray, "3 3"]:
    """The frame of the epipoles from that of a camera with any heading, held a little askew."""
    side = np.cross(up, ZENITH)
    length = float(np.linalg.norm(side))
    side = side / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    level = np.stack([side, up, np.cross(side, up)], axis=1)
    tilt = float(rng.choice(TILTS))
    return np.asarray(level @ held_askew(rng, tilt))


def _turned(
    scene: PoolScene, index: int, turn: np.ndarray, size: tuple[int, int], baseline: float, sign: float
) -> _Turned:
    image, inverse_depth = scene.images[index], np.asarray(scene.inverse_depth[index], np.float32)
    turned = RemapTable.for_directions(pixel_directions(*size) @ turn.T, inverse_depth.shape)
    colours, depth = turned.bilinear(image).astype(np.float32) / np.float32(255.0), turned.nearest(inverse_depth)
    is_known = np.isfinite(depth)
    scaled = np.where(is_known, depth * np.float32(baseline), UNKNOWN)
    return _Turned(colours, scaled, sign * turn.T @ ZENITH, is_known)


def _evidence(view: _Turned, other: _Turned, up: np.ndarray, rng: np.random.Generator) -> StereoFeatures:
    """What matching might know of a view: some of the truth, and some that is wrong."""
    size = view.inverse_depth.shape
    usable = _usable(up, size, rng)
    left_right_consistent = _agreed(view, other, rng) & usable & view.is_known
    matched = _matched(view.inverse_depth, left_right_consistent, rng)
    left_right_consistent, matched = _mistaken(*_blunted(view.inverse_depth, left_right_consistent, matched, rng), rng)
    sky = (view.inverse_depth == 0) & (usable | (rng.random() < 0.5))
    sky &= _blobs(size, 8, rng) > rng.choice([0.0, 0.0, 0.4])
    left_right_consistent &= usable & ~sky & (view.inverse_depth > 0) & view.is_known
    weight = np.where(sky, 0.0, np.where(left_right_consistent, 1.0, INCONSISTENT_MATCH_WEIGHT * usable))
    filled = np.where(sky, 0.0, fill_with_planes(matched.astype(np.float64), weight, view.image, usable))
    motion = Pose(np.eye(3), -view.towards)
    return StereoFeatures(view.image, matched, left_right_consistent, sky, filled, usable, motion, up)


def _agreed(view: _Turned, other: _Turned, rng: np.random.Generator) -> Bool[np.ndarray, "height width"]:
    """Where matching would be sure: seen by both, with texture, off the epipoles, not too near, and lucky."""
    size, root = view.inverse_depth.shape, sqrt_inv_depth(view.inverse_depth)
    directions = pixel_directions(*size)
    found = _is_seen(view, other, directions)
    found &= np.abs(directions @ view.towards) < np.cos(np.radians(rng.uniform(3.0, 14.0)))
    coarse, fine = (int(rng.choice([4, 8, 16])) for _ in range(2))
    found &= (_contrast(view.image) > rng.uniform(0.0, 0.01)) | (_blobs(size, 8, rng) > rng.uniform(0.0, 0.6))
    found &= (root < rng.uniform(0.7, 1.5)) | (_blobs(size, coarse, rng) > rng.uniform(0.0, 0.6))
    found &= _blobs(size, fine, rng) > rng.uniform(-0.4, 0.25)
    if rng.random() < 0.6:  # windows that lie across an edge match neither side
        found = cv2.erode(found.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    if rng.random() < 0.3:
        jumps = cv2.morphologyEx(root, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0.1
        found &= ~jumps
    return np.asarray(found)


def _is_seen(view: _Turned, other: _Turned, directions: np.ndarray) -> Bool[np.ndarray, "height width"]:
    """Whether the other camera sees the same point."""
    moved = sweep_directions(directions, view.inverse_depth.astype(np.float64), Pose(np.eye(3), -view.towards))
    nearest = RemapTable.for_directions(moved, view.inverse_depth.shape).nearest(other.inverse_depth)
    expected = view.inverse_depth / np.maximum(np.linalg.norm(moved, axis=-1), 1e-6)
    return np.asarray(nearest <= SEEN_WITHIN * expected + 0.004)


def _contrast(image: Float32[np.ndarray, "height width 3"]) -> Float32[np.ndarray, "height width"]:
    """Standard deviation of grey within 5×5 pixels."""
    grey = image.mean(axis=-1)
    mean, square = cv2.blur(grey, (5, 5)), cv2.blur(grey * grey, (5, 5))
    return np.asarray(np.sqrt(np.maximum(square - mean * mean, 0.0)))


def _blobs(size: tuple[int, ...], rows: int, rng: np.random.Generator) -> Float32[np.ndarray, "height width"]:
    """Smooth random numbers, mostly in [0, 1], that vary over the height ``rows`` times; the same over the seam."""
    coarse = rng.random((rows, 2 * rows), dtype=np.float32)
    height, width = size
    scale = height // rows
    wide = cv2.resize(
        add_border(coarse, 2), ((2 * rows + 4) * scale, (rows + 4) * scale), interpolation=cv2.INTER_CUBIC
    )
    return np.asarray(wide[2 * scale : 2 * scale + height, 2 * scale : 2 * scale + width])


def _matched(
    truth: Float32[np.ndarray, "height width"], left_right_consistent: Bool[np.ndarray, "height width"], rng: np.random.Generator
) -> Float32[np.ndarray, "height width"]:
    """The best match of every pixel: nearly right where matching is sure, elsewhere right, too far or anything."""
    size, root = truth.shape, sqrt_inv_depth(truth)
    exact = root * (1.0 + rng.uniform(0.002, 0.015) * rng.standard_normal(size, dtype=np.float32))
    behind = cv2.erode(root, np.ones((9, 9), np.uint8)) * (1.0 + 0.3 * (_blobs(size, 16, rng) - 0.5))
    anything = _blobs(size, 16, rng) * rng.uniform(0.3, 1.5)
    luck = _blobs(size, 16, rng)
    guess = np.where(luck < 0.35, exact, np.where(luck < 0.65, behind, anything))
    return np.asarray(np.square(np.clip(np.where(left_right_consistent, exact, guess), 0.0, MAX_SQRT_INV_DEPTH)), np.float32)


def _blunted(
    truth: Float32[np.ndarray, "height width"],
    left_right_consistent: Bool[np.ndarray, "height width"],
    matched: Float32[np.ndarray, "height width"],
    rng: np.random.Generator,
) -> tuple[Bool[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]:
    """What windows make of silhouettes: near things grow by some pixels, thin ones are lost, and much of it is sure."""
    root, size = sqrt_inv_depth(truth), truth.shape
    wide, thin = (np.ones((int(rng.integers(*sides)),) * 2, np.uint8) for sides in ((2, 9), (1, 6)))
    grown = filter_across_seam(partial(cv2.dilate, kernel=wide), root, len(wide))
    opened = filter_across_seam(partial(cv2.morphologyEx, op=cv2.MORPH_OPEN, kernel=thin), root, 2 * len(thin))
    for wrong, most in ((grown, 1.0), (opened, 0.8)):
        is_wrong = (np.abs(wrong - root) > APART) & (_blobs(size, 16, rng) < rng.uniform(0.3, most))
        noisy = wrong * (1.0 + 0.01 * rng.standard_normal(size, dtype=np.float32))
        matched = np.where(is_wrong, np.square(np.clip(noisy, 0.0, MAX_SQRT_INV_DEPTH)), matched)
        left_right_consistent = np.where(is_wrong, _blobs(size, 32, rng) < rng.uniform(0.3, 1.0), left_right_consistent)
    return left_right_consistent, matched.astype(np.float32)


def _mistaken(
    left_right_consistent: Bool[np.ndarray, "height width"], matched: Float32[np.ndarray, "height width"], rng: np.random.Generator
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


def _usable(up: np.ndarray, size: tuple[int, ...], rng: np.random.Generator) -> Bool[np.ndarray, "height width"]:
    """Now and then a mask hides what stands at the nadir."""
    if rng.random() < 0.8:
        return np.ones(size, np.bool_)
    elevation = pixel_directions(*size) @ up
    return np.asarray(elevation > -np.cos(rng.uniform(0.15, 0.6)))
