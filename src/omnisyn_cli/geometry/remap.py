"""Reading equirectangular images at the same directions many times, by OpenCV: fast, to 1/32 of a pixel."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, Shaped

from omnisyn_cli.geometry.sampling import add_border
from omnisyn_cli.geometry.sphere import direction_to_pixel

# Pixels added across the seam and the poles: bicubic interpolation reaches for at most two, and one is spare.
BORDER_PIXELS = 3
# Widest image that OpenCV's ``remap`` takes: its indices have 16 bits with a sign.
MAX_REMAP_COLUMNS = 32766 - 2 * BORDER_PIXELS


@dataclass(frozen=True)
class RemapTable:
    """A remap table: places in an equirectangular image, across the seam and over the poles."""

    # fractional indices of the image with its border
    row: Float32[np.ndarray, "height width"]
    col: Float32[np.ndarray, "height width"]

    @staticmethod
    def for_directions(directions: Float[np.ndarray, "height width 3"], size: tuple[int, ...]) -> "RemapTable":
        """The table for images of a size, given directions of any length in their frame."""
        row, col = direction_to_pixel(directions, (size[0], size[1]))
        return RemapTable(np.asarray(row + BORDER_PIXELS, np.float32), np.asarray(col + BORDER_PIXELS, np.float32))

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
        return np.asarray(cv2.remap(add_border(image, BORDER_PIXELS), self.col, self.row, interpolation))
