"""The shell of a room and its materials: floor, ceiling, and walls with real openings, each wall a row of slabs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from omnisyn_cli.scenes import palette
from omnisyn_cli.scenes.furniture import wood
from omnisyn_cli.scenes.materials import Material, Pattern, tonal_material
from omnisyn_cli.scenes.palette import pick
from omnisyn_cli.scenes.scene import LocalFrame, SceneBuilder, Shape


def wall_finish(rng: np.random.Generator, use: str) -> Material:
    """Draw paint, wallpaper, brick, boards or sheets for a wall; ``use`` is "home" or "office"."""
    tone = pick(rng, palette.INTERIOR)
    seed = int(rng.integers(1, 1000))
    kind = rng.random()
    if use == "home" and kind < 0.3:
        return Material(
            Pattern.WALLPAPER, tone, palette.scaled(tone, rng.uniform(0.75, 1.12)),
            palette.mixed(tone, pick(rng, palette.CLOTH), 0.4), cell=(rng.uniform(0.12, 0.5), rng.uniform(0.15, 0.5)),
            grain=0.03, seed=seed,
        )  # fmt: skip
    if kind < 0.4:
        brick = pick(rng, palette.BRICK) if rng.random() < 0.5 else tone
        return tonal_material(Pattern.BRICK, brick, 0.8, 1.25, cell=(0.25, 0.08), line=0.011, grain=0.12, seed=seed)
    if kind < 0.5:
        return Material(
            Pattern.PLANKS, pick(rng, palette.WOOD), pick(rng, palette.WOOD), (0.15, 0.1, 0.07), cell=(3.0, 0.14),
            line=0.006, grain=0.05, seed=seed,
        )  # fmt: skip
    return tonal_material(
        Pattern.PLAIN, tone, rng.uniform(0.78, 0.97), grain=rng.uniform(0.02, 0.1), grain_size=rng.uniform(0.5, 3.0),
        detail=rng.uniform(0.2, 0.6), seed=seed,
    )  # fmt: skip


def floor_finish(rng: np.random.Generator) -> Material:
    """Draw boards, tiles or carpet for a floor."""
    seed = int(rng.integers(1, 1000))
    kind = rng.random()
    if kind < 0.45:
        tone = pick(rng, palette.WOOD)
        return tonal_material(
            Pattern.PLANKS, tone, 0.75, 0.4, cell=(rng.uniform(0.6, 2.2), rng.uniform(0.07, 0.2)), line=0.005,
            grain=0.06, gloss=0.35, seed=seed,
        )  # fmt: skip
    if kind < 0.7:
        tone = pick(rng, palette.PAVING if rng.random() < 0.5 else palette.INTERIOR)
        other = palette.scaled(tone, rng.uniform(0.4, 0.95))
        pattern = Pattern.CHECKER if rng.random() < 0.3 else Pattern.TILES
        side = rng.uniform(0.2, 0.6)
        return Material(
            pattern, tone, other, palette.scaled(tone, 0.6), cell=(side, side), line=0.008, grain=0.07, gloss=0.45,
            detail=0.3, seed=seed,
        )  # fmt: skip
    tone = pick(rng, palette.CLOTH)
    grain_size = rng.choice([0.05, 0.3])
    return tonal_material(Pattern.PLAIN, tone, 0.8, grain=0.2, grain_size=grain_size, detail=0.4, seed=seed)


def low_texture_finish(rng: np.random.Generator, use: str) -> Material:
    """Draw paint with hardly any texture to match, for most walls; arguments as of :func:`wall_finish`."""
    if rng.random() < 0.3:
        return wall_finish(rng, use)
    tone = pick(rng, palette.INTERIOR)
    return tonal_material(
        Pattern.PLAIN, tone, rng.uniform(0.96, 1.0), grain=rng.uniform(0.0, 0.015), grain_size=rng.uniform(0.3, 4.0),
        detail=rng.uniform(0.0, 0.4), gloss=rng.uniform(0.05, 0.3) if rng.random() < 0.3 else 0.0,
        seed=int(rng.integers(1, 1000)),
    )  # fmt: skip


SLAB_THICKNESS = 0.06  # Of a wall's slabs, metres, all of it inside the cell; neighbours stand back to back


@dataclass(frozen=True)
class Cell:
    """A room: corners of its floor plan as (x, z), floor at y = 0, height ``height``; metres."""

    low: tuple[float, float]
    high: tuple[float, float]
    height: float


@dataclass(frozen=True)
class Opening:
    """A hole in a wall: from ``start`` to ``end`` along the wall's world axis, from ``bottom`` to ``top``; metres."""

    start: float
    end: float
    bottom: float
    top: float


WALLS = ("west", "east", "south", "north")  # Low and high x, low and high z

Openings = dict[str, list[Opening]]  # By wall.


def add_room_shell(
    build: SceneBuilder, cell: Cell, openings: Openings, use: str, *, casts_shadow: bool,
    finish: Callable[[np.random.Generator, str], Material] = wall_finish,
) -> None:  # fmt: skip
    """Add floor, ceiling, walls (by ``finish``), and skirting, window bars, curtains, doors, lamps for a ``use``."""
    rng = build.rng
    paint = finish(rng, use)
    accent = finish(rng, use) if rng.random() < 0.35 else paint
    (x0, z0), (x1, z1) = cell.low, cell.high
    build.box((x0, -0.3, z0), (x1, 0.0, z1), floor_finish(rng), casts_shadow=False)
    _ceiling(build, cell, use, casts_shadow)
    for name, material in (("west", paint), ("east", accent), ("south", paint), ("north", paint)):
        _wall(build, cell, name, openings[name], material)
        for opening in openings[name]:
            if opening.bottom > 0.0:
                _window(build, cell, name, opening)
            else:
                _doorway(build, cell, name, opening)
        if not openings[name] and rng.random() < 0.4:
            _closed_door(build, cell, name)


def _ceiling(build: SceneBuilder, cell: Cell, use: str, casts_shadow: bool) -> None:
    rng = build.rng
    (x0, z0), (x1, z1) = cell.low, cell.high
    white = pick(rng, ((0.9, 0.9, 0.88), (0.84, 0.83, 0.8), (0.75, 0.76, 0.76)))
    if use == "office" or rng.random() < 0.1:
        surface = Material(
            Pattern.PANELS, white, palette.scaled(white, 0.7), (0.97, 0.97, 0.95), cell=(0.6, 0.6), line=0.02,
            grain=0.05, detail=0.7, glow=2.5,
        )  # fmt: skip
    else:
        surface = tonal_material(Pattern.PLAIN, white, 0.92, grain=0.04, grain_size=1.5)
    build.box((x0, cell.height, z0), (x1, cell.height + 0.3, z1), surface, casts_shadow=casts_shadow)
    if rng.random() < 0.3:
        beam = wood(rng, 0.3) if rng.random() < 0.6 else surface
        for z in np.arange(z0 + 0.5, z1 - 0.2, rng.uniform(0.8, 1.6)):
            build.box((x0, cell.height - 0.18, float(z)), (x1, cell.height, float(z) + 0.12), beam, casts_shadow=False)
    if surface.pattern is Pattern.PLAIN:
        _ceiling_lamp(build, cell)
    for _ in range(max(1, int((x1 - x0) * (z1 - z0) / 30.0))):
        power = rng.uniform(0.25, 0.8)
        spot = (rng.uniform(x0 + 0.8, x1 - 0.8), cell.height - 0.5, rng.uniform(z0 + 0.8, z1 - 0.8))
        if len(build.lamps) < 5:
            build.lamps.append((*spot, power, 0.92 * power, 0.8 * power))


def _ceiling_lamp(build: SceneBuilder, cell: Cell) -> None:
    rng = build.rng
    x, z = 0.5 * (cell.low[0] + cell.high[0]), 0.5 * (cell.low[1] + cell.high[1])
    shade = Material(Pattern.PLAIN, (0.95, 0.92, 0.85), grain=0.02, glow=rng.uniform(0.5, 2.5))
    drop = rng.uniform(0.2, 0.7)
    kind = rng.random()
    if kind < 0.4:
        cord = Material(Pattern.PLAIN, (0.1, 0.1, 0.1), grain=0.0)
        build.rod((x, cell.height - drop, z), (x, cell.height, z), 0.006, cord)
        build.ball((x, cell.height - drop, z), rng.uniform(0.1, 0.2), shade)
    elif kind < 0.7:
        build.add(Shape.CYLINDER, (x, cell.height - 0.05, z), (0.22, 0.05, 0.22), shade)
    else:
        build.add(Shape.BOX, (x, cell.height - 0.04, z), (0.6, 0.03, 0.08), shade)


def wall_axes(cell: Cell, name: str, inset: float = 0.5 * SLAB_THICKNESS) -> tuple[float, float, float, bool]:
    """Start and end along a wall, where what is ``inset`` inside (slabs' middle) is across, whether it runs along x."""
    is_x = name in ("south", "north")
    along, across = (0, 1) if is_x else (1, 0)
    place = cell.low[across] + inset if name in ("west", "south") else cell.high[across] - inset
    return cell.low[along], cell.high[along], place, is_x


def _slab(
    build: SceneBuilder, wall: tuple[float, float, float, bool], along: tuple[float, float],
    heights: tuple[float, float], half: float, material: Material,
) -> None:  # fmt: skip
    """Add a piece of wall, or a bar in one."""
    across, is_x = wall[2], wall[3]
    middle, reach = 0.5 * (along[0] + along[1]), 0.5 * (along[1] - along[0])
    y, height = 0.5 * (heights[0] + heights[1]), 0.5 * (heights[1] - heights[0])
    if reach <= 1e-6 or height <= 1e-6:
        return
    centre = (middle, y, across) if is_x else (across, y, middle)
    build.add(Shape.BOX, centre, (reach, height, half) if is_x else (half, height, reach), material)


def _wall(build: SceneBuilder, cell: Cell, name: str, openings: Sequence[Opening], material: Material) -> None:
    wall = wall_axes(cell, name)
    at, half = wall[0], 0.5 * SLAB_THICKNESS
    ordered = sorted(openings, key=lambda opening: opening.start)
    for opening in ordered:
        _slab(build, wall, (at, opening.start), (0.0, cell.height), half, material)
        _slab(build, wall, (opening.start, opening.end), (0.0, opening.bottom), half, material)
        _slab(build, wall, (opening.start, opening.end), (opening.top, cell.height), half, material)
        at = opening.end
    _slab(build, wall, (at, wall[1]), (0.0, cell.height), half, material)
    if build.rng.random() < 0.5:
        skirting = Material(Pattern.PLAIN, palette.scaled(material.first, build.rng.choice([0.5, 1.15])), grain=0.04)
        at = wall[0]
        for opening in (*(o for o in ordered if o.bottom <= 0.0), Opening(wall[1], wall[1], 0.0, 0.0)):
            _slab(build, wall, (at, opening.start), (0.0, 0.09), half + 0.012, skirting)
            at = opening.end


def _window(build: SceneBuilder, cell: Cell, name: str, opening: Opening) -> None:
    """Add frame and bars of a window, its board, and perhaps curtains or a radiator."""
    rng = build.rng
    wall = wall_axes(cell, name)
    frame = Material(Pattern.PLAIN, (0.88, 0.88, 0.86) if rng.random() < 0.7 else (0.25, 0.24, 0.23), grain=0.03)
    a, b, low, high = opening.start, opening.end, opening.bottom, opening.top
    for edge in (a + 0.03, b - 0.03):
        _slab(build, wall, (edge - 0.03, edge + 0.03), (low, high), 0.045, frame)
    for edge in (low + 0.03, high - 0.03):
        _slab(build, wall, (a, b), (edge - 0.03, edge + 0.03), 0.045, frame)
    bars = max(1, round((b - a) / 0.9))
    for k in range(1, bars):
        x = a + k * (b - a) / bars
        _slab(build, wall, (x - 0.02, x + 0.02), (low, high), 0.03, frame)
    if rng.random() < 0.4:
        y = low + rng.uniform(0.6, 0.8) * (high - low)
        _slab(build, wall, (a, b), (y - 0.02, y + 0.02), 0.03, frame)
    if low > 0.3:
        _slab(build, wall, (a - 0.06, b + 0.06), (low - 0.03, low), 0.14, frame)
    inward = 1.0 if name in ("west", "south") else -1.0
    inside = (wall[0], wall[1], wall[2] + 0.1 * inward, wall[3])
    if rng.random() < 0.35 and high < 3.0:
        tone = pick(rng, palette.CLOTH)
        cloth = tonal_material(Pattern.RIBS, tone, 0.75, 1.0, cell=(0.09, 50.0), line=0.001, grain=0.08)
        for edge, sign in ((a, -1.0), (b, 1.0)):
            start, end = sorted((edge + sign * 0.25, edge - sign * 0.22))
            _slab(build, inside, (start, end), (0.1, high + 0.12), 0.025, cloth)
    elif low > 0.6 and low < 1.3 and rng.random() < 0.5:
        colours = (0.86, 0.86, 0.84), (0.72, 0.72, 0.7), (0.6, 0.6, 0.6)
        steel = Material(Pattern.RIBS, *colours, cell=(0.08, 9.0), line=0.01, grain=0.03)
        _slab(build, inside, (a + 0.1, b - 0.1), (0.12, low - 0.12), 0.04, steel)


def _doorway(build: SceneBuilder, cell: Cell, name: str, opening: Opening) -> None:
    """Add the frame of a doorway and, if it is narrow, an open door."""
    rng = build.rng
    wall = wall_axes(cell, name)
    frame = Material(Pattern.PLAIN, pick(rng, palette.WOOD) if rng.random() < 0.4 else (0.85, 0.85, 0.83), grain=0.04)
    a, b, top = opening.start, opening.end, opening.top
    for edge in (a, b):
        _slab(build, wall, (edge - 0.05, edge + 0.02), (0.0, top + 0.05), 0.045, frame)
    _slab(build, wall, (a, b), (top - 0.02, top + 0.05), 0.045, frame)
    if b - a < 1.0 and name == "west" and rng.random() < 0.6:
        angle = rng.uniform(0.6, 1.5)
        hinge = LocalFrame(build, (wall[2] + 0.06, 0.0, a), angle)
        hinge.box((0.0, 0.5 * top, 0.5 * (b - a)), (0.02, 0.5 * top - 0.01, 0.5 * (b - a) - 0.02), wood(rng, 1.0))


def _closed_door(build: SceneBuilder, cell: Cell, name: str) -> None:
    rng = build.rng
    low, high, across, is_x = wall_axes(cell, name)
    if high - low < 2.0:
        return
    middle = rng.uniform(low + 0.6, high - 0.6)
    top = min(2.1, cell.height - 0.1)
    inward = 1.0 if name in ("west", "south") else -1.0
    wall = (low, high, across + 0.03 * inward, is_x)
    tone = pick(rng, palette.WOOD if rng.random() < 0.6 else palette.INTERIOR)
    cell_size = (0.36, 9.0 if rng.random() < 0.3 else 0.7)
    leaf = tonal_material(Pattern.WINDOW, tone, 0.9, 1.0, cell=cell_size, line=0.1, grain=0.08, gloss=0.15)
    trim = Material(Pattern.PLAIN, palette.scaled(tone, 0.8), grain=0.04)
    _slab(build, wall, (middle - 0.45, middle + 0.45), (0.0, top), 0.02, leaf)
    for edge in (middle - 0.48, middle + 0.48):
        _slab(build, wall, (edge - 0.04, edge + 0.04), (0.0, top + 0.04), 0.035, trim)
    _slab(build, wall, (middle - 0.52, middle + 0.52), (top, top + 0.08), 0.035, trim)
    knob = (middle + 0.38, 1.0, wall[2] + 0.06 * inward) if is_x else (wall[2] + 0.06 * inward, 1.0, middle + 0.38)
    build.ball(knob, 0.03, Material(Pattern.PLAIN, (0.6, 0.58, 0.5), gloss=0.7, grain=0.0))
