"""The way of the virtual camera: when it is where, and which way the picture looks.

A chain of panoramas is walked along straight lines at constant speed (or starting and stopping gently). One frame falls
exactly on every panorama, so that the photograph itself is shown there and the change of segment cannot be seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from jaxtyping import Float

from omnisyn_cli.geometry.pose import Pose, rotation_taking, slerp

__all__ = ["EASES", "HEADINGS", "STILL", "Ease", "Heading", "Waypoint", "path_length", "plan_path"]

Ease = Literal["linear", "smooth"]
Heading = Literal["panoramas", "first", "fixed", "travel"]
EASES: tuple[Ease, ...] = ("linear", "smooth")
HEADINGS: tuple[Heading, ...] = ("panoramas", "first", "fixed", "travel")

STILL = 1e-9
"""Panoramas closer than this (metres) are at the same place."""

UP = np.array([0.0, 1.0, 0.0])
FORWARD = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True)
class Waypoint:
    """Where one frame is taken.

    Attributes:
        segment: index of the pair (panorama ``segment`` and the next).
        t: share of the way from the first panorama of the pair to the second, in [0, 1].
        pose: world-from-camera of the frame.
    """

    segment: int
    t: float
    pose: Pose


def path_length(poses: Sequence[Pose]) -> float:
    """Metres from the first panorama through all others to the last."""
    return float(_segment_lengths(poses).sum())


def plan_path(
    poses: Sequence[Pose], frames: int, *, ease: Ease = "linear", heading: Heading = "panoramas"
) -> list[Waypoint]:
    """Waypoints of ``frames`` frames from the first to the last panorama.

    Args:
        poses: world-from-camera, two or more.
        frames: at least one per panorama.
        ease: ``linear`` is constant speed, ``smooth`` starts and stops gently (smoothstep).
        heading: which way the image centre looks: ``panoramas`` turns from each photograph's orientation to the next's,
            so that the photographs themselves appear; ``first`` keeps the first one's; ``fixed`` keeps the world's axes
            (centre along −z, level); ``travel`` looks along the way, level.

    Raises:
        ValueError: fewer than two poses, or fewer frames than poses.
    """
    if len(poses) < 2:
        raise ValueError(f"expected at least two panoramas, got {len(poses)}")
    if frames < len(poses):
        raise ValueError(f"expected at least one frame per panorama ({len(poses)}), got {frames}")
    return [_waypoint(poses, where, heading) for where in _places(_segment_lengths(poses), frames, ease)]


def _segment_lengths(poses: Sequence[Pose]) -> Float[np.ndarray, " segments"]:
    return np.array([np.linalg.norm(b.position - a.position) for a, b in pairwise(poses)])


def _places(lengths: np.ndarray, frames: int, ease: Ease) -> Float[np.ndarray, " frames"]:
    """For every frame segment + t, with one frame on every panorama.

    Segments of no length (a turn in place) take the mean time of the others.
    """
    moving = lengths > STILL
    typical = lengths[moving].mean() if moving.any() else 1.0
    knots = np.concatenate([[0.0], np.cumsum(np.where(moving, lengths, typical))])
    time = np.linspace(0.0, 1.0, frames)
    way = knots[-1] * (time * time * (3.0 - 2.0 * time) if ease == "smooth" else time)
    nearest = _frames_at_knots(way, knots)
    segment_of_frame = np.interp(way, knots, np.arange(len(knots)))
    snapped = np.interp(segment_of_frame, segment_of_frame[nearest], np.arange(len(knots)))
    snapped[nearest] = np.arange(len(knots))
    return np.maximum.accumulate(snapped)


def _frames_at_knots(way: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """The frame nearest to each panorama; every panorama gets one of its own, in order, the ends the ends."""
    order, last = np.arange(len(knots)), len(way) - 1
    nearest = np.abs(way[None, :] - knots[:, None]).argmin(axis=1)
    nearest[0], nearest[-1] = 0, last
    later = np.maximum.accumulate(nearest - order) + order
    return np.minimum(later, last - order[::-1])


def _waypoint(poses: Sequence[Pose], where: float, heading: Heading) -> Waypoint:
    segment = min(int(where), len(poses) - 2)
    t = float(where - segment)
    first, second = poses[segment], poses[segment + 1]
    position = first.position if t == 0 else second.position if t == 1 else _between(first, second, t)
    return Waypoint(segment, t, Pose(_rotation(poses, segment, t, heading), position))


def _between(first: Pose, second: Pose, t: float) -> np.ndarray:
    return np.asarray((1.0 - t) * first.position + t * second.position)


def _rotation(poses: Sequence[Pose], segment: int, t: float, heading: Heading) -> Float[np.ndarray, "3 3"]:
    if heading == "fixed":
        return np.eye(3)
    if heading == "first":
        return poses[0].rotation
    if heading == "travel":
        return _travel_rotation(poses, segment, t)
    return slerp(poses[segment].rotation, poses[segment + 1].rotation, t)


def _travel_rotation(poses: Sequence[Pose], segment: int, t: float) -> Float[np.ndarray, "3 3"]:
    """Level, looking along the way; within the second half of a segment it begins to turn into the next one.

    At a panorama it looks half way between the directions before and after it, so that a corner is turned smoothly.
    """
    here = _level_direction(poses, segment)
    before, after = _level_direction(poses, segment - 1), _level_direction(poses, segment + 1)
    if t < 0.5:
        return slerp(slerp(before, here, 0.5), here, 2.0 * t)
    return slerp(here, slerp(here, after, 0.5), 2.0 * t - 1.0)


def _level_direction(poses: Sequence[Pose], segment: int) -> Float[np.ndarray, "3 3"]:
    """Rotation whose −z looks along a segment, level; one without a horizontal way borrows the nearest that has."""
    count = len(poses) - 1
    wanted = min(max(segment, 0), count - 1)
    for candidate in sorted(range(count), key=lambda k: (abs(k - wanted), k)):
        level = (poses[candidate + 1].position - poses[candidate].position) * np.array([1.0, 0.0, 1.0])
        length = float(np.linalg.norm(level))
        if length > STILL:
            return _turn_about_up(level / length)
    return poses[wanted].rotation


def _turn_about_up(direction: np.ndarray) -> np.ndarray:
    if direction[2] > 1.0 - 1e-12:
        return np.diag([-1.0, 1.0, -1.0])  # straight back: the half turn about the vertical, not about any other axis
    return rotation_taking(FORWARD, direction)
