"""Street props: trees, lamps, signs, cars, people; every function adds one to the ground."""

import math

import numpy as np

from omnisyn_cli.geometry.pose import rotation_from_rotation_vector
from omnisyn_cli.scenes import palette
from omnisyn_cli.scenes.materials import Material, Pattern, random_material, tonal_material
from omnisyn_cli.scenes.palette import pick
from omnisyn_cli.scenes.scene import LocalFrame, Point, SceneBuilder, Shape

# Materials of trees, cars and people. Set by hand.
BARK = Material(Pattern.PLAIN, (0.34, 0.27, 0.21), (0.22, 0.18, 0.15), grain=0.5, grain_size=0.25)
TYRE = Material(Pattern.PLAIN, (0.10, 0.10, 0.10), (0.07, 0.07, 0.07), grain=0.1)
RIM = Material(Pattern.PLAIN, (0.55, 0.56, 0.57), (0.25, 0.25, 0.26), grain=0.3, grain_size=0.2, gloss=0.4)
SKIN = Material(Pattern.PLAIN, (0.62, 0.46, 0.37), (0.50, 0.36, 0.28), grain=0.1)
HEADLIGHT = Material(Pattern.PLAIN, (0.90, 0.90, 0.86), gloss=0.6, grain=0.0)
TAIL_LIGHT = Material(Pattern.PLAIN, (0.50, 0.05, 0.05), gloss=0.6, grain=0.0)


def _leaves(rng: np.random.Generator, openness: float, size: float) -> Material:
    green = pick(rng, palette.FOLIAGE, 0.08)
    seed = int(rng.integers(1, 1000))
    return tonal_material(Pattern.LEAVES, green, 1.3, first=0.62, cell=(size, size), detail=openness, seed=seed)


def tree(build: SceneBuilder, base: Point, height: float) -> None:
    """Add a broad-leaved tree: a trunk, a few branches and a crown of open clumps around darker cores."""
    rng = build.rng
    x, y, z = base
    trunk = height * rng.uniform(0.25, 0.4)
    radius = 0.022 * height * rng.uniform(0.8, 1.4)
    build.pole(base, trunk * 1.35, radius, BARK)
    leaves = _leaves(rng, rng.uniform(0.5, 0.85), rng.uniform(0.13, 0.3))
    spread = height * rng.uniform(0.2, 0.3)
    for _ in range(int(rng.integers(3, 7))):
        angle, out, up = rng.uniform(0, 2 * math.pi), spread * rng.uniform(0.1, 0.9), rng.uniform(0.15, 0.85)
        centre = (x + out * math.cos(angle), y + trunk + up * (height - trunk), z + out * math.sin(angle))
        size = spread * rng.uniform(0.6, 1.0)
        half = (size, size * rng.uniform(0.65, 0.95), size)
        tint = rng.uniform(0.85, 1.15)
        build.add(Shape.ELLIPSOID, centre, half, leaves, tint=tint)
        core = (0.68 * half[0], 0.68 * half[1], 0.68 * half[2])
        solid = Material(Pattern.LEAVES, leaves.first, leaves.first, cell=leaves.cell, detail=0.25, seed=leaves.seed)
        build.add(Shape.ELLIPSOID, centre, core, solid, tint=0.8 * tint)
        if rng.random() < 0.5:
            build.rod((x, y + 0.8 * trunk, z), centre, 0.4 * radius, BARK)


def conifer(build: SceneBuilder, base: Point, height: float) -> None:
    """Add a fir: cones in tiers on a trunk."""
    rng = build.rng
    x, y, z = base
    build.pole(base, 0.3 * height, 0.02 * height, BARK)
    green = _leaves(rng, 0.55, 0.3)
    tiers = int(rng.integers(3, 6))
    widest = height * rng.uniform(0.16, 0.25)
    for tier in range(tiers):
        low = 0.12 + 0.75 * tier / tiers
        cone = height * (0.42 - 0.12 * tier / tiers)
        radius = widest * (1.0 - 0.75 * tier / tiers)
        centre = (x, y + low * height + 0.5 * cone, z)
        build.add(Shape.CONE, centre, (radius, 0.5 * cone, radius), green, tint=0.8 + 0.1 * tier)


def bush(build: SceneBuilder, base: Point, radius: float) -> None:
    """Add a low clump of leaves."""
    centre = (base[0], base[1] + 0.5 * radius, base[2])
    build.add(Shape.ELLIPSOID, centre, (radius, 0.8 * radius, radius), _leaves(build.rng, 0.4, 0.15))
    core = (0.8 * radius, 0.62 * radius, 0.8 * radius)
    build.add(Shape.ELLIPSOID, centre, core, _leaves(build.rng, 0.0, 0.15), tint=0.7)


def hedge(build: SceneBuilder, base: Point, half: tuple[float, float]) -> None:
    """Add a clipped hedge, ``half`` = half its length along z and half its height."""
    thick = build.rng.uniform(0.25, 0.5)
    centre = (base[0], base[1] + half[1], base[2])
    build.add(Shape.BOX, centre, (thick, half[1], half[0]), _leaves(build.rng, 0.0, 0.2))


def lamp_post(build: SceneBuilder, base: Point, height: float, toward: float) -> None:
    """Add a street lamp whose arm reaches in the direction x = ``toward``."""
    metal = Material(Pattern.PLAIN, pick(build.rng, palette.METAL), grain=0.08, gloss=0.2)
    x, y, z = base
    build.pole(base, 0.9, 0.09, metal)
    build.pole(base, height, 0.055, metal)
    reach = build.rng.uniform(0.5, 1.8) * math.copysign(1.0, toward)
    build.rod((x, y + height, z), (x + reach, y + height + 0.25, z), 0.035, metal)
    head = Material(Pattern.PLAIN, (0.75, 0.75, 0.72), grain=0.05)
    build.add(Shape.BOX, (x + reach, y + height + 0.22, z), (0.3, 0.06, 0.12), metal, cap=head)


def sign(build: SceneBuilder, base: Point, yaw: float) -> None:
    """Add a traffic sign: a plate or a disc on a pole, now and then two."""
    rng = build.rng
    x, y, z = base
    height = rng.uniform(2.1, 3.0)
    build.pole(base, height, 0.032, Material(Pattern.PLAIN, (0.55, 0.56, 0.56), grain=0.06, gloss=0.2))
    for level in range(int(rng.integers(1, 3))):
        look = {"third": (0.92, 0.92, 0.9), "cell": (0.5, 0.3), "grain": 0.03, "gloss": 0.15, "detail": 0.6}
        face = random_material(rng, Pattern.COLLAGE, [palette.SIGN] * 2, **look)
        half = (rng.uniform(0.2, 0.45), rng.uniform(0.18, 0.35), 0.012)
        build.add(Shape.BOX, (x, y + height - half[1] - 0.75 * level, z), half, face, yaw=yaw)


def bollard(build: SceneBuilder, base: Point) -> None:
    """Add a knee-high post."""
    build.pole(base, 0.9, 0.06, Material(Pattern.PLAIN, (0.2, 0.2, 0.2), gloss=0.2, grain=0.08))
    build.ball((base[0], base[1] + 0.92, base[2]), 0.075, Material(Pattern.PLAIN, (0.6, 0.6, 0.58), grain=0.05))


def waste_bin(build: SceneBuilder, base: Point) -> None:
    """Add a round bin or a wheeled box."""
    rng = build.rng
    paint = Material(Pattern.PLAIN, palette.scaled(pick(rng, palette.SIGN), 0.6), grain=0.12, gloss=0.1)
    if rng.random() < 0.5:
        build.pole(base, rng.uniform(0.8, 1.1), 0.25, paint)
    else:
        build.add(Shape.BOX, (base[0], base[1] + 0.55, base[2]), (0.3, 0.5, 0.35), paint, yaw=rng.uniform(-0.4, 0.4))


def bench(local: LocalFrame) -> None:
    """Add a bench of slats on two iron legs."""
    wood = Material(
        Pattern.PLANKS, (0.50, 0.36, 0.24), (0.42, 0.29, 0.2), (0.1, 0.08, 0.06), cell=(3.0, 0.1), line=0.02
    )
    iron = Material(Pattern.PLAIN, (0.15, 0.15, 0.15), grain=0.05)
    local.box((0.0, 0.44, 0.0), (0.8, 0.025, 0.22), wood)
    local.box((0.0, 0.75, -0.24), (0.8, 0.2, 0.02), wood)
    for side in (-0.65, 0.65):
        local.box((side, 0.21, 0.0), (0.03, 0.21, 0.2), iron)


def car(local: LocalFrame) -> None:
    """Add a car: body, cabin of glass, bumpers, wheels and lights; its nose points along the local −z."""
    rng = local.build.rng
    paint = pick(rng, palette.CAR)
    body = tonal_material(Pattern.PLAIN, paint, 0.9, grain=0.02, gloss=0.5, grain_size=2.0)
    dark = Material(Pattern.PLAIN, (0.09, 0.09, 0.1), grain=0.05, gloss=0.2)
    glass = Material(
        Pattern.WINDOW, paint, (0.10, 0.12, 0.14), palette.scaled(paint, 0.5), cell=(1.15, 9.0), line=0.06, gloss=1.0,
        grain=0.02,
    )  # fmt: skip
    screen = Material(Pattern.PLAIN, (0.1, 0.12, 0.14), grain=0.03, gloss=0.9)
    is_van = rng.random() < 0.2
    length, width = rng.uniform(3.7, 4.7), rng.uniform(0.83, 0.95)
    waist, roof = (1.0, rng.uniform(1.9, 2.2)) if is_van else (rng.uniform(0.82, 0.95), rng.uniform(1.4, 1.65))
    half = 0.5 * length
    local.box((0.0, 0.5 * (waist + 0.28), 0.0), (width, 0.5 * (waist - 0.28), half), body)
    local.box((0.0, 0.32, 0.0), (width - 0.05, 0.14, half + 0.06), dark)
    back = 0.0 if is_van else 0.12 * length
    cabin = 0.45 * length if is_van else 0.27 * length
    middle = 0.5 * (waist + roof)
    local.box((0.0, middle - 0.03, back), (width - 0.1, 0.5 * (roof - waist) - 0.03, cabin), glass, cap=dark)
    local.box((0.0, roof - 0.04, back), (width - 0.12, 0.045, cabin - (0.0 if is_van else 0.16)), body)
    if not is_van:  # raked windscreens, front and back
        for end, lean in ((back - cabin - 0.05, 0.95), (back + cabin + 0.02, -0.7)):
            rake = rotation_from_rotation_vector(np.array([lean, 0.0, 0.0]))
            turned = rotation_from_rotation_vector(np.array([0.0, local.yaw, 0.0])) @ rake
            size = (width - 0.13, 0.5 * (roof - waist) / math.cos(lean) - 0.05, 0.02)
            local.build.add(Shape.BOX, local.place(0.0, middle - 0.02, end), size, screen, rotation=turned)
    for z in (-0.62 * half, 0.62 * half):
        local.rod((-width - 0.01, 0.31, z), (width + 0.01, 0.31, z), 0.31, TYRE)
        local.rod((-width - 0.02, 0.31, z), (width + 0.02, 0.31, z), 0.18, RIM)
    for x in (-0.72 * width, 0.72 * width):
        local.box((x, 0.68, -half), (0.16, 0.07, 0.02), HEADLIGHT)
        local.box((x, 0.72, half), (0.14, 0.08, 0.02), TAIL_LIGHT)


def person(build: SceneBuilder, base: Point) -> None:
    """Add a person, standing or walking."""
    rng = build.rng
    x, y, z = base
    height = rng.uniform(1.5, 1.9)
    coat = Material(
        Pattern.PLAIN, pick(rng, palette.CLOTH), pick(rng, palette.CLOTH), grain=0.25, grain_size=0.3, detail=0.2
    )
    trousers = Material(Pattern.PLAIN, palette.scaled(pick(rng, palette.CLOTH), 0.6), grain=0.2)
    yaw, stride = rng.uniform(0, math.pi), rng.uniform(0.02, 0.25)
    c, s = math.cos(yaw), math.sin(yaw)
    hip, neck = 0.5 * height, 0.84 * height
    for side in (-1, 1):
        foot = (x + side * stride * c - 0.08 * side * s, y + 0.05, z + side * stride * s + 0.08 * side * c)
        build.rod(foot, (x - 0.07 * side * s, y + hip, z + 0.07 * side * c), 0.075, trousers)
        shoulder = (x - 0.2 * side * s, y + neck - 0.06, z + 0.2 * side * c)
        hand = (shoulder[0] - side * 0.5 * stride * c, y + hip - 0.02, shoulder[2] - side * 0.5 * stride * s)
        build.rod(hand, shoulder, 0.05, coat)
    build.add(Shape.ELLIPSOID, (x, y + 0.5 * (hip + neck), z), (0.2, 0.32, 0.2), coat, yaw=yaw)
    build.ball((x, y + height - 0.12, z), 0.115, SKIN)
    hair = Material(Pattern.PLAIN, palette.scaled(pick(rng, palette.WOOD), 0.6), grain=0.3, grain_size=0.1)
    build.ball((x, y + height - 0.095, z - 0.015), 0.117, hair)
