"""How high cameras stand above the floor: what a known height of the cameras makes metres of.

Level planes below each pair are swept. Tables and beds are level as well, so the floor is the lowest one of those that
fit about best. The sweeps of a set are added up: all pairs see one floor, but not one table. Where no plane fits, the
levels of matched points count; where depth is known, those of its points.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.geometry.pose import Pose, at_same_position
from omnisyn_cli.geometry.sphere import pixel_directions, solid_angles
from omnisyn_cli.poses.registration.features import Matches
from omnisyn_cli.poses.registration.pose_graph import MIN_PARALLAX_PIXELS
from omnisyn_cli.stereo.plane_sweep import AxisSweep, fit_plane, significant_support, sweep_directions
from omnisyn_cli.stereo.rectify import rectify
from omnisyn_cli.types import DepthEstimate, View

FLOOR_SIZE = (256, 512)  # Height and width of the pair in which planes are found: twice that of the sweep, for the fit

# A level plane may be the floor with this share of the support of the best one: furniture hides much of a floor. Chosen
# on the even pairs of ``bench_poses.py``, between floors below a table (0.67) and noise below a floor (0.11).
MIN_FLOOR_SHARE = 0.4
# Of the heights of two planes, up to which the worse one is the flank of the better one: four steps of a sweep.
FLANK_RATIO = 1.28
# Relative step at which the sweeps of all pairs are added: half of that of a sweep. Also of levels in depth.
HEIGHT_STEP = 0.03

# Sine of the angle (12°) below the horizon from which on depth says at which level a point is, and the share of what is
# below that the floor has to be.
MIN_DEPRESSION_SINE, MIN_LEVEL_SHARE = 0.2, 0.15
MIN_LEVEL_POINTS = 25  # Matched points that have to lie at the level of a floor where no plane is found
# Relative spread of such points, and share of points below, up to which the level is a floor and no table. What lies
# farther below than this factor is a reflection.
MAX_LEVEL_SPREAD, MAX_SHARE_BELOW, REFLECTION_RATIO = 0.025, 0.1, 2.5
MIN_POINTS_AT_PLANE = 4  # Near a plane below which there is none, to take it for the floor
# Of heights that belong to one floor: two steps of a sweep. Hand-held cameras differ by some centimetres.
SAME_FLOOR_RATIO = 1.13

# Sine of the angle (30°) from the horizon up to which there are walls; confidence from which on depth counts; share of
# the pictures that has to be left; and of that, how much may be nearer than walls are: furniture, mistakes.
MAX_WALL_SINE, MIN_WALL_CONFIDENCE, MIN_WALL_SHARE, WALL_QUANTILE = 0.5, 0.3, 0.03, 0.2

# What floors slope by, and how many pixels outweigh that: neighbouring ones do not match independently. Without it a
# floor of which little is seen tilts by up to 10°, and its height is off by a quarter.
FLOOR_SLOPE, SLOPE_PIXELS = math.radians(2.0), 200.0


@dataclass(frozen=True)
class LevelSweep:
    """How well level planes below two cameras fit."""

    views: tuple[View, View]  # of both
    heights: Float[np.ndarray, " planes"]  # of both cameras above each plane, the mean
    # of each plane above the median of all, as a share of the textured sphere; in the worse panorama
    support: Float[np.ndarray, " planes"]
    is_significant: Bool[np.ndarray, " planes"]  # by the rules for peaks of a sweep

    @staticmethod
    def of(first: View, second: View) -> "LevelSweep":
        """That of two panoramas from different places."""
        pair = rectify(first, second, FLOOR_SIZE)
        sweep = AxisSweep.of(sweep_directions(pair)[0], pair.grid.up)
        excess, is_significant = significant_support(sweep.support(0))
        heights = pair.baseline * sweep.distances + _half_rise(first, second)
        is_below = heights > 0.0
        return LevelSweep((first, second), *(each[is_below] for each in (heights, excess.clip(0.0), is_significant)))

    def height_above(self, floor: float) -> float | None:
        """Measured height above the plane that fits best near a floor; None if none does."""
        is_near = _is_same(self.heights, floor)
        if not (is_near & self.is_significant).any():
            return None
        pair, rise = rectify(*self.views, FLOOR_SIZE), _half_rise(*self.views)
        best = float(self.heights[np.where(is_near, self.support, -1.0).argmax()])
        up, inverse_distance = pair.grid.up, pair.baseline / (best - rise)
        stiffness = SLOPE_PIXELS / (FLOOR_SLOPE * inverse_distance) ** 2 * (np.eye(3) - np.outer(up, up))
        normal = fit_plane(sweep_directions(pair), -inverse_distance * up, stiffness)
        # Straight below both cameras, as ground may slope; the second one is at (0, 1, 0) in the frame of the pair.
        measured = pair.baseline * float(1.0 - 0.5 * normal[1]) / max(-float(normal @ up), 1e-9)
        return measured if _is_same(measured, floor) else None


def floor_heights(pairs: Sequence[tuple[View, View]]) -> list[float]:
    """Height above the floor of each pair that sees it, in the unit of positions; y is up, cameras are equally high."""
    sweeps = [LevelSweep.of(*pair) for pair in pairs if not at_same_position(*(view.pose for view in pair))]
    if not sweeps:
        return []
    every = np.log(np.concatenate([sweep.heights for sweep in sweeps]))
    grid = np.arange(every.min() - HEIGHT_STEP, every.max() + 2.0 * HEIGHT_STEP, HEIGHT_STEP)
    # Support is constant beyond the ends of a sweep, so that none of them looks like a peak.
    support = np.sum([np.interp(grid, np.log(sweep.heights), sweep.support) for sweep in sweeps], axis=0)
    floor = _lowest_level(grid, support)
    measured = [] if floor is None else [sweep.height_above(floor) for sweep in sweeps]
    return [height for height in measured if height is not None]


def height_above_points(first: Pose, second: Pose, matches: Matches) -> Float[np.ndarray, " points"]:
    """How high the first camera stands above each point of a pair that lies well below it and has parallax."""
    ray, other = matches.first @ first.rotation.T, matches.second @ second.rotation.T
    parallax = np.linalg.norm(np.cross(ray, other), axis=1)
    chosen = (parallax > math.sin(MIN_PARALLAX_PIXELS * matches.pixel)) & (ray[:, 1] < -MIN_DEPRESSION_SINE)
    side = np.linalg.norm(np.cross(second.position - first.position, other), axis=1)
    return np.asarray(-ray[chosen, 1] * side[chosen] / parallax[chosen])


def level_of_points(heights: Float[np.ndarray, " points"]) -> tuple[float, float] | None:
    """The lowest level that many points lie at, as height above them, and its relative spread; None without one."""
    logs = np.log(heights[heights > 0.0])
    if len(logs) < MIN_LEVEL_POINTS:
        return None
    rough = _level(logs, np.ones(len(logs)))
    there = logs[_is_same(np.exp(logs), rough)] if rough is not None else logs[:0]
    if len(there) < max(MIN_LEVEL_POINTS, MIN_LEVEL_SHARE * len(logs)):
        return None
    floor = float(np.median(there))
    spread, off = float(np.median(np.abs(there - floor))), logs - floor
    is_below = (off > math.log(SAME_FLOOR_RATIO)) & (off < math.log(REFLECTION_RATIO))
    return (math.exp(floor), spread) if spread < MAX_LEVEL_SPREAD and is_below.mean() < MAX_SHARE_BELOW else None


def spread_above(floor: float, heights: Float[np.ndarray, " points"]) -> float | None:
    """By how much the points near a plane differ from it, relative; None if they are few, or one lies below it."""
    near = heights[(heights > floor / FLANK_RATIO) & (heights < floor * REFLECTION_RATIO)]
    if len(near) < MIN_POINTS_AT_PLANE or near.max() > floor * SAME_FLOOR_RATIO:
        return None
    return float(np.median(np.abs(near / floor - 1.0)))


def height_in_depth(poses: tuple[Pose, Pose], depths: tuple[DepthEstimate, DepthEstimate]) -> float | None:
    """How high two cameras stand above the floor that depth shows, the mean; None unless both show the same."""
    first, second = (_height_of_one(pose, depth) for pose, depth in zip(poses, depths, strict=True))
    if first is None or second is None:
        return None
    rise = float(poses[1].position[1] - poses[0].position[1])
    return 0.5 * (first + second) if _is_same(first + rise, second) else None


def wall_distance(poses: tuple[Pose, Pose], depths: tuple[DepthEstimate, DepthEstimate]) -> float | None:
    """Metres from two cameras to the nearest walls around them; None where depth is hardly known at their height."""
    found = []
    for pose, depth in zip(poses, depths, strict=True):
        up = pixel_directions(*depth.inverse_depth.shape) @ pose.rotation[1]
        is_seen = (np.abs(up) < MAX_WALL_SINE) & (depth.inverse_depth > 0.0) & (depth.confidence > MIN_WALL_CONFIDENCE)
        found.append(np.sqrt(1.0 - up[is_seen] ** 2) / depth.inverse_depth[is_seen])
    metres = np.concatenate(found)
    is_enough = len(metres) > MIN_WALL_SHARE * sum(depth.inverse_depth.size for depth in depths)
    return float(np.quantile(metres, WALL_QUANTILE)) if is_enough else None


def _height_of_one(pose: Pose, depth: DepthEstimate) -> float | None:
    """How high a camera stands above the lowest level that much of its depth is at."""
    step = max(1, depth.inverse_depth.shape[0] // FLOOR_SIZE[0])
    inverse_depth, confidence = (
        each[step // 2 :: step, step // 2 :: step] for each in (depth.inverse_depth, depth.confidence)
    )
    size = inverse_depth.shape
    down = -(pixel_directions(*size) @ pose.rotation[1])
    is_below = down > MIN_DEPRESSION_SINE
    is_known = is_below & (inverse_depth > 0.0)
    logs = np.log(down[is_known] / inverse_depth[is_known])
    weight = (solid_angles(*size) * confidence)[is_known]
    if not weight.sum() > 0.0:
        return None
    floor = _level(logs, weight)
    if floor is None:
        return None
    is_floor = _is_same(np.exp(logs), floor)
    share = weight[is_floor].sum() / solid_angles(*size)[is_below].sum()
    return float(np.exp(np.median(logs[is_floor]))) if share > MIN_LEVEL_SHARE else None


def _level(logs: Float[np.ndarray, " points"], weight: Float[np.ndarray, " points"]) -> float | None:
    """The lowest level that points of some weights lie at, from logarithms of heights above them."""
    cells = np.floor(logs / HEIGHT_STEP).astype(int)
    first = int(cells.min()) - 2
    counts = np.convolve(np.bincount(cells - first, weight, cells.max() - first + 3), np.ones(3), "same")
    return _lowest_level((np.arange(len(counts)) + first + 0.5) * HEIGHT_STEP, counts)


def _lowest_level(logs: Float[np.ndarray, " levels"], support: Float[np.ndarray, " levels"]) -> float | None:
    """Height of the lowest level that is supported about best, from logarithms of heights; None without a peak."""
    peaks = 1 + np.flatnonzero((support[1:-1] >= support[:-2]) & (support[1:-1] > support[2:]))
    if len(peaks) == 0:
        return None
    at, height = support[peaks], logs[peaks]
    is_flank = (np.abs(height - height[:, None]) < math.log(FLANK_RATIO)) & (at > at[:, None])
    return float(np.exp(height[(at >= MIN_FLOOR_SHARE * at.max()) & ~is_flank.any(axis=1)].max()))


def _half_rise(first: View, second: View) -> float:
    """Half of what the second camera is above the first one."""
    return 0.5 * float(second.pose.position[1] - first.pose.position[1])


def _is_same(heights: np.ndarray | float, floor: float) -> Bool[np.ndarray, " *planes"]:
    ratio = np.asarray(heights) / floor
    return (ratio > 1.0 / SAME_FLOOR_RATIO) & (ratio < SAME_FLOOR_RATIO)
