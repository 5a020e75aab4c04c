"""What makes depth hard to find: shapes adrift, thin things, dark gaps, what stands or hangs close to the way."""

import math
from dataclasses import dataclass

import numpy as np

from omnisyn_cli.geometry.pose import rotation_from_rotation_vector
from omnisyn_cli.scenes import palette
from omnisyn_cli.scenes.finishes import any_finish
from omnisyn_cli.scenes.furniture import wood
from omnisyn_cli.scenes.materials import Material, Pattern, shaded
from omnisyn_cli.scenes.palette import pick
from omnisyn_cli.scenes.scene import Point, SceneBuilder, Shape, Turned, Walkway

BLACK = Material(Pattern.PLAIN, (0.03, 0.03, 0.03), (0.02, 0.02, 0.02), grain=0.02)

TRIES = 12
"""Places that are tried for a thing before it is left out."""

BESIDE = 0.65
"""Share of places that are drawn beside the way."""


@dataclass(frozen=True)
class Way:
    """A straight way that cameras may take, and that things keep clear of; metres.

    Attributes:
        start, end: of the line.
        margin: from the line to the nearest thing.
    """

    start: Point
    end: Point
    margin: float

    def is_clear_of(self, point: Point, radius: float) -> bool:
        """Whether a ball around a point leaves the way free."""
        start, step = np.array(self.start), np.subtract(self.end, self.start)
        share = np.clip((np.array(point) - start) @ step / max(float(step @ step), 1e-9), 0.0, 1.0)
        return float(np.linalg.norm(start + share * step - point)) > radius + self.margin

    def walkway(self, level: float, baselines: tuple[float, float], nearness: float) -> Walkway:
        """Cameras on it; the arguments are the height of the ground and those of the walkway."""
        low, high = np.minimum(self.start, self.end), np.maximum(self.start, self.end)
        around, below = np.array([0.1, 0.2, 0.1]), np.array([0.0, level, 0.0])
        low, high = low - around - below, high + around - below
        step = np.subtract(self.end, self.start)[[0, 2]]
        heading = step / max(float(np.linalg.norm(step)), 1e-9)
        corners = (tuple(map(float, low)), tuple(map(float, high)))
        return Walkway(*corners, (float(heading[0]), float(heading[1])), baselines, 0.18, nearness, 0.12)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Space:
    """A box to put things into, and the way through it; metres."""

    low: Point
    high: Point
    way: Way

    def drawn(self, rng: np.random.Generator) -> Point:
        """Any point of it, two of three times one beside the way: what is near is what is hard."""
        point = rng.uniform(self.low, self.high)
        if rng.random() < BESIDE:
            on_way = np.array(self.way.start) + rng.random() * np.subtract(self.way.end, self.way.start)
            aside = on_way + (0.5 + self.way.margin) * rng.normal(0.0, 1.0, 3)
            point = np.clip(aside, self.low, self.high)
        return float(point[0]), float(point[1]), float(point[2])

    def floor_place(self, rng: np.random.Generator, radius: float, tall: float) -> Point | None:
        """A place on the floor that leaves the way free; None where none was found."""
        for _ in range(TRIES):
            x, _, z = self.drawn(rng)
            heights = np.arange(self.low[1] + min(radius, tall), self.low[1] + tall + 0.01, max(radius, 0.1))
            if all(self.way.is_clear_of((x, float(y), z), radius) for y in heights):
                return x, self.low[1], z
        return None


def _odd_size(rng: np.random.Generator, least: float, greatest: float) -> Point:
    """Half sizes of a thing, compact, flat or long."""
    size = math.exp(rng.uniform(math.log(least), math.log(greatest)))
    a, b, c = size * rng.uniform(0.5, 1.0, 3)
    shape = rng.random()
    if shape < 0.2:
        b *= 0.08
    elif shape < 0.35:
        a, c = 0.1 * a, 0.1 * c
    return float(a), float(b), float(c)


def _shape(rng: np.random.Generator, half: Point) -> tuple[Shape, Point]:
    """One of the unit shapes; cylinders and cones are round."""
    shape = Shape(int(rng.choice(4, p=[0.5, 0.2, 0.2, 0.1])))
    return shape, (half if shape in (Shape.BOX, Shape.ELLIPSOID) else (half[0], half[1], half[0]))


def adrift(build: SceneBuilder, space: Space, count: int, greatest: float = 0.6) -> None:
    """Let shapes of any material float about."""
    rng = build.rng
    for _ in range(count):
        half = _odd_size(rng, 0.05, greatest)
        radius = math.hypot(*half)
        centre = next((c for c in (space.drawn(rng) for _ in range(TRIES)) if space.way.is_clear_of(c, radius)), None)
        if centre is None:
            continue
        shape, half = _shape(rng, half)
        turn = rotation_from_rotation_vector(rng.normal(0.0, 1.5, 3)) if rng.random() < 0.8 else np.eye(3)
        cap = any_finish(rng, 2.0 * radius) if rng.random() < 0.3 else None
        build.add(shape, centre, half, any_finish(rng, 2.0 * radius), cap=cap, rotation=turn)


def blocks(build: SceneBuilder, space: Space, count: int, greatest: float = 0.7) -> None:
    """Stand shapes of any material on the floor, now and then one on the other, some with a dark gap below."""
    rng = build.rng
    for _ in range(count):
        half = _odd_size(rng, 0.1, greatest)
        radius = math.hypot(half[0], half[2])
        base = space.floor_place(rng, radius, 2.0 * half[1])
        if base is None:
            continue
        at = base[1]
        if rng.random() < 0.3:
            gap = rng.uniform(0.04, 0.15)
            build.box((base[0] - 0.8 * half[0], at, base[2] - 0.8 * half[2]),
                      (base[0] + 0.8 * half[0], at + gap, base[2] + 0.8 * half[2]), BLACK)  # fmt: skip
            at += gap
        shape, half = _shape(rng, half)
        finish = any_finish(rng, 2.0 * radius)
        build.add(shape, (base[0], at + half[1], base[2]), half, finish, yaw=rng.uniform(-math.pi, math.pi))


def wires(build: SceneBuilder, space: Space, count: int) -> None:
    """Stretch thin ropes, wires and pipes across."""
    rng = build.rng
    for _ in range(count):
        start, end = np.array(space.drawn(rng)), np.array(space.drawn(rng))
        upright = rng.random()
        if upright < 0.3:
            end = np.array([start[0], space.high[1], start[2]])
        elif upright < 0.6:
            end[1] = start[1]
        between = [tuple(start + share * (end - start)) for share in np.linspace(0.0, 1.0, 25)]
        if np.linalg.norm(end - start) > 0.3 and all(space.way.is_clear_of(point, 0.12) for point in between):
            tone = pick(rng, palette.METAL if rng.random() < 0.6 else palette.SIGN)
            material = shaded(Pattern.PLAIN, tone, 0.8, grain=0.03, gloss=rng.uniform(0.0, 0.6))
            radius = math.exp(rng.uniform(math.log(0.004), math.log(0.04)))
            build.rod(tuple(map(float, start)), tuple(map(float, end)), radius, material)  # type: ignore[arg-type]


def bars(build: SceneBuilder, space: Space) -> None:
    """Stand a row of equal bars, as of a railing, a cage or a balustrade."""
    rng = build.rng
    count, step = int(rng.integers(4, 15)), rng.uniform(0.08, 0.3)
    reach = 0.5 * count * step
    tall = min(space.high[1] - space.low[1], rng.choice([0.9, 1.1, 2.2, 4.0]))
    yaw, radius = rng.uniform(-math.pi, math.pi), rng.uniform(0.006, 0.03)
    for _ in range(TRIES):
        x, _, z = space.drawn(rng)
        at = Turned(build, (x, space.low[1], z), yaw)
        places = [
            at.place(share * reach, y, 0.0) for share in np.linspace(-1.0, 1.0, 9) for y in np.arange(0, tall, 0.2)
        ]
        if all(space.way.is_clear_of(place, 0.2) for place in places):
            tone = pick(rng, palette.METAL if rng.random() < 0.6 else palette.WOOD)
            iron = shaded(Pattern.PLAIN, tone, 0.8, grain=0.05, gloss=0.15)
            for k in range(count):
                at.rod(((k + 0.5) * step - reach, 0.0, 0.0), ((k + 0.5) * step - reach, tall, 0.0), radius, iron)
            for y in (0.08, tall):
                at.rod((-reach, y, 0.0), (reach, y, 0.0), 1.2 * radius, iron)
            return


def platform(build: SceneBuilder, space: Space) -> None:
    """Raise part of the floor by a few steps whose risers are dark."""
    rng = build.rng
    wide, deep, rise = rng.uniform(0.6, 1.5), rng.uniform(0.6, 1.5), rng.uniform(0.1, 0.2)
    count = int(rng.integers(1, 5))
    base = space.floor_place(rng, math.hypot(wide, deep), rise * count)
    if base is None:
        return
    tread, yaw = any_finish(rng, wide), float(rng.choice([0.0, 0.5, 1.0, 1.5])) * math.pi
    riser = BLACK if rng.random() < 0.5 else tread
    at = Turned(build, base, yaw)
    for k in range(count):
        inset = 0.28 * k
        half = (wide, 0.5 * rise, max(0.15, deep - 0.5 * inset))
        at.box((0.0, (k + 0.5) * rise, -0.5 * inset), half, riser, cap=tread)


def arch(build: SceneBuilder, space: Space) -> None:
    """Stand two pillars with a lintel, or a row of columns."""
    rng = build.rng
    thick, tall = rng.uniform(0.08, 0.35), min(rng.uniform(1.8, 3.5), space.high[1] - space.low[1])
    stone = any_finish(rng, 1.0)
    step, count = rng.uniform(0.9, 2.2), int(rng.integers(2, 5))
    yaw = float(rng.choice([0.0, 0.5])) * math.pi
    for _ in range(TRIES):
        x, _, z = space.drawn(rng)
        at = Turned(build, (x, space.low[1], z), yaw)
        feet = [(k - 0.5 * (count - 1)) * step for k in range(count)]
        heights = np.arange(0.0, tall, 0.3)
        if all(space.way.is_clear_of(at.place(foot, y, 0.0), 1.5 * thick) for foot in feet for y in heights):
            for foot in feet:
                if rng.random() < 0.5:
                    at.rod((foot, 0.0, 0.0), (foot, tall, 0.0), thick, stone)
                else:
                    at.box((foot, 0.5 * tall, 0.0), (thick, 0.5 * tall, thick), stone)
            if space.way.is_clear_of(at.place(0.0, tall, 0.0), 0.5 * step * count):
                at.box((0.0, tall + 0.15, 0.0), (0.5 * step * (count - 1) + thick, 0.15, thick), stone)
            return


def unit(at: Turned) -> None:
    """Add a kitchen unit or counter on a dark plinth, its board sticking out."""
    rng = at.build.rng
    wide, tall, deep = rng.uniform(0.4, 1.2), rng.uniform(0.7, 1.0), rng.uniform(0.25, 0.35)
    at.box((0.0, 0.06, -0.05), (wide - 0.02, 0.06, deep - 0.05), BLACK)
    at.box((0.0, 0.5 * (tall + 0.12), 0.0), (wide, 0.5 * (tall - 0.12), deep), wood(rng, 1.0))
    at.box((0.0, tall + 0.02, 0.0), (wide + 0.01, 0.02, deep + 0.03), any_finish(rng, 0.5))


def chandelier(build: SceneBuilder, ceiling: Point, drop: float) -> None:
    """Hang a lamp with arms and bulbs from a point of the ceiling."""
    rng = build.rng
    metal = Material(Pattern.PLAIN, pick(rng, palette.METAL), grain=0.03, gloss=0.5)
    bulb = Material(Pattern.PLAIN, (0.95, 0.9, 0.8), grain=0.02, glow=rng.uniform(0.2, 1.5))
    x, y, z = ceiling
    hub = (x, y - drop, z)
    build.rod(hub, ceiling, 0.01, metal)
    build.ball(hub, rng.uniform(0.03, 0.08), metal)
    arms, reach, rise = int(rng.integers(3, 9)), rng.uniform(0.2, 0.5), rng.uniform(-0.1, 0.15)
    for k in range(arms):
        angle = 2.0 * math.pi * k / arms
        end = (x + reach * math.cos(angle), hub[1] + rise, z + reach * math.sin(angle))
        build.rod(hub, end, 0.008, metal)
        build.add(Shape.ELLIPSOID, (end[0], end[1] + 0.05, end[2]), (0.04, 0.06, 0.04), bulb)


def tripod(build: SceneBuilder, base: Point, tall: float) -> None:
    """Stand a tripod with a small head."""
    dark = Material(Pattern.PLAIN, (0.07, 0.07, 0.075), (0.1, 0.1, 0.1), grain=0.05, gloss=0.2)
    turn, spread = build.rng.uniform(0.0, 2.0), 0.3 * tall
    top = (base[0], base[1] + tall, base[2])
    for k in range(3):
        angle = turn + 2.0 * math.pi * k / 3
        build.rod((base[0] + spread * math.cos(angle), base[1], base[2] + spread * math.sin(angle)), top, 0.014, dark)
    build.add(Shape.BOX, top, (0.06, 0.05, 0.06), dark)
