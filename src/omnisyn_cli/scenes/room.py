"""Rooms in a row and homes on a grid, furnished, with real openings between them and to the outside.

Homes have walls with little texture, and cameras close to the furniture.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise, product

import numpy as np

from omnisyn_cli.scenes import furniture, palette, props
from omnisyn_cli.scenes.buildings import office
from omnisyn_cli.scenes.materials import Material, Pattern, random_material, tonal_material
from omnisyn_cli.scenes.palette import pick
from omnisyn_cli.scenes.scene import Lighting, LocalFrame, Scene, SceneBuilder, Shape, Walkway, daylight, sun_at, times
from omnisyn_cli.scenes.walls import WALLS, Cell, Opening, Openings, add_room_shell, low_texture_finish, wall_axes

# What stands around in the room that is looked at most.
EXTRAS = (
    furniture.kitchen_unit, furniture.tripod, furniture.chair, furniture.armchair, furniture.plant,
    furniture.floor_lamp, furniture.table, furniture.shelf,
)  # fmt: skip
BASELINE_RANGE = (0.25, 8.0)  # Shortest and longest distance between the first and the last camera, metres
MAX_BASELINE_IN_DEPTHS = 3.0  # Longest baseline, in multiples of the depth of the nearest surface

Grid = dict[tuple[int, int], tuple[Cell, Openings]]  # Rooms with their openings by column and row.
FurnitureMaker = Callable[[LocalFrame], None]

# What stands against walls, by the use of the room, and before windows.
WALL_FURNITURE: dict[str, tuple[FurnitureMaker, ...]] = {
    "home": (furniture.cabinet, furniture.shelf, furniture.sofa, furniture.bed, furniture.plant, furniture.floor_lamp),
    "office": (furniture.cabinet, furniture.shelf, furniture.shelf, furniture.screen, furniture.plant, furniture.table),
}
WINDOW_FURNITURE: tuple[FurnitureMaker, ...] = (furniture.table, furniture.plant, furniture.armchair)
# Yaw (radians) of furniture that faces away from a wall.
INWARD_YAW = {"south": 0.0, "north": math.pi, "west": 0.5 * math.pi, "east": -0.5 * math.pi}

OccupiedDisks = list[tuple[float, float, float]]  # Occupied disks on the floor: x, z and radius, metres.


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


def furnish(
    build: SceneBuilder, cell: Cell, use: str, openings: Openings, extras: Sequence[FurnitureMaker] = ()
) -> None:
    """Line the walls of a room ("home" or "office") and fill its floor, ``extras`` where there is room; no overlaps."""
    rng = build.rng
    occupied: OccupiedDisks = []
    size = (cell.high[0] - cell.low[0], cell.high[1] - cell.low[1])
    if rng.random() < (0.5 if use == "home" else 0.15):
        _rug(build, cell)
    for _ in range(int(rng.integers(6, 12) + size[0] * size[1] / 5.0)):
        _place_against_wall(build, cell, use, openings, occupied)
    for _ in range(int(rng.uniform(0.1, 0.45) * (size[0] + size[1]))):
        _picture(build, cell, openings)
    middle = (0.5 * (cell.low[0] + cell.high[0]), 0.0, 0.5 * (cell.low[1] + cell.high[1]))
    furniture.clutter(LocalFrame(build, middle, 0.0), (0.5 * size[0], 0.5 * size[1]), 0.0, int(rng.integers(0, 9)))
    if use == "office" and min(size) > 4.0 and rng.random() < 0.6:
        _rows_of_desks(build, cell, occupied)
    for _ in range(int(rng.integers(1, 4) + size[0] * size[1] / 9.0)):
        _place_on_floor(build, cell, use, occupied)
    for extra in extras:
        x, z = rng.uniform(cell.low[0] + 0.7, cell.high[0] - 0.7), rng.uniform(cell.low[1] + 0.7, cell.high[1] - 0.7)
        if _is_free(occupied, x, z, 0.5):
            extra(LocalFrame(build, (x, 0.0, z), rng.uniform(-math.pi, math.pi)))


def _is_free(occupied: OccupiedDisks, x: float, z: float, radius: float) -> bool:
    if any(math.hypot(x - a, z - b) < radius + r for a, b, r in occupied):
        return False
    occupied.append((x, z, radius))
    return True


def _rug(build: SceneBuilder, cell: Cell) -> None:
    rng = build.rng
    half = (rng.uniform(0.7, 1.4), 0.006, rng.uniform(0.6, 1.1))
    x = rng.uniform(cell.low[0] + 1.5, max(cell.low[0] + 1.51, cell.high[0] - 1.5))
    z = rng.uniform(cell.low[1] + 1.2, max(cell.low[1] + 1.21, cell.high[1] - 1.2))
    weave = random_material(rng, Pattern.RUG, [palette.CLOTH] * 3, cell=(0.3, 0.3), grain=0.12, grain_size=0.08)
    build.add(
        Shape.BOX, (x, 0.006, z), half, weave, yaw=float(rng.choice([0.0, rng.uniform(-0.3, 0.3)])), casts_shadow=False
    )


def _place_against_wall(build: SceneBuilder, cell: Cell, use: str, openings: Openings, occupied: OccupiedDisks) -> None:
    """Stand something against a wall, facing the room, and perhaps hang a picture over it."""
    rng = build.rng
    x, z, yaw, is_open = _wall_place(rng, cell, openings, 0.42)
    radius = 0.62
    if is_open > 1 or not _is_free(occupied, x, z, radius):
        return
    local = LocalFrame(build, (x, 0.0, z), yaw)
    choices = WINDOW_FURNITURE if is_open else WALL_FURNITURE[use]
    if rng.random() < 0.12:
        furniture.carton_pile(local)
    else:
        thing = choices[rng.integers(len(choices))]
        if thing is furniture.bed:
            local = LocalFrame(build, local.place(0.0, 0.0, 0.7), yaw)
            occupied.append((local.base[0], local.base[2], 0.9))
        thing(local)
    if rng.random() < 0.7:
        _picture(build, cell, openings)


def _wall_place(
    rng: np.random.Generator, cell: Cell, openings: Openings, gap: float
) -> tuple[float, float, float, int]:
    """A point ``gap`` in front of a wall, the yaw that looks away from it, and 0 (wall), 1 (window) or 2 (door)."""
    name = str(rng.choice(["south", "north", "west", "east"]))
    x, z = rng.uniform(cell.low[0] + 0.8, cell.high[0] - 0.8), rng.uniform(cell.low[1] + 0.8, cell.high[1] - 0.8)
    *_, across, is_x = wall_axes(cell, name, gap)
    before = [o for o in openings[name] if o.start - 0.6 < (x if is_x else z) < o.end + 0.6]
    is_open = 0 if not before else (2 if before[0].bottom <= 0.0 else 1)
    x, z = (x, across) if is_x else (across, z)
    return x, z, INWARD_YAW[name], is_open


def _picture(build: SceneBuilder, cell: Cell, openings: Openings) -> None:
    rng = build.rng
    x, z, yaw, is_open = _wall_place(rng, cell, openings, 0.075)
    if is_open:
        return
    half = (rng.uniform(0.15, 0.55), rng.uniform(0.15, 0.45), 0.015)
    paint = Material(
        Pattern.PICTURE, pick(rng, palette.GLASS, 0.15), pick(rng, palette.FOLIAGE, 0.15), pick(rng, palette.WOOD),
        cell=(0.25, 0.2), line=rng.uniform(0.01, 0.04), grain=0.04, gloss=0.2, seed=int(rng.integers(1, 1000)),
    )  # fmt: skip
    if rng.random() < 0.35:
        paint = Material(
            Pattern.COLLAGE, pick(rng, palette.SIGN, 0.1), pick(rng, palette.INTERIOR), pick(rng, palette.SIGN, 0.1),
            cell=(0.4, 0.3), grain=0.04, detail=0.8, seed=int(rng.integers(1, 1000)),
        )  # fmt: skip
    build.add(Shape.BOX, (x, rng.uniform(1.3, 1.75), z), half, paint, yaw=yaw)


def _rows_of_desks(build: SceneBuilder, cell: Cell, occupied: OccupiedDisks) -> None:
    rng = build.rng
    step = (rng.uniform(1.9, 2.6), rng.uniform(1.6, 2.4))
    seat = furniture.office_chair if rng.random() < 0.5 else furniture.chair
    for x in np.arange(cell.low[0] + 1.6, cell.high[0] - 1.4, step[0]):
        for z in np.arange(cell.low[1] + 1.5, cell.high[1] - 1.2, step[1]):
            if rng.random() < 0.8 and _is_free(occupied, float(x), float(z), 0.7):
                furniture.table(LocalFrame(build, (float(x), 0.0, float(z)), 0.0), (0.6, 0.35))
                behind = (float(x) + rng.uniform(-0.2, 0.2), 0.0, float(z) + rng.uniform(0.4, 0.7))
                seat(LocalFrame(build, behind, math.pi + rng.uniform(-0.5, 0.5)))


def _place_on_floor(build: SceneBuilder, cell: Cell, use: str, occupied: OccupiedDisks) -> None:
    """Stand something on the floor: the first item that the dice allow and that finds room."""
    rng = build.rng
    low, high = cell.low, cell.high
    x, z = rng.uniform(low[0] + 0.9, high[0] - 0.9), rng.uniform(low[1] + 0.9, high[1] - 0.9)
    dice, local = rng.random(), LocalFrame(build, (x, 0.0, z), rng.uniform(-math.pi, math.pi))
    items: tuple[tuple[float, float, FurnitureMaker], ...] = (  # limit of the dice, radius in metres, what adds it
        (0.45, 1.15, partial(_table_with_chairs, use=use)), (0.6, 0.55, furniture.armchair),
        (0.7, 0.4, furniture.chair), (0.78, 0.4, lambda local: props.person(local.build, local.base)),
        (0.86, 0.35, furniture.carton_pile), (0.93, 0.4, partial(_column, height=cell.height)),
    )  # fmt: skip
    for limit, radius, add in items:
        if dice < limit and _is_free(occupied, x, z, radius):
            add(local)
            return
    if cell.height > 2.6 and rng.random() < 0.6 and _is_free(occupied, x, z, 1.4):
        turned = replace(local, yaw=float(rng.choice([0.0, 0.5, 1.0, 1.5])) * math.pi)
        furniture.stairs(turned, int(rng.integers(4, 12)))


def _table_with_chairs(local: LocalFrame, use: str) -> None:
    rng = local.build.rng
    local = replace(local, yaw=float(rng.choice([0.0, 0.5 * math.pi])) + rng.normal(0, 0.06))
    half = (rng.uniform(0.5, 0.9), rng.uniform(0.35, 0.5))
    furniture.table(local, half)
    seat = furniture.office_chair if use == "office" and rng.random() < 0.5 else furniture.chair
    for side, turn in ((-1.0, 0.0), (1.0, math.pi)):
        for place in (-0.5, 0.5):
            if rng.random() < 0.7:
                spot = local.place(place * half[0], 0.0, side * (half[1] + rng.uniform(0.05, 0.3)))
                seat(LocalFrame(local.build, spot, local.yaw + turn + rng.normal(0, 0.25)))


def _column(local: LocalFrame, height: float) -> None:
    build, (x, _, z) = local.build, local.base
    plaster = Material(Pattern.PLAIN, pick(build.rng, palette.INTERIOR), grain=0.08)
    if build.rng.random() < 0.5:
        build.pole(local.base, height, build.rng.uniform(0.1, 0.25), plaster)
    else:
        half_wide = build.rng.uniform(0.1, 0.25)
        build.add(Shape.BOX, (x, 0.5 * height, z), (half_wide, 0.5 * height, half_wide), plaster)
