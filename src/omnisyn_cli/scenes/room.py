"""Rooms: one to three in a row with real openings between them and to the outside, or one large hall."""

import math
from dataclasses import dataclass

import numpy as np

from omnisyn_cli.scenes import palette, props
from omnisyn_cli.scenes.buildings import office
from omnisyn_cli.scenes.daylight import daylight, sun_at
from omnisyn_cli.scenes.furnishing import furnish, furnish_hall
from omnisyn_cli.scenes.materials import Pattern, plant_material
from omnisyn_cli.scenes.palette import pick
from omnisyn_cli.scenes.scene import Lighting, Scene, SceneBuilder, Walkway
from omnisyn_cli.scenes.walls import Cell, Opening, Openings, add_room_shell


@dataclass(frozen=True)
class _Plan:
    """What the rooms are for and how they are lit.

    Attributes:
        use: "home", "office" or "hall".
        cells: the rooms, along x.
        lamp_lit: whether light falls from the ceiling rather than through the windows.
    """

    use: str
    cells: tuple[Cell, ...]
    lamp_lit: bool


def room(seed: int) -> Scene:
    """Generate rooms; equal seeds give equal rooms."""
    rng = np.random.default_rng([13, seed])
    plan = _draw_plan(rng)
    build = SceneBuilder(rng, lighting=_indoor_light(rng, plan))
    _add_outdoors(build, rng.uniform(-12, -0.4) if rng.random() < 0.4 else -0.3)
    openings = _draw_openings(rng, plan)
    for index, cell in enumerate(plan.cells):
        add_room_shell(build, cell, openings[index], plan.use, casts_shadow=not plan.lamp_lit)
        if plan.use == "hall":
            furnish_hall(build, cell)
        else:
            furnish(build, cell, plan.use, openings[index])
        _add_walkway(build, cell, plan.use)
    return build.build("room")


def _draw_plan(rng: np.random.Generator) -> _Plan:
    use = str(rng.choice(["home", "office", "hall"], p=[0.48, 0.3, 0.22]))
    if use == "hall":
        size, height = (rng.uniform(10, 30), rng.uniform(8, 20)), rng.uniform(4, 9)
        cell = Cell((-0.5 * size[0], -0.5 * size[1]), (0.5 * size[0], 0.5 * size[1]), height)
        return _Plan(use, (cell,), bool(rng.random() < 0.7))
    count = int(rng.choice([1, 2, 3], p=[0.35, 0.4, 0.25]))
    height = rng.uniform(2.3, 3.2) if rng.random() < 0.8 else rng.uniform(3.2, 4.5)
    largest = 7.0 if use == "home" else 11.0
    widths = rng.uniform(2.8, largest, count)
    x = -0.5 * float(widths.sum())
    cells = []
    for width in widths:
        depth = rng.uniform(2.8, largest)
        front = rng.uniform(0.4, 0.6) * depth
        cells.append(Cell((x, front - depth), (x + float(width), front), height))
        x += float(width)
    return _Plan(use, tuple(cells), bool(rng.random() < 0.55))


def _indoor_light(rng: np.random.Generator, plan: _Plan) -> Lighting:
    """Light from the ceiling, or daylight through the windows; the picture of the sky is that of some day."""
    day = daylight(rng)
    warmth = rng.uniform(0.0, 1.0)
    tone = (1.0, 0.97 - 0.1 * warmth, 0.95 - 0.28 * warmth)
    level = rng.uniform(0.32, 0.55)
    sky = (level * tone[0], level * tone[1], level * tone[2])
    bounce = (0.85 * sky[0], 0.82 * sky[1], 0.77 * sky[2])
    if plan.lamp_lit:
        strength = rng.uniform(0.35, 0.9)
        sun = (strength * tone[0], strength * tone[1], strength * tone[2])
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


def _draw_openings(rng: np.random.Generator, plan: _Plan) -> list[Openings]:
    """Doors between neighbours and windows to the outside, by cell and by wall: west, east, south, north."""
    openings: list[Openings] = [{"west": [], "east": [], "south": [], "north": []} for _ in plan.cells]
    for left, right in zip(range(len(plan.cells)), range(1, len(plan.cells)), strict=False):
        low = max(plan.cells[left].low[1], plan.cells[right].low[1]) + 0.3
        high = min(plan.cells[left].high[1], plan.cells[right].high[1]) - 0.3
        width = min(float(rng.choice([0.85, 1.2, 2.4])), high - low)
        middle = rng.uniform(low + 0.5 * width, high - 0.5 * width + 1e-9)
        height = min(rng.uniform(2.0, 2.4), plan.cells[left].height - 0.15)
        door = Opening(middle - 0.5 * width, middle + 0.5 * width, 0.0, height)
        openings[left]["east"].append(door)
        openings[right]["west"].append(door)
    for cell, walls in zip(plan.cells, openings, strict=True):
        for name in ("south", "north"):
            if rng.random() < (0.65 if plan.use != "hall" else 0.4):
                walls[name] = _draw_windows(rng, cell)
    return openings


def _draw_windows(rng: np.random.Generator, cell: Cell) -> list[Opening]:
    """A row of equal windows along x."""
    length = cell.high[0] - cell.low[0]
    width = min(rng.uniform(0.8, 2.4), length - 0.8)
    count = max(1, int(rng.uniform(0.4, 0.9) * length / (width + 0.5)))
    sill = float(rng.choice([0.05, rng.uniform(0.7, 1.1)], p=[0.2, 0.8])) if cell.height < 4.6 else cell.height - 2.2
    head = min(cell.height - 0.2, sill + rng.uniform(1.0, 1.9)) if sill > 0.5 else min(2.3, cell.height - 0.2)
    step = length / count
    middles = [cell.low[0] + (k + 0.5) * step for k in range(count)]
    return [Opening(m - 0.5 * width, m + 0.5 * width, sill, head) for m in middles]


def _add_walkway(build: SceneBuilder, cell: Cell, use: str) -> None:
    margin = 0.45
    low = (cell.low[0] + margin, 1.05, cell.low[1] + margin)
    high = (cell.high[0] - margin, min(2.3, cell.height - 0.5), cell.high[1] - margin)
    level = build.ground[3]  # heights of walkways count from the ground
    low, high = (low[0], low[1] - level, low[2]), (high[0], high[1] - level, high[2])
    baselines = (0.5, 4.0) if use == "hall" else (0.3, 2.5)
    build.walkways.append(Walkway(low, high, (0.0, 0.0), baselines, 0.22))
