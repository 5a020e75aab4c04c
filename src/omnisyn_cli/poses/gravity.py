"""Which way is up in a single panorama, also where the camera hung upside down or lay on its side.

Vertical edges tell the axis to a fraction of a degree, but not its end, and in rooms other edges are as straight.
A network (:mod:`omnisyn_cli.networks.attitude`) tells which of six ways to hold the picture is likeliest.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from omnisyn_cli.geometry.pose import rotation_taking
from omnisyn_cli.geometry.resize import resize_area
from omnisyn_cli.geometry.sampling import rotated_image
from omnisyn_cli.geometry.sphere import UP
from omnisyn_cli.poses.registration.features import Picture, Usable, grey_of
from omnisyn_cli.poses.registration.scan import SMALL_SIZE, Lines, Vertical, find_lines, find_vertical
from omnisyn_cli.runtime.session import open_model, run_network

# Axes of the camera near which the vertical is looked for: its own, to the right and ahead.
AXES = (UP, np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
NETWORK_SIZE = (128, 256)  # rows and columns that the network sees
MIN_LOG_ODDS = 1.0  # against upright, from which on a picture is called otherwise
# Standard deviation up to which a zenith is certain: 2.5 of them are 1°.
MAX_STD = math.radians(0.4)
MIN_USABLE_SHARE = 0.75  # of the pixels; parts of the sphere lack the poles

# What to do about attitudes that are not upright.
REMEDIES = {
    "upside down": "if so, rotate the picture by 180°",
    "rolled by 90°": "if so, turn it upright (ffmpeg -vf v360=e:e:roll=90, or -90)",
}


@dataclass(frozen=True)
class Gravity:
    """How a camera was held."""

    vertical: Vertical  # the zenith in the camera's frame, by vertical edges
    attitude: str  # "upright", or a key of :data:`REMEDIES`

    @property
    def tilt(self) -> float:
        """Radians between the zenith and the camera's own."""
        return math.acos(max(-1.0, min(1.0, float(self.vertical.up @ UP))))


def gravity_of_picture(image: Picture, usable: Usable = None) -> Gravity:
    """:func:`gravity_of` of a panorama."""
    return gravity_of(resize_area(image, SMALL_SIZE), find_lines(grey_of(image), usable), usable)


def gravity_of(small: Picture, lines: Lines, usable: Usable = None) -> Gravity:
    """How the camera of a small picture with these lines was held: upright unless there is evidence against it."""
    found = [find_vertical(lines, axis) for axis in AXES]
    verticals = [replace(each, is_certain=each.is_certain and each.std <= MAX_STD) for each in found]
    if usable is not None and usable.mean() < MIN_USABLE_SHARE:
        return Gravity(verticals[0], "upright")
    ways = [replace(each, up=sign * each.up) for each in verticals for sign in (1.0, -1.0)]
    log_odds = [_log_odds(small, way.up) for way in ways]
    best = int(np.argmax(log_odds))
    if best == 0 or log_odds[best] - log_odds[0] < MIN_LOG_ODDS:
        return Gravity(ways[0], "upright")
    return Gravity(replace(ways[best], is_certain=False), "upside down" if best == 1 else "rolled by 90°")


def _log_odds(small: Picture, up: np.ndarray) -> float:
    """Of a picture with this zenith; only differences between zeniths mean something."""
    image = rotated_image(small, rotation_taking(up, UP), np.eye(3), NETWORK_SIZE)
    pixels = np.ascontiguousarray(image.transpose(2, 0, 1)[None], np.float32)
    return float(run_network(_network(), {"image": pixels}, [(1, 1, 1, 1)])[0].item())


@lru_cache(maxsize=1)
def _network() -> Any:
    return open_model("attitude", device="cpu", threads=1)
