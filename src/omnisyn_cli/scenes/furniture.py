"""Furniture: every function adds one piece to the floor, its front along the local +z axis."""

import math

import numpy as np

from omnisyn_cli.scenes import palette
from omnisyn_cli.scenes.materials import Material, Pattern, tonal_material
from omnisyn_cli.scenes.palette import pick
from omnisyn_cli.scenes.scene import LocalFrame

# Materials of legs, feet, boxes and gaps. Set by hand.
BLACK_PLASTIC = Material(Pattern.PLAIN, (0.08, 0.08, 0.085), (0.11, 0.11, 0.11), grain=0.08, gloss=0.15)
CHROME = Material(Pattern.PLAIN, (0.55, 0.56, 0.57), (0.45, 0.46, 0.46), grain=0.05, gloss=0.7)
CARTON = Material(Pattern.PLAIN, (0.62, 0.47, 0.31), (0.74, 0.63, 0.46), grain=0.08, grain_size=0.4, detail=0.3, seed=3)
DARK_MATERIAL = Material(Pattern.PLAIN, (0.04, 0.04, 0.045), (0.03, 0.03, 0.03), grain=0.05)


def wood(rng: np.random.Generator, plank: float = 0.5) -> Material:
    """Draw a varnished or painted board."""
    if rng.random() < 0.3:
        paint = pick(rng, palette.INTERIOR)
        return tonal_material(Pattern.PLAIN, paint, 0.9, grain=0.05, gloss=0.15, seed=int(rng.integers(1, 1000)))
    tone = pick(rng, palette.WOOD)
    return tonal_material(
        Pattern.PLANKS, tone, 0.8, 0.5, cell=(2.0, plank), line=0.004, grain=0.05, gloss=0.2,
        seed=int(rng.integers(1, 1000)),
    )  # fmt: skip


def _cloth(rng: np.random.Generator) -> Material:
    tone = pick(rng, palette.CLOTH, 0.08)
    if rng.random() < 0.25:
        return Material(
            Pattern.WALLPAPER, tone, palette.scaled(tone, 1.3), pick(rng, palette.CLOTH), cell=(0.15, 0.15), grain=0.1,
        )  # fmt: skip
    return tonal_material(Pattern.PLAIN, tone, 0.85, grain=0.14, grain_size=0.25, seed=int(rng.integers(1, 1000)))


def table(local: LocalFrame, size: tuple[float, float] | None = None) -> None:
    """Add a table with four legs, trestles or one column, and things on it."""
    rng = local.build.rng
    width, depth = size or (rng.uniform(0.4, 1.0), rng.uniform(0.3, 0.5))
    height = rng.uniform(0.42, 0.55) if rng.random() < 0.25 else rng.uniform(0.7, 0.78)
    top = wood(rng, 0.2)
    leg = top if rng.random() < 0.5 else (BLACK_PLASTIC if rng.random() < 0.5 else CHROME)
    local.box((0.0, height - 0.02, 0.0), (width, 0.02, depth), top)
    thickness = rng.uniform(0.012, 0.035)
    for x in (-width + 0.06, width - 0.06):
        for z in (-depth + 0.06, depth - 0.06):
            local.rod((x, 0.0, z), (x, height - 0.03, z), thickness, leg)
    if rng.random() < 0.5:
        for z in (-depth + 0.06, depth - 0.06):
            local.box((0.0, height - 0.08, z), (width - 0.06, 0.035, 0.01), leg)
    clutter(local, (width, depth), height, int(rng.integers(0, 5)))


def clutter(local: LocalFrame, half: tuple[float, float], height: float, count: int) -> None:
    """Put small things on a board or floor of half sizes ``half``: boxes, books, cups, bottles, balls."""
    rng = local.build.rng
    for _ in range(count):
        x, z = rng.uniform(-0.85, 0.85) * half[0], rng.uniform(-0.75, 0.75) * half[1]
        colour = pick(rng, palette.SIGN if rng.random() < 0.3 else palette.CLOTH, 0.1)
        stuff = Material(
            Pattern.COLLAGE, colour, pick(rng, palette.INTERIOR), pick(rng, palette.SIGN), cell=(0.1, 0.06), grain=0.05
        )
        plain = tonal_material(Pattern.PLAIN, colour, 0.9, grain=0.05, gloss=0.3)
        kind = rng.random()
        if kind < 0.5:
            size = (rng.uniform(0.05, 0.17), rng.uniform(0.01, 0.12), rng.uniform(0.05, 0.13))
            local.box((x, height + size[1], z), size, stuff, turn=rng.uniform(0.0, math.pi))
        elif kind < 0.85:
            length = rng.uniform(0.08, 0.3)
            local.rod((x, height, z), (x, height + length, z), rng.uniform(0.03, 0.05), plain)
        else:
            radius = rng.uniform(0.05, 0.12)
            local.ellipsoid((x, height + radius, z), (radius, radius, radius), plain)


def chair(local: LocalFrame) -> None:
    """Add a chair with four thin legs, a seat and a back of slats or one board."""
    rng = local.build.rng
    body = wood(rng, 0.1)
    leg = body if rng.random() < 0.6 else CHROME
    seat = _cloth(rng) if rng.random() < 0.5 else body
    half, height = rng.uniform(0.19, 0.24), rng.uniform(0.42, 0.48)
    top = height + rng.uniform(0.35, 0.55)
    local.box((0.0, height, 0.0), (half, rng.uniform(0.015, 0.04), half), seat)
    for x in (-half + 0.03, half - 0.03):
        local.rod((x, 0.0, half - 0.03), (x, height, half - 0.03), 0.016, leg)
        local.rod((x, 0.0, -half + 0.02), (x, top, -half - 0.03), 0.016, leg)
    if rng.random() < 0.5:
        size = (half - 0.02, 0.4 * (top - height) - 0.02, 0.012)
        local.box((0.0, 0.5 * (height + top) + 0.08, -half - 0.02), size, seat)
    else:
        for share in (0.35, 0.65, 0.95):
            local.box((0.0, height + share * (top - height), -half - 0.02), (half - 0.03, 0.03, 0.01), body)


def office_chair(local: LocalFrame) -> None:
    """Add a swivel chair on a star of five feet."""
    rng = local.build.rng
    cloth = _cloth(rng)
    for k in range(5):
        angle = 2.0 * math.pi * k / 5
        local.rod((0.0, 0.09, 0.0), (0.3 * math.cos(angle), 0.05, 0.3 * math.sin(angle)), 0.022, BLACK_PLASTIC)
    local.rod((0.0, 0.05, 0.0), (0.0, 0.45, 0.0), 0.028, CHROME)
    local.box((0.0, 0.48, 0.0), (0.23, 0.04, 0.23), cloth)
    local.box((0.0, 0.82, -0.24), (0.21, 0.26, 0.03), cloth)
    for x in (-0.27, 0.27):
        local.box((x, 0.68, 0.0), (0.025, 0.015, 0.15), BLACK_PLASTIC)
        local.rod((x, 0.5, -0.05), (x, 0.67, -0.05), 0.014, BLACK_PLASTIC)


def sofa(local: LocalFrame) -> None:
    """Add a sofa with cushions."""
    rng = local.build.rng
    cloth = _cloth(rng)
    width = rng.uniform(0.65, 1.15)
    local.box((0.0, 0.22, 0.0), (width, 0.14, 0.42), cloth)
    local.box((0.0, 0.55, -0.36), (width, 0.27, 0.09), cloth, tint=0.95)
    for x in (-width - 0.07, width + 0.07):
        local.box((x, 0.32, 0.0), (0.09, 0.28, 0.44), cloth, tint=0.9)
    seats = 2 if width < 0.9 else 3
    for k in range(seats):
        x = (2 * k + 1 - seats) / seats * width
        local.box((x, 0.42, 0.04), (width / seats - 0.01, 0.07, 0.36), cloth, tint=1.06)
    for _ in range(int(rng.integers(0, 3))):
        local.ellipsoid((rng.uniform(-0.8, 0.8) * width, 0.62, -0.18), (0.2, 0.18, 0.09), _cloth(rng))


def armchair(local: LocalFrame) -> None:
    """Add an armchair."""
    cloth = _cloth(local.build.rng)
    local.box((0.0, 0.25, 0.0), (0.3, 0.16, 0.34), cloth)
    local.box((0.0, 0.6, -0.32), (0.34, 0.34, 0.08), cloth, tint=0.95)
    for x in (-0.36, 0.36):
        local.box((x, 0.34, 0.0), (0.07, 0.26, 0.36), cloth, tint=0.9)


def bed(local: LocalFrame) -> None:
    """Add a bed with its head at the back."""
    rng = local.build.rng
    bedstead, cover = wood(rng, 0.2), _cloth(rng)
    width = rng.uniform(0.45, 0.9)
    white = Material(Pattern.PLAIN, (0.87, 0.86, 0.83), (0.8, 0.79, 0.76), grain=0.06, grain_size=0.3)
    local.box((0.0, 0.2, 0.0), (width, 0.1, 1.0), bedstead)
    local.box((0.0, 0.38, 0.0), (width - 0.02, 0.1, 0.97), white)
    local.box((0.0, 0.41, 0.22), (width + 0.01, 0.1, 0.78), cover)
    local.box((0.0, 0.55, -1.02), (width, 0.45, 0.03), bedstead)
    for x in (-0.5 * width, 0.5 * width) if width > 0.6 else (0.0,):
        local.ellipsoid((x, 0.53, -0.72), (0.3, 0.09, 0.19), white)


def cabinet(local: LocalFrame) -> None:
    """Add a cupboard or chest with doors or drawers."""
    rng = local.build.rng
    width, height, depth = rng.uniform(0.35, 0.9), rng.uniform(0.6, 2.1), rng.uniform(0.2, 0.32)
    tone = pick(rng, palette.WOOD if rng.random() < 0.6 else palette.INTERIOR)
    face = tonal_material(
        Pattern.TILES, tone, 0.93, 0.35, cell=(width / max(1, round(width / 0.4)), height / int(rng.integers(1, 5))),
        line=0.012, grain=0.08, gloss=0.15,
    )  # fmt: skip
    local.box((0.0, 0.5 * height, 0.0), (width, 0.5 * height, depth), face, cap=wood(rng, 0.3))
    if height < 1.3:
        clutter(local, (width, depth), height, int(rng.integers(0, 4)))


def shelf(local: LocalFrame) -> None:
    """Add an open shelf with books and boxes."""
    rng = local.build.rng
    board = wood(rng, 0.3)
    width, height, depth = rng.uniform(0.4, 0.8), rng.uniform(1.2, 2.2), rng.uniform(0.13, 0.2)
    rows = max(2, int(height / rng.uniform(0.3, 0.42)))
    for x in (-width, width):
        local.box((x, 0.5 * height, 0.0), (0.012, 0.5 * height, depth), board)
    if rng.random() < 0.7:
        local.box((0.0, 0.5 * height, -depth), (width, 0.5 * height, 0.008), board, tint=0.8)
    for row in range(rows + 1):
        y = 0.02 + row * (height - 0.04) / rows
        local.box((0.0, y, 0.0), (width, 0.012, depth), board)
        if row < rows and rng.random() < 0.8:
            _shelf_row(local, y + 0.012, (height - 0.04) / rows - 0.05, width, depth)


def _shelf_row(local: LocalFrame, y: float, room: float, width: float, depth: float) -> None:
    rng = local.build.rng
    if rng.random() < 0.7:
        books = Material(
            Pattern.BOOKS, pick(rng, palette.CLOTH, 0.1), pick(rng, palette.SIGN, 0.1), pick(rng, palette.INTERIOR),
            cell=(rng.uniform(0.025, 0.05), 1.0), grain=0.03, seed=int(rng.integers(1, 1000)),
        )  # fmt: skip
        share = rng.uniform(0.4, 0.95)
        half = (share * width, 0.45 * room, 0.6 * depth)
        local.box((rng.choice([-1.0, 1.0]) * (1.0 - share) * width * 0.9, y + half[1], 0.0), half, books)
    else:
        for x in (-0.5, 0.45):
            half = (rng.uniform(0.2, 0.4) * width, rng.uniform(0.2, 0.45) * room, 0.75 * depth)
            local.box((x * width, y + half[1], 0.0), half, CARTON if rng.random() < 0.4 else _cloth(rng))


def floor_lamp(local: LocalFrame) -> None:
    """Add a lamp on a thin stand with a glowing shade."""
    rng = local.build.rng
    height = rng.uniform(1.3, 1.8)
    shade = Material(Pattern.PLAIN, (0.93, 0.84, 0.66), grain=0.03, glow=rng.uniform(0.3, 1.4))
    local.rod((0.0, 0.0, 0.0), (0.0, 0.03, 0.0), 0.15, BLACK_PLASTIC)
    local.rod((0.0, 0.0, 0.0), (0.0, height, 0.0), 0.013, BLACK_PLASTIC)
    if rng.random() < 0.5:
        local.rod((0.0, height - 0.05, 0.0), (0.0, height + 0.22, 0.0), 0.17, shade)
    else:
        local.ellipsoid((0.0, height + 0.1, 0.0), (0.16, 0.16, 0.16), shade)


def plant(local: LocalFrame) -> None:
    """Add a pot plant."""
    rng = local.build.rng
    clay = pick(rng, palette.BRICK)
    local.rod((0.0, 0.0, 0.0), (0.0, 0.32, 0.0), 0.15, tonal_material(Pattern.PLAIN, clay, 0.9, grain=0.1))
    green = pick(rng, palette.FOLIAGE)
    leaves = tonal_material(Pattern.LEAVES, green, 1.3, first=0.6, cell=(0.1, 0.1), detail=0.75)
    height = rng.uniform(0.3, 0.8)
    local.rod((0.0, 0.3, 0.0), (0.0, 0.4 + height, 0.0), 0.015, Material(Pattern.PLAIN, (0.3, 0.25, 0.16)))
    for _ in range(int(rng.integers(2, 5))):
        size = rng.uniform(0.14, 0.32)
        centre = (rng.uniform(-0.15, 0.15), 0.35 + height * rng.uniform(0.4, 1.0), rng.uniform(-0.15, 0.15))
        local.ellipsoid(centre, (size, 1.2 * size, size), leaves)


def screen(local: LocalFrame) -> None:
    """Add a standing screen or whiteboard."""
    rng = local.build.rng
    width, height = rng.uniform(0.4, 0.8), rng.uniform(1.3, 1.8)
    board = Material(
        Pattern.WINDOW, (0.8, 0.8, 0.8), pick(rng, palette.INTERIOR), (0.5, 0.5, 0.5), cell=(9.0, 0.62), line=0.03,
        grain=0.05, gloss=0.2,
    )  # fmt: skip
    local.box((0.0, 0.5 * height + 0.08, 0.0), (width, 0.5 * height - 0.04, 0.02), board)
    for x in (-width, width):
        local.rod((x, 0.0, 0.0), (x, height, 0.0), 0.02, CHROME)
        local.rod((x, 0.03, -0.25), (x, 0.03, 0.25), 0.018, CHROME)


def stairs(local: LocalFrame, steps: int) -> None:
    """Add a flight of steps with a railing; it climbs along the local −z axis."""
    rng = local.build.rng
    tread, rail = wood(rng, 0.3), CHROME
    width, rise, run = rng.uniform(0.45, 0.7), 0.175, 0.28
    x = width - 0.05
    for k in range(steps):
        y, z = rise * (k + 1), -run * k
        local.box((0.0, 0.5 * rise * (k + 1), z), (width, 0.5 * rise * (k + 1), 0.5 * run), tread)
        if k % 2 == 0:
            local.rod((x, y, z), (x, y + 0.9, z), 0.012, rail)
    local.rod((x, rise + 0.9, 0.0), (x, rise * steps + 0.9, -run * (steps - 1)), 0.022, rail)


def carton_pile(local: LocalFrame) -> None:
    """Add a few cartons, one on the other."""
    rng = local.build.rng
    height = 0.0
    for _ in range(int(rng.integers(1, 4))):
        half = (rng.uniform(0.15, 0.32), rng.uniform(0.1, 0.24), rng.uniform(0.15, 0.28))
        centre = (rng.uniform(-0.04, 0.04), height + half[1], 0.0)
        local.box(centre, half, CARTON, tint=rng.uniform(0.8, 1.15), turn=rng.uniform(-0.2, 0.2))
        height += 2.0 * half[1]


def kitchen_unit(local: LocalFrame) -> None:
    """Add a kitchen unit or counter on a dark plinth, its board sticking out."""
    rng = local.build.rng
    width, height, depth = rng.uniform(0.4, 1.2), rng.uniform(0.7, 1.0), rng.uniform(0.25, 0.35)
    local.box((0.0, 0.06, -0.05), (width - 0.02, 0.06, depth - 0.05), DARK_MATERIAL)
    local.box((0.0, 0.5 * (height + 0.12), 0.0), (width, 0.5 * (height - 0.12), depth), wood(rng, 1.0))
    local.box((0.0, height + 0.02, 0.0), (width + 0.01, 0.02, depth + 0.03), wood(rng))


def chandelier(local: LocalFrame) -> None:
    """Hang a lamp with arms and bulbs from the base, which is a point of the ceiling."""
    rng = local.build.rng
    metal = Material(Pattern.PLAIN, pick(rng, palette.METAL), grain=0.03, gloss=0.5)
    bulb = Material(Pattern.PLAIN, (0.95, 0.9, 0.8), grain=0.02, glow=rng.uniform(0.2, 1.5))
    drop, reach, rise = rng.uniform(0.3, 0.9), rng.uniform(0.2, 0.5), rng.uniform(-0.1, 0.15)
    hub = (0.0, -drop, 0.0)
    local.rod(hub, (0.0, 0.0, 0.0), 0.01, metal)
    local.ellipsoid(hub, (0.06, 0.06, 0.06), metal)
    for angle in np.linspace(0.0, 2.0 * math.pi, rng.integers(3, 9), endpoint=False):
        end = (reach * math.cos(angle), rise - drop, reach * math.sin(angle))
        local.rod(hub, end, 0.008, metal)
        local.ellipsoid((end[0], end[1] + 0.05, end[2]), (0.04, 0.06, 0.04), bulb)


def tripod(local: LocalFrame) -> None:
    """Add a tripod with a small head."""
    height = local.build.rng.uniform(1.0, 1.6)
    for angle in (0.0, 2.1, 4.2):
        foot = (0.3 * height * math.cos(angle), 0.0, 0.3 * height * math.sin(angle))
        local.rod(foot, (0.0, height, 0.0), 0.014, BLACK_PLASTIC)
    local.box((0.0, height, 0.0), (0.06, 0.05, 0.06), BLACK_PLASTIC)
