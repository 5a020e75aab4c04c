"""Homes: rooms on a grid with doorways and windows, furniture close to the camera path, walls with little texture."""

import math

import numpy as np

from omnisyn_cli.scenes import furniture, obstacles, palette, props
from omnisyn_cli.scenes.daylight import daylight, sun_at
from omnisyn_cli.scenes.finishes import low_texture_finish, random_finish
from omnisyn_cli.scenes.furnishing import furnish
from omnisyn_cli.scenes.materials import Material, Pattern
from omnisyn_cli.scenes.obstacles import CameraPath, Enclosure
from omnisyn_cli.scenes.palette import pick
from omnisyn_cli.scenes.scene import Lighting, LocalFrame, Scene, SceneBuilder, Walkway
from omnisyn_cli.scenes.solids import Shape
from omnisyn_cli.scenes.walls import Cell, Opening, Openings, add_room_shell

PATH_FURNITURE = (
    furniture.bed, furniture.table, furniture.chair, furniture.chair, furniture.armchair, furniture.sofa,
    furniture.cabinet, furniture.office_chair, furniture.plant, furniture.floor_lamp, furniture.shelf,
    obstacles.kitchen_unit,
)  # fmt: skip

BASELINE_RANGE = (0.25, 8.0)
"""Shortest and longest distance between the first and the last camera, metres."""

MAX_BASELINE_IN_DEPTHS = 3.0
"""Longest baseline, in multiples of the depth of the nearest surface."""

Grid = dict[tuple[int, int], tuple[Cell, Openings]]
"""Rooms with their openings by column and row."""


def home(seed: int) -> Scene:
    """Generate a home; equal seeds give equal homes."""
    rng = np.random.default_rng([17, seed])
    build = SceneBuilder(rng, lighting=indoor_light(rng))
    build.ground = (0.0, 1.0, 0.0, -0.3)
    build.ground_material = random_finish(rng, 3.0)
    rooms = _floor_plan(rng)
    visited = list(rooms)[rng.integers(len(rooms))]
    for place, (cell, openings) in rooms.items():
        use = "office" if rng.random() < 0.2 else "home"
        add_room_shell(build, cell, openings, use, casts_shadow=False, finish=low_texture_finish)
        near = abs(place[0] - visited[0]) + abs(place[1] - visited[1])
        if near < 2:  # what is farther shows through doors of doors
            furnish(build, cell, use, openings)
            _add_room_walkway(build, cell)
        if near == 0:
            _add_obstacles(build, cell)
    _add_outdoors(build)
    return build.build("home")


def indoor_light(rng: np.random.Generator) -> Lighting:
    """Light from above through a ceiling that casts no shadow, or low from one side with dark on the other."""
    day, warmth, level = daylight(rng), rng.uniform(0.0, 1.0), rng.uniform(0.2, 0.55)
    tone = (1.0, 0.97 - 0.1 * warmth, 0.95 - 0.3 * warmth)
    is_sided = rng.random() < 0.4
    strength = rng.uniform(0.8, 1.6) if is_sided else rng.uniform(0.2, 0.8)
    elevation = rng.uniform(0.35, 0.9) if is_sided else rng.uniform(1.15, 1.5)
    level *= 0.6 if is_sided else 1.0
    return day._replace(
        sun_direction=sun_at(rng.uniform(-math.pi, math.pi), elevation),
        sun=(strength * tone[0], strength * tone[1], strength * tone[2]),
        sky=(level * tone[0], level * tone[1], level * tone[2]),
        bounce=(0.8 * level * tone[0], 0.77 * level * tone[1], 0.7 * level * tone[2]), softness=rng.uniform(0.02, 0.2),
        haze=0.0, exposure=rng.uniform(1.0, 2.0),
    )  # fmt: skip


def _floor_plan(rng: np.random.Generator) -> Grid:
    """Two to six rooms on a grid, most neighbours joined by a door, most outer walls with windows."""
    columns, rows = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    height = rng.uniform(2.3, 3.1)
    xs = np.concatenate([[0.0], np.cumsum(rng.uniform(2.3, 5.5, columns))])
    zs = np.concatenate([[0.0], np.cumsum(rng.uniform(2.3, 5.5, rows))])
    xs, zs = xs - 0.5 * xs[-1], zs - 0.5 * zs[-1]
    rooms: Grid = {
        (i, j): (
            Cell((float(xs[i]), float(zs[j])), (float(xs[i + 1]), float(zs[j + 1])), height),
            {"west": [], "east": [], "south": [], "north": []},
        )
        for i in range(columns)
        for j in range(rows)
    }
    for (i, j), (cell, openings) in rooms.items():
        for axis, (ahead, behind), other in ((1, ("east", "west"), (i + 1, j)), (0, ("north", "south"), (i, j + 1))):
            if other not in rooms:
                openings[ahead] = _windows(rng, cell.low[axis], cell.high[axis], height)
            elif rng.random() < 0.85:
                door = _door(rng, cell.low[axis], cell.high[axis], height)
                openings[ahead].append(door)
                rooms[other][1][behind].append(door)
        for axis, name, is_outer in ((1, "west", i == 0), (0, "south", j == 0)):
            if is_outer:
                openings[name] = _windows(rng, cell.low[axis], cell.high[axis], height)
    return rooms


def _door(rng: np.random.Generator, low: float, high: float, height: float) -> Opening:
    width = min(float(rng.choice([0.8, 0.95, 1.4, 2.2])), high - low - 0.6)
    middle = rng.uniform(low + 0.3 + 0.5 * width, high - 0.3 - 0.5 * width)
    return Opening(middle - 0.5 * width, middle + 0.5 * width, 0.0, min(rng.uniform(2.0, 2.3), height - 0.1))


def _windows(rng: np.random.Generator, low: float, high: float, height: float) -> list[Opening]:
    """A row of equal windows along a wall, or none."""
    if rng.random() < 0.4:
        return []
    width = min(rng.uniform(0.6, 2.2), high - low - 0.6)
    count = max(1, int(rng.uniform(0.3, 0.9) * (high - low) / (width + 0.4)))
    sill = 0.06 if rng.random() < 0.2 else rng.uniform(0.6, 1.1)
    head = min(height - 0.15, sill + rng.uniform(0.9, 1.9))
    step = (high - low) / count
    return [
        Opening(low + (k + 0.5) * step - 0.5 * width, low + (k + 0.5) * step + 0.5 * width, sill, head)
        for k in range(count)
    ]


def _add_room_walkway(build: SceneBuilder, cell: Cell) -> None:
    """Let cameras stand anywhere in a room."""
    level = build.ground[3]
    low = (cell.low[0] + 0.4, build.rng.uniform(0.6, 1.3) - level, cell.low[1] + 0.4)
    high = (cell.high[0] - 0.4, min(2.1, cell.height - 0.3) - level, cell.high[1] - 0.4)
    build.walkways.append(Walkway(low, high, (0.0, 0.0), BASELINE_RANGE, 0.2, MAX_BASELINE_IN_DEPTHS, 0.12))


def _add_obstacles(build: SceneBuilder, cell: Cell) -> None:
    """Put obstacles beside a camera path: furniture, lamps, people, and floating shapes in half of the rooms."""
    rng = build.rng
    enclosure = _draw_enclosure(rng, cell)
    for _ in range(int(rng.integers(2, 7))):
        place = enclosure.sample_floor_point(rng, 0.5, 0.9)
        if place is not None:
            add_item = PATH_FURNITURE[rng.integers(len(PATH_FURNITURE))]
            add_item(LocalFrame(build, place, rng.uniform(-math.pi, math.pi)))
    for thing, chance in ((_add_chandelier, 0.5), (_add_person_or_tripod, 0.35), (_add_dark_doorway, 0.4)):
        if rng.random() < chance:
            thing(build, enclosure)
    if rng.random() < 0.5:
        obstacles.floating_shapes(build, enclosure, int(rng.integers(10, 31)), 0.35)
    for add, chance in ((obstacles.bars, 0.2), (obstacles.platform, 0.3), (obstacles.arch, 0.15)):
        if rng.random() < chance:
            add(build, enclosure)
    obstacles.wires(build, enclosure, int(rng.integers(0, 4)))
    obstacles.blocks(build, enclosure, int(rng.integers(0, 5)), 0.3)
    build.walkways.extend([enclosure.path.walkway(build.ground[3], BASELINE_RANGE, MAX_BASELINE_IN_DEPTHS)] * 4)


def _draw_enclosure(rng: np.random.Generator, cell: Cell) -> Enclosure:
    """A room, and a path through it at the height of a camera."""
    low, high = (cell.low[0] + 0.15, 0.0, cell.low[1] + 0.15), (cell.high[0] - 0.15, cell.height, cell.high[1] - 0.15)
    ends = [(rng.uniform(low[0] + 0.4, high[0] - 0.4), rng.uniform(1.0, 1.8), rng.uniform(low[2] + 0.4, high[2] - 0.4))
            for _ in range(2)]  # fmt: skip
    return Enclosure(low, high, CameraPath(ends[0], ends[1], rng.uniform(0.25, 0.7)))


def _add_chandelier(build: SceneBuilder, enclosure: Enclosure) -> None:
    """Hang a chandelier beside the path."""
    x, _, z = enclosure.sample_point(build.rng)
    drop = build.rng.uniform(0.3, 1.0)
    if enclosure.path.is_clear_of((x, enclosure.high[1] - drop, z), 0.5):
        obstacles.chandelier(build, (x, enclosure.high[1], z), drop)


def _add_person_or_tripod(build: SceneBuilder, enclosure: Enclosure) -> None:
    """A person or a tripod beside the path."""
    place = enclosure.sample_floor_point(build.rng, 0.3, 1.9)
    if place is not None and build.rng.random() < 0.6:
        props.person(build, place)
    elif place is not None:
        obstacles.tripod(build, place, build.rng.uniform(1.0, 1.6))


def _add_dark_doorway(build: SceneBuilder, enclosure: Enclosure) -> None:
    """A doorway into the dark, in a wall along x."""
    rng = build.rng
    x = rng.uniform(enclosure.low[0] + 0.3, enclosure.high[0] - 0.3)
    z = enclosure.low[2] - 0.08 if rng.random() < 0.5 else enclosure.high[2] + 0.08
    build.add(Shape.BOX, (x, 1.0, z), (0.42, 1.0, 0.012), obstacles.DARK_GAP_MATERIAL)


def _add_outdoors(build: SceneBuilder) -> None:
    """Trees and buildings outside the windows."""
    rng = build.rng
    for _ in range(int(rng.integers(3, 9))):
        angle, far = rng.uniform(-math.pi, math.pi), rng.uniform(12.0, 35.0)
        base = (far * math.cos(angle), build.ground[3], far * math.sin(angle))
        if rng.random() < 0.6:
            props.tree(build, base, rng.uniform(4, 11))
        else:
            tone = pick(rng, palette.PLASTER)
            front = Material(
                Pattern.FACADE, tone, pick(rng, palette.GLASS), palette.scaled(tone, 0.7), cell=(2.5, 3.0), line=0.08,
            )  # fmt: skip
            height = rng.uniform(3, 8)
            half = (rng.uniform(3, 8), height, rng.uniform(3, 8))
            build.add(Shape.BOX, (base[0] * 1.3, base[1] + height, base[2] * 1.3), half, front, yaw=angle)
