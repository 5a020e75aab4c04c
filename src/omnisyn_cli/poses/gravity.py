"""Which way is up in a single panorama, also where the camera hung upside down or lay on its side.

Vertical edges tell the axis to a fraction of a degree, but not its end, and in rooms other edges are as straight.
Light and texture around the ends of an axis tell the rest, though not always. Weights are those of a logistic
regression on 80 generated panoramas. Of 40 real ones that were turned, 22 upside-down ones were named and 19 that were
rolled by 90°; of the 40 upright ones a dark corridor was taken for rolled.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from omnisyn_cli.geometry.resize import resize_area
from omnisyn_cli.geometry.sphere import UP, pixel_directions
from omnisyn_cli.poses.registration.features import Picture, Usable, grey_of
from omnisyn_cli.poses.registration.scan import SMALL_SIZE, Lines, Vertical, find_lines, find_vertical

# Axes of the camera near which the vertical is looked for: its own, to the right and ahead.
AXES = (UP, np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
CAP, BELT = 0.64, 0.35  # cosines from an axis: the caps lie beyond the first, the belt between them below the second
# Of the differences of the upper cap from the lower: light, logarithm of texture, share of plain pixels.
END_WEIGHTS = np.array([2.11, -1.09, 2.75])
# Of the texture of the caps less that of the belt, and of the share of contrast that lies between circles of latitude.
AXIS_WEIGHTS = np.array([-1.62, 9.49])
# Logarithms of odds from which on a picture is called upside down, and rolled instead of upright.
MIN_END_LOG_ODDS, MIN_AXIS_LOG_ODDS = 1.2, 1.5
# Standard deviation up to which a zenith is certain: 2.5 of them are 1°. What light and texture tell never is.
MAX_STD = math.radians(0.4)
MIN_USABLE_SHARE = 0.75  # of the pixels; parts of the sphere lack the caps
MAX_STEP, MIN_STEP, PLAIN_STEP = 0.2, 0.003, 0.004  # differences of neighbouring pixels, in [0, 1]
LATITUDES = 16  # circles of equal width that contrast is measured between

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
    directions = pixel_directions(*small.shape[:2])
    area = np.sqrt((1.0 - directions[..., 1] ** 2).clip(1e-6))
    grey = small @ np.array([0.299, 0.587, 0.114], np.float32)
    across = np.abs(np.diff(grey, axis=1, prepend=grey[:, -1:])) / area.clip(0.05)
    step = np.hypot(across, np.diff(grey, axis=0, prepend=grey[:1])).clip(0.0, MAX_STEP)
    maps = np.stack([grey, np.log(step + MIN_STEP), step < PLAIN_STEP])
    along = [directions @ vertical.up for vertical in verticals]
    ends = [float(END_WEIGHTS @ (_mean(maps, area * (a > CAP)) - _mean(maps, area * (a < -CAP)))) for a in along]
    axes = [_axis_log_odds(maps, a, area) for a in along]
    best = int(np.argmax(axes))
    is_rolled = axes[best] - axes[0] > MIN_AXIS_LOG_ODDS and abs(ends[best]) > MIN_END_LOG_ODDS
    if not (is_rolled and verticals[best].is_certain):
        best = 0
    up = verticals[best].up * (-1.0 if ends[best] < (0.0 if best else -MIN_END_LOG_ODDS) else 1.0)
    attitude = "rolled by 90°" if best else "upright" if up @ UP > 0 else "upside down"
    is_certain = verticals[best].is_certain and attitude == "upright"
    return Gravity(Vertical(up, verticals[best].std, is_certain), attitude)


def _axis_log_odds(maps: np.ndarray, along: np.ndarray, area: np.ndarray) -> float:
    """How much an axis looks like the vertical: its caps are plain, and light changes from circle to circle."""
    texture = _mean(maps[1], area * (np.abs(along) > CAP)) - _mean(maps[1], area * (np.abs(along) < BELT))
    circle = ((along + 1.0) / 2.0 * LATITUDES).astype(int).clip(0, LATITUDES - 1).ravel()
    weight = np.bincount(circle, area.ravel(), LATITUDES)
    means = np.bincount(circle, (area * maps[0]).ravel(), LATITUDES) / weight.clip(1e-9)
    mean = _mean(maps[0], area)
    between = float(weight @ (means - mean) ** 2) / float(weight.sum())
    return float(AXIS_WEIGHTS @ [float(texture), between / max(float(_mean((maps[0] - mean) ** 2, area)), 1e-6)])


def _mean(maps: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Of each map, weighted."""
    return np.asarray((maps * weight).sum(axis=(-2, -1)) / weight.sum())
