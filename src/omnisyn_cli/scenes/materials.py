"""Materials: a pattern of up to three colours, and how it takes the light. Or photographs, packed with mip levels.

A photograph takes the place of a material's colours. Tiled, it is mirrored at its edges, so that it goes on without a
seam; what repeats itself is hidden by noise on walls, and by patches that are turned on the ground.
"""

import math
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import cv2
import numpy as np
from jaxtyping import Int64, UInt8

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
# A material as kernels read it: colours are linear; for photographs see :class:`PhotoMapping`.
PACKED_MATERIAL = np.dtype([
    ("pattern", "i8"), *((name, "f8", 3) for name in COLOURS), ("cell", "f8", 2), ("line", "f8"), ("grain", "f8"),
    ("grain_size", "f8"), ("detail", "f8"), ("gloss", "f8"), ("glow", "f8"), ("seed", "i8"), ("is_perforated", "?"),
    ("photo", "i8"), ("photo_mapping", "i8"), ("photo_width", "f8"), ("photo_seed", "i8"), ("has_patches", "?"),
])  # fmt: skip


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


MIP_LEVELS = 12  # Levels that there is room for (textures up to 2¹¹ pixels); the last of a photograph is repeated
# Share of a scene's materials that become photographs: each scene draws its own in this range.
PHOTO_SHARE_RANGE = (0.3, 0.9)
MIN_PICTURE_SHARE = 0.85  # Share of the pictures on walls that become photographs at least; chosen by eye
GLASS_MIN_GLOSS = 0.8  # Gloss from which on a plain material is glass or a screen and keeps its colour


class PhotoMapping(IntEnum):
    """How a photograph is mapped onto a face."""

    TILED = 0  # mirrored at its edges, instead of the pattern
    UNDER = 1  # tiled, under the pattern: its second and third colour stay (windows, road markings)
    FITTED = 2  # once, cropped to the face; the pattern's third colour stays (a frame)


# By pattern: mappings, one of which is drawn, and the range of a photograph's width in metres, chosen by eye.
PHOTO_PLACEMENTS: Mapping[Pattern, tuple[tuple[PhotoMapping, ...], float, float]] = {
    Pattern.PLAIN: ((PhotoMapping.TILED,), 0.4, 4.0),
    Pattern.BRICK: ((PhotoMapping.TILED,), 0.8, 5.0),
    Pattern.TILES: ((PhotoMapping.TILED,), 0.6, 4.0),
    Pattern.CHECKER: ((PhotoMapping.TILED,), 0.6, 4.0),
    Pattern.PLANKS: ((PhotoMapping.TILED,), 0.5, 3.0),
    Pattern.FACADE: ((PhotoMapping.TILED, PhotoMapping.UNDER), 3.0, 14.0),
    Pattern.STRIPES: ((PhotoMapping.TILED,), 0.5, 3.0),
    Pattern.COLLAGE: ((PhotoMapping.FITTED,), 1.0, 1.0),
    Pattern.ROAD: ((PhotoMapping.UNDER,), 1.5, 8.0),
    Pattern.GRASS: ((PhotoMapping.TILED,), 1.0, 8.0),
    Pattern.WALLPAPER: ((PhotoMapping.TILED,), 0.5, 3.5),
    Pattern.PANELS: ((PhotoMapping.UNDER,), 0.6, 3.0),
    Pattern.RIBS: ((PhotoMapping.TILED,), 0.8, 4.0),
    Pattern.PICTURE: ((PhotoMapping.FITTED,), 1.0, 1.0),
    Pattern.RUG: ((PhotoMapping.FITTED, PhotoMapping.TILED), 0.5, 2.0),
}

GROUND_PATTERNS = (Pattern.ROAD, Pattern.GRASS)  # Patterns that lie on the ground whatever they belong to


class Photos(NamedTuple):
    """Photographs with their mip levels; a tuple, for the kernels.

    ``texels`` are those of all levels of all photographs, one after the other, row after row; sRGB. ``levels``: of each
    photograph and level, the first texel, height and width; level k is half of level k − 1.
    """

    texels: UInt8[np.ndarray, "texels 3"]
    levels: Int64[np.ndarray, "photos levels 3"]


NO_PHOTOS = Photos(np.zeros((1, 3), np.uint8), np.zeros((1, 1, 3), np.int64))  # Of scenes without


def pack_photos(images: Sequence[UInt8[np.ndarray, "height width 3"]]) -> Photos:
    """One photograph or more, of any sizes, averaged as light, which is the square of a sample."""
    texels, levels, first = [], [], 0
    for image in images:
        rows = []
        for level in _mip_levels(image):
            texels.append(level.reshape(-1, 3))
            rows.append((first, level.shape[0], level.shape[1]))
            first += level.shape[0] * level.shape[1]
        levels.append([*rows, *[rows[-1]] * (MIP_LEVELS - len(rows))])
    return Photos(np.concatenate(texels), np.array(levels, np.int64))


def _mip_levels(image: UInt8[np.ndarray, "height width 3"]) -> list[np.ndarray]:
    light = np.square(image.astype(np.float32) / np.float32(255.0))
    levels = [image]
    while max(light.shape[:2]) > 1 and len(levels) < MIP_LEVELS:
        size = (max(1, light.shape[1] // 2), max(1, light.shape[0] // 2))
        light = np.asarray(cv2.resize(light, size, interpolation=cv2.INTER_AREA)).reshape(size[1], size[0], 3)
        levels.append(np.rint(np.sqrt(light) * 255.0).astype(np.uint8))
    return levels


def with_photos(materials: np.ndarray, ground: int, photos: Photos, seed: int) -> np.ndarray:
    """Packed materials, some of which show photographs, by chance; ``ground`` is the row of that of the ground."""
    rng = np.random.default_rng([41, seed])
    share = rng.uniform(*PHOTO_SHARE_RANGE)
    materials = materials.copy()
    for row, material in enumerate(materials):
        pattern = Pattern(material["pattern"])
        chance, photo, draws = rng.random(), int(rng.integers(len(photos.levels))), rng.random(3)
        wanted_share = max(share, MIN_PICTURE_SHARE) if pattern == Pattern.PICTURE else share
        is_glass = material["gloss"] >= GLASS_MIN_GLOSS and pattern == Pattern.PLAIN
        if pattern not in PHOTO_PLACEMENTS or chance > wanted_share or is_glass or material["glow"] > 0.0:
            continue
        mappings, min_width, max_width = PHOTO_PLACEMENTS[pattern]
        material["photo"], material["photo_mapping"] = photo, mappings[int(draws[0] * len(mappings))]
        material["photo_width"] = min_width * math.exp(draws[1] * math.log(max_width / min_width))
        material["photo_seed"] = 1 + int(draws[2] * 1e4)
        material["has_patches"] = row == ground or pattern in GROUND_PATTERNS
    return materials
