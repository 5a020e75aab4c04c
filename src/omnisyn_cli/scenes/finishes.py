"""Materials of walls, floors and objects."""

import numpy as np

from omnisyn_cli.scenes import palette
from omnisyn_cli.scenes.materials import Material, Pattern, tonal_material
from omnisyn_cli.scenes.palette import pick


def wall_finish(rng: np.random.Generator, use: str) -> Material:
    """Draw paint, wallpaper, brick, boards or sheets for a wall; ``use`` is "home" or "office"."""
    tone = pick(rng, palette.INTERIOR)
    seed = int(rng.integers(1, 1000))
    kind = rng.random()
    if use == "home" and kind < 0.3:
        return Material(
            Pattern.WALLPAPER, tone, palette.scaled(tone, rng.uniform(0.75, 1.12)),
            palette.mixed(tone, pick(rng, palette.CLOTH), 0.4), cell=(rng.uniform(0.12, 0.5), rng.uniform(0.15, 0.5)),
            grain=0.03, seed=seed,
        )  # fmt: skip
    if kind < 0.4:
        brick = pick(rng, palette.BRICK) if rng.random() < 0.5 else tone
        return tonal_material(Pattern.BRICK, brick, 0.8, 1.25, cell=(0.25, 0.08), line=0.011, grain=0.12, seed=seed)
    if kind < 0.5:
        return Material(
            Pattern.PLANKS, pick(rng, palette.WOOD), pick(rng, palette.WOOD), (0.15, 0.1, 0.07), cell=(3.0, 0.14),
            line=0.006, grain=0.05, seed=seed,
        )  # fmt: skip
    return tonal_material(
        Pattern.PLAIN, tone, rng.uniform(0.78, 0.97), grain=rng.uniform(0.02, 0.1), grain_size=rng.uniform(0.5, 3.0),
        detail=rng.uniform(0.2, 0.6), seed=seed,
    )  # fmt: skip


def floor_finish(rng: np.random.Generator) -> Material:
    """Draw boards, tiles or carpet for a floor."""
    seed = int(rng.integers(1, 1000))
    kind = rng.random()
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
