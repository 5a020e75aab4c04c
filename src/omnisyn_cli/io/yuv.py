# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""RGB pictures as the planes that encoders work on: BT.709 in limited range, one chroma sample for four pixels.

A chroma sample lies where players take it to be if a stream says nothing: in the column of every other pixel, half way
between two rows. It is the mean of both rows over that column and, with half the weight, the ones beside it; columns
wrap around. ffmpeg would do the same, several times slower and from twice as many bytes.

Sources: Recommendation ITU-R BT.709-6, items 3.2 to 3.4 and 4.6; Recommendation ITU-T H.264, section 6.2 (4:2:0) and
figure E-1 (type 0).
"""

import numpy as np
from jaxtyping import UInt8

from omnisyn_cli.compute.arrays import empty
from omnisyn_cli.compute.jit import fast_kernel, fast_subkernel

RED, GREEN, BLUE = 0.2126, 0.7152, 0.0722  # weights of the channels in luma (BT.709-6, item 3.2)
BLACK_LUMA, LUMA_RANGE = 16.0, 219.0  # 8-bit code of black, and how far above it white is (limited range)
NEUTRAL_CHROMA, CHROMA_RANGE = 128.0, 224.0  # 8-bit code of grey, and the range of the colour differences around it
ROUNDING = 0.5  # added before a code is truncated to an integer, so that it is rounded
PIXELS_PER_RUN = 512  # pixels of two rows that are converted together: their sums (6 KiB) stay in the L1 cache
STRIDE = PIXELS_PER_RUN + 1  # chroma sums of a channel: that of the column before the run, then those of the run
TWO = np.float32(2.0)  # typed, because a plain 2 would widen the products to 64 bits


def _luma_weights(of_channels: np.ndarray) -> tuple[np.float32, np.float32, np.float32]:
    red, green, blue = of_channels.astype(np.float32)
    return red, green, blue


def _chroma_shares(axis: int) -> tuple[np.float32, np.float32, np.float32]:
    """What a sample of each channel adds to the code of blue (2) or red (0) difference; weights sum up to eight."""
    luma = np.array((RED, GREEN, BLUE))
    return _luma_weights((np.eye(3)[axis] - luma) * (0.5 * CHROMA_RANGE / 255.0 / (1.0 - luma[axis]) / 8.0))


YR, YG, YB = _luma_weights(np.array((RED, GREEN, BLUE)) * LUMA_RANGE / 255.0)
UR, UG, UB = _chroma_shares(2)
VR, VG, VB = _chroma_shares(0)
LUMA_ZERO, CHROMA_ZERO = np.float32(BLACK_LUMA + ROUNDING), np.float32(NEUTRAL_CHROMA + ROUNDING)
"""Weights of red, green and blue in luma (Y) and in the differences of blue (U) and red (V), then their zeros."""


class PlanarFrames:
    """Memory for one converted frame, used again for the next."""

    def __init__(self, size: tuple[int, int]) -> None:
        height, width = size
        self._samples = np.empty(height * width * 3 // 2, np.uint8)
        luma, blue, red = np.split(self._samples, (height * width, height * width * 5 // 4))
        self._luma = luma.reshape(height, width)
        self._chroma = tuple(plane.reshape(height // 2, width // 2) for plane in (blue, red))

    def __call__(self, frame: UInt8[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, " samples"]:
        """Luma, blue and red difference of a contiguous RGB frame of even size; the next call overwrites them."""
        _convert_rows(frame, self._luma, *self._chroma)
        return self._samples


@fast_kernel()
def _convert_rows(rgb, luma, blue, red):
    """Rows of the chroma planes and the two rows of luma for each."""
    width = luma.shape[1]
    sums, flat = empty(3 * STRIDE, np.float32), rgb.reshape(-1)
    for row in range(len(blue)):
        upper, lower = 6 * row * width, (6 * row + 3) * width
        for k in range(3):  # the column before the first is the last one
            last = 3 * (width - 1) + k
            sums[k * STRIDE] = np.float32(flat[upper + last]) + np.float32(flat[lower + last])
        for left in range(0, width, PIXELS_PER_RUN):
            right = min(left + PIXELS_PER_RUN, width)
            for k in range(3):
                sums[k * STRIDE + 1 : (k + 1) * STRIDE] = 0.0
            _add_chroma_sums(flat[upper + 3 * left : upper + 3 * right], luma[2 * row, left:right], sums)
            _add_chroma_sums(flat[lower + 3 * left : lower + 3 * right], luma[2 * row + 1, left:right], sums)
            _write_chroma(sums, blue[row, left // 2 : right // 2], red[row, left // 2 : right // 2])
            for k in range(3):
                sums[k * STRIDE] = sums[k * STRIDE + right - left]


@fast_subkernel()
def _add_chroma_sums(rgb, luma, sums):
    """Luma of a run of pixels, three samples each; they are added to ``sums``, channel after channel."""
    for col in range(len(luma)):
        r, g, b = np.float32(rgb[3 * col]), np.float32(rgb[3 * col + 1]), np.float32(rgb[3 * col + 2])
        luma[col] = np.uint8(np.int32(YR * r + YG * g + YB * b + LUMA_ZERO))
        sums[1 + col] += r
        sums[STRIDE + 1 + col] += g
        sums[2 * STRIDE + 1 + col] += b


@fast_subkernel()
def _write_chroma(sums, blue, red):
    """Chroma of every other pixel, of the columns beside it and of both rows; the first sum is of the column before."""
    for col in range(len(blue)):
        before, at, after = 2 * col, 2 * col + 1, 2 * col + 2
        r = sums[before] + TWO * sums[at] + sums[after]
        g = sums[STRIDE + before] + TWO * sums[STRIDE + at] + sums[STRIDE + after]
        b = sums[2 * STRIDE + before] + TWO * sums[2 * STRIDE + at] + sums[2 * STRIDE + after]
        blue[col] = np.uint8(np.int32(UR * r + UG * g + UB * b + CHROMA_ZERO))
        red[col] = np.uint8(np.int32(VR * r + VG * g + VB * b + CHROMA_ZERO))
