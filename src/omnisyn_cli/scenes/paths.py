"""Where cameras go: straight lines through free space; and the standard evaluation set of such walks.

The set has streets and rooms from fixed seeds, each walked 1, 2, 4 and 6 metres. All baselines of a scene begin at the
same first panorama and go the same way, so that figures differ by the distance and by nothing else. Poses are rounded
so far that they are the same numbers on every machine.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.scenes.panorama import trace_rays
from omnisyn_cli.scenes.room import room
from omnisyn_cli.scenes.scene import Scene, Walkway
from omnisyn_cli.scenes.street import street

_MAX_ATTEMPTS = 400  # Paths that are drawn before a scene has no room for one. Set by hand.
_MAX_CLIMB = 2.0  # Metres of a path that goes straight up, unless more is asked for
# Factor on a baseline at every attempt, where it may be shortened: about a fifth is left after a hundred.
_BASELINE_DECAY = 0.985

# Rows and columns of the rays cast from an end, and the quantile of their lengths that counts as the nearest depth: one
# twig beside the camera does not shorten the path.
_PROBE_SIZE, _NEAR_QUANTILE = (8, 16), 0.04


def sample_path(
    scene: Scene, seed: int, frames: int, *, baseline: float | None = None, vertical: float = 0.05, tilt: float = 0.0
) -> list[Pose]:
    """Draw a straight path of cameras that keep clear of everything; the first and the last pose are its ends.

    Equal seeds give equal paths; frames are evenly spaced, with one random heading. ``baseline`` is the metres between
    the ends; None = what is usual. ``vertical`` is the share of paths straight up, ``tilt`` the standard deviation
    (radians) of each frame's pitch and roll; above 0 each has its own heading. ValueError: there is no room.
    """
    rng = np.random.default_rng([11, seed])
    heading = rng.uniform(-math.pi, math.pi)
    share = np.random.default_rng([12, seed]).random()
    for attempt in range(_MAX_ATTEMPTS):
        walkway = scene.walkways[rng.integers(len(scene.walkways))]
        clearance = walkway.clearance * max(0.3, 1.0 - attempt / _MAX_ATTEMPTS)
        length = baseline if baseline is not None else _draw_baseline(rng, walkway, attempt, share)
        if baseline is None and attempt > _MAX_ATTEMPTS // 2:
            length = walkway.baselines[0]
        is_upright = rng.random() < vertical
        if is_upright and baseline is None:
            length = min(length, _MAX_CLIMB)
        start, end = _draw_segment(rng, scene, walkway, length, upright=is_upright, strict=attempt < _MAX_ATTEMPTS // 2)
        if _is_free(scene, start, end, clearance) and _is_allowed_end(scene, walkway, end):
            if baseline is None and _is_too_long(scene, walkway, start, end):
                continue
            shares = np.linspace(0.0, 1.0, frames)[:, None]
            level = rotation_from_heading(heading)
            positions = start + shares * (end - start)
            return [Pose(random_rotation(rng, tilt) if tilt > 0.0 else level, position) for position in positions]
    raise ValueError(f"expected room for a path, found none in {_MAX_ATTEMPTS} attempts: try a shorter baseline")


def _draw_baseline(rng: np.random.Generator, walkway: Walkway, attempt: int, share: float) -> float:
    """Of an attempt; ``share`` says where between the shortest and the longest it begins."""
    low, high = walkway.baselines
    if walkway.max_baseline_in_depths is None:
        return rng.uniform(low, high)
    return max(low, low * math.exp(share * math.log(high / low)) * math.exp(attempt * math.log(_BASELINE_DECAY)))


def _is_too_long(scene: Scene, walkway: Walkway, start: Float[np.ndarray, "3"], end: Float[np.ndarray, "3"]) -> bool:
    """Whether a path is too long for what is beside its ends."""
    if walkway.max_baseline_in_depths is None:
        return False
    directions = pixel_directions(*_PROBE_SIZE).reshape(-1, 3)
    nearest = min(float(np.quantile(trace_rays(scene, place, directions)[0], _NEAR_QUANTILE)) for place in (start, end))
    return float(np.linalg.norm(end - start)) > walkway.max_baseline_in_depths * nearest


def _is_free(scene: Scene, start: Float[np.ndarray, "3"], end: Float[np.ndarray, "3"], clearance: float) -> bool:
    """Whether a segment stays out of every shape's box, grown by ``clearance`` on all sides."""
    rotation, half = scene.shapes["rotation"], scene.shapes["half"]
    local = np.einsum("nji,nj->ni", rotation, start - scene.shapes["centre"])
    step = np.einsum("nji,j->ni", rotation, end - start)
    step = np.where(np.abs(step) < 1e-12, 1e-12, step)
    middle, reach = -local / step, (half + clearance) / np.abs(step)
    enters, leaves = (middle - reach).max(axis=1), (middle + reach).min(axis=1)
    return not np.any((enters < leaves) & (leaves > 0.0) & (enters < 1.0))


def _is_allowed_end(scene: Scene, walkway: Walkway, point: Float[np.ndarray, "3"]) -> bool:
    """Whether a point lies over a walkway, rather than beyond a window; streets go on."""
    goes_on = any(walkway.heading) and walkway.max_baseline_in_depths is None
    over = (w.low[0] <= point[0] <= w.high[0] and w.low[2] <= point[2] <= w.high[2] for w in scene.walkways)
    return goes_on or any(over)


def _draw_segment(
    rng: np.random.Generator, scene: Scene, walkway: Walkway, length: float, *, upright: bool, strict: bool
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Both ends of a candidate; heights count from the ground."""
    low, high = np.array(walkway.low), np.array(walkway.high)
    start = rng.uniform(low, high)
    if upright:
        start[1] = low[1] * 0.8
        step = np.array([0.0, length, 0.0])
    else:
        bearing = rng.uniform(-math.pi, math.pi)
        ahead = np.array([walkway.heading[0], 0.0, walkway.heading[1]])
        if ahead.any() and (strict or rng.random() < 0.7):
            sign = 1.0 if rng.random() < 0.5 else -1.0
            bearing = math.atan2(sign * ahead[0], sign * ahead[2]) + rng.normal(0.0, 0.15)
        climb = rng.normal(0.0, walkway.slope) if rng.random() < 0.5 else 0.0
        step = length * np.array([math.sin(bearing), climb, math.cos(bearing)])
    end = start + step
    for point in (start, end):
        point[1] += (scene.ground[3] - scene.ground[[0, 2]] @ point[[0, 2]]) / scene.ground[1]
    if not upright:
        end = start + (end - start) * (length / float(np.linalg.norm(end - start)))
    return start, end


def random_rotation(rng: np.random.Generator, tilt: float) -> Float[np.ndarray, "3 3"]:
    """How a camera is held with any heading, and pitch and roll of a standard deviation in radians."""
    return rotation_from_heading(rng.uniform(-math.pi, math.pi), rng.normal(0.0, tilt), rng.normal(0.0, tilt))


STANDARD_KINDS = ("street", "room")  # Generators of the standard set; others may come, these stay what they are
SUITE_SEEDS = (9_000_001, 9_000_002)  # Far beyond those that networks are trained with
BASELINES = (1.0, 2.0, 4.0, 6.0)  # Metres from the first to the last panorama, ascending
FRAMES_PER_WALK = 5  # Two inputs, and three true frames at equal distances between them
# Decimals of the ends in metres: micrometres, far coarser than the arithmetic of two machines may differ.
POSITION_DECIMALS = 6


@dataclass(frozen=True)
class SuiteScene:
    """One walk: generator of the scene, seed of scene and path, metres from the first panorama to the last.

    The path has the poses of all panoramas in walking order; it is empty where the scene has no room for this baseline.
    """

    kind: str
    seed: int
    baseline: float
    path: tuple[Pose, ...]

    @property
    def name(self) -> str:
        """Of its folder."""
        return f"{self.kind}-{self.seed}-{self.baseline:g}m"


def suite_scenes() -> Iterator[SuiteScene]:
    """All walks, those of a scene from the shortest on."""
    for kind in STANDARD_KINDS:
        for seed in SUITE_SEEDS:
            longest = longest_path({"street": street, "room": room}[kind](seed), seed)
            for baseline in BASELINES:
                yield SuiteScene(kind, seed, baseline, tuple(_evenly_spaced(longest, baseline)))


def longest_path(scene: Scene, seed: int) -> tuple[Pose, ...]:
    """Both ends of the longest free way that is one of :data:`BASELINES`; none where even the shortest is not free."""
    for baseline in reversed(BASELINES):
        try:
            ends = sample_path(scene, seed, 2, baseline=baseline, vertical=0.0)
        except ValueError:
            continue
        return tuple(Pose(np.round(end.rotation, 12), np.round(end.position, POSITION_DECIMALS)) for end in ends)
    return ()


def _evenly_spaced(longest: tuple[Pose, ...], baseline: float) -> Iterator[Pose]:
    """Poses evenly spaced over the first metres of a way; none where it is shorter."""
    if not longest:
        return
    way = longest[1].position - longest[0].position
    length = float(np.linalg.norm(way))
    if baseline > length + 10**-POSITION_DECIMALS:
        return
    for share in np.linspace(0.0, baseline / length, FRAMES_PER_WALK):
        yield Pose(longest[0].rotation, np.round(longest[0].position + share * way, POSITION_DECIMALS))
