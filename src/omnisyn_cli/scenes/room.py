"""Rooms: one to three in a row with real openings between them and to the outside."""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from omnisyn_cli.scenes import palette, props
from omnisyn_cli.scenes.buildings import office
from omnisyn_cli.scenes.daylight import daylight, sun_at
from omnisyn_cli.scenes.furnishing import furnish
from omnisyn_cli.scenes.materials import Pattern, plant_material
from omnisyn_cli.scenes.palette import pick
from omnisyn_cli.scenes.scene import Lighting, Scene, SceneBuilder, Walkway
from omnisyn_cli.scenes.walls import WALLS, Cell, Opening, Openings, add_room_shell


def room(seed: int) -> Scene:
    """Generate rooms; equal seeds give equal rooms."""
    rng = np.random.default_rng([13, seed])
    use = str(rng.choice(["home", "office"], p=[0.48, 0.52]))
    cells = _draw_cells(rng, 7.0 if use == "home" else 11.0)
    lamp_lit = bool(rng.random() < 0.55)
    build = SceneBuilder(rng, lighting=indoor_light(rng, lamp_lit=lamp_lit))
    add_outdoors(build, rng.uniform(-12, -0.4) if rng.random() < 0.4 else -0.3)
    for cell, openings in zip(cells, _draw_openings(rng, cells), strict=True):
        add_room_shell(build, cell, openings, use, casts_shadow=not lamp_lit)
        furnish(build, cell, use, openings)
        add_walkway(build, cell, 0.45, (1.05, min(2.3, cell.height - 0.5)), (0.3, 2.5), 0.22)
    return build.build("room")


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


def indoor_light(rng: np.random.Generator, *, lamp_lit: bool) -> Lighting:
    """Light from the ceiling, or daylight through the windows; the picture of the sky is that of some day."""
    day = daylight(rng)
    warmth = rng.uniform(0.0, 1.0)
    tone = (1.0, 0.97 - 0.1 * warmth, 0.95 - 0.28 * warmth)
    level = rng.uniform(0.32, 0.55)
    sky = (level * tone[0], level * tone[1], level * tone[2])
    bounce = (0.85 * sky[0], 0.82 * sky[1], 0.77 * sky[2])
    if lamp_lit:
        strength = rng.uniform(0.35, 0.9)
        sun = (strength * tone[0], strength * tone[1], strength * tone[2])
        direction, softness = sun_at(rng.uniform(0, 2 * math.pi), rng.uniform(1.15, 1.5)), rng.uniform(0.06, 0.2)
    else:
        direction, softness = sun_at(rng.choice([0.0, math.pi]) + rng.normal(0, 0.5), rng.uniform(0.35, 0.9)), 0.008
        sun = (2.6, 2.35, 1.9)
    day = day._replace(sun_direction=direction, sun=sun, sky=sky, bounce=bounce, softness=softness)
    return day._replace(haze=0.0, exposure=rng.uniform(1.2, 1.9))


def add_outdoors(build: SceneBuilder, level: float) -> None:
    """Add the ground outside, and buildings and trees in view of the windows."""
    rng = build.rng
    green = pick(rng, palette.FOLIAGE)
    build.ground = (0.0, 1.0, 0.0, level)
    build.ground_material = plant_material(Pattern.GRASS, green, 0.85, 1.25, third=(0.5, 0.47, 0.35), detail=0.4)
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
    for (left, west), (right, east) in itertools.pairwise(zip(cells, openings, strict=True)):
        low, high = max(left.low[1], right.low[1]) + 0.3, min(left.high[1], right.high[1]) - 0.3
        door = draw_door(rng, low, high, left.height)
        west["east"].append(door)
        east["west"].append(door)
    for cell, walls in zip(cells, openings, strict=True):
        for name in ("south", "north"):
            if rng.random() < 0.65:
                walls[name] = draw_windows(rng, cell.low[0], cell.high[0], cell.height)
    return openings


def draw_door(rng: np.random.Generator, low: float, high: float, room_height: float) -> Opening:
    """A doorway somewhere between two places along a wall."""
    width = min(float(rng.choice([0.85, 1.2, 2.4])), high - low)
    middle = rng.uniform(low + 0.5 * width, high - 0.5 * width + 1e-9)
    height = min(rng.uniform(2.0, 2.4), room_height - 0.15)
    return Opening(middle - 0.5 * width, middle + 0.5 * width, 0.0, height)


def draw_windows(rng: np.random.Generator, low: float, high: float, room_height: float) -> list[Opening]:
    """A row of equal windows along a wall."""
    length = high - low
    width = min(rng.uniform(0.8, 2.4), length - 0.8)
    count = max(1, int(rng.uniform(0.4, 0.9) * length / (width + 0.5)))
    sill = float(rng.choice([0.05, rng.uniform(0.7, 1.1)], p=[0.2, 0.8]))
    head = min(room_height - 0.2, sill + rng.uniform(1.0, 1.9)) if sill > 0.5 else min(2.3, room_height - 0.2)
    step = length / count
    middles = [low + (k + 0.5) * step for k in range(count)]
    return [Opening(m - 0.5 * width, m + 0.5 * width, sill, head) for m in middles]


def add_walkway(
    build: SceneBuilder, cell: Cell, margin: float, heights: tuple[float, float], baselines: tuple[float, float],
    clearance: float, max_baseline_in_depths: float | None = None, slope: float = 0.02,
) -> None:  # fmt: skip
    """Let cameras stand in a room, at heights above its floor; arguments as of :class:`Walkway`."""
    low, high = ((x, height - build.ground[3], z) for (x, z), height in zip(_inner(cell, margin), heights, strict=True))
    build.walkways.append(Walkway(low, high, (0.0, 0.0), baselines, clearance, max_baseline_in_depths, slope))


def _inner(cell: Cell, margin: float) -> tuple[tuple[float, float], tuple[float, float]]:
    return (cell.low[0] + margin, cell.low[1] + margin), (cell.high[0] - margin, cell.high[1] - margin)
