"""Renderings that can be asked what else their photographs show."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from omnisyn_cli.types import Layer, SourceSampler


def plain_sampler(colour: float = 0.5) -> SourceSampler:
    """A photograph of one colour, whose surface is wherever somebody supposes it."""

    def paint(points: np.ndarray, top: int, out: np.ndarray) -> None:
        out[:] = np.where(points[..., None] >= 0.0, np.float32([colour, colour, colour, 1.0]), np.float32(0.0))

    def whole(points: np.ndarray) -> np.ndarray:
        out = np.empty((*points.shape, 4), np.float32)
        paint(points, 0, out)
        return out

    return SourceSampler(paint, whole, lambda points, least: np.zeros_like(points))


def asked(view: Layer, colour: float = 0.5) -> Layer:
    """With such a sampler."""
    return replace(view, source_sampler=plain_sampler(colour))


def neighbours(values: np.ndarray) -> Iterator[np.ndarray]:
    """Of every pixel the one above, below, on the left and on the right; columns wrap, rows end."""
    for step, axis in ((1, 0), (-1, 0), (1, 1), (-1, 1)):
        moved = np.roll(values, step, axis)
        if axis == 0:
            moved[0 if step > 0 else -1] = values[0 if step > 0 else -1]
        yield moved
