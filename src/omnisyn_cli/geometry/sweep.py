"""Sphere sweep geometry: a frame fixed by the baseline, and what an angle of parallax says about inverse depth.

Two panoramas are turned (in full 3-D) into a *canonical frame* that both share. In it the second camera lies at a fixed
direction from the first, so moving a point from one to the other depends on ``inverse_depth · baseline`` alone:

* :func:`epipole_frame`: the zenith (row 0) points along the baseline. Epipolar lines are meridians: a match lies in the
  same column, further down in the second image.
* :func:`forward_frame`: the image centre (−z) points along the baseline with poles kept as upright as possible: the
  paper's frame (section 3.2), for all baselines instead of horizontal ones.

Singular, and said here once: at the two epipoles parallax is zero whatever the depth.
"""

import math
from functools import partial
from typing import Any

import cv2
import numpy as np
from array_api_compat import array_namespace
from jaxtyping import Float, Shaped

from omnisyn_cli.geometry.pose import Pose, rotation_taking
from omnisyn_cli.geometry.sampling import filter_across_seam, sample_nearest
from omnisyn_cli.geometry.sphere import UP, pixel_directions

__all__ = [
    "agreement_around",
    "epipole_frame",
    "exchanged_in_epipole_frame",
    "exchanged_in_forward_frame",
    "forward_frame",
    "free_space_agreement",
    "inverse_depth_from_parallax",
    "motion_in_baselines",
    "parallax_from_inverse_depth",
    "seen_from_second",
    "sweep_directions",
]

Array = Any  # numpy.ndarray or torch.Tensor

TOLERANCE = 0.1
"""Relative error in inverse depth that counts as agreement between two views."""

INFINITE = 1e-3
"""Inverse depth × baseline below which two values need not agree."""

FAINT = 1e-2
"""Inverse depth × baseline that differences around a pixel are relative to at least."""

FARTHEST_APART, HALVING = 0.5, 0.2
"""Relative difference that is as bad as any, and the mean of them around a pixel that halves what it is worth."""

NEARBY = 1 / 128
"""Of the height, to every side: what is around a pixel."""


def epipole_frame(first: Pose, second: Pose) -> tuple[Pose, Pose, float]:
    """Both cameras turned so that +y points from the first to the second and both share one orientation.

    The image centre looks as nearly straight down as the baseline lets it, so the ground lies at azimuth 0 and the sky
    at the seam; with a vertical baseline it stays near the horizon.

    Returns:
        ``(first, second, baseline)``: the turned world-from-camera poses (same positions) and the distance in metres.
    """
    right, along, baseline = _right_and_along(first, second)
    rotation = np.stack([right, along, np.cross(right, along)], axis=-1)
    return Pose(rotation, first.position), Pose(rotation, second.position), baseline


def forward_frame(first: Pose, second: Pose) -> tuple[Pose, Pose, float]:
    """Both cameras turned so that −z points from the first to the second; otherwise as :func:`epipole_frame`.

    Source: OmniSyn, section 3.2 (there for horizontal baselines).
    """
    right, along, baseline = _right_and_along(first, second)
    rotation = np.stack([right, np.cross(right, along), -along], axis=-1)
    return Pose(rotation, first.position), Pose(rotation, second.position), baseline


def exchanged_in_epipole_frame(image: Shaped[np.ndarray, "*shape"]) -> Shaped[np.ndarray, "*shape"]:
    """An image in the epipole frame as it looks when the roles of both cameras are exchanged; its own inverse."""
    return np.ascontiguousarray(image[::-1, ::-1])


def exchanged_in_forward_frame(image: Shaped[np.ndarray, "*shape"]) -> Shaped[np.ndarray, "*shape"]:
    """An image in the forward frame as it looks when the roles of both cameras are exchanged; its own inverse."""
    return np.roll(image, image.shape[1] // 2, axis=1)


def parallax_from_inverse_depth(polar_angle: Array, inverse_depth: Array, baseline: float = 1.0) -> Array:
    """How far down its meridian a point moves from the first image to the second, radians in [0, π − polar_angle].

    ``polar_angle`` is the angle between the baseline (metres) and the direction in the first camera; an inverse depth
    (1/metre, as seen from the first camera) of 0 is infinitely far.
    """
    xp = array_namespace(polar_angle, inverse_depth)
    shift = inverse_depth * baseline
    return xp.atan2(shift * xp.sin(polar_angle), 1.0 - shift * xp.cos(polar_angle))


def inverse_depth_from_parallax(polar_angle: Array, parallax: Array, baseline: float = 1.0) -> Array:
    """Inverse depth (1/metre) in the first camera from a parallax in radians, by the law of sines.

    ``ρ = sin δ / (baseline · sin(polar_angle + δ))``. Where the rays meet behind the cameras or nowhere
    (``polar_angle + δ`` at 0 or π or beyond) the answer is 0 for no parallax and infinity otherwise.
    """
    xp = array_namespace(polar_angle, parallax)
    far_side = xp.sin(polar_angle + parallax)
    is_open = far_side > 1e-12
    inverse_depth = xp.sin(parallax) / (baseline * xp.where(is_open, far_side, xp.ones_like(far_side)))
    unmeasurable = xp.where(parallax > 0, xp.full_like(inverse_depth, math.inf), xp.zeros_like(inverse_depth))
    return xp.where(is_open, inverse_depth, unmeasurable)


def sweep_directions(
    directions: Float[Array, "*batch 3"], inverse_depth: Array, second_from_first: Pose
) -> Float[Array, "*batch 3"]:
    """Where points on a sphere around the first camera are seen by the second, not normalised.

    The homogeneous form ``R·d + ρ·t``: nothing divides, and ρ = 0 is the sphere at infinity.

    ``directions`` are unit vectors of the first camera; inverse depths (1/metre) broadcast against their first axes.
    """
    xp = array_namespace(directions, inverse_depth)
    rotation = xp.asarray(second_from_first.rotation, dtype=directions.dtype)
    translation = xp.asarray(second_from_first.position, dtype=directions.dtype)
    turned = directions @ rotation.T
    return turned + inverse_depth[..., None] * translation


def motion_in_baselines(first: Pose, second: Pose) -> Pose:
    """Takes points of the first camera's frame to the second one's; the unit is the distance between both, not 0."""
    motion = second.inverse() @ first
    return Pose(motion.rotation, motion.position / np.linalg.norm(motion.position))


def seen_from_second(
    directions: Float[np.ndarray, "*batch 3"], inverse_depth: Float[np.ndarray, "*batch"], second_from_first: Pose
) -> tuple[Float[np.ndarray, "*batch 3"], Float[np.ndarray, "*batch"]]:
    """Where the second camera sees points, as :func:`sweep_directions`, and their inverse depth from there.

    Inverse depth is in the inverse of the unit that ``second_from_first`` is in, and is so from there.
    """
    exact = inverse_depth.astype(np.float64)
    moved = sweep_directions(directions, exact, second_from_first)
    return moved, exact / np.maximum(np.linalg.norm(moved, axis=-1), 1e-9)


def free_space_agreement(
    inverse_depth: Float[np.ndarray, "height width"], other: Float[np.ndarray, "height width"], other_from_this: Pose
) -> Float[np.ndarray, "height width"]:
    """1 where nothing contradicts an estimate, falling to 0 where the other camera sees through the surface.

    Where the other camera sees something nearer the surface is merely hidden from it, which contradicts nothing.

    Inverse depths, each in its own panorama's frame, and the translation of ``other_from_this`` are in baselines.
    """
    expected, seen = _as_seen_by_other(inverse_depth, other, other_from_this)
    too_far = np.maximum(expected - seen - INFINITE, 0.0) / np.maximum(expected, INFINITE)
    return np.asarray(1.0 / (1.0 + (too_far / TOLERANCE) ** 2), np.float32)


def agreement_around(
    inverse_depth: Float[np.ndarray, "height width"], other: Float[np.ndarray, "height width"], other_from_this: Pose
) -> Float[np.ndarray, "height width"]:
    """1 where both estimates agree around a pixel, ½ where they are :data:`HALVING` apart there in the mean.

    What agrees amid what does not does so by chance more often. A surface that is hidden from the other camera is not
    contradicted, but not confirmed either: it counts as :data:`TOLERANCE` apart.

    Frames and units are those of :func:`free_space_agreement`.
    """
    expected, seen = _as_seen_by_other(inverse_depth, other, other_from_this)
    apart = (expected - seen) / np.maximum(np.maximum(expected, seen), FAINT)
    apart = np.where(apart > 0.0, np.minimum(apart, FARTHEST_APART), np.minimum(-apart, TOLERANCE))
    side = 2 * math.ceil(NEARBY * len(apart)) + 1
    mean = partial(cv2.blur, ksize=(side, side), borderType=cv2.BORDER_REPLICATE)
    around = filter_across_seam(mean, apart.astype(np.float32), side // 2)
    return np.asarray(1.0 / (1.0 + around / HALVING), np.float32)


def _as_seen_by_other(inverse_depth: np.ndarray, other: np.ndarray, other_from_this: Pose) -> tuple[Array, Array]:
    """Inverse depth from the other camera of all points, and what it estimates in their directions itself."""
    moved, expected = seen_from_second(pixel_directions(*inverse_depth.shape), inverse_depth, other_from_this)
    return expected, sample_nearest(other, moved)


def _right_and_along(first: Pose, second: Pose) -> tuple[np.ndarray, np.ndarray, float]:
    """Orthogonal unit vectors, level (but for a vertical baseline) and along the baseline, and its length in metres."""
    offset = second.position - first.position
    baseline = float(np.linalg.norm(offset))
    if baseline == 0.0:
        raise ValueError("expected two different positions, got a baseline of 0 m; a turn in place has no sweep")
    along = offset / baseline
    right = np.cross(along, UP)
    length = float(np.linalg.norm(right))
    if length > 1e-6:
        return right / length, along, baseline
    return rotation_taking(UP if along[1] >= 0 else -UP, along) @ np.array([1.0, 0.0, 0.0]), along, baseline
