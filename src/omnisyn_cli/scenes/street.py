"""Streets: a road along z with kerbs, pavements, house fronts, crossings and all that stands between them."""

import itertools
import math

import numpy as np

from omnisyn_cli.geometry.pose import rotation_from_rotation_vector
from omnisyn_cli.scenes import palette, props
from omnisyn_cli.scenes.buildings import house, office, town_house
from omnisyn_cli.scenes.daylight import daylight
from omnisyn_cli.scenes.materials import Material, Pattern
from omnisyn_cli.scenes.palette import pick
from omnisyn_cli.scenes.roadway import StreetPlan, draw_plan, lay_pavement, lay_roadway
from omnisyn_cli.scenes.scene import LocalFrame, Scene, SceneBuilder, Walkway
from omnisyn_cli.scenes.solids import Shape


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
