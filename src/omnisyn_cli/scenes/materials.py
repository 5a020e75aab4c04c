"""Materials: a pattern of up to three colours, and how it takes the light."""

from collections.abc import Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from omnisyn_cli.scenes.palette import Colour, Palette, pick, scaled


class Pattern(IntEnum):
    """What :mod:`omnisyn_cli.scenes.textures` draws; ``first``, ``second``, ``third`` are the material's colours."""

    PLAIN = 0  # first; stains of second by ``detail``
    BRICK = 1  # staggered cells of first and second, mortar third
    TILES = 2  # cells of first and second by chance, joints third
    CHECKER = 3  # first and second in turn
    PLANKS = 4  # long cells with grain
    FACADE = 5  # wall first, glass second, trim third
    STRIPES = 6  # diagonal first and second
    COLLAGE = 7  # random rectangles of all three
    ROAD = 8  # asphalt first, markings second and third
    GRASS = 9  # first and second, dry patches third
    WALLPAPER = 10  # repeated motif
    LEAVES = 11  # clumps, with holes
    BARS = 12  # vertical bars and rails, open between
    PANELS = 13  # ceiling grid: panel first, joints second, lit panels third
    RIBS = 14  # corrugated sheet
    PICTURE = 16  # framed picture
    BOOKS = 17  # spines of all three colours
    RUG = 18  # borders and motif
    WINDOW = 19  # one window or door: frame third, glass second


class Material(NamedTuple):
    """A surface."""

    pattern: Pattern = Pattern.PLAIN  # what is drawn
    # its colours, sRGB in [0, 1]
    first: Colour = (0.5, 0.5, 0.5)
    second: Colour = (0.4, 0.4, 0.4)
    third: Colour = (0.3, 0.3, 0.3)
    cell: tuple[float, float] = (1.0, 1.0)  # size of the pattern's cell, metres
    line: float = 0.02  # width of joints, bars or frames, metres
    grain: float = 0.15  # strength of the noise that lies over everything
    grain_size: float = 0.7  # wavelength of its coarsest octave, metres
    detail: float = 0.5  # a number in [0, 1] with a meaning of each pattern's own
    gloss: float = 0.0  # 0 (matt) to 1 (mirror-like at grazing angles)
    glow: float = 0.0  # light of its own, in units of the colours
    seed: int = 1  # of the noise and of the cells


COLOURS = ("first", "second", "third")


def tonal_material(
    pattern: Pattern, tone: Colour, second: float, third: float | None = None, first: float = 1.0, **properties: Any
) -> Material:
    """A material whose colours are one colour times a factor each; ``properties`` is the rest."""
    if third is not None:
        properties["third"] = scaled(tone, third)
    return Material(pattern, scaled(tone, first), scaled(tone, second), **properties)


def random_material(
    rng: np.random.Generator, pattern: Pattern, palettes: Sequence[Palette], **properties: Any
) -> Material:
    """A material whose colours are picked from a palette each and whose seed is drawn; the rest is ``properties``."""
    properties |= zip(COLOURS, [pick(rng, palette) for palette in palettes], strict=False)
    return Material(pattern, seed=int(rng.integers(1, 1000)), **properties)


PERFORATED_PATTERNS = (Pattern.LEAVES, Pattern.BARS)  # Patterns with holes, which rays pass

PACKED_MATERIAL = np.dtype([
    ("pattern", "i8"), *((name, "f8", 3) for name in COLOURS), ("cell", "f8", 2), ("line", "f8"), ("grain", "f8"),
    ("grain_size", "f8"), ("detail", "f8"), ("gloss", "f8"), ("glow", "f8"), ("seed", "i8"), ("is_perforated", "?"),
    ("photo", "i8"), ("photo_mapping", "i8"), ("photo_width", "f8"), ("photo_seed", "i8"), ("has_patches", "?"),
])  # fmt: skip
"""A material as kernels read it: colours are linear; for photographs see :mod:`omnisyn_cli.scenes.photos`."""


def pack_materials(materials: Sequence[Material]) -> np.ndarray:
    """One record of :data:`PACKED_MATERIAL` per material, without photographs."""
    packed = np.zeros(len(materials), PACKED_MATERIAL)
    for field, values in zip(Material._fields, zip(*materials, strict=True), strict=True):
        packed[field] = values
    for colour in COLOURS:
        packed[colour] **= 2
    packed["is_perforated"] = np.isin(packed["pattern"], PERFORATED_PATTERNS)
    packed["photo"] = -1
    return packed
