"""Homes: rooms on a grid with doorways and windows, furniture close to the way, walls with hardly any texture."""

import math
from dataclasses import replace

import numpy as np

from omnisyn_cli.scenes import furniture, obstacles, palette, props
from omnisyn_cli.scenes.daylight import daylight, sun_at
from omnisyn_cli.scenes.finishes import any_finish, faint_finish
from omnisyn_cli.scenes.furnishing import furnish
from omnisyn_cli.scenes.materials import Material, Pattern
from omnisyn_cli.scenes.obstacles import Space, Way
from omnisyn_cli.scenes.palette import pick
from omnisyn_cli.scenes.scene import Lighting, Scene, SceneBuilder, Shape, Turned, Walkway
from omnisyn_cli.scenes.walls import Cell, Opening, Openings, enclose

NEAR_THE_WAY = (
    furniture.bed, furniture.table, furniture.chair, furniture.chair, furniture.armchair, furniture.sofa,
    furniture.cabinet, furniture.office_chair, furniture.plant, furniture.floor_lamp, furniture.shelf, obstacles.unit,
)  # fmt: skip

BASELINES = (0.25, 8.0)
"""Metres."""

NEARNESS = 3.0
"""Longest baseline in distances of the nearest thing."""

Grid = dict[tuple[int, int], tuple[Cell, Openings]]
"""Rooms with their openings by column and row."""


def home(seed: int) -> Scene:
    """Generate a home; equal seeds give equal homes."""
    rng = np.random.default_rng([17, seed])
    build = SceneBuilder(rng, lighting=indoor_light(rng))
    build.ground = (0.0, 1.0, 0.0, -0.3)
    build.ground_material = any_finish(rng, 3.0)
    rooms = _plan(rng)
    visited = list(rooms)[rng.integers(len(rooms))]
    for place, (cell, openings) in rooms.items():
        use = "office" if rng.random() < 0.2 else "home"
        enclose(build, cell, openings, use, casts_shadow=False, finish=faint_finish)
        near = abs(place[0] - visited[0]) + abs(place[1] - visited[1])
        if near < 2:  # what is farther shows through doors of doors
            furnish(build, cell, use, openings)
            _stay_in(build, cell)
        if near == 0:
            _close_by(build, cell)
    _outside(build)
    return build.build("home")


def indoor_light(rng: np.random.Generator) -> Lighting:
    """Light from above through a ceiling that casts no shadow, or low from one side with dark on the other."""
    day, warmth, level = daylight(rng), rng.uniform(0.0, 1.0), rng.uniform(0.2, 0.55)
    tone = (1.0, 0.97 - 0.1 * warmth, 0.95 - 0.3 * warmth)
    is_sided = rng.random() < 0.4
    strength = rng.uniform(0.8, 1.6) if is_sided else rng.uniform(0.2, 0.8)
    elevation = rng.uniform(0.35, 0.9) if is_sided else rng.uniform(1.15, 1.5)
    level *= 0.6 if is_sided else 1.0
    return replace(
        day,
        sun_direction=sun_at(rng.uniform(-math.pi, math.pi), elevation),
        sun=(strength * tone[0], strength * tone[1], strength * tone[2]),
        sky=(level * tone[0], level * tone[1], level * tone[2]),
        bounce=(0.8 * level * tone[0], 0.77 * level * tone[1], 0.7 * level * tone[2]),
        softness=rng.uniform(0.02, 0.2),
        haze=0.0,
        exposure=rng.uniform(1.0, 2.0),
    )


def _plan(rng: np.random.Generator) -> Grid:
    """Two to six rooms on a grid, most neighbours joined by a door, most outer walls with windows."""
    columns, rows = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    tall = rng.uniform(2.3, 3.1)
    xs = np.concatenate([[0.0], np.cumsum(rng.uniform(2.3, 5.5, columns))])
    zs = np.concatenate([[0.0], np.cumsum(rng.uniform(2.3, 5.5, rows))])
    xs, zs = xs - 0.5 * xs[-1], zs - 0.5 * zs[-1]
    rooms: Grid = {
        (i, j): (
            Cell((float(xs[i]), float(zs[j])), (float(xs[i + 1]), float(zs[j + 1])), tall),
            {"west": [], "east": [], "south": [], "north": []},
        )
        for i in range(columns)
        for j in range(rows)
    }
    for (i, j), (cell, openings) in rooms.items():
        for axis, (ahead, behind), other in ((1, ("east", "west"), (i + 1, j)), (0, ("north", "south"), (i, j + 1))):
            if other not in rooms:
                openings[ahead] = _windows(rng, cell.low[axis], cell.high[axis], tall)
            elif rng.random() < 0.85:
                door = _door(rng, cell.low[axis], cell.high[axis], tall)
                openings[ahead].append(door)
                rooms[other][1][behind].append(door)
        for axis, name, is_outer in ((1, "west", i == 0), (0, "south", j == 0)):
            if is_outer:
                openings[name] = _windows(rng, cell.low[axis], cell.high[axis], tall)
    return rooms


def _door(rng: np.random.Generator, low: float, high: float, tall: float) -> Opening:
    wide = min(float(rng.choice([0.8, 0.95, 1.4, 2.2])), high - low - 0.6)
    middle = rng.uniform(low + 0.3 + 0.5 * wide, high - 0.3 - 0.5 * wide)
    return Opening(middle - 0.5 * wide, middle + 0.5 * wide, 0.0, min(rng.uniform(2.0, 2.3), tall - 0.1))


def _windows(rng: np.random.Generator, low: float, high: float, tall: float) -> list[Opening]:
    """A row of equal windows along a wall, or none."""
    if rng.random() < 0.4:
        return []
    wide = min(rng.uniform(0.6, 2.2), high - low - 0.6)
    count = max(1, int(rng.uniform(0.3, 0.9) * (high - low) / (wide + 0.4)))
    sill = 0.06 if rng.random() < 0.2 else rng.uniform(0.6, 1.1)
    head = min(tall - 0.15, sill + rng.uniform(0.9, 1.9))
    step = (high - low) / count
    return [
        Opening(low + (k + 0.5) * step - 0.5 * wide, low + (k + 0.5) * step + 0.5 * wide, sill, head)
        for k in range(count)
    ]


def _stay_in(build: SceneBuilder, cell: Cell) -> None:
    """Let cameras stand anywhere in a room."""
    level = build.ground[3]
    low = (cell.low[0] + 0.4, build.rng.uniform(0.6, 1.3) - level, cell.low[1] + 0.4)
    high = (cell.high[0] - 0.4, min(2.1, cell.tall - 0.3) - level, cell.high[1] - 0.4)
    build.walkways.append(Walkway(low, high, (0.0, 0.0), BASELINES, 0.2, NEARNESS, 0.12))


def _close_by(build: SceneBuilder, cell: Cell) -> None:
    """Put things next to a way through a room: furniture, lamps, somebody, and in half of the rooms shapes adrift."""
    rng = build.rng
    space = _space(rng, cell)
    for _ in range(int(rng.integers(2, 7))):
        place = space.floor_place(rng, 0.5, 0.9)
        if place is not None:
            NEAR_THE_WAY[rng.integers(len(NEAR_THE_WAY))](Turned(build, place, rng.uniform(-math.pi, math.pi)))
    for thing, chance in ((_hang, 0.5), (_stand_by, 0.35), (_dark_door, 0.4)):
        if rng.random() < chance:
            thing(build, space)
    if rng.random() < 0.5:
        obstacles.adrift(build, space, int(rng.integers(10, 31)), 0.35)
    for add, chance in ((obstacles.bars, 0.2), (obstacles.platform, 0.3), (obstacles.arch, 0.15)):
        if rng.random() < chance:
            add(build, space)
    obstacles.wires(build, space, int(rng.integers(0, 4)))
    obstacles.blocks(build, space, int(rng.integers(0, 5)), 0.3)
    build.walkways.extend([space.way.walkway(build.ground[3], BASELINES, NEARNESS)] * 4)


def _space(rng: np.random.Generator, cell: Cell) -> Space:
    """A room, and a way through it at the height of a camera."""
    low, high = (cell.low[0] + 0.15, 0.0, cell.low[1] + 0.15), (cell.high[0] - 0.15, cell.tall, cell.high[1] - 0.15)
    ends = [(rng.uniform(low[0] + 0.4, high[0] - 0.4), rng.uniform(1.0, 1.8), rng.uniform(low[2] + 0.4, high[2] - 0.4))
            for _ in range(2)]  # fmt: skip
    return Space(low, high, Way(ends[0], ends[1], rng.uniform(0.25, 0.7)))


def _hang(build: SceneBuilder, space: Space) -> None:
    """Hang a chandelier beside the way."""
    x, _, z = space.drawn(build.rng)
    drop = build.rng.uniform(0.3, 1.0)
    if space.way.is_clear_of((x, space.high[1] - drop, z), 0.5):
        obstacles.chandelier(build, (x, space.high[1], z), drop)


def _stand_by(build: SceneBuilder, space: Space) -> None:
    """Somebody, or a tripod."""
    place = space.floor_place(build.rng, 0.3, 1.9)
    if place is not None and build.rng.random() < 0.6:
        props.person(build, place)
    elif place is not None:
        obstacles.tripod(build, place, build.rng.uniform(1.0, 1.6))


def _dark_door(build: SceneBuilder, space: Space) -> None:
    """A doorway into the dark, in a wall along x."""
    rng = build.rng
    x = rng.uniform(space.low[0] + 0.3, space.high[0] - 0.3)
    z = space.low[2] - 0.08 if rng.random() < 0.5 else space.high[2] + 0.08
    build.add(Shape.BOX, (x, 1.0, z), (0.42, 1.0, 0.012), obstacles.BLACK)


def _outside(build: SceneBuilder) -> None:
    """What is seen through the windows."""
    rng = build.rng
    for _ in range(int(rng.integers(3, 9))):
        angle, far = rng.uniform(-math.pi, math.pi), rng.uniform(12.0, 35.0)
        base = (far * math.cos(angle), build.ground[3], far * math.sin(angle))
        if rng.random() < 0.6:
            props.tree(build, base, rng.uniform(4, 11))
        else:
            tone = pick(rng, palette.PLASTER)
            front = Material(
                Pattern.FACADE, tone, pick(rng, palette.GLASS), palette.darker(tone, 0.7), cell=(2.5, 3.0), line=0.08
            )
            tall = rng.uniform(3, 8)
            half = (rng.uniform(3, 8), tall, rng.uniform(3, 8))
            build.add(Shape.BOX, (base[0] * 1.3, base[1] + tall, base[2] * 1.3), half, front, yaw=angle)
