"""Buildings along a street: town houses, offices, suburban houses. The front faces the road at ``base``."""

import math

import numpy as np

from omnisyn_cli.scenes import palette, props
from omnisyn_cli.scenes.materials import Material, Pattern, random_material, tonal_material
from omnisyn_cli.scenes.palette import pick
from omnisyn_cli.scenes.scene import Point, SceneBuilder, Shape

# Of windows without a room behind them. Set by hand.
DARK_GLASS = Material(Pattern.PLAIN, (0.12, 0.14, 0.16), grain=0.1, gloss=1.0)


def _facade(rng: np.random.Generator, floor: float, shop: bool) -> Material:
    is_brick = rng.random() < 0.3
    wall = pick(rng, palette.BRICK if is_brick else palette.PLASTER)
    trim = pick(rng, palette.PLASTER) if rng.random() < 0.6 else palette.scaled(wall, rng.uniform(0.6, 1.25))
    return Material(
        Pattern.FACADE, wall, pick(rng, palette.GLASS, 0.1), trim, cell=(rng.uniform(1.7, 3.6), floor),
        line=rng.uniform(0.05, 0.11), grain=rng.uniform(0.04, 0.16), grain_size=rng.uniform(0.8, 4.0),
        detail=0.8 if shop else 0.2, gloss=0.9, seed=int(rng.integers(1, 10000)),
    )  # fmt: skip


def town_house(
    build: SceneBuilder, base: Point, width: float, side: float, floors: int, *, detailed: bool, facing_z: bool = False
) -> None:
    """Add a house of several floors with windows, ledges, balconies, shop signs and awnings.

    ``base``: middle of the front's foot, facing −x at ``side`` 1, or z if ``facing_z``; ``detailed``: seen near by.
    """
    rng = build.rng
    floor = rng.uniform(2.8, 3.6)
    height, depth = floors * floor + rng.uniform(0.3, 1.2), rng.uniform(8, 13)
    front = _facade(rng, floor, rng.random() < 0.5)
    roof = Material(Pattern.PLAIN, pick(rng, palette.CONCRETE), grain=0.2)
    x, y, z = base
    if facing_z:
        build.add(Shape.BOX, (x, y + 0.5 * height, z), (0.5 * width, 0.5 * height, 0.5 * depth), front, cap=roof)
        return
    _block(build, base, (depth, height, width), side, front, roof)
    if not detailed:
        return
    trim = tonal_material(Pattern.PLAIN, front.third, 0.85, grain=0.12)
    _band(build, base, width, height, 0.25, trim, 0.28)
    if rng.random() < 0.6:
        _band(build, base, width, floor - 0.05, 0.14, trim, rng.uniform(0.08, 0.3))
    if rng.random() < 0.35:
        _pilasters(build, base, width, height, trim)
    if rng.random() < 0.5:
        _balconies(build, base, width, side, floors, floor)
    _ground_floor(build, base, width, side, floor, front.detail > 0.4)
    if rng.random() < 0.4:
        _pitched_roof(build, (x + side * 0.5 * depth, y + height, z), depth, width, along_z=True)
    if rng.random() < 0.5:
        chimney = Material(
            Pattern.BRICK, (0.5, 0.33, 0.27), (0.42, 0.28, 0.24), (0.6, 0.56, 0.5), cell=(0.25, 0.08), line=0.012
        )
        build.add(Shape.BOX, (x + side * 2.0, y + height + 0.7, z + 0.3 * width), (0.35, 0.9, 0.5), chimney)


def _block(build: SceneBuilder, base: Point, size: Point, side: float, front: Material, roof: Material) -> None:
    """Add the body of a house, as deep, tall and wide as ``size`` says."""
    depth, height, width = size
    centre = (base[0] + side * 0.5 * depth, base[1] + 0.5 * height, base[2])
    build.add(Shape.BOX, centre, (0.5 * depth, 0.5 * height, 0.5 * width - 0.01), front, cap=roof)


def _band(build: SceneBuilder, base: Point, width: float, at: float, half: float, trim: Material, out: float) -> None:
    """Add a ledge across the front that sticks out by ``out``."""
    build.add(Shape.BOX, (base[0], base[1] + at, base[2]), (out, half, 0.5 * width), trim)


def _pilasters(build: SceneBuilder, base: Point, width: float, height: float, trim: Material) -> None:
    count = max(2, int(width / build.rng.uniform(2.6, 5.0)))
    for k in range(count + 1):
        z = base[2] + (k / count - 0.5) * (width - 0.5)
        build.add(Shape.BOX, (base[0], base[1] + 0.5 * height, z), (0.14, 0.5 * height, 0.2), trim)


def _balconies(build: SceneBuilder, base: Point, width: float, side: float, floors: int, floor: float) -> None:
    rng = build.rng
    slab = Material(Pattern.PLAIN, pick(rng, palette.CONCRETE), grain=0.12)
    solid = rng.random() < 0.35
    rail = slab if solid else Material(Pattern.BARS, pick(rng, palette.METAL), cell=(0.12, 1.0), line=0.025, grain=0.05)
    half_wide = rng.uniform(0.8, 1.6) if rng.random() < 0.6 else 0.5 * width - 0.3
    places = [0.0] if half_wide > 1.7 else [float(p) for p in rng.uniform(-0.5, 0.5, 2) * (width - 2 * half_wide)]
    out = rng.uniform(0.7, 1.3)
    for level in range(1, min(floors, 5)):
        for place in places:
            x, y, z = base[0] - side * 0.5 * out, base[1] + level * floor, base[2] + place
            build.add(Shape.BOX, (x, y, z), (0.5 * out, 0.08, half_wide), slab)
            build.add(Shape.BOX, (base[0] - side * out, y + 0.55, z), (0.025, 0.5, half_wide), rail)


def _ground_floor(build: SceneBuilder, base: Point, width: float, side: float, floor: float, shop: bool) -> None:
    """Add a door with its step, and the sign and awning of a shop."""
    rng = build.rng
    x, y, z = base
    door = Material(
        Pattern.WINDOW, (0.3, 0.2, 0.15), pick(rng, palette.GLASS), palette.scaled(pick(rng, palette.WOOD), 0.8),
        cell=(0.5, 0.9), line=0.12, gloss=0.5, grain=0.1,
    )  # fmt: skip
    at = z + rng.uniform(-0.35, 0.35) * width
    build.add(Shape.BOX, (x, y + 1.1, at), (0.06, 1.1, 0.55), door)
    step = Material(Pattern.PLAIN, pick(rng, palette.CONCRETE))
    build.add(Shape.BOX, (x - side * 0.15, y + 0.08, at), (0.25, 0.08, 0.75), step)
    if not shop:
        return
    palettes = (palette.SIGN, palette.PLASTER, palette.SIGN)
    board = random_material(rng, Pattern.COLLAGE, palettes, cell=(1.2, 0.5), grain=0.05, detail=0.3)
    build.add(Shape.BOX, (x - side * 0.06, y + floor - 0.45, z), (0.08, 0.28, 0.45 * width), board)
    if rng.random() < 0.5:
        cloth = Material(
            Pattern.STRIPES, pick(rng, palette.SIGN), (0.85, 0.83, 0.78), cell=(0.5, 0.5), detail=0.5, grain=0.08
        )
        centre, half = (x - side * 0.55, y + floor - 0.85, z), (0.62, 0.02, 0.35 * width)
        build.add(Shape.BOX, centre, half, cloth, rotation=_about_z(-side * 0.45))
    if rng.random() < 0.4:  # a sign that sticks out
        build.add(Shape.BOX, (x - side * 0.5, y + floor + 0.3, z + 0.4 * width), (0.35, 0.35, 0.04), board)


def _about_z(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _pitched_roof(build: SceneBuilder, middle: Point, depth: float, width: float, *, along_z: bool) -> None:
    """Add two tiled slabs that meet in a ridge along z (else along x), and nothing under them."""
    rng = build.rng
    clay = palette.scaled(pick(rng, palette.BRICK), rng.uniform(0.6, 1.0))
    if rng.random() < 0.4:
        clay = (0.27, 0.27, 0.29)
    tiles = tonal_material(Pattern.BRICK, clay, 0.8, 0.5, cell=(0.3, 0.25), line=0.03, grain=0.2)
    angle = rng.uniform(0.4, 0.75)
    span = 0.5 * (depth if along_z else width) + 0.4
    run = 0.5 * span / math.cos(angle)
    rise = 0.5 * span * math.tan(angle)
    for sign in (-1.0, 1.0):
        if along_z:
            rotation = _about_z(-sign * angle)
            centre = (middle[0] + sign * 0.5 * span, middle[1] + rise, middle[2])
            half = (run, 0.09, 0.5 * width + 0.2)
        else:
            rotation = np.roll(_about_z(sign * angle), 1, axis=(0, 1))  # about x
            centre = (middle[0], middle[1] + rise, middle[2] + sign * 0.5 * span)
            half = (0.5 * depth + 0.2, 0.09, run)
        build.add(Shape.BOX, centre, half, tiles, rotation=rotation)


def office(build: SceneBuilder, base: Point, width: float, side: float, *, detailed: bool) -> None:
    """Add a modern block: bands of glass, fins or slabs."""
    rng = build.rng
    floor = rng.uniform(3.1, 4.0)
    height, depth = floor * int(rng.integers(3, 13)), rng.uniform(12, 20)
    wall = pick(rng, palette.CONCRETE if rng.random() < 0.6 else palette.PLASTER)
    front = Material(
        Pattern.FACADE, wall, pick(rng, palette.GLASS, 0.1), palette.scaled(wall, rng.uniform(0.5, 1.2)),
        cell=(rng.uniform(1.2, 4.0), floor), line=rng.uniform(0.04, 0.1), grain=0.06, grain_size=3.0,
        detail=rng.uniform(0, 1), gloss=1.0, seed=int(rng.integers(1, 10000)),
    )  # fmt: skip
    x, y, z = base
    roof = Material(Pattern.PLAIN, pick(rng, palette.CONCRETE), grain=0.2)
    _block(build, base, (depth, height, width), side, front, roof)
    if not detailed:
        return
    trim = Material(Pattern.PLAIN, palette.scaled(wall, rng.uniform(0.7, 1.15)), grain=0.08)
    _band(build, base, width, height, 0.4, trim, 0.1)
    if rng.random() < 0.4:
        _pilasters(build, base, width, height, trim)
    elif rng.random() < 0.6:
        for level in range(1, min(9, int(height / floor))):
            _band(build, base, width, level * floor, 0.15, trim, rng.uniform(0.3, 0.9))
    if rng.random() < 0.6:  # entrance with a canopy on columns
        build.add(Shape.BOX, (x - side * 1.2, y + 3.0, z), (1.3, 0.15, 2.5), trim)
        for end in (-2.2, 2.2):
            build.pole((x - side * 2.2, y, z + end), 2.9, 0.12, trim)
        build.add(Shape.BOX, (x, y + 1.3, z), (0.05, 1.3, 1.6), DARK_GLASS)


def house(build: SceneBuilder, base: Point, width: float, side: float, *, detailed: bool) -> None:
    """Add a detached house with a pitched roof, a hedge or fence, and a garage."""
    rng = build.rng
    floor = rng.uniform(2.6, 3.0)
    floors = int(rng.integers(1, 3))
    height, depth = floors * floor + 0.3, rng.uniform(7, 11)
    front = _facade(rng, floor, shop=False)
    x, y, z = base
    centre = (x + side * 0.5 * depth, y + 0.5 * height, z)
    build.add(Shape.BOX, centre, (0.5 * depth, 0.5 * height, 0.5 * width), front)
    _pitched_roof(build, (centre[0], y + height, z), depth, width, along_z=bool(rng.random() < 0.6))
    if rng.random() < 0.3:
        gable = tonal_material(Pattern.BRICK, front.first, 0.85, 1.25, cell=(0.26, 0.085), line=0.012, grain=0.15)
    else:
        gable = tonal_material(Pattern.PLAIN, front.first, 0.75, grain=0.15, grain_size=2.5, detail=0.35)
    build.add(Shape.BOX, (centre[0], y + height + 0.5, z), (0.3 * depth, 0.7, 0.3 * width), gable)
    if not detailed:
        return
    _ground_floor(build, base, width, side, floor, shop=False)
    if rng.random() < 0.5:
        gate = Material(Pattern.RIBS, pick(rng, palette.PLASTER), cell=(0.2, 0.5), line=0.02, grain=0.05)
        build.add(Shape.BOX, (x - side * 0.05, y + 1.1, z + 0.28 * width), (0.08, 1.1, 1.2), gate)
    if rng.random() < 0.5:
        props.hedge(build, (x - side * rng.uniform(1.5, 2.8), y, z), (0.42 * width, rng.uniform(0.4, 0.9)))
    for _ in range(int(rng.integers(0, 3))):
        spot = (x - side * rng.uniform(0.8, 3.0), y, z + rng.uniform(-0.5, 0.5) * width)
        if rng.random() < 0.6:
            props.bush(build, spot, rng.uniform(0.3, 0.8))
        else:
            props.tree(build, spot, rng.uniform(3.0, 6.0))
