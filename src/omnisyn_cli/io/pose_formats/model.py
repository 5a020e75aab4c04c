"""What readers of other programs' poses are asked and what they answer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from omnisyn_cli.geometry.pose import Pose

__all__ = ["ImportOptions", "ImportedPoses", "ImportedView", "Origin"]

Origin = tuple[float, float, float]
"""WGS84 latitude and longitude in degrees, altitude in metres."""


@dataclass(frozen=True)
class ImportOptions:
    """What a user may say about a source.

    Attributes:
        images: folder with the panoramas; None looks where the format usually has them.
        origin: where the world's origin lies; None leaves it where the format has it, or at the first panorama.
        up: a name of :data:`omnisyn_cli.io.pose_formats.axes.WORLD_UP` or ``cameras``; None is the format's own.
        camera: a name of :data:`omnisyn_cli.io.pose_formats.axes.CAMERA_AXES`; None is the format's own.
        floor: the floor of a ZInD tour; None is the only one.
        time_tolerance: seconds by which time stamps of poses and images may differ.
        allow_outside: whether files that a source names may lie outside its folder.
    """

    images: Path | None = None
    origin: Origin | None = None
    up: str | None = None
    camera: str | None = None
    floor: str | None = None
    time_tolerance: float = 0.02
    allow_outside: bool = False


@dataclass(frozen=True)
class ImportedView:
    """One panorama.

    Attributes:
        name: as the source calls it, a path with forward slashes.
        pose: camera-to-world in our axes.
        image: the file, or None where it was not found.
        depth: a depth file that ``poses.json`` can refer to, or None.
    """

    name: str
    pose: Pose
    image: Path | None = None
    depth: Path | None = None


@dataclass(frozen=True)
class ImportedPoses:
    """What a source says.

    Attributes:
        views: in the order of the source, or of the file names where it has none.
        notes: one line for everything that was assumed, in words for the user.
    """

    views: tuple[ImportedView, ...]
    notes: tuple[str, ...]
