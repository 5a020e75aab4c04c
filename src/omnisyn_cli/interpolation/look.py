"""Which way a flat video looks: along the way, as the first panorama does, or as its author says."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.geometry.sphere import FORWARD, direction_to_angles
from omnisyn_cli.io.documents import read_keyframes
from omnisyn_cli.synthesis.trajectory import Waypoint

LOOK_AHEAD, LOOK_FIRST = "ahead", "first"  # words for directions


def look_along(path: Sequence[Waypoint], first: Pose, look: str) -> tuple[Waypoint, ...]:
    """A path that looks along the way, with level pictures that look as ``look`` says.

    That is ``ahead``, ``first`` (as the first panorama does), ``YAW,PITCH`` in degrees, or the name of a file of
    keyframes. Raises InputError: none of these, or a malformed file.
    """
    if look == LOOK_AHEAD:
        return tuple(path)
    yaw, pitch = _angles(look, len(path))
    heading = float(direction_to_angles(first.rotation @ FORWARD)[0])
    return tuple(
        replace(waypoint, pose=Pose(rotation_from_heading(heading + across, up), waypoint.pose.position))
        for waypoint, across, up in zip(path, yaw, pitch, strict=True)
    )


def _angles(look: str, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Yaw to the right and pitch upwards of every frame, in radians."""
    if look.endswith(".json"):
        keys = read_keyframes(Path(look))
        shares, times = np.linspace(0.0, 1.0, frames), [key.at for key in keys]
        yaws, pitches = [key.yaw for key in keys], [key.pitch for key in keys]
        return np.radians(np.interp(shares, times, yaws)), np.radians(np.interp(shares, times, pitches))
    try:
        yaw, pitch = map(float, ("0", "0") if look == LOOK_FIRST else look.split(","))
    except ValueError:
        yaw = pitch = math.nan
    if not (math.isfinite(yaw) and abs(pitch) <= 90.0):
        raise InputError(
            f"expected ahead, first, YAW,PITCH in degrees or the name of a .json file to look at, got {look!r:.60}; "
            "choose one"
        )
    return np.full(frames, math.radians(yaw)), np.full(frames, math.radians(pitch))
