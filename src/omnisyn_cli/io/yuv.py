# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""RGB pictures as the planes that encoders work on: BT.709 in limited range, one chroma sample for four pixels.

ffmpeg would do the same, several times slower and from twice as many bytes.

Sources: Recommendation ITU-R BT.709-6, items 3.2 to 3.4 and 4.6; Recommendation ITU-T H.264, section 6.2 (4:2:0).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import UInt8

from omnisyn_cli.jit import fast_kernel

__all__ = ["PlanarFrames"]

RED, GREEN, BLUE = 0.2126, 0.7152, 0.0722
"""Shares of the channels in luma."""

BLACK, LUMA_RANGE = 16.0, 219.0
"""Code of black, and how far above it white is."""

GREY, CHROMA_RANGE = 128.0, 224.0

HALF = 0.5
"""Added before a number is cut to a whole one."""

RUN = 512
"""Pixels of two rows that are converted together: their sums stay in the nearest cache."""


def _luma_shares() -> tuple[np.float32, np.float32, np.float32]:
    """What a sample of each channel adds to the code of luma."""
    red, green, blue = (np.float32(share * LUMA_RANGE / 255.0) for share in (RED, GREEN, BLUE))
    return red, green, blue


def _chroma_shares(axis: int) -> tuple[np.float32, np.float32, np.float32]:
    """What a sample of each channel, summed over four pixels, adds to the code of blue (2) or red (0) difference."""
    luma = np.array((RED, GREEN, BLUE))
    difference = (np.eye(3)[axis] - luma) * (0.5 * CHROMA_RANGE / 255.0 / (1.0 - luma[axis]) / 4.0)
    red, green, blue = (np.float32(share) for share in difference)
    return red, green, blue


YR, YG, YB = _luma_shares()
UR, UG, UB = _chroma_shares(2)
VR, VG, VB = _chroma_shares(0)
LUMA_ZERO, CHROMA_ZERO = np.float32(BLACK + HALF), np.float32(GREY + HALF)


class PlanarFrames:
    """Memory for one converted frame, used again for the next."""

    def __init__(self, size: tuple[int, int]) -> None:
        height, width = size
        self._samples = np.empty(height * width * 3 // 2, np.uint8)
        luma, blue, red = np.split(self._samples, (height * width, height * width * 5 // 4))
        self._luma = luma.reshape(height, width)
        self._chroma = tuple(plane.reshape(height // 2, width // 2) for plane in (blue, red))

    def __call__(self, frame: UInt8[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, " samples"]:
        """Luma, blue difference and red difference, one after the other; the next call overwrites them.

        Args:
            frame: RGB of the announced size, contiguous; height and width are even.
        """
        _convert_rows(frame, self._luma, *self._chroma, 0, len(frame) // 2)
        return self._samples


@fast_kernel()
def _convert_rows(rgb, luma, blue, red, begin, end):
    """Rows ``begin`` to ``end`` of the chroma planes and the two rows of luma for each."""
    width = luma.shape[1]
    sums, flat = np.empty(3 * RUN, np.float32), rgb.reshape(-1)
    for row in range(begin, end):
        for left in range(0, width, RUN):
            right = min(left + RUN, width)
            upper, lower = 6 * row * width, (6 * row + 3) * width
            _begin_sums(flat[upper + 3 * left : upper + 3 * right], luma[2 * row, left:right], sums)
            _end_sums(flat[lower + 3 * left : lower + 3 * right], luma[2 * row + 1, left:right], sums)
            _differences(sums, blue[row, left // 2 : right // 2], red[row, left // 2 : right // 2])


@fast_kernel()
def _begin_sums(rgb, luma, sums):
    """Luma of a run of pixels, three samples each; they are put into ``sums``, channel after channel."""
    for col in range(len(luma)):
        r, g, b = np.float32(rgb[3 * col]), np.float32(rgb[3 * col + 1]), np.float32(rgb[3 * col + 2])
        luma[col] = np.uint8(np.int32(YR * r + YG * g + YB * b + LUMA_ZERO))
        sums[col], sums[RUN + col], sums[2 * RUN + col] = r, g, b


@fast_kernel()
def _end_sums(rgb, luma, sums):
    """As :func:`_begin_sums`; the samples are added."""
    for col in range(len(luma)):
        r, g, b = np.float32(rgb[3 * col]), np.float32(rgb[3 * col + 1]), np.float32(rgb[3 * col + 2])
        luma[col] = np.uint8(np.int32(YR * r + YG * g + YB * b + LUMA_ZERO))
        sums[col] += r
        sums[RUN + col] += g
        sums[2 * RUN + col] += b


@fast_kernel()
def _differences(sums, blue, red):
    """Chroma of the mean colour of two by two pixels."""
    for col in range(len(blue)):
        r = sums[2 * col] + sums[2 * col + 1]
        g = sums[RUN + 2 * col] + sums[RUN + 2 * col + 1]
        b = sums[2 * RUN + 2 * col] + sums[2 * RUN + 2 * col + 1]
        blue[col] = np.uint8(np.int32(UR * r + UG * g + UB * b + CHROMA_ZERO))
        red[col] = np.uint8(np.int32(VR * r + VG * g + VB * b + CHROMA_ZERO))
