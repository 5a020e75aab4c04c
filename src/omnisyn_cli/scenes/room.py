"""Rooms: one to three in a row with real openings between them and to the outside, or one large hall."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from omnisyn_cli.scenes import furniture, palette, props
from omnisyn_cli.scenes.buildings import office
from omnisyn_cli.scenes.daylight import daylight, sun_at
from omnisyn_cli.scenes.hall import furnish_hall
from omnisyn_cli.scenes.materials import Material, Pattern
from omnisyn_cli.scenes.palette import pick
from omnisyn_cli.scenes.scene import Lighting, Scene, SceneBuilder, Shape, Walkway
from omnisyn_cli.scenes.turned import Turned
from omnisyn_cli.scenes.walls import Cell, Opening, enclose

__all__ = ["room"]

Openings = dict[str, list[Opening]]
Thing = Callable[[SceneBuilder, tuple[float, float, float], float], None]


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
    _outside(build, rng.uniform(-12, -0.4) if rng.random() < 0.4 else -0.3)
    openings = _openings(rng, plan)
    for index, cell in enumerate(plan.cells):
        enclose(build, cell, openings[index], plan.use, casts_shadow=not plan.lamp_lit)
        if plan.use == "hall":
            furnish_hall(build, cell)
        else:
            _furnish(build, cell, plan.use, openings[index])
        _walkway(build, cell, plan.use)
    return build.build("room")


def _draw_plan(rng: np.random.Generator) -> _Plan:
    use = str(rng.choice(["home", "office", "hall"], p=[0.48, 0.3, 0.22]))
    if use == "hall":
        size, tall = (rng.uniform(10, 30), rng.uniform(8, 20)), rng.uniform(4, 9)
        cell = Cell((-0.5 * size[0], -0.5 * size[1]), (0.5 * size[0], 0.5 * size[1]), tall)
        return _Plan(use, (cell,), bool(rng.random() < 0.7))
    count = int(rng.choice([1, 2, 3], p=[0.35, 0.4, 0.25]))
    tall = rng.uniform(2.3, 3.2) if rng.random() < 0.8 else rng.uniform(3.2, 4.5)
    largest = 7.0 if use == "home" else 11.0
    widths = rng.uniform(2.8, largest, count)
    x = -0.5 * float(widths.sum())
    cells = []
    for width in widths:
        deep = rng.uniform(2.8, largest)
        front = rng.uniform(0.4, 0.6) * deep
        cells.append(Cell((x, front - deep), (x + float(width), front), tall))
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
    return Lighting(
        sun_direction=direction,
        sun=sun,
        sky=sky,
        bounce=bounce,
        softness=softness,
        zenith=day.zenith,
        horizon=day.horizon,
        cloud=day.cloud,
        cloud_cover=day.cloud_cover,
        cloud_scale=day.cloud_scale,
        haze=0.0,
        exposure=rng.uniform(1.2, 1.9),
        seed=day.seed,
    )


def _outside(build: SceneBuilder, level: float) -> None:
    """Add the ground outside and a few things to see through the windows."""
    rng = build.rng
    green = pick(rng, palette.FOLIAGE)
    build.ground = (0.0, 1.0, 0.0, level)
    build.ground_material = Material(
        Pattern.GRASS, palette.darker(green, 0.85), palette.darker(green, 1.25), (0.5, 0.47, 0.35), detail=0.4
    )
    for side in (-1.0, 1.0):
        for _ in range(int(rng.integers(1, 4))):
            x, z = rng.uniform(-25, 25), side * rng.uniform(16, 45)
            if rng.random() < 0.5:
                office(build, (side * abs(x) + side * 10.0, level, z), rng.uniform(10, 20), side, detailed=False)
            elif rng.random() < 0.6:
                props.tree(build, (x, level, z), rng.uniform(5, 12))
            else:
                props.conifer(build, (x, level, z), rng.uniform(7, 14))


def _openings(rng: np.random.Generator, plan: _Plan) -> list[Openings]:
    """Doors between neighbours and windows to the outside, by cell and by wall: west, east, south, north."""
    openings: list[Openings] = [{"west": [], "east": [], "south": [], "north": []} for _ in plan.cells]
    for left, right in zip(range(len(plan.cells)), range(1, len(plan.cells)), strict=False):
        low = max(plan.cells[left].low[1], plan.cells[right].low[1]) + 0.3
        high = min(plan.cells[left].high[1], plan.cells[right].high[1]) - 0.3
        wide = min(float(rng.choice([0.85, 1.2, 2.4])), high - low)
        middle = rng.uniform(low + 0.5 * wide, high - 0.5 * wide + 1e-9)
        tall = min(rng.uniform(2.0, 2.4), plan.cells[left].tall - 0.15)
        door = Opening(middle - 0.5 * wide, middle + 0.5 * wide, 0.0, tall)
        openings[left]["east"].append(door)
        openings[right]["west"].append(door)
    for cell, walls in zip(plan.cells, openings, strict=True):
        for name in ("south", "north"):
            if rng.random() < (0.65 if plan.use != "hall" else 0.4):
                walls[name] = _windows(rng, cell)
    return openings


def _windows(rng: np.random.Generator, cell: Cell) -> list[Opening]:
    """A row of equal windows along x."""
    length = cell.high[0] - cell.low[0]
    wide = min(rng.uniform(0.8, 2.4), length - 0.8)
    count = max(1, int(rng.uniform(0.4, 0.9) * length / (wide + 0.5)))
    sill = float(rng.choice([0.05, rng.uniform(0.7, 1.1)], p=[0.2, 0.8])) if cell.tall < 4.6 else cell.tall - 2.2
    head = min(cell.tall - 0.2, sill + rng.uniform(1.0, 1.9)) if sill > 0.5 else min(2.3, cell.tall - 0.2)
    step = length / count
    middles = [cell.low[0] + (k + 0.5) * step for k in range(count)]
    return [Opening(m - 0.5 * wide, m + 0.5 * wide, sill, head) for m in middles]


def _walkway(build: SceneBuilder, cell: Cell, use: str) -> None:
    margin = 0.45
    low = (cell.low[0] + margin, 1.05, cell.low[1] + margin)
    high = (cell.high[0] - margin, min(2.3, cell.tall - 0.5), cell.high[1] - margin)
    level = build.ground[3]  # heights of walkways count from the ground
    low, high = (low[0], low[1] - level, low[2]), (high[0], high[1] - level, high[2])
    baselines = (0.5, 4.0) if use == "hall" else (0.3, 2.5)
    build.walkways.append(Walkway(low, high, (0.0, 0.0), baselines, 0.22))


def _furnish(build: SceneBuilder, cell: Cell, use: str, openings: Openings) -> None:
    """Line the walls and fill the floor; things that would overlap are left out."""
    rng = build.rng
    taken: list[tuple[float, float, float]] = []
    size = (cell.high[0] - cell.low[0], cell.high[1] - cell.low[1])
    if rng.random() < (0.5 if use == "home" else 0.15):
        _rug(build, cell)
    for _ in range(int(rng.integers(6, 12) + size[0] * size[1] / 5.0)):
        _against_wall(build, cell, use, openings, taken)
    for _ in range(int(rng.uniform(0.1, 0.45) * (size[0] + size[1]))):
        _picture(build, cell, openings)
    middle = (0.5 * (cell.low[0] + cell.high[0]), 0.0, 0.5 * (cell.low[1] + cell.high[1]))
    furniture.clutter(Turned(build, middle, 0.0), (0.5 * size[0], 0.5 * size[1]), 0.0, int(rng.integers(0, 9)))
    if use == "office" and min(size) > 4.0 and rng.random() < 0.6:
        _rows_of_desks(build, cell, taken)
    for _ in range(int(rng.integers(1, 4) + size[0] * size[1] / 9.0)):
        _in_the_middle(build, cell, use, taken)


def _is_free(taken: list[tuple[float, float, float]], x: float, z: float, radius: float) -> bool:
    if any(math.hypot(x - a, z - b) < radius + r for a, b, r in taken):
        return False
    taken.append((x, z, radius))
    return True


def _rug(build: SceneBuilder, cell: Cell) -> None:
    rng = build.rng
    half = (rng.uniform(0.7, 1.4), 0.006, rng.uniform(0.6, 1.1))
    x = rng.uniform(cell.low[0] + 1.5, max(cell.low[0] + 1.51, cell.high[0] - 1.5))
    z = rng.uniform(cell.low[1] + 1.2, max(cell.low[1] + 1.21, cell.high[1] - 1.2))
    weave = Material(
        Pattern.RUG,
        pick(rng, palette.CLOTH),
        pick(rng, palette.CLOTH),
        pick(rng, palette.CLOTH),
        cell=(0.3, 0.3),
        grain=0.12,
        grain_size=0.08,
        seed=int(rng.integers(1, 1000)),
    )
    build.add(
        Shape.BOX, (x, 0.006, z), half, weave, yaw=float(rng.choice([0.0, rng.uniform(-0.3, 0.3)])), casts_shadow=False
    )


def _against_wall(
    build: SceneBuilder, cell: Cell, use: str, openings: Openings, taken: list[tuple[float, float, float]]
) -> None:
    """Stand something against a wall, facing the room, and perhaps hang a picture over it."""
    rng = build.rng
    x, z, yaw, is_open = _wall_place(rng, cell, openings, 0.42)
    radius = 0.62
    if is_open > 1 or not _is_free(taken, x, z, radius):
        return
    base = (x, 0.0, z)
    home: tuple[Thing, ...] = (
        furniture.cabinet,
        furniture.shelf,
        furniture.sofa,
        furniture.bed,
        furniture.plant,
        furniture.floor_lamp,
    )
    work: tuple[Thing, ...] = (
        furniture.cabinet,
        furniture.shelf,
        furniture.shelf,
        furniture.screen,
        furniture.plant,
        furniture.table,
    )
    choices = home if use == "home" else work
    if is_open:  # nothing tall before a window
        choices = (furniture.table, furniture.plant, furniture.armchair)
    if rng.random() < 0.12:
        furniture.carton_pile(build, base, yaw, on_pallet=False)
    else:
        thing = choices[rng.integers(len(choices))]
        if thing is furniture.bed:
            inward = (x + 0.7 * math.sin(yaw), 0.0, z + 0.7 * math.cos(yaw))
            furniture.bed(build, inward, yaw)
            taken.append((inward[0], inward[2], 0.9))
        else:
            thing(build, base, yaw)
    if rng.random() < 0.7:
        _picture(build, cell, openings)


def _wall_place(
    rng: np.random.Generator, cell: Cell, openings: Openings, gap: float
) -> tuple[float, float, float, int]:
    """A point ``gap`` in front of a wall, the yaw that looks away from it, and 0 (wall), 1 (window) or 2 (door)."""
    name = str(rng.choice(["south", "north", "west", "east"]))
    x, z = rng.uniform(cell.low[0] + 0.8, cell.high[0] - 0.8), rng.uniform(cell.low[1] + 0.8, cell.high[1] - 0.8)
    along = x if name in ("south", "north") else z
    before = [o for o in openings[name] if o.start - 0.6 < along < o.end + 0.6]
    is_open = 0 if not before else (2 if before[0].bottom <= 0.0 else 1)
    if name == "south":
        return x, cell.low[1] + gap, 0.0, is_open
    if name == "north":
        return x, cell.high[1] - gap, math.pi, is_open
    if name == "west":
        return cell.low[0] + gap, z, 0.5 * math.pi, is_open
    return cell.high[0] - gap, z, -0.5 * math.pi, is_open


def _picture(build: SceneBuilder, cell: Cell, openings: Openings) -> None:
    rng = build.rng
    x, z, yaw, is_open = _wall_place(rng, cell, openings, 0.075)
    if is_open:
        return
    half = (rng.uniform(0.15, 0.55), rng.uniform(0.15, 0.45), 0.015)
    paint = Material(
        Pattern.PICTURE,
        pick(rng, palette.GLASS, 0.15),
        pick(rng, palette.FOLIAGE, 0.15),
        pick(rng, palette.WOOD),
        cell=(0.25, 0.2),
        line=rng.uniform(0.01, 0.04),
        grain=0.04,
        gloss=0.2,
        seed=int(rng.integers(1, 1000)),
    )
    if rng.random() < 0.35:
        paint = Material(
            Pattern.COLLAGE,
            pick(rng, palette.SIGN, 0.1),
            pick(rng, palette.INTERIOR),
            pick(rng, palette.SIGN, 0.1),
            cell=(0.4, 0.3),
            grain=0.04,
            detail=0.8,
            seed=int(rng.integers(1, 1000)),
        )
    build.add(Shape.BOX, (x, rng.uniform(1.3, 1.75), z), half, paint, yaw=yaw)


def _rows_of_desks(build: SceneBuilder, cell: Cell, taken: list[tuple[float, float, float]]) -> None:
    rng = build.rng
    step = (rng.uniform(1.9, 2.6), rng.uniform(1.6, 2.4))
    seat = furniture.office_chair if rng.random() < 0.5 else furniture.chair
    for x in np.arange(cell.low[0] + 1.6, cell.high[0] - 1.4, step[0]):
        for z in np.arange(cell.low[1] + 1.5, cell.high[1] - 1.2, step[1]):
            if rng.random() < 0.8 and _is_free(taken, float(x), float(z), 0.7):
                furniture.table(build, (float(x), 0.0, float(z)), 0.0, (0.6, 0.35))
                seat(
                    build,
                    (float(x) + rng.uniform(-0.2, 0.2), 0.0, float(z) + rng.uniform(0.4, 0.7)),
                    math.pi + rng.uniform(-0.5, 0.5),
                )


def _in_the_middle(build: SceneBuilder, cell: Cell, use: str, taken: list[tuple[float, float, float]]) -> None:
    """Stand a table with chairs, an armchair, a column or a person somewhere on the floor."""
    rng = build.rng
    low, high = cell.low, cell.high
    x, z = rng.uniform(low[0] + 0.9, high[0] - 0.9), rng.uniform(low[1] + 0.9, high[1] - 0.9)
    choice, yaw = rng.random(), rng.uniform(-math.pi, math.pi)
    base = (x, 0.0, z)
    if choice < 0.45 and _is_free(taken, x, z, 1.15):
        yaw = float(rng.choice([0.0, 0.5 * math.pi])) + rng.normal(0, 0.06)
        half = (rng.uniform(0.5, 0.9), rng.uniform(0.35, 0.5))
        furniture.table(build, base, yaw, half)
        seat = furniture.office_chair if use == "office" and rng.random() < 0.5 else furniture.chair
        for side in (-1.0, 1.0):
            for place in (-0.5, 0.5):
                if rng.random() < 0.7:
                    a, b = place * half[0], side * (half[1] + rng.uniform(0.05, 0.3))
                    c, s = math.cos(yaw), math.sin(yaw)
                    turn = yaw + (math.pi if side > 0 else 0.0) + rng.normal(0, 0.25)
                    seat(build, (x + c * a + s * b, 0.0, z - s * a + c * b), turn)
    elif choice < 0.6 and _is_free(taken, x, z, 0.55):
        furniture.armchair(build, base, yaw)
    elif choice < 0.7 and _is_free(taken, x, z, 0.4):
        furniture.chair(build, base, yaw)
    elif choice < 0.78 and _is_free(taken, x, z, 0.4):
        props.person(build, base)
    elif choice < 0.86 and _is_free(taken, x, z, 0.35):
        furniture.carton_pile(build, base, yaw, on_pallet=False)
    elif choice < 0.93 and _is_free(taken, x, z, 0.4):
        plaster = Material(Pattern.PLAIN, pick(rng, palette.INTERIOR), grain=0.08)
        if rng.random() < 0.5:
            build.pole(base, cell.tall, rng.uniform(0.1, 0.25), plaster)
        else:
            half_wide = rng.uniform(0.1, 0.25)
            build.add(Shape.BOX, (x, 0.5 * cell.tall, z), (half_wide, 0.5 * cell.tall, half_wide), plaster)
    elif cell.tall > 2.6 and rng.random() < 0.6 and _is_free(taken, x, z, 1.4):
        furniture.stairs(build, base, float(rng.choice([0.0, 0.5, 1.0, 1.5])) * math.pi, int(rng.integers(4, 12)))
