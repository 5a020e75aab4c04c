"""Rooms in a row and homes on a grid, with real openings between them and to the outside.

Homes have walls with little texture, and cameras close to the furniture.
"""

import math
from collections.abc import Sequence
from itertools import pairwise, product

import numpy as np

from omnisyn_cli.scenes import furniture, palette, props
from omnisyn_cli.scenes.buildings import office
from omnisyn_cli.scenes.furnishing import furnish
from omnisyn_cli.scenes.materials import Pattern, tonal_material
from omnisyn_cli.scenes.palette import pick
from omnisyn_cli.scenes.scene import Lighting, LocalFrame, Scene, SceneBuilder, Walkway, daylight, sun_at, times
from omnisyn_cli.scenes.walls import WALLS, Cell, Opening, Openings, add_room_shell, low_texture_finish

# What stands around in the room that is looked at most.
EXTRAS = (
    furniture.kitchen_unit, furniture.tripod, furniture.chair, furniture.armchair, furniture.plant,
    furniture.floor_lamp, furniture.table, furniture.shelf,
)  # fmt: skip
BASELINE_RANGE = (0.25, 8.0)  # Shortest and longest distance between the first and the last camera, metres
MAX_BASELINE_IN_DEPTHS = 3.0  # Longest baseline, in multiples of the depth of the nearest surface

Grid = dict[tuple[int, int], tuple[Cell, Openings]]  # Rooms with their openings by column and row.


def room(seed: int) -> Scene:
    """Generate rooms; equal seeds give equal rooms."""
    rng = np.random.default_rng([13, seed])
    use = str(rng.choice(["home", "office"], p=[0.48, 0.52]))
    cells = _draw_cells(rng, 7.0 if use == "home" else 11.0)
    lamp_lit = bool(rng.random() < 0.55)
    build = SceneBuilder(rng, lighting=_indoor_light(rng, lamp_lit=lamp_lit))
    _add_outdoors(build, rng.uniform(-12, -0.4) if rng.random() < 0.4 else -0.3)
    for cell, openings in zip(cells, _draw_openings(rng, cells), strict=True):
        add_room_shell(build, cell, openings, use, casts_shadow=not lamp_lit)
        furnish(build, cell, use, openings)
        _add_walkway(build, cell, 0.45, (1.05, min(2.3, cell.height - 0.5)), (0.3, 2.5), 0.22)
    return build.build("room")


def home(seed: int) -> Scene:
    """Generate a home; equal seeds give equal homes."""
    rng = np.random.default_rng([17, seed])
    build = SceneBuilder(rng, lighting=_indoor_light(rng, lamp_lit=bool(rng.random() < 0.6)))
    _add_outdoors(build, -0.3)
    rooms = _floor_plan(rng)
    visited = list(rooms)[rng.integers(len(rooms))]
    for place, (cell, openings) in rooms.items():
        use = "office" if rng.random() < 0.2 else "home"
        add_room_shell(build, cell, openings, use, casts_shadow=False, finish=low_texture_finish)
        near = abs(place[0] - visited[0]) + abs(place[1] - visited[1])
        if near < 2:  # what is farther shows through doors of doors
            furnish(build, cell, use, openings, EXTRAS if near == 0 else ())
            heights = (rng.uniform(0.6, 1.3), min(2.1, cell.height - 0.3))
            _add_walkway(build, cell, 0.4, heights, BASELINE_RANGE, 0.2, MAX_BASELINE_IN_DEPTHS, slope=0.12)
        if near == 0 and rng.random() < 0.5:
            x, z = rng.uniform(cell.low, cell.high)
            furniture.chandelier(LocalFrame(build, (x, cell.height, z), 0.0))
    return build.build("home")


def _draw_cells(rng: np.random.Generator, largest: float) -> list[Cell]:
    """One to three rooms along x, at most so many metres wide and deep."""
    count = int(rng.choice([1, 2, 3], p=[0.35, 0.4, 0.25]))
    height = rng.uniform(2.3, 3.2) if rng.random() < 0.8 else rng.uniform(3.2, 4.5)
    widths = rng.uniform(2.8, largest, count)
    x = -0.5 * float(widths.sum())
    cells = []
    for width in widths:
        depth = rng.uniform(2.8, largest)
        front = rng.uniform(0.4, 0.6) * depth
        cells.append(Cell((x, front - depth), (x + float(width), front), height))
        x += float(width)
    return cells


def _indoor_light(rng: np.random.Generator, *, lamp_lit: bool) -> Lighting:
    """Light from the ceiling, or daylight through the windows; the picture of the sky is that of some day."""
    day = daylight(rng)
    warmth = rng.uniform(0.0, 1.0)
    tone = (1.0, 0.97 - 0.1 * warmth, 0.95 - 0.28 * warmth)
    sky = times(tone, rng.uniform(0.32, 0.55))
    bounce = (0.85 * sky[0], 0.82 * sky[1], 0.77 * sky[2])
    if lamp_lit:
        sun = times(tone, rng.uniform(0.35, 0.9))
        direction, softness = sun_at(rng.uniform(0, 2 * math.pi), rng.uniform(1.15, 1.5)), rng.uniform(0.06, 0.2)
    else:
        direction, softness = sun_at(rng.choice([0.0, math.pi]) + rng.normal(0, 0.5), rng.uniform(0.35, 0.9)), 0.008
        sun = (2.6, 2.35, 1.9)
    day = day._replace(sun_direction=direction, sun=sun, sky=sky, bounce=bounce, softness=softness)
    return day._replace(haze=0.0, exposure=rng.uniform(1.2, 1.9))


def _add_outdoors(build: SceneBuilder, level: float) -> None:
    """Add the ground outside, and buildings and trees in view of the windows."""
    rng = build.rng
    green = pick(rng, palette.FOLIAGE)
    build.ground = (0.0, 1.0, 0.0, level)
    grass = tonal_material(Pattern.GRASS, green, 1.25, first=0.85, detail=0.4)
    build.ground_material = grass._replace(third=(0.5, 0.47, 0.35))
    for side in (-1.0, 1.0):
        for _ in range(int(rng.integers(1, 4))):
            x, z = rng.uniform(-25, 25), side * rng.uniform(16, 45)
            if rng.random() < 0.5:
                office(build, (side * abs(x) + side * 10.0, level, z), rng.uniform(10, 20), side, detailed=False)
            elif rng.random() < 0.6:
                props.tree(build, (x, level, z), rng.uniform(5, 12))
            else:
                props.conifer(build, (x, level, z), rng.uniform(7, 14))


def _draw_openings(rng: np.random.Generator, cells: Sequence[Cell]) -> list[Openings]:
    """Doors between neighbours and windows to the outside, by cell and by wall: west, east, south, north."""
    openings: list[Openings] = [{name: [] for name in WALLS} for _ in cells]
    for (left, west), (right, east) in pairwise(zip(cells, openings, strict=True)):
        low, high = max(left.low[1], right.low[1]) + 0.3, min(left.high[1], right.high[1]) - 0.3
        door = _draw_door(rng, low, high, left.height)
        west["east"].append(door)
        east["west"].append(door)
    for cell, walls in zip(cells, openings, strict=True):
        for name in ("south", "north"):
            if rng.random() < 0.65:
                walls[name] = _draw_windows(rng, cell.low[0], cell.high[0], cell.height)
    return openings


def _draw_door(rng: np.random.Generator, low: float, high: float, room_height: float) -> Opening:
    """A doorway somewhere between two places along a wall."""
    width = min(float(rng.choice([0.85, 1.2, 2.4])), high - low)
    middle = rng.uniform(low + 0.5 * width, high - 0.5 * width + 1e-9)
    height = min(rng.uniform(2.0, 2.4), room_height - 0.15)
    return Opening(middle - 0.5 * width, middle + 0.5 * width, 0.0, height)


def _draw_windows(rng: np.random.Generator, low: float, high: float, room_height: float) -> list[Opening]:
    """A row of equal windows along a wall."""
    length = high - low
    width = min(rng.uniform(0.8, 2.4), length - 0.8)
    count = max(1, int(rng.uniform(0.4, 0.9) * length / (width + 0.5)))
    sill = float(rng.choice([0.05, rng.uniform(0.7, 1.1)], p=[0.2, 0.8]))
    head = min(room_height - 0.2, sill + rng.uniform(1.0, 1.9)) if sill > 0.5 else min(2.3, room_height - 0.2)
    step = length / count
    middles = [low + (k + 0.5) * step for k in range(count)]
    return [Opening(m - 0.5 * width, m + 0.5 * width, sill, head) for m in middles]


def _add_walkway(
    build: SceneBuilder, cell: Cell, margin: float, heights: tuple[float, float], baselines: tuple[float, float],
    clearance: float, max_baseline_in_depths: float | None = None, slope: float = 0.02,
) -> None:  # fmt: skip
    """Let cameras stand in a room, at heights above its floor; arguments as of :class:`Walkway`."""
    level = build.ground[3]
    low = (cell.low[0] + margin, heights[0] - level, cell.low[1] + margin)
    high = (cell.high[0] - margin, heights[1] - level, cell.high[1] - margin)
    build.walkways.append(Walkway(low, high, (0.0, 0.0), baselines, clearance, max_baseline_in_depths, slope))


def _floor_plan(rng: np.random.Generator) -> Grid:
    """Two to six rooms on a grid, most neighbours joined by a door, most outer walls with windows."""
    height = rng.uniform(2.3, 3.1)
    xs, zs = (np.cumsum(rng.uniform(2.3, 5.5, rng.integers(2, most))) for most in (5, 4))
    xs, zs = xs - xs.mean(), zs - zs.mean()
    rooms: Grid = {
        (i, j): (Cell((xs[i], zs[j]), (xs[i + 1], zs[j + 1]), height), {name: [] for name in WALLS})
        for i, j in product(range(len(xs) - 1), range(len(zs) - 1))
    }
    for (i, j), (cell, openings) in rooms.items():
        for axis, ahead, behind, after, before in (
            (1, "east", "west", (i + 1, j), (i - 1, j)), (0, "north", "south", (i, j + 1), (i, j - 1)),
        ):  # fmt: skip
            low, high = cell.low[axis], cell.high[axis]
            if after in rooms and rng.random() < 0.85:
                door = _draw_door(rng, low + 0.3, high - 0.3, height)
                openings[ahead].append(door)
                rooms[after][1][behind].append(door)
            for wall, other in ((ahead, after), (behind, before)):
                if other not in rooms and rng.random() < 0.6:
                    openings[wall] = _draw_windows(rng, low, high, height)
    return rooms
