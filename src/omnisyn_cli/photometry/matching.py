"""Both renderings of a frame brought to the exposure that belongs to its share of the way."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from omnisyn_cli.photometry.curve import ExposureCurve
from omnisyn_cli.photometry.kernels import expose_rows
from omnisyn_cli.photometry.transfer import linear_from_stored
from omnisyn_cli.threads import run_bands
from omnisyn_cli.types import Rendering, RowRendering

__all__ = ["CLIPPING", "ExposureMatcher", "loss_of_white"]

CLIPPING = np.float32(0.94)
"""Stored value from which on a channel may have been cut off: interpolation mixes the white with its surroundings."""

MOST_LOSS = 0.95
"""A colour that was cut off keeps a little of its worth, for where the other view sees nothing."""


@dataclass(frozen=True)
class ExposureMatcher:
    """Gives the renderings of a pair one exposure; costs nothing where both were exposed alike.

    Attributes:
        curve: gain from the first view to the second.
        threads: at most this many; None is one per core.
    """

    curve: ExposureCurve
    threads: int | None = None

    def __call__(self, first: Rendering, second: Rendering, t: float) -> None:
        """Change both renderings in place to what they look like at a share ``t`` of the way.

        A highlight that was cut off in the brighter picture is only a lower bound: once it is darkened it is worth less
        than what the other view shows there.
        """
        if self.curve.is_identity:
            return
        for view, end in ((first, 0), (second, 1)):
            if t != end:
                self._expose(view, self.curve.table(t, of_second=end == 1))

    def by_rows(self, first: RowRendering, second: RowRendering, t: float) -> tuple[RowRendering, RowRendering]:
        """Both renderings with colours as a call makes them."""
        if self.curve.is_identity:
            return first, second
        exposed = [
            view if t == end else _exposed(view, self.curve.table(t, of_second=end == 1))
            for view, end in ((first, 0), (second, 1))
        ]
        return exposed[0], exposed[1]

    def _expose(self, view: Rendering, table: np.ndarray) -> None:
        loss = loss_of_white(table)
        run_bands(
            lambda begin, end: expose_rows(view.colour, table, loss, CLIPPING, begin, end),
            len(view.colour),
            self.threads,
        )


def _exposed(view: RowRendering, table: np.ndarray) -> RowRendering:
    """A rendering whose colours go through a table when they are made."""
    loss = loss_of_white(table)

    def colour_rows(begin: int, end: int, out: np.ndarray) -> None:
        view.colour_rows(begin, end, out)
        expose_rows(out, table, loss, CLIPPING, 0, end - begin)

    def colour_at(rows: np.ndarray, cols: np.ndarray) -> np.ndarray:
        colour = view.colour_at(rows, cols)
        expose_rows(colour, table, loss, CLIPPING, 0, len(rows))
        return colour

    return replace(view, colour_rows=colour_rows, colour_at=colour_at)


def loss_of_white(table: Float[np.ndarray, "3 entries"]) -> np.float32:
    """Share of its worth that a white pixel loses when it goes through ``table``, see :meth:`ExposureCurve.table`."""
    white = float(linear_from_stored(np.asarray(table[:, -1], np.float64)).min())
    return np.float32(min(MOST_LOSS, 1.0 - white**4))
