"""Both renderings of a frame brought to the exposure that belongs to its share of the way."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from omnisyn_cli.fusion.photometry.exposure_curve import ExposureCurve, srgb_to_linear
from omnisyn_cli.fusion.photometry.exposure_kernels import expose_rows
from omnisyn_cli.types import EdgePixels, EdgeSamples, Layer, SourceSampler

__all__ = ["CLIPPING", "MOST_LOSS"]

Array = Any  # numpy.ndarray or torch.Tensor

CLIPPING = np.float32(0.94)
"""Stored value from which on a channel may have been cut off: interpolation mixes the white with its surroundings."""

MOST_LOSS = 0.95
"""A colour that was cut off keeps a little of its weight, for where the other view sees nothing."""


def _change_numbers(table: np.ndarray, loss: np.float32) -> Callable[[np.ndarray], None]:
    return lambda colour: expose_rows(colour, table, loss, CLIPPING)


@dataclass(frozen=True)
class ExposureMatcher:
    """Gives the renderings of a pair one exposure; costs nothing where both were exposed alike.

    Attributes:
        curve: gain from the first view to the second.
        change: given a table, see :meth:`ExposureCurve.table`, and the share of its weight that a white pixel loses,
            answers what exposes colours in place; by default those of numpy.
    """

    curve: ExposureCurve
    change: Callable[[np.ndarray, np.float32], Callable[[Array], None]] = _change_numbers

    def __call__(self, first: Layer, second: Layer, t: float) -> tuple[Layer, Layer]:
        """Both renderings as they look at a share ``t`` of the way.

        A highlight that was cut off in the brighter picture is only a lower bound: once it is darkened it weighs less
        than what the other view shows there.
        """
        if self.curve.is_identity:
            return first, second
        exposed = [
            view if t == end else self._exposed(view, self.curve.table(t, of_second=end == 1))
            for view, end in ((first, 0), (second, 1))
        ]
        return exposed[0], exposed[1]

    def _exposed(self, view: Layer, table: np.ndarray) -> Layer:
        """A rendering whose colours go through a table when they are made."""
        change = self.change(table, clipped_weight_loss(table))

        def colour_rows(begin: int, end: int, out: Array) -> None:
            view.colour_rows(begin, end, out)
            change(out)

        def colour_grid(rows: np.ndarray, cols: np.ndarray) -> Array:
            colour = view.colour_grid(rows, cols)
            change(colour)
            return colour

        return replace(
            view, colour_rows=colour_rows, colour_grid=colour_grid, held=None,
            samples=None if view.samples is None else partial(_samples, view.samples, change),
            source_sampler=None if view.source_sampler is None else _exposed_sampler(view.source_sampler, change),
        )  # fmt: skip


def _samples(of_view: Callable[[EdgePixels], EdgeSamples], change: Callable[[Array], None], edge_pixels: EdgePixels) -> EdgeSamples:
    """Those of a view, exposed."""
    inverse_depth, colour = of_view(edge_pixels)
    change(colour)
    return inverse_depth, colour


def _exposed_sampler(source_sampler: SourceSampler, change: Callable[[Array], None]) -> SourceSampler:
    """One whose colours are exposed."""

    def colour_rows(inverse_depth: np.ndarray, top: int, out: np.ndarray) -> None:
        source_sampler.colour_rows(inverse_depth, top, out)
        change(out)

    def colour(inverse_depth: np.ndarray) -> np.ndarray:
        colours = source_sampler.colour(inverse_depth)
        change(colours)
        return colours

    return replace(source_sampler, colour_rows=colour_rows, colour=colour)


def clipped_weight_loss(table: Float[np.ndarray, "3 entries"]) -> np.float32:
    """Share of its weight that a white pixel loses when it goes through ``table``, see :meth:`ExposureCurve.table`."""
    white = float(srgb_to_linear(np.asarray(table[:, -1], np.float64)).min())
    return np.float32(min(MOST_LOSS, 1.0 - white**4))
