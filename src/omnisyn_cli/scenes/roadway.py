"""The plan of a street and its ground: road, crossings, kerbs, pavements and yards, all of which follow the slope."""

import math
from dataclasses import dataclass

import numpy as np

from omnisyn_cli.geometry.pose import rotation_from_rotation_vector
from omnisyn_cli.scenes import palette
from omnisyn_cli.scenes.materials import Material, Pattern, plant_material
from omnisyn_cli.scenes.palette import pick
from omnisyn_cli.scenes.scene import SceneBuilder
from omnisyn_cli.scenes.solids import Shape

STREET_HALF_LENGTH = 85.0
"""Half the length of the street, metres."""


@dataclass(frozen=True)
class StreetPlan:
    """Style and measures of a street along z; lengths in metres.

    Attributes:
        style: "town", "suburb", "office" or "square".
        road: half width of the roadway.
        pavement: width of each pavement.
        kerb: height of the pavement above the road.
        slope: rise per metre along z.
        crossings: z and half width of each crossing road.
    """

    style: str
    road: float
    pavement: float
    kerb: float
    slope: float
    crossings: tuple[tuple[float, float], ...]

    def ground(self, z: float, raised: bool = True) -> float:
        """Height of the road, or of the pavement, at z."""
        return self.slope * z + (self.kerb if raised else 0.0)

    def is_crossing(self, z: float, margin: float = 0.0) -> bool:
        """Whether z lies on a crossing road."""
        return any(abs(z - middle) < half + margin for middle, half in self.crossings)

    def blocks(self) -> list[tuple[float, float]]:
        """The stretches of z between the crossings."""
        edges = [-STREET_HALF_LENGTH]
        for middle, half in sorted(self.crossings):
            edges += [middle - half, middle + half]
        edges.append(STREET_HALF_LENGTH)
        return [(edges[i], edges[i + 1]) for i in range(0, len(edges), 2) if edges[i + 1] > edges[i] + 1.0]


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


def _grass_material(rng: np.random.Generator) -> Material:
    green, dry = pick(rng, palette.FOLIAGE), (0.55, 0.50, 0.30)
    return plant_material(Pattern.GRASS, green, 0.85, 1.25, third=dry, detail=rng.uniform(0, 0.8))


def lay_pavement(build: SceneBuilder, plan: StreetPlan, side: float) -> None:
    """Lay kerb, pavement and the yards behind it, on the side of this sign of x."""
    rng = build.rng
    stone = _paving_material(rng)
    kerb = Material(
        Pattern.BRICK, (0.58, 0.57, 0.55), (0.52, 0.51, 0.5), (0.35, 0.34, 0.33), cell=(1.0, 1.0), line=0.012
    )
    green = plan.style in ("suburb", "square") or rng.random() < 0.25
    yard = _grass_material(rng) if green else stone
    inner = plan.road + plan.pavement
    for low, high in plan.blocks():
        _add_slab(build, plan, (side * plan.road, side * (plan.road + 0.16)), (low, high), plan.kerb + 0.004, 0.3, kerb)
        _add_slab(build, plan, (side * (plan.road + 0.16), side * inner), (low, high), plan.kerb, 0.3, stone, kerb)
        _add_slab(build, plan, (side * inner, side * 95.0), (low, high), plan.kerb - 0.002, 0.3, yard, kerb)
