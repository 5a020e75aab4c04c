"""Fusion as in the paper: a network paints every pixel of the picture from two renderings and what they show at all.

The network sees the frame at its own size, up to :data:`MOST_ROWS`; larger frames are painted at that size and
enlarged. Nothing here knows which view is nearer, how far the way is or which surface is in front: that is left to the
network, as the authors leave it. It paints from the first frame after a photograph to the last before the next.

Source: OmniSyn, section 3.5.
"""

from __future__ import annotations

from typing import Protocol

import cv2
import numpy as np
from jaxtyping import Float32

from omnisyn_cli.fusion.geometric import GeometricFuser, is_in_place
from omnisyn_cli.fusion.network import working_size
from omnisyn_cli.fusion.network_kernels import reduce_rows
from omnisyn_cli.geometry.border import add_border
from omnisyn_cli.geometry.sphere import direction_to_pixel, pixel_directions
from omnisyn_cli.threads import run_bands
from omnisyn_cli.types import UNSEEN, Rendering

__all__ = ["MOST_ROWS", "MULTIPLE", "Painter", "PaintingFuser"]

MOST_ROWS = 1024
"""Of a picture that is painted: the network's own memory grows with it."""

MULTIPLE = 64
"""It halves its input six times."""

PLANES = 8
"""Colours of the first and of the second view, and whether each of them shows anything."""

BORDER = 2
"""Pixels from over the seam and the poles that interpolation may reach for."""


class Painter(Protocol):
    """A trained network that paints, however it is run."""

    def __call__(self, planes: Float32[np.ndarray, "8 height width"]) -> Float32[np.ndarray, "3 height width"]:
        """The picture; planes are both views' colours in [0, 1], 0 where nothing is seen, and 1 where something is."""
        ...


class PaintingFuser(GeometricFuser):
    """Paints; implements :class:`omnisyn_cli.types.Fuser`. Not shared between threads.

    Args:
        size: height and width of the frames; where they are lower than :data:`MULTIPLE` the fusion is geometric.
        painter: the network.
        threads: at most this many; None is one per core.
    """

    def __init__(self, size: tuple[int, int], painter: Painter, threads: int | None = None) -> None:
        super().__init__(size, threads=threads)
        self._painter = painter
        self._small = working_size(size, MOST_ROWS, MULTIPLE)
        self._maps = None if self._small is None or self._small == size else _maps(self._small, size)

    def __call__(self, first: Rendering, second: Rendering, t: float) -> Float32[np.ndarray, "height width 3"]:
        """The painted picture in [0, 1]; the next call overwrites it.

        Raises:
            InputError: the network does not take the planes, or answers something else.
        """
        if self._small is None or is_in_place(first, second):
            return super().__call__(first, second, t)
        painted = self._painter(self._planes(first, second, self._small)).transpose(1, 2, 0)
        if self._maps is not None:
            painted = _enlarged(painted, *self._maps)
        np.clip(painted, 0.0, 1.0, out=self._image)
        return self._image

    def takes_rows(self) -> bool:
        """No: the network looks at whole renderings."""
        return False

    def _planes(
        self, first: Rendering, second: Rendering, size: tuple[int, int]
    ) -> Float32[np.ndarray, "8 height width"]:
        planes = np.empty((PLANES, *size), np.float32)
        for index, view in enumerate((first, second)):
            colour, inverse_depth = np.zeros((*size, 4), np.float32), np.empty(size, np.float32)
            _reduce(view, colour, inverse_depth, self.threads)
            planes[3 * index : 3 * index + 3] = colour[..., :3].transpose(2, 0, 1)
            planes[6 + index] = colour[..., 3] > UNSEEN
        return planes


def _reduce(view: Rendering, colour: np.ndarray, inverse_depth: np.ndarray, threads: int | None) -> None:
    def band(begin: int, end: int) -> None:
        reduce_rows(view.colour, view.inverse_depth, colour, inverse_depth, begin, end)

    run_bands(band, len(colour), threads)


def _maps(source: tuple[int, int], size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of a bordered picture that the pixels of one of another size lie at."""
    row, col = direction_to_pixel(pixel_directions(*size), source)
    return (row + BORDER).astype(np.float32), (col + BORDER).astype(np.float32)


def _enlarged(
    picture: Float32[np.ndarray, "rows cols 3"], row: np.ndarray, col: np.ndarray
) -> Float32[np.ndarray, "height width 3"]:
    return np.asarray(cv2.remap(add_border(picture, BORDER), col, row, cv2.INTER_LINEAR), np.float32)
