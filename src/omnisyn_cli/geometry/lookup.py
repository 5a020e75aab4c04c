"""Reading equirectangular images at the same directions many times, by OpenCV: fast, to 1/32 of a pixel."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, Shaped

from omnisyn_cli.geometry.sampling import add_border
from omnisyn_cli.geometry.sphere import direction_to_pixel

__all__ = ["MOST_COLUMNS", "Lookup"]

BORDER = 3
"""Pixels from over the seam and the poles that interpolation may reach for."""

MOST_COLUMNS = 32766 - 2 * BORDER
"""Of an image: OpenCV looks up no more."""


@dataclass(frozen=True)
class Lookup:
    """Places in an equirectangular image, across the seam and over the poles.

    Attributes:
        row, col: fractional indices of the image with its border.
    """

    row: Float32[np.ndarray, "height width"]
    col: Float32[np.ndarray, "height width"]

    @staticmethod
    def along(directions: Float[np.ndarray, "height width 3"], size: tuple[int, ...]) -> "Lookup":
        """Where images of a size show some directions, in their own frame and of any length."""
        row, col = direction_to_pixel(directions, (size[0], size[1]))
        return Lookup(np.asarray(row + BORDER, np.float32), np.asarray(col + BORDER, np.float32))

    def nearest(self, image: Shaped[np.ndarray, "rows cols *channels"]) -> Shaped[np.ndarray, "height width ..."]:
        """The pixels that lie nearest; numbers, or a mask."""
        return self._read(image, cv2.INTER_NEAREST)

    def bilinear(self, image: Shaped[np.ndarray, "rows cols *channels"]) -> Shaped[np.ndarray, "height width ..."]:
        """Interpolated between four pixels."""
        return self._read(image, cv2.INTER_LINEAR)

    def bicubic(self, image: Shaped[np.ndarray, "rows cols *channels"]) -> Shaped[np.ndarray, "height width ..."]:
        """Interpolated between sixteen pixels, sharper than by Catmull and Rom; numbers may over- and undershoot."""
        return self._read(image, cv2.INTER_CUBIC)

    def _read(self, image: np.ndarray, interpolation: int) -> np.ndarray:
        if image.dtype == np.bool_:
            return self._read(image.view(np.uint8), interpolation).view(np.bool_)
        return np.asarray(cv2.remap(add_border(image, BORDER), self.col, self.row, interpolation))
