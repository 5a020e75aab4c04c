"""Two renderings of a frame, some rows at a time: what is done to their colours before they are blended, in order.

A rendering gives its colours, exposed by then (:mod:`omnisyn_cli.fusion.photometry`). Confidence is judged by what both
show; then ghosts are suppressed (:mod:`omnisyn_cli.fusion.ghosts`). What is left is blended, and stored.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.compute.threads import run_bands
from omnisyn_cli.fusion.ghosts import GhostSuppression
from omnisyn_cli.types import ColourStep, EdgePixels, EdgeSamples, Layer

__all__ = ["ROWS", "LayerPair"]

Array = Any  # numpy.ndarray or torch.Tensor

ROWS = 32
"""Of a band: that are coloured and blended together; an even number."""


@dataclass(frozen=True)
class LayerPair:
    """Both renderings of a frame.

    Attributes:
        first: of the first view.
        second: of the second view.
        steps: what changes or judges the colours of both before they are blended, in order.
    """

    first: Layer
    second: Layer
    steps: tuple[ColourStep, ...] = ()

    def then(self, step: ColourStep | None) -> LayerPair:
        """With one step more, if there is one."""
        return self if step is None else replace(self, steps=(*self.steps, step))

    def colour(self, top: int, bottom: int, out: Float32[Array, "views rows width 4"]) -> None:
        """Write the colours of rows ``top`` to ``bottom`` of both, as they are blended."""
        self.first.colour_rows(top, bottom, out[0])
        self.second.colour_rows(top, bottom, out[1])
        for step in self.steps:
            step(out[0], out[1], top)

    @property
    def has_edge_samples(self) -> bool:
        """Whether pixels of both have samples."""
        return self.first.samples is not None and self.second.samples is not None

    def samples(self, of_first: EdgePixels, of_second: EdgePixels) -> tuple[EdgeSamples, EdgeSamples]:
        """Of both, as they are blended; ValueError where there are none. The spots are the same ones."""
        if self.first.samples is None or self.second.samples is None:
            raise ValueError("expected renderings with samples, got others; ask has_edge_samples first")
        first, second = self.first.samples(of_first), self.second.samples(of_second)
        for step in self.steps:
            if isinstance(step, GhostSuppression):
                step.of_samples(first[1], second[1], of_first)
        return first, second


class RowTileRunner:
    """Memory for the colours of bands, one for each thread, and of whole pictures; reused from frame to frame."""

    def __init__(self, size: tuple[int, int], threads: int | None = None) -> None:
        self.size, self.threads = size, threads
        self._rooms: list[np.ndarray] = []
        self._held: np.ndarray | None = None

    def __call__(
        self, views: LayerPair, use: Callable[[int, int, np.ndarray, np.ndarray], None], edges: Sequence[int] | None = None
    ) -> None:
        """Call ``use`` with first row, row after the last and both views' colours ``(rows, width, 4)``, for all bands.

        Args:
            views: what is coloured.
            use: called from several threads.
            edges: first rows of bands and, last, the height; by default every :data:`ROWS` rows.
        """
        between = list(pairwise([*range(0, self.size[0], ROWS), self.size[0]] if edges is None else edges))
        most = max(bottom - top for top, bottom in between)

        def some(begin: int, end: int) -> None:
            room = self._room(most)
            for top, bottom in between[begin:end]:
                views.colour(top, bottom, room[:, : bottom - top])
                use(top, bottom, room[0, : bottom - top], room[1, : bottom - top])
            self._rooms.append(room)

        run_bands(some, len(between), self.threads)

    def held(self, first: Layer, second: Layer) -> tuple[Layer, Layer]:
        """Both with all of their colours at hand, for whoever looks at them more than once."""
        if first.held is not None and second.held is not None:
            return first, second
        if self._held is None:
            self._held = np.empty((2, *self.size, 4), np.float32)
        for view, colour in zip((first, second), self._held, strict=True):
            run_bands(lambda begin, end: view.colour_rows(begin, end, colour[begin:end]), len(colour), self.threads)  # noqa: B023
        one, other = (
            replace(
                Layer.from_arrays(view.inverse_depth, colour, view.target_from_source),
                samples=view.samples,
                source_sampler=view.source_sampler,
            )
            for view, colour in zip((first, second), self._held, strict=True)
        )
        return one, other

    def _room(self, rows: int) -> Float32[np.ndarray, "views rows width 4"]:
        """Used by one thread at a time."""
        while self._rooms:
            room = self._rooms.pop()
            if room.shape[1] >= rows:
                return room
        return np.empty((2, rows, self.size[1], 4), np.float32)
