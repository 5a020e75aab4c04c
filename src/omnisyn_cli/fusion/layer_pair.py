"""The two layers of a frame, shaded a tile of rows at a time, and what happens to their colours before blending.

The order of the steps: each layer shades its rows and matches their exposure (:mod:`omnisyn_cli.fusion.photometry`);
confidence is judged from both; ghosts are suppressed (:mod:`omnisyn_cli.fusion.ghosts`). Then the fuser blends.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.fusion.ghosts import GhostSuppression
from omnisyn_cli.types import ColourStep, EdgePixels, EdgeSamples, Layer

Array = Any  # numpy.ndarray or torch.Tensor

TILE_ROWS = 32  # rows that are shaded and blended together; even, because hole filling halves them. Set by hand.


@dataclass(frozen=True)
class LayerPair:
    """Both layers of a frame, and the steps that change or judge their colours before they are blended, in order."""

    first: Layer
    second: Layer
    steps: tuple[ColourStep, ...] = ()

    def with_step(self, step: ColourStep | None) -> "LayerPair":
        """The pair with one more step, unless that is None."""
        return self if step is None else replace(self, steps=(*self.steps, step))

    def shade_rows(self, top: int, bottom: int, out: Float32[Array, "views rows width 4"]) -> None:
        """Write the colours of rows ``top`` to ``bottom`` of both layers, ready to be blended."""
        self.first.colour_rows(top, bottom, out[0])
        self.second.colour_rows(top, bottom, out[1])
        for step in self.steps:
            step(out[0], out[1], top)

    @property
    def has_edge_samples(self) -> bool:
        """Whether both layers can be supersampled."""
        return self.first.edge_samples is not None and self.second.edge_samples is not None

    def edge_samples(self, of_first: EdgePixels, of_second: EdgePixels) -> tuple[EdgeSamples, EdgeSamples]:
        """Samples of edge pixels in both layers, ready to be blended; ValueError: see :attr:`has_edge_samples`."""
        if self.first.edge_samples is None or self.second.edge_samples is None:
            raise ValueError("expected layers with edge samples, got others; ask has_edge_samples first")
        first, second = self.first.edge_samples(of_first), self.second.edge_samples(of_second)
        for step in self.steps:
            if isinstance(step, GhostSuppression):
                step.apply_to_edges(first[1], second[1], of_first)
        return first, second


class LayerPairShader:
    """Shades a layer pair tile by tile on several threads. Its buffers are reused from frame to frame."""

    def __init__(self, size: tuple[int, int], threads: int | None = None) -> None:
        self.size, self.threads = size, threads
        self._scratch: list[np.ndarray] = []
        self._cached_colours: np.ndarray | None = None

    def __call__(
        self, layers: LayerPair, use: Callable[[int, int, np.ndarray, np.ndarray], None],
        boundaries: Sequence[int] | None = None,
    ) -> None:  # fmt: skip
        """Call ``use``, on several threads, with first row, row after the last and both colours of each tile."""
        tiles = list(pairwise([*range(0, self.size[0], TILE_ROWS), self.size[0]] if boundaries is None else boundaries))
        tallest = max(bottom - top for top, bottom in tiles)

        def run(begin: int, end: int) -> None:
            scratch = self._take_scratch(tallest)
            for top, bottom in tiles[begin:end]:
                layers.shade_rows(top, bottom, scratch[:, : bottom - top])
                use(top, bottom, scratch[0, : bottom - top], scratch[1, : bottom - top])
            self._scratch.append(scratch)

        run_ranges(run, len(tiles), self.threads)

    def with_cached_colours(self, first: Layer, second: Layer) -> tuple[Layer, Layer]:
        """Both layers with all of their colours shaded, for callers that read them more than once."""
        if first.cached_colour is not None and second.cached_colour is not None:
            return first, second
        if self._cached_colours is None:
            self._cached_colours = np.empty((2, *self.size, 4), np.float32)
        for layer, colour in zip((first, second), self._cached_colours, strict=True):
            run_ranges(lambda begin, end: layer.colour_rows(begin, end, colour[begin:end]), len(colour), self.threads)  # noqa: B023
        cached_first, cached_second = (
            replace(
                Layer.from_arrays(layer.inverse_depth, colour, layer.target_from_source),
                edge_samples=layer.edge_samples,
                source_sampler=layer.source_sampler,
            )
            for layer, colour in zip((first, second), self._cached_colours, strict=True)
        )
        return cached_first, cached_second

    def _take_scratch(self, rows: int) -> Float32[np.ndarray, "views rows width 4"]:
        """A buffer for one thread; too small ones are dropped."""
        while self._scratch:
            scratch = self._scratch.pop()
            if scratch.shape[1] >= rows:
                return scratch
        return np.empty((2, rows, self.size[1], 4), np.float32)
