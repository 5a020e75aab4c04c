"""Obstacles that make depth hard to estimate: floating shapes, thin structures, dark gaps, objects near the path."""

import math
from dataclasses import dataclass

import numpy as np

from omnisyn_cli.geometry.pose import rotation_from_rotation_vector
from omnisyn_cli.scenes import palette
from omnisyn_cli.scenes.finishes import random_finish
from omnisyn_cli.scenes.furniture import wood
from omnisyn_cli.scenes.materials import Material, Pattern, tonal_material
from omnisyn_cli.scenes.palette import pick
from omnisyn_cli.scenes.scene import LocalFrame, Point, SceneBuilder, Walkway
from omnisyn_cli.scenes.solids import Shape

DARK_GAP_MATERIAL = Material(Pattern.PLAIN, (0.03, 0.03, 0.03), (0.02, 0.02, 0.02), grain=0.02)
"""Nearly black: a gap that no light reaches. Set by hand."""

MAX_PLACEMENT_TRIES = 12
"""Places that are tried for an object before it is left out."""

NEAR_PATH_SHARE = 0.65
"""Share of places that are drawn beside the camera path; chosen by eye."""


@dataclass(frozen=True)
class CameraPath:
    """A straight path of cameras that obstacles keep clear of; metres.

    Attributes:
        start, end: of the line.
        margin: from the line to the nearest thing.
    """

    start: Point
    end: Point
    clearance: float

    def is_clear_of(self, point: Point, radius: float) -> bool:
        """Whether a ball around a point leaves the path free."""
        start, step = np.array(self.start), np.subtract(self.end, self.start)
        share = np.clip((np.array(point) - start) @ step / max(float(step @ step), 1e-9), 0.0, 1.0)
        return float(np.linalg.norm(start + share * step - point)) > radius + self.clearance

    def walkway(self, level: float, baselines: tuple[float, float], max_baseline_in_depths: float) -> Walkway:
        """Cameras on it; the arguments are the height of the ground and those of the walkway."""
        low, high = np.minimum(self.start, self.end), np.maximum(self.start, self.end)
        around, below = np.array([0.1, 0.2, 0.1]), np.array([0.0, level, 0.0])
        low, high = low - around - below, high + around - below
        step = np.subtract(self.end, self.start)[[0, 2]]
        heading = step / max(float(np.linalg.norm(step)), 1e-9)
        corners = (tuple(map(float, low)), tuple(map(float, high)))
        return Walkway(*corners, (float(heading[0]), float(heading[1])), baselines, 0.18, max_baseline_in_depths, 0.12)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Enclosure:
    """A box to put obstacles into, and the camera path through it; metres."""

    low: Point
    high: Point
    path: CameraPath

    def sample_point(self, rng: np.random.Generator) -> Point:
        """A random point, in most cases one beside the path: near surfaces are the hard ones."""
        point = rng.uniform(self.low, self.high)
        if rng.random() < NEAR_PATH_SHARE:
            on_way = np.array(self.path.start) + rng.random() * np.subtract(self.path.end, self.path.start)
            aside = on_way + (0.5 + self.path.clearance) * rng.normal(0.0, 1.0, 3)
            point = np.clip(aside, self.low, self.high)
        return float(point[0]), float(point[1]), float(point[2])

    def sample_floor_point(self, rng: np.random.Generator, radius: float, height: float) -> Point | None:
        """A place on the floor that leaves the path free; None where none was found."""
        for _ in range(MAX_PLACEMENT_TRIES):
            x, _, z = self.sample_point(rng)
            heights = np.arange(self.low[1] + min(radius, height), self.low[1] + height + 0.01, max(radius, 0.1))
            if all(self.path.is_clear_of((x, float(y), z), radius) for y in heights):
                return x, self.low[1], z
        return None


def _draw_half_size(rng: np.random.Generator, min_size: float, max_size: float) -> Point:
    """Half sizes of a compact, flat or long object."""
    size = math.exp(rng.uniform(math.log(min_size), math.log(max_size)))
    a, b, c = size * rng.uniform(0.5, 1.0, 3)
    shape = rng.random()
    if shape < 0.2:
        b *= 0.08
    elif shape < 0.35:
        a, c = 0.1 * a, 0.1 * c
    return float(a), float(b), float(c)


def _draw_shape(rng: np.random.Generator, half: Point) -> tuple[Shape, Point]:
    """One of the unit shapes; cylinders and cones are round."""
    shape = Shape(int(rng.choice(4, p=[0.5, 0.2, 0.2, 0.1])))
    return shape, (half if shape in (Shape.BOX, Shape.ELLIPSOID) else (half[0], half[1], half[0]))


def floating_shapes(build: SceneBuilder, enclosure: Enclosure, count: int, max_size: float = 0.6) -> None:
    """Add floating shapes of any material."""
    rng = build.rng
    for _ in range(count):
        half = _draw_half_size(rng, 0.05, max_size)
        radius = math.hypot(*half)
        centre = next(
            (
                c
                for c in (enclosure.sample_point(rng) for _ in range(MAX_PLACEMENT_TRIES))
                if enclosure.path.is_clear_of(c, radius)
            ),
            None,
        )
        if centre is None:
            continue
        shape, half = _draw_shape(rng, half)
        turn = rotation_from_rotation_vector(rng.normal(0.0, 1.5, 3)) if rng.random() < 0.8 else np.eye(3)
        cap = random_finish(rng, 2.0 * radius) if rng.random() < 0.3 else None
        build.add(shape, centre, half, random_finish(rng, 2.0 * radius), cap=cap, rotation=turn)


def blocks(build: SceneBuilder, enclosure: Enclosure, count: int, max_size: float = 0.7) -> None:
    """Stand shapes of any material on the floor, now and then one on the other, some with a dark gap below."""
    rng = build.rng
    for _ in range(count):
        half = _draw_half_size(rng, 0.1, max_size)
        radius = math.hypot(half[0], half[2])
        base = enclosure.sample_floor_point(rng, radius, 2.0 * half[1])
        if base is None:
            continue
        bottom = base[1]
        if rng.random() < 0.3:
            gap = rng.uniform(0.04, 0.15)
            build.box((base[0] - 0.8 * half[0], bottom, base[2] - 0.8 * half[2]),
                      (base[0] + 0.8 * half[0], bottom + gap, base[2] + 0.8 * half[2]), DARK_GAP_MATERIAL)  # fmt: skip
            bottom += gap
        shape, half = _draw_shape(rng, half)
        finish = random_finish(rng, 2.0 * radius)
        build.add(shape, (base[0], bottom + half[1], base[2]), half, finish, yaw=rng.uniform(-math.pi, math.pi))


def wires(build: SceneBuilder, enclosure: Enclosure, count: int) -> None:
    """Stretch thin ropes, wires and pipes across."""
    rng = build.rng
    for _ in range(count):
        start, end = np.array(enclosure.sample_point(rng)), np.array(enclosure.sample_point(rng))
        upright = rng.random()
        if upright < 0.3:
            end = np.array([start[0], enclosure.high[1], start[2]])
        elif upright < 0.6:
            end[1] = start[1]
        between = [tuple(start + share * (end - start)) for share in np.linspace(0.0, 1.0, 25)]
        if np.linalg.norm(end - start) > 0.3 and all(enclosure.path.is_clear_of(point, 0.12) for point in between):
            tone = pick(rng, palette.METAL if rng.random() < 0.6 else palette.SIGN)
            material = tonal_material(Pattern.PLAIN, tone, 0.8, grain=0.03, gloss=rng.uniform(0.0, 0.6))
            radius = math.exp(rng.uniform(math.log(0.004), math.log(0.04)))
            build.rod(tuple(map(float, start)), tuple(map(float, end)), radius, material)  # type: ignore[arg-type]


def bars(build: SceneBuilder, enclosure: Enclosure) -> None:
    """Stand a row of equal bars, as of a railing, a cage or a balustrade."""
    rng = build.rng
    count, step = int(rng.integers(4, 15)), rng.uniform(0.08, 0.3)
    reach = 0.5 * count * step
    height = min(enclosure.high[1] - enclosure.low[1], rng.choice([0.9, 1.1, 2.2, 4.0]))
    yaw, radius = rng.uniform(-math.pi, math.pi), rng.uniform(0.006, 0.03)
    for _ in range(MAX_PLACEMENT_TRIES):
        x, _, z = enclosure.sample_point(rng)
        local = LocalFrame(build, (x, enclosure.low[1], z), yaw)
        places = [
            local.place(share * reach, y, 0.0) for share in np.linspace(-1.0, 1.0, 9) for y in np.arange(0, height, 0.2)
        ]
        if all(enclosure.path.is_clear_of(place, 0.2) for place in places):
            tone = pick(rng, palette.METAL if rng.random() < 0.6 else palette.WOOD)
            iron = tonal_material(Pattern.PLAIN, tone, 0.8, grain=0.05, gloss=0.15)
            for k in range(count):
                local.rod(((k + 0.5) * step - reach, 0.0, 0.0), ((k + 0.5) * step - reach, height, 0.0), radius, iron)
            for y in (0.08, height):
                local.rod((-reach, y, 0.0), (reach, y, 0.0), 1.2 * radius, iron)
            return


def platform(build: SceneBuilder, enclosure: Enclosure) -> None:
    """Raise part of the floor by a few steps whose risers are dark."""
    rng = build.rng
    width, depth, rise = rng.uniform(0.6, 1.5), rng.uniform(0.6, 1.5), rng.uniform(0.1, 0.2)
    count = int(rng.integers(1, 5))
    base = enclosure.sample_floor_point(rng, math.hypot(width, depth), rise * count)
    if base is None:
        return
    tread, yaw = random_finish(rng, width), float(rng.choice([0.0, 0.5, 1.0, 1.5])) * math.pi
    riser = DARK_GAP_MATERIAL if rng.random() < 0.5 else tread
    local = LocalFrame(build, base, yaw)
    for k in range(count):
        inset = 0.28 * k
        half = (width, 0.5 * rise, max(0.15, depth - 0.5 * inset))
        local.box((0.0, (k + 0.5) * rise, -0.5 * inset), half, riser, cap=tread)


def arch(build: SceneBuilder, enclosure: Enclosure) -> None:
    """Stand two pillars with a lintel, or a row of columns."""
    rng = build.rng
    thick, height = rng.uniform(0.08, 0.35), min(rng.uniform(1.8, 3.5), enclosure.high[1] - enclosure.low[1])
    stone = random_finish(rng, 1.0)
    step, count = rng.uniform(0.9, 2.2), int(rng.integers(2, 5))
    yaw = float(rng.choice([0.0, 0.5])) * math.pi
    for _ in range(MAX_PLACEMENT_TRIES):
        x, _, z = enclosure.sample_point(rng)
        local = LocalFrame(build, (x, enclosure.low[1], z), yaw)
        feet = [(k - 0.5 * (count - 1)) * step for k in range(count)]
        heights = np.arange(0.0, height, 0.3)
        if all(enclosure.path.is_clear_of(local.place(foot, y, 0.0), 1.5 * thick) for foot in feet for y in heights):
            for foot in feet:
                if rng.random() < 0.5:
                    local.rod((foot, 0.0, 0.0), (foot, height, 0.0), thick, stone)
                else:
                    local.box((foot, 0.5 * height, 0.0), (thick, 0.5 * height, thick), stone)
            if enclosure.path.is_clear_of(local.place(0.0, height, 0.0), 0.5 * step * count):
                local.box((0.0, height + 0.15, 0.0), (0.5 * step * (count - 1) + thick, 0.15, thick), stone)
            return


def kitchen_unit(local: LocalFrame) -> None:
    """Add a kitchen unit or counter on a dark plinth, its board sticking out."""
    rng = local.build.rng
    width, height, depth = rng.uniform(0.4, 1.2), rng.uniform(0.7, 1.0), rng.uniform(0.25, 0.35)
    local.box((0.0, 0.06, -0.05), (width - 0.02, 0.06, depth - 0.05), DARK_GAP_MATERIAL)
    local.box((0.0, 0.5 * (height + 0.12), 0.0), (width, 0.5 * (height - 0.12), depth), wood(rng, 1.0))
    local.box((0.0, height + 0.02, 0.0), (width + 0.01, 0.02, depth + 0.03), random_finish(rng, 0.5))


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


def tripod(build: SceneBuilder, base: Point, height: float) -> None:
    """Stand a tripod with a small head."""
    dark = Material(Pattern.PLAIN, (0.07, 0.07, 0.075), (0.1, 0.1, 0.1), grain=0.05, gloss=0.2)
    turn, spread = build.rng.uniform(0.0, 2.0), 0.3 * height
    top = (base[0], base[1] + height, base[2])
    for k in range(3):
        angle = turn + 2.0 * math.pi * k / 3
        build.rod((base[0] + spread * math.cos(angle), base[1], base[2] + spread * math.sin(angle)), top, 0.014, dark)
    build.add(Shape.BOX, top, (0.06, 0.05, 0.06), dark)
