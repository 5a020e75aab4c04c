"""The path of the virtual camera: when it is where, and which way the picture looks.

A chain of panoramas is walked along straight lines at constant speed (or starting and stopping gently). One frame falls
exactly on every panorama, so that the photograph itself is shown there and the change of segment cannot be seen.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from jaxtyping import Float

from omnisyn_cli.geometry.pose import SAME_POSITION_METRES, Pose, distance_between, rotation_taking, slerp
from omnisyn_cli.geometry.sphere import FORWARD

Ease = Literal["linear", "smooth"]
Heading = Literal["panoramas", "first", "fixed", "travel"]
EASES: tuple[Ease, ...] = ("linear", "smooth")
HEADINGS: tuple[Heading, ...] = ("panoramas", "first", "fixed", "travel")
"""How time runs along the way, and where the image centre looks, by the values of options."""


@dataclass(frozen=True)
class Waypoint:
    """Where one frame is taken."""

    segment: int  # index of the pair (panorama ``segment`` and the next)
    t: float  # share of the way from the first panorama of the pair to the second, in [0, 1]
    pose: Pose  # world-from-camera of the frame


def path_length(poses: Sequence[Pose]) -> float:
    """Metres from the first panorama through all others to the last."""
    return float(_segment_lengths(poses).sum())


def plan_path(
    poses: Sequence[Pose], frames: int, *, ease: Ease = "linear", heading: Heading = "panoramas"
) -> list[Waypoint]:
    """Waypoints of ``frames`` frames, at least one per panorama, from the first to the last of two poses or more.

    ``ease``: ``linear`` is constant speed, ``smooth`` starts and stops gently (smoothstep). ``heading`` is where the
    image centre looks: ``panoramas`` turns from each photograph's orientation to the next's, so that the photographs
    themselves appear; ``first`` keeps the first one's; ``fixed`` keeps the world's axes (centre along −z, level);
    ``travel`` looks along the way, level.

    Raises ValueError: fewer than two poses, or fewer frames than poses.
    """
    if len(poses) < 2:
        raise ValueError(f"expected at least two panoramas, got {len(poses)}")
    if frames < len(poses):
        raise ValueError(f"expected at least one frame per panorama ({len(poses)}), got {frames}")
    where = _places(_segment_lengths(poses), frames, ease)
    segment_index = np.minimum(where.astype(int), len(poses) - 2)
    path = []
    for k, (first, second) in enumerate(pairwise(poses)):
        t = where[segment_index == k] - k  # shares of the way; exact at 0 and 1
        positions = (1.0 - t)[:, None] * first.position + t[:, None] * second.position
        posed = map(Pose, _rotations(poses, k, t, heading), positions)
        path += [Waypoint(k, float(share), pose) for share, pose in zip(t, posed, strict=True)]
    return path


def _segment_lengths(poses: Sequence[Pose]) -> Float[np.ndarray, " segments"]:
    return np.array([distance_between(a, b) for a, b in pairwise(poses)])


def _places(lengths: np.ndarray, frames: int, ease: Ease) -> Float[np.ndarray, " frames"]:
    """For every frame segment + t, one frame on every panorama; turns in place take the mean time of the others."""
    moving = lengths > SAME_POSITION_METRES
    typical = lengths[moving].mean() if moving.any() else 1.0
    knots = np.concatenate([[0.0], np.cumsum(np.where(moving, lengths, typical))])
    time = np.linspace(0.0, 1.0, frames)
    walked = knots[-1] * (time * time * (3.0 - 2.0 * time) if ease == "smooth" else time)
    nearest = _frames_at_knots(walked, knots)
    segment_of_frame = np.interp(walked, knots, np.arange(len(knots)))
    snapped = np.interp(segment_of_frame, segment_of_frame[nearest], np.arange(len(knots)))
    snapped[nearest] = np.arange(len(knots))
    return np.maximum.accumulate(snapped)


def _frames_at_knots(walked: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """The frame nearest to each panorama; every panorama gets one of its own, in order, the ends the ends."""
    order, last = np.arange(len(knots)), len(walked) - 1
    after = np.clip(np.searchsorted(walked, knots), 1, last)
    nearest = np.where(knots - walked[after - 1] <= walked[after] - knots, after - 1, after)
    nearest[0], nearest[-1] = 0, last
    later = np.maximum.accumulate(nearest - order) + order
    return np.minimum(later, last - order[::-1])


def _rotations(poses: Sequence[Pose], segment: int, t: np.ndarray, heading: Heading) -> Float[np.ndarray, "frames 3 3"]:
    if heading == "fixed":
        return np.broadcast_to(np.eye(3), (len(t), 3, 3))
    if heading == "first":
        return np.broadcast_to(poses[0].rotation, (len(t), 3, 3))
    if heading == "travel":
        return _travel_rotations(poses, segment, t)
    return slerp(poses[segment].rotation, poses[segment + 1].rotation, t)


def _travel_rotations(poses: Sequence[Pose], segment: int, t: np.ndarray) -> Float[np.ndarray, "frames 3 3"]:
    """Level, looking along the way; within the second half of a segment it begins to turn into the next one."""
    # at a panorama half way between the directions before and after it, so that a corner is turned smoothly
    here = _level_direction(poses, segment)
    begin = slerp(_level_direction(poses, segment - 1), here, 0.5)
    end = slerp(here, _level_direction(poses, segment + 1), 0.5)
    is_early = (t < 0.5)[:, None, None]
    return np.where(is_early, slerp(begin, here, 2.0 * t), slerp(here, end, 2.0 * t - 1.0))


def _level_direction(poses: Sequence[Pose], segment: int) -> Float[np.ndarray, "3 3"]:
    """Rotation whose −z looks along a segment, level; one without a horizontal way borrows the nearest that has."""
    count = len(poses) - 1
    wanted = min(max(segment, 0), count - 1)
    for candidate in sorted(range(count), key=lambda k: (abs(k - wanted), k)):
        level = (poses[candidate + 1].position - poses[candidate].position) * np.array([1.0, 0.0, 1.0])
        length = float(np.linalg.norm(level))
        if length > SAME_POSITION_METRES:
            is_back = level[2] / length > 1.0 - 1e-12  # the half turn about the vertical, not about any other axis
            return np.diag([-1.0, 1.0, -1.0]) if is_back else rotation_taking(FORWARD, level / length)
    return poses[wanted].rotation
