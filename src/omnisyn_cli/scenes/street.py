"""Streets: a road along z on a slope, with kerbs, pavements, house fronts, crossings, and all that stands between."""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from omnisyn_cli.geometry.pose import rotation_from_rotation_vector
from omnisyn_cli.scenes import palette, props
from omnisyn_cli.scenes.buildings import house, office, town_house
from omnisyn_cli.scenes.materials import Material, Pattern, tonal_material
from omnisyn_cli.scenes.palette import pick
from omnisyn_cli.scenes.scene import LocalFrame, Scene, SceneBuilder, Shape, Walkway, daylight

STREET_HALF_LENGTH = 85.0  # Half the length of the street, metres


@dataclass(frozen=True)
class StreetPlan:
    """Style and measures of a street along z; lengths in metres."""

    style: str  # "town", "suburb", "office" or "square"
    # half width of the roadway, and width of each pavement
    road: float
    pavement: float
    # height of the pavement above the road, and rise per metre along z
    kerb: float
    slope: float
    crossings: tuple[tuple[float, float], ...]  # z and half width of each crossing road

    def ground(self, z: float, raised: bool = True) -> float:
        """Height of the road, or of the pavement, at z."""
        return self.slope * z + (self.kerb if raised else 0.0)

    def is_crossing(self, z: float, margin: float = 0.0) -> bool:
        """Whether z lies on a crossing road."""
        return any(abs(z - middle) < half + margin for middle, half in self.crossings)

    def blocks(self) -> list[tuple[float, float]]:
        """The stretches of z between the crossings."""
        ends = [-STREET_HALF_LENGTH, *(z for at, half in sorted(self.crossings) for z in (at - half, at + half))]
        blocks = zip(ends[::2], [*ends[1::2], STREET_HALF_LENGTH], strict=True)
        return [(low, high) for low, high in blocks if high > low + 1.0]


def draw_plan(rng: np.random.Generator) -> StreetPlan:
    """Draw the plan of a street."""
    style = str(rng.choice(["town", "suburb", "office", "square"], p=[0.4, 0.2, 0.22, 0.18]))
    slope = 0.0 if rng.random() < 0.6 else rng.uniform(-0.06, 0.06)
    middles = (rng.uniform(-45, -9), rng.uniform(6, 50))
    crossings = [(middle, rng.uniform(3.0, 6.0)) for middle in middles if rng.random() < 0.6]
    return StreetPlan(
        style=style, road=float(rng.choice([rng.uniform(2.6, 4.2), rng.uniform(4.2, 8.0)])),
        pavement=rng.uniform(1.4, 4.5), kerb=rng.uniform(0.08, 0.17), slope=slope, crossings=tuple(crossings),
    )  # fmt: skip


def _add_slab(
    build: SceneBuilder, plan: StreetPlan, x: tuple[float, float], z: tuple[float, float], top: float, deep: float,
    material: Material, side_material: Material | None = None,
) -> None:  # fmt: skip
    """Add a slab that follows the slope, from x[0] to x[1] and z[0] to z[1], ``top`` metres above the road."""
    middle = 0.5 * (z[0] + z[1])
    angle = -math.atan(plan.slope)
    rotation = rotation_from_rotation_vector(np.array([angle, 0.0, 0.0]))
    length = 0.5 * (z[1] - z[0]) * math.hypot(1.0, plan.slope)
    centre = (0.5 * (x[0] + x[1]), plan.slope * middle + top - 0.5 * deep, middle)
    half = (0.5 * abs(x[1] - x[0]), 0.5 * deep, length)
    build.add(
        Shape.BOX, centre, half, material if side_material is None else side_material, cap=material, rotation=rotation,
        casts_shadow=False,
    )  # fmt: skip


def lay_roadway(build: SceneBuilder, plan: StreetPlan) -> None:
    """Lay the road, its crossings, zebras, manholes and mended patches."""
    rng = build.rng
    normal = np.array([0.0, 1.0, -plan.slope]) / math.hypot(1.0, plan.slope)
    build.ground = (float(normal[0]), float(normal[1]), float(normal[2]), 0.0)
    grey = pick(rng, palette.ASPHALT)
    paint = (0.86, 0.86, 0.83)
    seed = int(rng.integers(1, 1000))
    build.ground_material = Material(
        Pattern.ROAD, grey, paint, (0.82, 0.62, 0.16), cell=(plan.road, rng.uniform(4, 9)), line=rng.uniform(0.1, 0.18),
        detail=rng.uniform(0, 1), seed=seed,
    )  # fmt: skip
    if plan.style == "square":
        build.ground_material = _paving_material(rng)
    bare = Material(Pattern.ROAD, grey, grey, grey, cell=(500.0, 9.0), detail=0.0, line=0.0, seed=seed)
    zebra = Material(
        Pattern.STRIPES, paint, palette.scaled(grey, 1.05), cell=(1.0, 1.0), detail=0.5, grain=0.3, grain_size=0.4,
    )  # fmt: skip
    for middle, half in plan.crossings:
        _add_slab(build, plan, (-90.0, 90.0), (middle - half, middle + half), 0.004, 0.02, bare)
        if rng.random() < 0.7:
            for edge in (middle - half - 3.2, middle + half + 0.4):
                _add_slab(build, plan, (-plan.road + 0.2, plan.road - 0.2), (edge, edge + 2.8), 0.006, 0.02, zebra)
    for _ in range(int(rng.integers(1, 5))):
        x, z = rng.uniform(-0.8, 0.8) * plan.road, rng.uniform(-14, 14)
        if rng.random() < 0.5:
            iron = Material(
                Pattern.CHECKER, (0.25, 0.24, 0.23), (0.33, 0.32, 0.3), cell=(0.05, 0.05), line=0.004, grain=0.2
            )
            build.add(Shape.CYLINDER, (x, plan.ground(z, False), z), (0.33, 0.006 + 0.33 * abs(plan.slope), 0.33), iron)
        else:
            patch = Material(
                Pattern.ROAD, palette.scaled(grey, rng.uniform(0.75, 1.15)), grey, grey, (500.0, 9.0), 0.0, detail=0.0,
            )  # fmt: skip
            size = rng.uniform(0.4, 1.6, 2)
            _add_slab(build, plan, (x - size[0], x + size[0]), (z - size[1], z + size[1]), 0.007, 0.02, patch)


def _paving_material(rng: np.random.Generator) -> Material:
    stone, other = pick(rng, palette.PAVING), pick(rng, palette.PAVING)
    wide = rng.uniform(0.2, 0.9)
    return Material(
        Pattern(rng.choice([Pattern.BRICK, Pattern.TILES, Pattern.TILES])), stone, palette.mixed(stone, other, 0.55),
        palette.scaled(stone, 0.65), cell=(wide, wide * rng.uniform(0.4, 1.0)), line=rng.uniform(0.008, 0.02),
        grain=rng.uniform(0.1, 0.3), grain_size=rng.uniform(0.5, 2.5), detail=rng.uniform(0.1, 0.6),
        seed=int(rng.integers(1, 1000)),
    )  # fmt: skip


def lay_pavement(build: SceneBuilder, plan: StreetPlan, side: float) -> None:
    """Lay kerb, pavement and the yards behind it, on the side of this sign of x."""
    rng = build.rng
    stone = _paving_material(rng)
    kerb = Material(
        Pattern.BRICK, (0.58, 0.57, 0.55), (0.52, 0.51, 0.5), (0.35, 0.34, 0.33), cell=(1.0, 1.0), line=0.012
    )
    yard = stone
    if plan.style in ("suburb", "square") or rng.random() < 0.25:
        grass = tonal_material(Pattern.GRASS, pick(rng, palette.FOLIAGE), 1.25, first=0.85, detail=rng.uniform(0, 0.8))
        yard = grass._replace(third=(0.55, 0.50, 0.30))
    inner = plan.road + plan.pavement
    for low, high in plan.blocks():
        _add_slab(build, plan, (side * plan.road, side * (plan.road + 0.16)), (low, high), plan.kerb + 0.004, 0.3, kerb)
        _add_slab(build, plan, (side * (plan.road + 0.16), side * inner), (low, high), plan.kerb, 0.3, stone, kerb)
        _add_slab(build, plan, (side * inner, side * 95.0), (low, high), plan.kerb - 0.002, 0.3, yard, kerb)


def street(seed: int) -> Scene:
    """Generate a street; equal seeds give equal streets."""
    rng = np.random.default_rng([7, seed])
    plan = draw_plan(rng)
    build = SceneBuilder(rng, lighting=daylight(rng))
    lay_roadway(build, plan)
    for side in (-1.0, 1.0):
        lay_pavement(build, plan, side)
        _fronts(build, plan, side)
        _skyline(build, plan, side)
        _roadside(build, plan, side)
    _wires(build, plan)
    _traffic(build, plan)
    reach = plan.road + 0.6 * plan.pavement
    low, high = 1.2 + max(0.0, plan.kerb), 2.7
    build.walkways.append(Walkway((-reach, low, -14.0), (reach, high, 14.0), (0.0, 1.0), (1.0, 6.0), 0.3))
    return build.build("street")


def _fronts(build: SceneBuilder, plan: StreetPlan, side: float) -> None:
    """Line one side with buildings; squares have an open side, suburbs gardens."""
    rng = build.rng
    inner = plan.road + plan.pavement
    setback = {"town": rng.uniform(0, 0.8), "office": rng.uniform(0.5, 9), "suburb": rng.uniform(3, 8)}.get(
        plan.style, 0.5
    )
    if plan.style == "square" and side > 0:
        setback = rng.uniform(14, 30)
    gap = {"town": 0.12, "office": 0.35, "suburb": 0.95, "square": 0.2}[plan.style]
    floors = int(rng.integers(2, 6))
    for low, high in plan.blocks():
        z = low + rng.uniform(0.2, 3.0)
        while z < high - 4.0:
            width = {"town": rng.uniform(6, 16), "office": rng.uniform(14, 34), "suburb": rng.uniform(7, 13)}.get(
                plan.style, rng.uniform(8, 20)
            )
            width = min(width, high - z)
            x = side * (inner + setback + rng.uniform(0, 0.5))
            base = (x, plan.ground(z + 0.5 * width) - 0.05, z + 0.5 * width)
            near = abs(base[2]) < 32.0
            if width > 4.0:
                if plan.style == "suburb":
                    house(build, base, width, side, detailed=near)
                elif plan.style == "office":
                    office(build, base, width, side, detailed=near)
                else:
                    town_house(build, base, width, side, max(1, floors + int(rng.integers(-1, 3))), detailed=near)
            z += width
            if rng.random() < gap:
                z += rng.uniform(2.0, 9.0)


def _skyline(build: SceneBuilder, plan: StreetPlan, side: float) -> None:
    """Add towers and tree tops behind the first row, and what closes the street far away."""
    rng = build.rng
    for _ in range(int(rng.integers(3, 8))):
        x, z = side * rng.uniform(35, 90), rng.uniform(-80, 80)
        if rng.random() < (0.25 if plan.style == "suburb" else 0.6):
            office(build, (x, plan.ground(z), z), rng.uniform(14, 30), side, detailed=False)
        elif rng.random() < 0.5:
            props.tree(build, (x, plan.ground(z), z), rng.uniform(7, 13))
        else:
            props.conifer(build, (x, plan.ground(z), z), rng.uniform(9, 18))
    z = math.copysign(rng.uniform(88, 120), side)
    for x in (-18.0, 4.0, 20.0):
        town_house(build, (x, plan.ground(z), z), 18.0, side, int(rng.integers(3, 7)), detailed=False, facing_z=True)


def _roadside(build: SceneBuilder, plan: StreetPlan, side: float) -> None:
    """Stand trees, lamps, signs, bins, benches, people, fences and parked cars along one pavement."""
    rng = build.rng
    kerb_x = side * (plan.road + 0.45)
    trees, lamp, parked = rng.random() < 0.6, rng.uniform(14, 30), rng.random() < 0.6
    conifers = rng.random() < 0.25
    z = -44.0 + rng.uniform(0, 6)
    while z < 44.0:
        if not plan.is_crossing(z, 1.5) and trees and rng.random() < 0.75:
            x = kerb_x + side * rng.uniform(0.1, 0.5)
            plant = props.conifer if conifers else props.tree
            plant(build, (x, plan.ground(z), z), rng.uniform(4.0, 10.0))
        z += rng.uniform(6, 12)
    z = -50.0 + rng.uniform(0, lamp)
    height = rng.uniform(4.5, 8.0)
    while z < 50.0:
        if not plan.is_crossing(z):
            props.lamp_post(build, (kerb_x, plan.ground(z), z), height, -side)
        z += lamp
    for _ in range(int(rng.integers(5, 14))):
        _small_thing(build, plan, side)
    if parked:
        z = -34.0 + rng.uniform(0, 5)
        while z < 34.0:
            if rng.random() < 0.55 and not plan.is_crossing(z, 4.0):
                x = side * (plan.road - 1.05)
                yaw = (0.0 if side > 0 else math.pi) + rng.uniform(-0.04, 0.04)
                props.car(LocalFrame(build, (x, plan.ground(z, False), z), yaw))
            z += rng.uniform(5.2, 8.0)
    if rng.random() < 0.3:
        _fence(build, plan, side)


def _small_thing(build: SceneBuilder, plan: StreetPlan, side: float) -> None:
    rng = build.rng
    z = rng.uniform(-26, 26)
    if plan.is_crossing(z, 0.8):
        return
    near_kerb = side * (plan.road + 0.5)
    near_wall = side * (plan.road + plan.pavement - 0.5)
    choice = rng.random()
    if choice < 0.3:
        x = side * (plan.road + rng.uniform(0.4, max(0.5, plan.pavement - 0.4)))
        props.person(build, (x, plan.ground(z), z))
    elif choice < 0.5:
        props.sign(build, (near_kerb, plan.ground(z), z), rng.uniform(-0.3, 0.3))
    elif choice < 0.62:
        props.waste_bin(build, (near_wall, plan.ground(z), z))
    elif choice < 0.72:
        props.bench(LocalFrame(build, (near_wall, plan.ground(z), z), side * math.pi / 2 * -1.0))
    elif choice < 0.82:
        props.bush(build, (near_wall + side * rng.uniform(0.3, 2.0), plan.ground(z), z), rng.uniform(0.4, 0.9))
    else:
        for k in range(int(rng.integers(2, 6))):
            if not plan.is_crossing(z + 1.5 * k, 0.3):
                props.bollard(build, (near_kerb, plan.ground(z + 1.5 * k), z + 1.5 * k))


def _fence(build: SceneBuilder, plan: StreetPlan, side: float) -> None:
    rng = build.rng
    line = float(rng.choice([0.02, 0.025, 0.03]))
    iron = Material(Pattern.BARS, pick(rng, palette.METAL), cell=(0.13, 0.13), line=line, grain=0.05, gloss=0.1)
    x = side * (plan.road + plan.pavement - 0.12) if rng.random() < 0.6 else side * (plan.road + 0.25)
    height = rng.uniform(0.8, 1.5)
    rotation = rotation_from_rotation_vector(np.array([-math.atan(plan.slope), 0.0, 0.0]))
    for low, high in plan.blocks():
        low, high = max(low, -30.0), min(high, 30.0)
        if high - low < 3.0 or rng.random() < 0.25:
            continue
        middle = 0.5 * (low + high)
        centre = (x, plan.ground(middle) + 0.5 * height, middle)
        build.add(Shape.BOX, centre, (0.012, 0.5 * height, 0.5 * (high - low)), iron, rotation=rotation)


def _wires(build: SceneBuilder, plan: StreetPlan) -> None:
    rng = build.rng
    if rng.random() < 0.55:
        return
    black = Material(Pattern.PLAIN, (0.08, 0.08, 0.08), grain=0.0)
    wood = Material(Pattern.PLAIN, (0.32, 0.27, 0.22), (0.25, 0.2, 0.17), grain=0.3, grain_size=0.3)
    side = float(rng.choice([-1.0, 1.0]))
    x, height, step = side * (plan.road + 0.7), rng.uniform(6.5, 9.0), rng.uniform(18, 30)
    start = -60.0 + rng.uniform(0, step)
    stands = [start + step * k for k in range(int((60.0 - start) / step) + 1)]
    for z in stands:
        build.pole((x, plan.ground(z), z), height, 0.12, wood)
        build.rod((x - 0.9, plan.ground(z) + height - 0.5, z), (x + 0.9, plan.ground(z) + height - 0.5, z), 0.05, wood)
    for a, b in itertools.pairwise(stands):
        for across in (-0.8, 0.0, 0.8):
            low, middle = plan.ground(a) + height - 0.4, 0.5 * (a + b)
            sag = (x + across, 0.5 * (plan.ground(a) + plan.ground(b)) + height - 1.0, middle)
            build.rod((x + across, low, a), sag, 0.018, black)
            build.rod(sag, (x + across, plan.ground(b) + height - 0.4, b), 0.018, black)


def _traffic(build: SceneBuilder, plan: StreetPlan) -> None:
    """Put a few moving cars on the road, away from the middle where cameras are."""
    rng = build.rng
    if plan.style == "square":
        for _ in range(int(rng.integers(2, 9))):
            x, z = rng.uniform(-1, 1) * (plan.road + 8), rng.uniform(-25, 25)
            props.person(build, (x, plan.ground(z, abs(x) > plan.road), z))
        return
    for _ in range(int(rng.integers(0, 4))):
        lane = float(rng.choice([-0.5, 0.5]))
        z = math.copysign(rng.uniform(9, 45), rng.uniform(-1, 1))
        base = (lane * plan.road, plan.ground(z, False), z)
        props.car(LocalFrame(build, base, 0.0 if lane > 0 else math.pi))
