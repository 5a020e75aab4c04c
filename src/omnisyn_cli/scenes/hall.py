"""Warehouses and workshops: racks, pallets, columns, beams, lights and markings on the floor."""

import math

import numpy as np

from omnisyn_cli.scenes import furniture, goods, palette
from omnisyn_cli.scenes.materials import Material, Pattern
from omnisyn_cli.scenes.palette import pick
from omnisyn_cli.scenes.scene import SceneBuilder, Shape
from omnisyn_cli.scenes.walls import Cell


def furnish_hall(build: SceneBuilder, cell: Cell) -> None:
    """Fill a hall, leaving aisles along x."""
    rng = build.rng
    (x0, z0), (x1, z1) = cell.low, cell.high
    _beams(build, cell)
    rack_tall = min(cell.tall - 0.6, rng.uniform(2.2, 6.0))
    aisle = rng.uniform(3.0, 5.5)
    z = z0 + 0.7
    while z < z1 - 0.6:
        roll = rng.random()
        if roll < 0.6:
            bays = max(1, min(6, int((x1 - x0) * rng.uniform(0.25, 0.85) / 2.7)))
            span = 0.5 * bays * 2.7
            x = rng.uniform(x0 + span + 0.2, max(x0 + span + 0.21, x1 - span - 0.2))
            goods.rack(build, (x, 0.0, z), 0.0, bays, rack_tall)
        elif roll < 0.9:
            for x in np.arange(x0 + 1.5, x1 - 1.5, rng.uniform(1.8, 4.5)):
                if rng.random() < 0.6:
                    goods.loaded_pallet(build, (float(x), 0.0, z + rng.uniform(-0.2, 0.4)), rng.normal(0, 0.1))
        _marking(build, cell, z + 0.9)
        z += aisle * rng.uniform(0.8, 1.2)
    for _ in range(int(rng.integers(2, 7))):
        x, z = rng.uniform(x0 + 1, x1 - 1), rng.uniform(z0 + 1, z1 - 1)
        if rng.random() < 0.5:
            yaw = rng.uniform(0, math.pi)
            thing = goods.loaded_pallet if rng.random() < 0.6 else goods.carton_pile
            thing(build, (x, 0.0, z), yaw)
        else:
            furniture.table(build, (x, 0.0, z), rng.uniform(0, math.pi), (0.9, 0.4))
    if rng.random() < 0.5:
        _columns(build, cell)


def _beams(build: SceneBuilder, cell: Cell) -> None:
    """Add trusses under the roof, and lamps between them."""
    rng = build.rng
    (x0, z0), (x1, z1) = cell.low, cell.high
    steel = Material(Pattern.PLAIN, pick(rng, palette.METAL), grain=0.06)
    light = Material(Pattern.PLAIN, (0.97, 0.97, 0.95), grain=0.0, glow=2.0)
    deep = rng.uniform(0.3, 0.7)
    step = rng.uniform(3.0, 6.0)
    top = cell.tall - 0.05
    open_truss = rng.random() < 0.5
    for x in np.arange(x0 + 0.5 * step, x1, step):
        if open_truss:
            for y in (top, top - deep):
                build.box((float(x) - 0.06, y - 0.05, z0), (float(x) + 0.06, y + 0.05, z1), steel, casts_shadow=False)
            count = max(2, min(8, int((z1 - z0) / 1.4)))
            for k in range(count):
                a, b = z0 + k * (z1 - z0) / count, z0 + (k + 1) * (z1 - z0) / count
                heights = (top, top - deep) if k % 2 else (top - deep, top)
                build.rod((float(x), heights[0], a), (float(x), heights[1], b), 0.035, steel)
        else:
            build.box((float(x) - 0.12, top - deep, z0), (float(x) + 0.12, top, z1), steel, casts_shadow=False)
        for z in np.arange(z0 + 2.0, z1 - 1.0, rng.uniform(3.0, 6.0)):
            if rng.random() < 0.85:
                spot = (float(x) + 0.5 * step, cell.tall - rng.uniform(0.2, 0.6), float(z))
                if spot[0] < x1 - 0.9:
                    build.add(Shape.BOX, spot, (0.7, 0.05, 0.12), light, casts_shadow=False)


def _columns(build: SceneBuilder, cell: Cell) -> None:
    rng = build.rng
    concrete = Material(Pattern.PLAIN, pick(rng, palette.CONCRETE), (0.4, 0.4, 0.4), grain=0.12)
    hazard = Material(Pattern.STRIPES, (0.1, 0.1, 0.1), (0.85, 0.68, 0.1), cell=(0.3, 0.3), detail=1.0, grain=0.1)
    half, step = rng.uniform(0.12, 0.3), rng.uniform(4.0, 7.0)
    z = rng.uniform(cell.low[1] + 1.5, cell.high[1] - 1.5)
    for x in np.arange(cell.low[0] + 0.6 * step, cell.high[0] - 0.5, step):
        build.add(Shape.BOX, (float(x), 0.5 * cell.tall, z), (half, 0.5 * cell.tall, half), concrete)
        build.add(Shape.BOX, (float(x), 0.6, z), (half + 0.01, 0.6, half + 0.01), hazard)


def _marking(build: SceneBuilder, cell: Cell, z: float) -> None:
    """Paint a line along the floor, plain or striped."""
    rng = build.rng
    if rng.random() < 0.3 or z > cell.high[1] - 0.2:
        return
    if rng.random() < 0.5:
        paint = Material(
            Pattern.STRIPES, (0.12, 0.12, 0.12), (0.85, 0.68, 0.1), cell=(0.3, 0.3), detail=1.0, grain=0.15
        )
    else:
        paint = Material(Pattern.PLAIN, pick(rng, palette.SIGN), grain=0.2, grain_size=0.4)
    build.box((cell.low[0] + 0.8, 0.0, z), (cell.high[0] - 0.8, 0.004, z + 0.1), paint, casts_shadow=False)
