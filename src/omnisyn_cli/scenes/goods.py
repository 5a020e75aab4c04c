"""Stock: cartons, pallets and racks; every function adds one to the floor, as those of furniture do."""

import numpy as np

from omnisyn_cli.scenes import palette
from omnisyn_cli.scenes.materials import Material, Pattern
from omnisyn_cli.scenes.palette import pick
from omnisyn_cli.scenes.scene import LocalFrame, Point

CARTON = Material(
    Pattern.CARTON, (0.62, 0.47, 0.31), (0.74, 0.63, 0.46), (0.88, 0.87, 0.84), grain=0.08, grain_size=0.4, seed=3
)
"""Of boxes. Set by hand."""


def carton_pile(local: LocalFrame) -> None:
    """Add a few cartons, one on the other."""
    rng = local.build.rng
    height = 0.0
    for _ in range(int(rng.integers(1, 4))):
        half = (rng.uniform(0.15, 0.32), rng.uniform(0.1, 0.24), rng.uniform(0.15, 0.28))
        centre = (rng.uniform(-0.04, 0.04), height + half[1], 0.0)
        local.box(centre, half, CARTON, tint=rng.uniform(0.8, 1.15), turn=rng.uniform(-0.2, 0.2))
        height += 2.0 * half[1]


def loaded_pallet(local: LocalFrame) -> None:
    """Add a pallet with equal cartons in layers."""
    rng = local.build.rng
    pallet = Material(
        Pattern.PLANKS, (0.66, 0.54, 0.38), (0.55, 0.44, 0.3), (0.2, 0.15, 0.1), cell=(2.0, 0.14), line=0.04
    )
    local.box((0.0, 0.13, 0.0), (0.6, 0.015, 0.5), pallet)
    for x in (-0.52, 0.0, 0.52):
        local.box((x, 0.06, 0.0), (0.06, 0.06, 0.5), pallet)
    half = (0.58 / int(rng.integers(1, 4)), rng.uniform(0.12, 0.25), 0.48 / int(rng.integers(1, 3)))
    columns, rows = round(0.58 / half[0]), round(0.48 / half[2])
    layers = int(rng.integers(1, 5 if columns * rows < 4 else 4))
    for layer in range(layers):
        for i in range(columns):
            for j in range(rows):
                if layer < layers - 1 or rng.random() < 0.7:
                    centre = (
                        (2 * i + 1 - columns) * half[0],
                        0.145 + (2 * layer + 1) * half[1],
                        (2 * j + 1 - rows) * half[2],
                    )
                    size = (half[0] - 0.006, half[1] - 0.003, half[2] - 0.006)
                    local.box(centre, size, CARTON, tint=rng.uniform(0.85, 1.1))


def rack(local: LocalFrame, bays: int, height: float) -> None:
    """Add a pallet rack: frames, beams, loads; it stretches along the local x axis, its middle at the base."""
    rng = local.build.rng
    upright = Material(
        Pattern.PLAIN, pick(rng, ((0.12, 0.2, 0.42), (0.2, 0.2, 0.2), (0.2, 0.3, 0.25))), grain=0.06, gloss=0.1
    )
    beam = Material(
        Pattern.PLAIN, pick(rng, ((0.8, 0.63, 0.1), (0.78, 0.35, 0.1), (0.6, 0.6, 0.6))), grain=0.06, gloss=0.1
    )
    bay, depth = rng.uniform(1.8, 2.7), rng.uniform(0.35, 0.55)
    levels = max(1, int(height / rng.uniform(1.3, 2.0)))
    for k in range(bays + 1):
        x = (k - 0.5 * bays) * bay
        for z in (-depth, depth):
            local.box((x, 0.5 * height, z), (0.045, 0.5 * height, 0.04), upright)
        for y in np.arange(0.4, height - 0.7, 1.1):
            local.rod((x, y, -depth), (x, y + 0.7, depth), 0.018, upright)
    for level in range(levels + 1):
        y = 0.12 + level * (height - 0.3) / max(1, levels) if level else 0.0
        if level:
            for z in (-depth, depth):
                local.box((0.0, y, z), (0.5 * bays * bay, 0.06, 0.025), beam)
            local.box((0.0, y + 0.045, 0.0), (0.5 * bays * bay, 0.01, depth), beam, tint=0.7)
        for k in range(bays):
            if rng.random() < 0.8:
                base = ((k + 0.5 - 0.5 * bays) * bay, y + 0.06 * (level > 0), 0.0)
                _load(local, base, 0.42 * bay, depth, height / (levels + 1))


def _load(local: LocalFrame, base: Point, width: float, depth: float, room: float) -> None:
    rng = local.build.rng
    pieces = int(rng.integers(1, 4))
    for k in range(pieces):
        half = (
            width / pieces * rng.uniform(0.75, 0.97),
            min(0.8, 0.5 * room) * rng.uniform(0.35, 0.85),
            depth * rng.uniform(0.7, 0.95),
        )
        x = base[0] + (2 * k + 1 - pieces) * width / pieces
        if rng.random() < 0.75:
            goods = CARTON
        else:
            goods = Material(
                Pattern.PLAIN, pick(rng, palette.CLOTH), pick(rng, palette.INTERIOR), grain=0.12, gloss=0.2
            )
        local.box((x, base[1] + half[1], base[2]), half, goods, tint=rng.uniform(0.8, 1.15))
