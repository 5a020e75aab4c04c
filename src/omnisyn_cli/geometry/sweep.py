"""Sphere sweep geometry: a frame fixed by the baseline, and the relation of parallax to inverse depth.

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
from omnisyn_cli.geometry.tolerances import SAME_SURFACE_TOLERANCE

Array = Any  # numpy.ndarray or torch.Tensor
Map = Float[np.ndarray, "height width"]

# Inverse depth × baseline that the other camera may be short of: below it two values both mean infinity.
FREE_SPACE_SLACK = 1e-3
# Least inverse depth × baseline that differences in a neighbourhood are taken relative to; chosen by eye.
MIN_RELATIVE_SCALE = 1e-2
# Relative differences of inverse depth: the largest that counts, and the mean that halves confidence. Chosen on the
# bench of 12 pairs, where the factor lowers the calibration error of confidence from 0.114 to 0.080.
MAX_DISAGREEMENT, HALF_CONFIDENCE_DISAGREEMENT = 0.5, 0.2
# Half the side of the neighbourhood in :func:`neighbourhood_agreement`, as a share of the height.
AGREEMENT_RADIUS = 1 / 128


def epipole_frame(first: Pose, second: Pose) -> tuple[Pose, Pose, float]:
    """Both cameras turned so that +y points from the first to the second, in one orientation; and metres between.

    The image centre looks as nearly straight down as the baseline lets it, so the ground lies at azimuth 0 and the sky
    at the seam; with a vertical baseline it stays near the horizon. Positions stay.
    """
    right, along, baseline = _right_and_along(first, second)
    rotation = np.stack([right, along, np.cross(right, along)], axis=-1)
    return Pose(rotation, first.position), Pose(rotation, second.position), baseline


def forward_frame(first: Pose, second: Pose) -> tuple[Pose, Pose, float]:
    """:func:`epipole_frame`, but −z points to the second. Source: OmniSyn, section 3.2 (horizontal baselines there)."""
    right, along, baseline = _right_and_along(first, second)
    rotation = np.stack([right, np.cross(right, along), -along], axis=-1)
    return Pose(rotation, first.position), Pose(rotation, second.position), baseline


def swap_cameras_in_epipole_frame(image: Shaped[np.ndarray, "*shape"]) -> Shaped[np.ndarray, "*shape"]:
    """An image in the epipole frame after both cameras swapped roles; its own inverse."""
    return np.ascontiguousarray(image[::-1, ::-1])


def swap_cameras_in_forward_frame(image: Shaped[np.ndarray, "*shape"]) -> Shaped[np.ndarray, "*shape"]:
    """An image in the forward frame after both cameras swapped roles; its own inverse."""
    return np.roll(image, image.shape[1] // 2, axis=1)


def parallax_from_inverse_depth(polar_angle: Array, inverse_depth: Array, baseline: float = 1.0) -> Array:
    """Radians in [0, π − polar_angle] down a meridian; angle to the baseline (metres), inverse depth (1/metre)."""
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
    """Where the second camera sees points on a sphere around the first, not normalised: ``R·d + ρ·t``.

    Directions are unit vectors; inverse depths (1/metre, 0 at infinity) broadcast against their first axes.
    """
    xp = array_namespace(directions, inverse_depth)
    rotation = xp.asarray(second_from_first.rotation, dtype=directions.dtype)
    translation = xp.asarray(second_from_first.position, dtype=directions.dtype)
    return directions @ rotation.T + inverse_depth[..., None] * translation


def motion_in_baselines(first: Pose, second: Pose) -> Pose:
    """The transform from the first camera's frame to the second one's, in units of their distance (not 0)."""
    motion = second.inverse() @ first
    return Pose(motion.rotation, motion.position / np.linalg.norm(motion.position))


def reproject_to_second(
    directions: Float[np.ndarray, "*batch 3"], inverse_depth: Float[np.ndarray, "*batch"], second_from_first: Pose
) -> tuple[Float[np.ndarray, "*batch 3"], Float[np.ndarray, "*batch"]]:
    """:func:`sweep_directions`, and the inverse depth from there, both in the unit of ``second_from_first``."""
    exact = inverse_depth.astype(np.float64)
    moved = sweep_directions(directions, exact, second_from_first)
    return moved, exact / np.maximum(np.linalg.norm(moved, axis=-1), 1e-9)


def free_space_agreement(inverse_depth: Map, other: Map, other_from_this: Pose) -> Map:
    """1 where nothing contradicts an estimate (occlusion does not), 0 where the other sees through; in baselines."""
    expected, seen = _expected_and_seen(inverse_depth, other, other_from_this)
    too_far = np.maximum(expected - seen - FREE_SPACE_SLACK, 0.0) / np.maximum(expected, FREE_SPACE_SLACK)
    return np.asarray(1.0 / (1.0 + (too_far / SAME_SURFACE_TOLERANCE) ** 2), np.float32)


def neighbourhood_agreement(inverse_depth: Map, other: Map, other_from_this: Pose) -> Map:
    """1 where both estimates agree around a pixel, ½ where they differ by :data:`HALF_CONFIDENCE_DISAGREEMENT` there.

    A pixel that agrees amid others that do not often does by chance. An occluded surface is not confirmed: it counts as
    :data:`SAME_SURFACE_TOLERANCE` apart. Frames and units are those of :func:`free_space_agreement`.
    """
    expected, seen = _expected_and_seen(inverse_depth, other, other_from_this)
    difference = (expected - seen) / np.maximum(np.maximum(expected, seen), MIN_RELATIVE_SCALE)
    disagreement = np.where(
        difference > 0.0, np.minimum(difference, MAX_DISAGREEMENT), np.minimum(-difference, SAME_SURFACE_TOLERANCE)
    )
    side = 2 * math.ceil(AGREEMENT_RADIUS * len(disagreement)) + 1
    blur = partial(cv2.blur, ksize=(side, side), borderType=cv2.BORDER_REPLICATE)
    mean = filter_across_seam(blur, disagreement.astype(np.float32), side // 2)
    return np.asarray(1.0 / (1.0 + mean / HALF_CONFIDENCE_DISAGREEMENT), np.float32)


def _expected_and_seen(inverse_depth: np.ndarray, other: np.ndarray, other_from_this: Pose) -> tuple[Array, Array]:
    """Inverse depth of all points from the other camera, and the other camera's own estimate in their directions."""
    moved, expected = reproject_to_second(pixel_directions(*inverse_depth.shape), inverse_depth, other_from_this)
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
