"""Homes: rooms on a grid with doorways and windows, walls with little texture, cameras close to the furniture."""

from itertools import product

import numpy as np

from omnisyn_cli.scenes import furniture
from omnisyn_cli.scenes.finishes import low_texture_finish
from omnisyn_cli.scenes.furnishing import furnish
from omnisyn_cli.scenes.room import add_outdoors, add_walkway, draw_door, draw_windows, indoor_light
from omnisyn_cli.scenes.scene import LocalFrame, Scene, SceneBuilder
from omnisyn_cli.scenes.walls import Cell, Openings, add_room_shell

EXTRAS = (
    furniture.kitchen_unit, furniture.tripod, furniture.chair, furniture.armchair, furniture.plant,
    furniture.floor_lamp, furniture.table, furniture.shelf,
)  # fmt: skip
"""What stands around in the room that is looked at most."""

BASELINE_RANGE = (0.25, 8.0)
"""Shortest and longest distance between the first and the last camera, metres."""

MAX_BASELINE_IN_DEPTHS = 3.0
"""Longest baseline, in multiples of the depth of the nearest surface."""

Grid = dict[tuple[int, int], tuple[Cell, Openings]]
"""Rooms with their openings by column and row."""


def home(seed: int) -> Scene:
    """Generate a home; equal seeds give equal homes."""
    rng = np.random.default_rng([17, seed])
    build = SceneBuilder(rng, lighting=indoor_light(rng, lamp_lit=bool(rng.random() < 0.6)))
    add_outdoors(build, -0.3)
    rooms = _floor_plan(rng)
    visited = list(rooms)[rng.integers(len(rooms))]
    for place, (cell, openings) in rooms.items():
        use = "office" if rng.random() < 0.2 else "home"
        add_room_shell(build, cell, openings, use, casts_shadow=False, finish=low_texture_finish)
        near = abs(place[0] - visited[0]) + abs(place[1] - visited[1])
        if near < 2:  # what is farther shows through doors of doors
            furnish(build, cell, use, openings, EXTRAS if near == 0 else ())
            heights = (rng.uniform(0.6, 1.3), min(2.1, cell.height - 0.3))
            add_walkway(build, cell, 0.4, heights, BASELINE_RANGE, 0.2, MAX_BASELINE_IN_DEPTHS, slope=0.12)
        if near == 0 and rng.random() < 0.5:
            x, z = rng.uniform(cell.low, cell.high)
            furniture.chandelier(LocalFrame(build, (x, cell.height, z), 0.0))
    return build.build("home")


def _floor_plan(rng: np.random.Generator) -> Grid:
    """Two to six rooms on a grid, most neighbours joined by a door, most outer walls with windows."""
    height = rng.uniform(2.3, 3.1)
    xs, zs = (np.cumsum(rng.uniform(2.3, 5.5, rng.integers(2, most))) for most in (5, 4))
    xs, zs = xs - xs.mean(), zs - zs.mean()
    rooms: Grid = {
        (i, j): (
            Cell((xs[i], zs[j]), (xs[i + 1], zs[j + 1]), height),
            {"west": [], "east": [], "south": [], "north": []},
        )
        for i, j in product(range(len(xs) - 1), range(len(zs) - 1))
    }
    for (i, j), (cell, openings) in rooms.items():
        for axis, ahead, behind, after, before in (
            (1, "east", "west", (i + 1, j), (i - 1, j)), (0, "north", "south", (i, j + 1), (i, j - 1)),
        ):  # fmt: skip
            low, high = cell.low[axis], cell.high[axis]
            if after in rooms and rng.random() < 0.85:
                door = draw_door(rng, low + 0.3, high - 0.3, height)
                openings[ahead].append(door)
                rooms[after][1][behind].append(door)
            for wall, other in ((ahead, after), (behind, before)):
                if other not in rooms and rng.random() < 0.6:
                    openings[wall] = draw_windows(rng, low, high, height)
    return rooms
