"""Colours as they occur: plaster, brick, stone, wood, paint, cloth. sRGB in [0, 1]."""

from collections.abc import Sequence

import numpy as np

Colour = tuple[float, float, float]
Palette = Sequence[Colour]

PLASTER: Palette = (
    (0.86, 0.83, 0.76), (0.80, 0.74, 0.62), (0.74, 0.66, 0.55), (0.88, 0.87, 0.85), (0.70, 0.70, 0.68),
    (0.83, 0.72, 0.56), (0.72, 0.56, 0.46), (0.62, 0.64, 0.66), (0.76, 0.78, 0.74), (0.56, 0.52, 0.47),
    (0.80, 0.68, 0.62), (0.45, 0.44, 0.44),
)  # fmt: skip
BRICK: Palette = (
    (0.55, 0.31, 0.24), (0.62, 0.38, 0.28), (0.46, 0.28, 0.23), (0.66, 0.50, 0.38), (0.52, 0.42, 0.36),
    (0.72, 0.62, 0.48),
)  # fmt: skip
CONCRETE: Palette = ((0.60, 0.59, 0.57), (0.52, 0.52, 0.51), (0.67, 0.65, 0.61), (0.44, 0.44, 0.45), (0.72, 0.72, 0.71))
PAVING: Palette = (
    (0.55, 0.53, 0.50), (0.48, 0.45, 0.43), (0.63, 0.58, 0.52), (0.58, 0.47, 0.42), (0.42, 0.42, 0.43),
    (0.66, 0.64, 0.60),
)  # fmt: skip
ASPHALT: Palette = ((0.36, 0.36, 0.37), (0.44, 0.43, 0.42), (0.30, 0.30, 0.31), (0.50, 0.49, 0.47))
GLASS: Palette = ((0.20, 0.25, 0.30), (0.14, 0.17, 0.20), (0.28, 0.34, 0.38), (0.22, 0.27, 0.26), (0.33, 0.38, 0.43))
METAL: Palette = ((0.28, 0.29, 0.30), (0.45, 0.46, 0.47), (0.16, 0.17, 0.17), (0.60, 0.61, 0.62), (0.20, 0.26, 0.22))
WOOD: Palette = (
    (0.56, 0.40, 0.26), (0.43, 0.29, 0.19), (0.68, 0.53, 0.37), (0.30, 0.20, 0.14), (0.62, 0.45, 0.32),
    (0.75, 0.64, 0.50),
)  # fmt: skip
FOLIAGE: Palette = (
    (0.24, 0.36, 0.15), (0.31, 0.42, 0.17), (0.20, 0.31, 0.17), (0.38, 0.44, 0.20), (0.27, 0.33, 0.13),
    (0.47, 0.42, 0.17),
)  # fmt: skip
CAR: Palette = (
    (0.78, 0.78, 0.78), (0.12, 0.12, 0.13), (0.40, 0.41, 0.43), (0.88, 0.88, 0.87), (0.45, 0.10, 0.09),
    (0.12, 0.20, 0.36), (0.25, 0.28, 0.30), (0.58, 0.55, 0.48), (0.20, 0.30, 0.25), (0.70, 0.55, 0.15),
)  # fmt: skip
CLOTH: Palette = (
    (0.25, 0.27, 0.33), (0.45, 0.42, 0.40), (0.60, 0.56, 0.50), (0.33, 0.22, 0.20), (0.22, 0.30, 0.30),
    (0.50, 0.28, 0.24), (0.70, 0.66, 0.58), (0.28, 0.34, 0.46), (0.16, 0.16, 0.18), (0.52, 0.50, 0.36),
    (0.36, 0.42, 0.38), (0.62, 0.44, 0.26),
)  # fmt: skip
INTERIOR: Palette = (
    (0.90, 0.89, 0.86), (0.86, 0.83, 0.77), (0.80, 0.80, 0.80), (0.78, 0.74, 0.66), (0.72, 0.76, 0.76),
    (0.84, 0.78, 0.70), (0.62, 0.66, 0.62), (0.58, 0.62, 0.68), (0.70, 0.58, 0.50), (0.50, 0.26, 0.26),
    (0.93, 0.92, 0.91), (0.66, 0.60, 0.46),
)  # fmt: skip
SIGN: Palette = (
    (0.70, 0.12, 0.12), (0.12, 0.27, 0.55), (0.88, 0.72, 0.16), (0.15, 0.42, 0.25), (0.90, 0.90, 0.88),
    (0.14, 0.14, 0.15), (0.82, 0.42, 0.14), (0.45, 0.30, 0.48),
)  # fmt: skip


def pick(rng: np.random.Generator, palette: Palette, spread: float = 0.05) -> Colour:
    """Choose a colour and vary its lightness by ±2·spread and its hue by less."""
    red, green, blue = palette[int(rng.integers(len(palette)))]
    lightness = 1.0 + spread * rng.uniform(-2, 2)
    a, b, c = (0.3 * spread * rng.uniform(-1, 1) for _ in range(3))
    return _bounded(lightness * red + a), _bounded(lightness * green + b), _bounded(lightness * blue + c)


def _bounded(channel: float) -> float:
    return min(0.97, max(0.02, channel))


def scaled(colour: Colour, factor: float) -> Colour:
    """Scale a colour; above 1 it gets lighter."""
    return min(0.97, colour[0] * factor), min(0.97, colour[1] * factor), min(0.97, colour[2] * factor)


def mixed(first: Colour, second: Colour, share: float) -> Colour:
    """Blend two colours; ``share`` is that of the second."""
    a, b = 1.0 - share, share
    return a * first[0] + b * second[0], a * first[1] + b * second[1], a * first[2] + b * second[2]
