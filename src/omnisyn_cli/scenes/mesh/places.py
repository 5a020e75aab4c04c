"""Where cameras stand in a mesh: at eye height above a floor, in free space, with something around them."""

import math
from itertools import islice

import numpy as np
from jaxtyping import Float

from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.scenes.mesh.raycast import MeshCaster
from omnisyn_cli.scenes.mesh.render import sphere_directions

EYE_HEIGHTS = (1.1, 1.9)  # Metres above the floor
CLEARANCE = 0.3  # Metres to the nearest surface, at least
RAYS = 96  # That a place is judged by
MIN_ENCLOSED_SHARE = 0.52  # Share of the rays that hit something; an empty plane alone is half
MIN_FLOOR_SHARE = 0.95  # Share of the rays below a place that hit something
# Share of surfaces seen from behind, in the gap between two shells; inside or outside it is nearly none or all.
BETWEEN_SHELLS = (0.4, 0.6)
LEVEL = 0.8  # Least cosine between the normal of a floor and up
NEAR_MEDIAN = 0.6  # Metres: places whose median distance is less are inside of things
BASELINES = (0.12, 2.4)  # Of walks, in median distances
LONGEST_WALK = 12.0  # Metres
ATTEMPTS = 200  # Places that are drawn before a mesh is given up. Set by hand.
PLACES = 40  # That a walk begins at one of

Place = tuple[Float[np.ndarray, " 3"], float]  # For a camera, and the median distance of what is around it; metres


def look_around(caster: MeshCaster, position: Float[np.ndarray, " 3"]) -> float | None:
    """Median distance of what a camera there would see, metres; None where none should stand."""
    directions = sphere_directions(RAYS)
    hits = caster.hits(position[None], directions)
    found = hits.is_hit
    below = directions[:, 1] < -0.6
    if found.mean() < MIN_ENCLOSED_SHARE or found[below].mean() < MIN_FLOOR_SHARE:
        return None
    distances = hits.distance[found]
    if distances.min() < CLEARANCE or np.median(distances) < NEAR_MEDIAN:
        return None
    behind = np.einsum("ij,ij->i", caster.normals[hits.face[found]], directions[found]) > 0
    if BETWEEN_SHELLS[0] < behind.mean() < BETWEEN_SHELLS[1]:
        return None
    return float(np.median(distances))


def find_places(caster: MeshCaster, rng: np.random.Generator, count: int, attempts: int = 400) -> list[Place]:
    """Places by chance; fewer than ``count`` where ``attempts`` do not find more."""
    low, high = (np.percentile(caster.mesh.vertices, share, axis=0) for share in (1, 99))
    starts = rng.uniform(low, np.maximum(high, low + 1e-3), (attempts, 3))
    starts[:, 1] += 0.3
    down = np.broadcast_to([0.0, -1.0, 0.0], starts.shape)
    floor = caster.hits(starts, down)
    level = floor.is_hit & (np.abs(caster.normals[floor.face][:, 1]) > LEVEL)
    eyes = starts[level]
    eyes[:, 1] += rng.uniform(*EYE_HEIGHTS, level.sum()) - floor.distance[level]
    found = ((eye, median) for eye in eyes if (median := look_around(caster, eye)) is not None)
    return list(islice(found, count))


def find_line(
    caster: MeshCaster, places: list[Place], rng: np.random.Generator, frames: int
) -> list[Float[np.ndarray, " 3"]] | None:
    """A straight walk from a place: ends and some between, evenly by log length over median distance; or None."""
    for _ in range(ATTEMPTS if places else 0):
        begin, median = places[rng.integers(len(places))]
        length = min(median * float(np.exp(rng.uniform(*np.log(BASELINES)))), LONGEST_WALK)
        heading, rise = rng.uniform(0.0, 2.0 * math.pi), rng.normal(0.0, 0.05)
        step = np.array([math.cos(heading), rise, math.sin(heading)])
        step /= np.linalg.norm(step)
        if caster.distances(begin[None], step[None])[0] < length + CLEARANCE:
            continue
        shares = np.array([0.0, *np.sort(rng.uniform(0.2, 0.8, max(0, frames - 2))), 1.0])[:frames]
        line = [begin + share * length * step for share in shares]
        if all(look_around(caster, position) is not None for position in line[1:]):
            return line
    return None


def find_walk(caster: MeshCaster, rng: np.random.Generator, frames: int) -> list[Pose] | None:
    """Upright cameras with one heading along a line that :func:`find_line` finds; None if there is none."""
    line = find_line(caster, find_places(caster, rng, PLACES), rng, frames)
    rotation = rotation_from_heading(rng.uniform(-math.pi, math.pi))
    return None if line is None else [Pose(rotation, position) for position in line]
