"""Photographs as materials: packed with mip levels, and handed out to the materials of a scene.

A photograph takes the place of a material's colours. Tiled, it is mirrored at its edges, so that it goes on without a
seam; what repeats itself is hidden by noise on walls, and by patches that are turned on the ground.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import cv2
import numpy as np
from jaxtyping import Float, Int64, UInt8

from omnisyn_cli.scenes.materials import Column, Pattern
from omnisyn_cli.scenes.scene import Papering, Scene

LEVELS = 12
"""Mip levels that there is room for; the last of a photograph is repeated."""

SHARES = (0.3, 0.9)
"""Of a scene's materials that become photographs, between which a scene draws its own."""

PICTURES = 0.85
"""Share of the pictures on walls that do at least."""

GLASSY = 0.8
"""Gloss from which on a plain material is glass or a screen, and stays."""


class Use(IntEnum):
    """How a photograph lies on a face."""

    TILED = 0  # mirrored at its edges, instead of the pattern
    UNDER = 1  # tiled, under the pattern: its second and third colour stay (windows, road markings)
    FITTED = 2  # once, cropped to the face; the pattern's third colour stays (a frame)


SIZES: Mapping[Pattern, tuple[tuple[Use, ...], float, float]] = {
    Pattern.PLAIN: ((Use.TILED,), 0.4, 4.0),
    Pattern.BRICK: ((Use.TILED,), 0.8, 5.0),
    Pattern.TILES: ((Use.TILED,), 0.6, 4.0),
    Pattern.CHECKER: ((Use.TILED,), 0.6, 4.0),
    Pattern.PLANKS: ((Use.TILED,), 0.5, 3.0),
    Pattern.FACADE: ((Use.TILED, Use.UNDER), 3.0, 14.0),
    Pattern.STRIPES: ((Use.TILED,), 0.5, 3.0),
    Pattern.COLLAGE: ((Use.FITTED,), 1.0, 1.0),
    Pattern.ROAD: ((Use.UNDER,), 1.5, 8.0),
    Pattern.GRASS: ((Use.TILED,), 1.0, 8.0),
    Pattern.WALLPAPER: ((Use.TILED,), 0.5, 3.5),
    Pattern.PANELS: ((Use.UNDER,), 0.6, 3.0),
    Pattern.RIBS: ((Use.TILED,), 0.8, 4.0),
    Pattern.CARTON: ((Use.UNDER,), 0.3, 1.0),
    Pattern.PICTURE: ((Use.FITTED,), 1.0, 1.0),
    Pattern.RUG: ((Use.FITTED, Use.TILED), 0.5, 2.0),
}
"""Of a pattern: uses, one of which is drawn, and the least and the greatest width of a photograph in metres."""

GROUND = (Pattern.ROAD, Pattern.GRASS)
"""Patterns that lie on the ground whatever they belong to."""


@dataclass(frozen=True)
class Photos:
    """Photographs with their mip levels.

    Attributes:
        texels: of all levels of all photographs, one after the other, row after row; sRGB.
        levels: of each photograph and level, the first texel, height and width; level k is half of level k − 1.
    """

    texels: UInt8[np.ndarray, "texels 3"]
    levels: Int64[np.ndarray, "photos levels 3"]


def pack_photos(images: Sequence[UInt8[np.ndarray, "height width 3"]]) -> Photos:
    """Photographs of any sizes, averaged as light, with the scenes' own curve: light is the square of a sample.

    Raises:
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
        levels.append([*rows, *[rows[-1]] * (LEVELS - len(rows))])
    return Photos(np.concatenate(texels), np.array(levels, np.int64))


def _mip_levels(image: UInt8[np.ndarray, "height width 3"]) -> list[np.ndarray]:
    light = np.square(image.astype(np.float32) / np.float32(255.0))
    levels = [image]
    while max(light.shape[:2]) > 1 and len(levels) < LEVELS:
        size = (max(1, light.shape[1] // 2), max(1, light.shape[0] // 2))
        light = np.asarray(cv2.resize(light, size, interpolation=cv2.INTER_AREA)).reshape(size[1], size[0], 3)
        levels.append(np.rint(np.sqrt(light) * 255.0).astype(np.uint8))
    return levels


def with_photos(scene: Scene, photos: Photos, seed: int) -> Scene:
    """A scene some of whose materials are photographs, by chance; equal arguments give equal scenes."""
    rng = np.random.default_rng([41, seed])
    share = rng.uniform(*SHARES)
    chosen = np.zeros((len(scene.materials), 5))
    chosen[:, 0] = -1.0
    for row, material in enumerate(scene.materials):
        pattern = Pattern(int(material[Column.PATTERN]))
        chance, photo, numbers = rng.random(), int(rng.integers(len(photos.levels))), rng.random(3)
        likely = max(share, PICTURES) if pattern == Pattern.PICTURE else share
        if pattern not in SIZES or chance > likely or _shines(material):
            continue
        uses, least, greatest = SIZES[pattern]
        use = uses[int(numbers[0] * len(uses))]
        wide = least * math.exp(numbers[1] * math.log(greatest / least))
        chosen[row] = photo, use, wide, 1 + int(numbers[2] * 1e4), row == scene.ground_material or pattern in GROUND
    return replace(scene, papering=Papering(photos.texels, photos.levels, chosen))


def _shines(material: Float[np.ndarray, " columns"]) -> bool:
    """Whether a plain material is a lamp, glass or a screen."""
    is_glass = material[Column.GLOSS] >= GLASSY and material[Column.PATTERN] == Pattern.PLAIN
    return bool(is_glass or material[Column.GLOW] > 0.0)
