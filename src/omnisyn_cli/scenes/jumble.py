"""Cluttered places: halls, courts and yards full of blocks, bars, arches and floating shapes."""

import math
from collections.abc import Callable

import numpy as np

from omnisyn_cli.scenes import obstacles, palette, props
from omnisyn_cli.scenes.daylight import daylight
from omnisyn_cli.scenes.finishes import floor_finish, low_texture_finish, random_finish, wall_finish
from omnisyn_cli.scenes.home import BASELINE_RANGE, MAX_BASELINE_IN_DEPTHS, indoor_light
from omnisyn_cli.scenes.materials import Material, Pattern, plant_material, tonal_material
from omnisyn_cli.scenes.obstacles import CameraPath, Enclosure
from omnisyn_cli.scenes.palette import pick
from omnisyn_cli.scenes.scene import Scene, SceneBuilder, Walkway
from omnisyn_cli.scenes.solids import Shape

FinishSampler = Callable[[np.random.Generator, str], Material]


def jumble(seed: int) -> Scene:
    """Generate a cluttered hall or roofless court; equal seeds give equal places."""
    rng = np.random.default_rng([19, seed])
    has_roof = rng.random() < 0.6
    build = SceneBuilder(rng, lighting=indoor_light(rng) if has_roof else daylight(rng))
    build.ground_material = _draw_finish(rng, floor_finish, 2.0)
    enclosure = _draw_enclosure(rng, rng.uniform(3.0, 14.0, 2), rng.uniform(2.4, 6.0))
    _add_shell(build, enclosure, has_roof=has_roof)
    obstacles.floating_shapes(
        build, enclosure, int(rng.integers(10, 31)) if rng.random() < 0.7 else 0, rng.uniform(0.3, 0.8)
    )
    obstacles.blocks(build, enclosure, int(rng.integers(3, 16)), rng.uniform(0.3, 1.2))
    for add, most in ((obstacles.arch, 4), (obstacles.bars, 4), (obstacles.platform, 4)):
        for _ in range(int(rng.integers(0, most))):
            add(build, enclosure)
    obstacles.wires(build, enclosure, int(rng.integers(0, 8)))
    for _ in range(int(rng.integers(0, 3))):
        _add_figure(build, enclosure)
    _add_walkways(build, enclosure)
    return build.build("jumble")


def yard(seed: int) -> Scene:
    """Generate a garden or square under the sky, with fences, plants and people; equal seeds give equal yards."""
    rng = np.random.default_rng([23, seed])
    build = SceneBuilder(rng, lighting=daylight(rng))
    build.ground_material = _ground_material(rng)
    enclosure = _draw_enclosure(rng, rng.uniform(6.0, 24.0, 2), rng.uniform(3.0, 5.0))
    _add_boundaries(build, enclosure)
    for _ in range(int(rng.integers(6, 22))):
        _add_plant(build, enclosure)
    for _ in range(int(rng.integers(0, 6))):
        _add_figure(build, enclosure)
    for add, most in ((obstacles.arch, 3), (obstacles.bars, 4), (obstacles.platform, 3)):
        for _ in range(int(rng.integers(0, most))):
            add(build, enclosure)
    obstacles.wires(build, enclosure, int(rng.integers(0, 7)))
    obstacles.blocks(build, enclosure, int(rng.integers(0, 8)), 0.8)
    if rng.random() < 0.4:
        obstacles.floating_shapes(build, enclosure, int(rng.integers(10, 31)), rng.uniform(0.3, 0.9))
    _add_walkways(build, enclosure)
    return build.build("yard")


def _draw_finish(rng: np.random.Generator, typical: FinishSampler, size: float) -> Material:
    """A finish as of rooms, or any other."""
    return typical(rng, str(rng.choice(["home", "office", "hall"]))) if rng.random() < 0.6 else random_finish(rng, size)


def _draw_enclosure(rng: np.random.Generator, sides: np.ndarray, height: float) -> Enclosure:
    """A box around the origin, and a camera path through it."""
    half = 0.5 * float(sides[0]), 0.5 * float(sides[1])
    top = min(2.2, height - 0.6)
    ends = [(rng.uniform(-0.8, 0.8) * half[0], rng.uniform(0.7, top), rng.uniform(-0.8, 0.8) * half[1])
            for _ in range(2)]  # fmt: skip
    path = CameraPath(ends[0], ends[1], math.exp(rng.uniform(math.log(0.25), math.log(1.2))))
    return Enclosure((-half[0], 0.0, -half[1]), (half[0], height, half[1]), path)


def _add_shell(build: SceneBuilder, enclosure: Enclosure, *, has_roof: bool) -> None:
    """Four walls, some with openings into the dark or the open, and perhaps a roof."""
    rng = build.rng
    (x0, _, z0), (x1, height, z1) = enclosure.low, enclosure.high
    typical = low_texture_finish if rng.random() < 0.5 else wall_finish
    finish = _draw_finish(rng, typical, 2.0)
    for along_x, at, low, high in ((True, z0, x0, x1), (True, z1, x0, x1), (False, x0, z0, z1), (False, x1, z0, z1)):
        material = _draw_finish(rng, typical, 2.0) if rng.random() < 0.4 else finish
        if not has_roof and rng.random() < 0.2:
            continue  # open on this side
        outward = 0.15 if at > 0 else -0.15
        middle = 0.5 * (low + high)
        centre = (middle, 0.5 * height, at + outward) if along_x else (at + outward, 0.5 * height, middle)
        reach = 0.5 * (high - low) + 0.3
        half = (reach, 0.5 * height, 0.15) if along_x else (0.15, 0.5 * height, reach)
        build.add(Shape.BOX, centre, half, material, casts_shadow=not has_roof)
        if rng.random() < 0.5:
            spot, inner = rng.uniform(low + 0.5, high - 0.5), at - 0.02 * math.copysign(1.0, outward)
            door = (spot, 1.05, inner) if along_x else (inner, 1.05, spot)
            size = (0.5, 1.05, 0.03) if along_x else (0.03, 1.05, 0.5)
            build.add(
                Shape.BOX, door, size, obstacles.DARK_GAP_MATERIAL if rng.random() < 0.6 else random_finish(rng, 1.0)
            )
    if has_roof:
        roof = _draw_finish(rng, low_texture_finish, 2.0)
        build.box((x0 - 0.3, height, z0 - 0.3), (x1 + 0.3, height + 0.3, z1 + 0.3), roof, casts_shadow=False)
        _add_lamps(build, enclosure)


def _add_lamps(build: SceneBuilder, enclosure: Enclosure) -> None:
    """A few lamps, now and then all of them on one side."""
    rng = build.rng
    side = rng.uniform(0.0, 1.0) if rng.random() < 0.4 else None
    for _ in range(int(rng.integers(1, 5))):
        x, _, z = enclosure.sample_point(rng)
        if side is not None:
            x = enclosure.low[0] + 0.3 if side < 0.5 else enclosure.high[0] - 0.3
        power = rng.uniform(0.3, 1.5)
        build.lamps.append((x, enclosure.high[1] - rng.uniform(0.2, 1.0), z, power, 0.92 * power, 0.8 * power))


def _ground_material(rng: np.random.Generator) -> Material:
    if rng.random() < 0.4:
        green = pick(rng, palette.FOLIAGE)
        return plant_material(Pattern.GRASS, green, 0.85, 1.25, third=(0.5, 0.47, 0.35), detail=rng.uniform(0.1, 0.8))
    tone = pick(rng, palette.PAVING)
    side = rng.uniform(0.15, 1.2)
    return tonal_material(
        Pattern.TILES if rng.random() < 0.7 else Pattern.BRICK, tone, rng.uniform(0.8, 1.0), 0.6,
        cell=(side, side * rng.uniform(0.5, 1.0)), line=0.012, grain=rng.uniform(0.03, 0.2),
        seed=int(rng.integers(1, 1000)),
    )  # fmt: skip


def _add_boundaries(build: SceneBuilder, enclosure: Enclosure) -> None:
    """Walls, fronts, hedges or fences on each side, some sides open; trees behind."""
    rng = build.rng
    (x0, _, z0), (x1, _, z1) = enclosure.low, enclosure.high
    for along_x, at, low, high in ((True, z0, x0, x1), (True, z1, x0, x1), (False, x0, z0, z1), (False, x1, z0, z1)):
        choice, sign = rng.random(), math.copysign(1.0, at)
        if choice < 0.15:
            continue
        depth, height, material = _draw_boundary(rng, choice)
        middle, out = 0.5 * (low + high), at + sign * depth
        centre = (middle, 0.5 * height, out) if along_x else (out, 0.5 * height, middle)
        reach = 0.5 * (high - low) + depth
        half = (reach, 0.5 * height, depth) if along_x else (depth, 0.5 * height, reach)
        build.add(Shape.BOX, centre, half, material)
        if height > 3.0 and rng.random() < 0.7:
            spot, inner = rng.uniform(low + 1, high - 1), at - 0.01 * sign
            door = (spot, 1.1, inner) if along_x else (inner, 1.1, spot)
            build.add(Shape.BOX, door, (0.6, 1.1, 0.03) if along_x else (0.03, 1.1, 0.6), obstacles.DARK_GAP_MATERIAL)
    for _ in range(int(rng.integers(3, 12))):
        angle, far = rng.uniform(-math.pi, math.pi), 0.5 * math.hypot(x1 - x0, z1 - z0) + rng.uniform(3.0, 25.0)
        base = (far * math.cos(angle), 0.0, far * math.sin(angle))
        (props.tree if rng.random() < 0.7 else props.conifer)(build, base, rng.uniform(4.0, 13.0))


def _draw_boundary(rng: np.random.Generator, choice: float) -> tuple[float, float, Material]:
    """Half depth, height and material of a front, wall, hedge or fence, by ``choice`` in [0, 1)."""
    if choice < 0.35:
        tone = pick(rng, palette.PLASTER)
        front = Material(
            Pattern.FACADE, tone, pick(rng, palette.GLASS), palette.scaled(tone, rng.uniform(0.6, 1.2)),
            cell=(rng.uniform(1.7, 3.6), rng.uniform(2.6, 3.4)), line=0.08, grain=rng.uniform(0.02, 0.15), gloss=0.9,
            seed=int(rng.integers(1, 1000)),
        )  # fmt: skip
        return 4.0, rng.uniform(3.0, 14.0), front
    if choice < 0.6:
        return 0.15, rng.uniform(1.2, 3.5), _draw_finish(rng, wall_finish, 1.0)
    if choice < 0.8:
        green = pick(rng, palette.FOLIAGE)
        leaves = plant_material(Pattern.LEAVES, green, 0.6, 1.3, cell=(0.2, 0.2), detail=0.0)
        return rng.uniform(0.25, 0.5), rng.uniform(0.8, 2.5), leaves
    pattern = Pattern.BARS if rng.random() < 0.5 else Pattern.MESH
    iron = Material(pattern, pick(rng, palette.METAL), cell=(rng.uniform(0.08, 0.2),) * 2, line=rng.uniform(0.01, 0.03))
    return 0.015, rng.uniform(0.9, 2.2), iron


def _add_plant(build: SceneBuilder, enclosure: Enclosure) -> None:
    """A tree, bush or hedge of the yard itself."""
    rng = build.rng
    choice, size = rng.random(), rng.uniform(0.25, 0.8)
    place = enclosure.sample_floor_point(rng, 1.0 if choice < 0.35 else size, 4.0 if choice < 0.35 else 1.6 * size)
    if place is None:
        return
    if choice < 0.35:
        (props.tree if rng.random() < 0.7 else props.conifer)(build, place, rng.uniform(2.5, 7.0))
    elif choice < 0.8:
        props.bush(build, place, size)
    else:
        props.hedge(build, place, (size, rng.uniform(0.25, 0.7)))


def _add_figure(build: SceneBuilder, enclosure: Enclosure) -> None:
    """A person, tripod, sign, bin or bollard close to the path."""
    rng = build.rng
    place = enclosure.sample_floor_point(rng, 0.35, 1.9)
    if place is None:
        return
    choice = rng.random()
    if choice < 0.5:
        props.person(build, place)
    elif choice < 0.65:
        obstacles.tripod(build, place, rng.uniform(1.0, 1.6))
    elif choice < 0.8:
        props.sign(build, place, rng.uniform(-math.pi, math.pi))
    elif choice < 0.9:
        props.waste_bin(build, place)
    else:
        props.bollard(build, place)


def _add_walkways(build: SceneBuilder, enclosure: Enclosure) -> None:
    """Cameras stand on the path and, for one walkway in four, anywhere else."""
    build.walkways.extend([enclosure.path.walkway(build.ground[3], BASELINE_RANGE, MAX_BASELINE_IN_DEPTHS)] * 3)
    low = (enclosure.low[0] + 0.4, 0.6, enclosure.low[2] + 0.4)
    high = (enclosure.high[0] - 0.4, min(2.4, enclosure.high[1] - 0.4), enclosure.high[2] - 0.4)
    build.walkways.append(Walkway(low, high, (0.0, 0.0), BASELINE_RANGE, 0.2, MAX_BASELINE_IN_DEPTHS, 0.12))
