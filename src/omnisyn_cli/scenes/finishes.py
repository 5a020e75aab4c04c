"""Materials of walls, floors and objects."""

import math

import numpy as np

from omnisyn_cli.scenes import palette
from omnisyn_cli.scenes.materials import Material, Pattern, tonal_material
from omnisyn_cli.scenes.palette import pick

ALL_PURPOSE_PATTERNS = (
    Pattern.PLAIN, Pattern.PLAIN, Pattern.BRICK, Pattern.TILES, Pattern.CHECKER, Pattern.PLANKS, Pattern.STRIPES,
    Pattern.COLLAGE, Pattern.COLLAGE, Pattern.GRASS, Pattern.WALLPAPER, Pattern.RIBS, Pattern.CARTON, Pattern.RUG,
)  # fmt: skip
"""Patterns that anything can be covered with."""

ALL_COLOURS = (*palette.INTERIOR, *palette.CLOTH, *palette.SIGN, *palette.WOOD, *palette.BRICK, *palette.METAL)
"""Of surfaces that can have any colour."""


def wall_finish(rng: np.random.Generator, use: str) -> Material:
    """Draw paint, wallpaper, brick, boards or sheets for a wall; ``use`` is "home", "office" or "hall"."""
    tone = pick(rng, palette.INTERIOR if use != "hall" else palette.CONCRETE)
    seed = int(rng.integers(1, 1000))
    kind = rng.random()
    if use == "home" and kind < 0.3:
        return Material(
            Pattern.WALLPAPER, tone, palette.scaled(tone, rng.uniform(0.75, 1.12)),
            palette.mixed(tone, pick(rng, palette.CLOTH), 0.4), cell=(rng.uniform(0.12, 0.5), rng.uniform(0.15, 0.5)),
            grain=0.03, seed=seed,
        )  # fmt: skip
    if kind < (0.4 if use != "hall" else 0.3):
        brick = pick(rng, palette.BRICK) if rng.random() < 0.5 else tone
        return tonal_material(Pattern.BRICK, brick, 0.8, 1.25, cell=(0.25, 0.08), line=0.011, grain=0.12, seed=seed)
    if use == "hall" and kind < 0.6:
        return tonal_material(Pattern.RIBS, tone, 0.85, 0.6, cell=(0.3, 2.5), line=0.03, grain=0.06, seed=seed)
    if kind < 0.5:
        return Material(
            Pattern.PLANKS, pick(rng, palette.WOOD), pick(rng, palette.WOOD), (0.15, 0.1, 0.07), cell=(3.0, 0.14),
            line=0.006, grain=0.05, seed=seed,
        )  # fmt: skip
    return tonal_material(
        Pattern.PLAIN, tone, rng.uniform(0.78, 0.97), grain=rng.uniform(0.02, 0.1), grain_size=rng.uniform(0.5, 3.0),
        detail=rng.uniform(0.2, 0.6), seed=seed,
    )  # fmt: skip


def floor_finish(rng: np.random.Generator, use: str) -> Material:
    """Draw concrete, boards, tiles or carpet for a floor; arguments as of :func:`wall_finish`."""
    seed = int(rng.integers(1, 1000))
    kind = rng.random()
    if use == "hall":
        tone = pick(rng, palette.CONCRETE)
        return tonal_material(
            Pattern.TILES, tone, 0.96, 0.75, cell=(5.0, 5.0), line=0.012, grain=0.16, grain_size=1.2, gloss=0.25,
            seed=seed,
        )  # fmt: skip
    if kind < 0.45:
        tone = pick(rng, palette.WOOD)
        return tonal_material(
            Pattern.PLANKS, tone, 0.75, 0.4, cell=(rng.uniform(0.6, 2.2), rng.uniform(0.07, 0.2)), line=0.005,
            grain=0.06, gloss=0.35, seed=seed,
        )  # fmt: skip
    if kind < 0.7:
        tone = pick(rng, palette.PAVING if rng.random() < 0.5 else palette.INTERIOR)
        other = palette.scaled(tone, rng.uniform(0.4, 0.95))
        pattern = Pattern.CHECKER if rng.random() < 0.3 else Pattern.TILES
        side = rng.uniform(0.2, 0.6)
        return Material(
            pattern, tone, other, palette.scaled(tone, 0.6), cell=(side, side), line=0.008, grain=0.07, gloss=0.45,
            detail=0.3, seed=seed,
        )  # fmt: skip
    tone = pick(rng, palette.CLOTH)
    return tonal_material(
        Pattern.PLAIN, tone, 0.8, grain=0.2, grain_size=rng.choice([0.05, 0.3]), detail=0.4, seed=seed
    )


def random_finish(rng: np.random.Generator, size: float) -> Material:
    """Draw any pattern of any colours at any scale up to ``size`` metres; every fifth is dark, every fourth shines."""
    first, second, third = (pick(rng, ALL_COLOURS, 0.12) for _ in range(3))
    if rng.random() < 0.2:
        first, second, third = (palette.scaled(colour, rng.uniform(0.1, 0.5)) for colour in (first, second, third))
    cell = size * math.exp(rng.uniform(math.log(0.03), 0.0))
    return Material(
        ALL_PURPOSE_PATTERNS[rng.integers(len(ALL_PURPOSE_PATTERNS))], first, second, third,
        cell=(cell, cell * rng.uniform(0.3, 1.5)), line=cell * rng.uniform(0.02, 0.2),
        grain=math.exp(rng.uniform(math.log(0.005), math.log(0.4))),
        grain_size=size * math.exp(rng.uniform(math.log(0.05), 0.0)), detail=rng.uniform(0.0, 1.0),
        gloss=rng.uniform(0.2, 1.0) if rng.random() < 0.25 else 0.0, seed=int(rng.integers(1, 10000)),
    )  # fmt: skip


def low_texture_finish(rng: np.random.Generator, use: str) -> Material:
    """Draw paint with hardly any texture to match, for most walls; arguments as of :func:`wall_finish`."""
    if rng.random() < 0.3:
        return wall_finish(rng, use)
    tone = pick(rng, palette.INTERIOR)
    return tonal_material(
        Pattern.PLAIN, tone, rng.uniform(0.96, 1.0), grain=rng.uniform(0.0, 0.015), grain_size=rng.uniform(0.3, 4.0),
        detail=rng.uniform(0.0, 0.4), gloss=rng.uniform(0.05, 0.3) if rng.random() < 0.3 else 0.0,
        seed=int(rng.integers(1, 1000)),
    )  # fmt: skip
