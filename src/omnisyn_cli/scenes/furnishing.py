"""Furniture of rooms: against walls, on floors, on walls."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from omnisyn_cli.scenes import furniture, palette, props
from omnisyn_cli.scenes.materials import Material, Pattern, random_material
from omnisyn_cli.scenes.palette import pick
from omnisyn_cli.scenes.scene import LocalFrame, SceneBuilder, Shape
from omnisyn_cli.scenes.walls import Cell, Openings, wall_axes

FurnitureMaker = Callable[[LocalFrame], None]

# What stands against the walls of a home.
HOME_WALL_FURNITURE: tuple[FurnitureMaker, ...] = (
    furniture.cabinet, furniture.shelf, furniture.sofa, furniture.bed, furniture.plant, furniture.floor_lamp,
)  # fmt: skip
# What stands against the walls of an office.
OFFICE_WALL_FURNITURE: tuple[FurnitureMaker, ...] = (
    furniture.cabinet, furniture.shelf, furniture.shelf, furniture.screen, furniture.plant, furniture.table,
)  # fmt: skip
# What stands before a window.
WINDOW_FURNITURE: tuple[FurnitureMaker, ...] = (furniture.table, furniture.plant, furniture.armchair)
# Yaw (radians) of furniture that faces away from a wall.
INWARD_YAW = {"south": 0.0, "north": math.pi, "west": 0.5 * math.pi, "east": -0.5 * math.pi}

OccupiedDisks = list[tuple[float, float, float]]  # Occupied disks on the floor: x, z and radius, metres.


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
    choices = WINDOW_FURNITURE if is_open else HOME_WALL_FURNITURE if use == "home" else OFFICE_WALL_FURNITURE
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
