"""Photographs as materials: packed with mip levels, and handed out to the materials of a scene.

A photograph takes the place of a material's colours. Tiled, it is mirrored at its edges, so that it goes on without a
seam; what repeats itself is hidden by noise on walls, and by patches that are turned on the ground.
"""

import math
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Int64, UInt8

from omnisyn_cli.scenes.materials import Pattern

MIP_LEVELS = 12  # Levels that there is room for (textures up to 2¹¹ pixels); the last of a photograph is repeated

PHOTO_SHARE_RANGE = (0.3, 0.9)
"""Share of a scene's materials that become photographs: each scene draws its own in this range."""

MIN_PICTURE_SHARE = 0.85  # Share of the pictures on walls that become photographs at least; chosen by eye
GLASS_MIN_GLOSS = 0.8  # Gloss from which on a plain material is glass or a screen and keeps its colour


class PhotoMapping(IntEnum):
    """How a photograph is mapped onto a face."""

    TILED = 0  # mirrored at its edges, instead of the pattern
    UNDER = 1  # tiled, under the pattern: its second and third colour stay (windows, road markings)
    FITTED = 2  # once, cropped to the face; the pattern's third colour stays (a frame)


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
"""By pattern: mappings, one of which is drawn, and the range of a photograph's width in metres, chosen by eye."""

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
    """Photographs of any sizes, averaged as light, with the scenes' own curve: light is the square of a sample.

    ValueError: there are none.
    """
    if not images:
        raise ValueError("expected at least one photograph, got none")
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
