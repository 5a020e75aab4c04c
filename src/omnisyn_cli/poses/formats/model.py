"""What readers of other programs' poses are asked and what they answer, and axes taken to ours and back.

Every format says camera-to-world or its inverse, in axes of its own. A pose of ours is
``ours_from_world · world_from_camera · camera_from_ours`` with one matrix for the world and one for the camera, both
rotations: what is left-handed (ZInD) is mirrored by its own reader.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from omnisyn_cli.errors import PoseError
from omnisyn_cli.geometry.pose import Pose, rotation_taking

MIN_MEAN_UP_LENGTH = 1e-3
"""Length of the mean of the cameras' up vectors below which it has no direction: only rounding is left of it."""

CAMERA_AXES = {
    "opengl": np.eye(3),
    "opencv": np.diag([1.0, -1.0, -1.0]),
    "flu": np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
}
"""``camera_from_ours``: opengl x right, y up, −z forward (ours); opencv x right, y down, z forward; flu x forward,
y left, z up (ROS bodies)."""

WORLD_UP = {
    "y": np.eye(3),
    "-y": np.diag([1.0, -1.0, -1.0]),
    "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "-z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}
"""``ours_from_world`` by the world's axis that points up; x stays x. With z up, y (north) becomes −z."""

Origin = tuple[float, float, float]
"""WGS84 latitude and longitude in degrees, altitude in metres."""


@dataclass(frozen=True)
class ImportOptions:
    """What a user may say about a source."""

    images: Path | None = None  # folder with the panoramas; None looks where the format usually has them
    # where the world's origin lies; None leaves it where the format has it, or at the first panorama
    origin: Origin | None = None
    up: str | None = None  # a name of :data:`WORLD_UP` or ``cameras``; None is the format's own
    camera: str | None = None  # a name of :data:`CAMERA_AXES`; None is the format's own
    # which way the horizon turns in the picture as the roll of a place grows, ``counter-clockwise`` as GPano defines
    # it, or ``clockwise`` as some programs have it; None is the format's own
    roll: str | None = None
    floor: str | None = None  # the floor of a ZInD tour; None is the only one
    time_tolerance: float = 0.02  # seconds by which time stamps of poses and images may differ
    allow_outside: bool = False  # whether files that a source names may lie outside its folder

    def pose(self, foreign: Pose, *, camera: str, up: str) -> Pose:
        """Our pose of a camera-to-world one in the axes ``camera`` and ``up``, or in those that the user names."""
        ours_from_world, camera_from_ours = WORLD_UP[self.up or up], CAMERA_AXES[self.camera or camera]
        return Pose(ours_from_world @ foreign.rotation @ camera_from_ours, ours_from_world @ foreign.position)


@dataclass(frozen=True)
class ImportedView:
    """One panorama."""

    name: str  # as the source calls it, a path with forward slashes
    pose: Pose  # camera-to-world in our axes
    image: Path | None = None  # the file, or None where it was not found
    depth: Path | None = None  # a depth file that ``poses.json`` can refer to, or None


@dataclass(frozen=True)
class ImportedPoses:
    """What a source says."""

    views: tuple[ImportedView, ...]  # in the order of the source, or of the file names where it has none
    notes: tuple[str, ...]  # one line for everything that was assumed, in words for the user


def noted(notes: Mapping[str, object]) -> tuple[str, ...]:
    """The notes whose condition holds."""
    return tuple(note for note, holds in notes.items() if holds)


def foreign_from_pose(pose: Pose, *, camera: str, up: str) -> Pose:
    """A camera-to-world pose in other axes: the inverse of :meth:`ImportOptions.pose`."""
    world_from_ours = WORLD_UP[up].T
    return Pose(world_from_ours @ pose.rotation @ CAMERA_AXES[camera].T, world_from_ours @ pose.position)


def leveled(poses: Sequence[Pose]) -> list[Pose]:
    """The same poses in a world whose y axis is the mean of the cameras' own: level where cameras were held level."""
    mean_up = np.mean([pose.rotation[:, 1] for pose in poses], axis=0)
    length = float(np.linalg.norm(mean_up))
    if length < MIN_MEAN_UP_LENGTH:
        raise PoseError("expected cameras held roughly upright, got directions that cancel out; choose --up by axis")
    turn = Pose(rotation_taking(mean_up / length, np.array([0.0, 1.0, 0.0])), np.zeros(3))
    return [turn @ pose for pose in poses]
