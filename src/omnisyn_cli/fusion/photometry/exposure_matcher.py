"""Both layers of a frame, brought to the exposure that belongs to its share of the way."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from omnisyn_cli.fusion.photometry.exposure_curve import ExposureCurve, srgb_to_linear
from omnisyn_cli.fusion.photometry.exposure_kernels import expose_rows
from omnisyn_cli.types import EdgePixels, EdgeSamples, Layer, SourceSampler

Array = Any  # numpy.ndarray or torch.Tensor

# sRGB value from which on a channel may be clipped: interpolation mixes white with what is near. Set by hand.
CLIPPING_SRGB = np.float32(0.94)
# Share of its weight that a clipped colour may lose; the rest fills where only it is seen. Set by hand.
MAX_CLIPPED_WEIGHT_LOSS = 0.95


@dataclass(frozen=True)
class ExposureMatcher:
    """Gives the layers of a pair one exposure; costs nothing where both were exposed alike."""

    curve: ExposureCurve  # gain from the first view to the second

    def __call__(self, first: Layer, second: Layer, t: float) -> tuple[Layer, Layer]:
        """Both layers as they look at a share ``t`` of the way.

        A clipped highlight in the brighter picture is only a lower bound. Once it is darkened, it weighs less than what
        the other layer shows there.
        """
        if self.curve.is_identity:
            return first, second
        exposed = [
            layer if t == end else self._expose(layer, self.curve.table(t, of_second=end == 1))
            for layer, end in ((first, 0), (second, 1))
        ]
        return exposed[0], exposed[1]

    def _expose(self, layer: Layer, table: np.ndarray) -> Layer:
        """A layer whose colours go through a table when they are shaded."""
        loss = clipped_weight_loss(table)

        def change(colour: np.ndarray) -> None:
            expose_rows(colour, table, loss, CLIPPING_SRGB)

        def colour_rows(begin: int, end: int, out: Array) -> None:
            layer.colour_rows(begin, end, out)
            change(out)

        return replace(
            layer, colour_rows=colour_rows, subsampled_colours=_exposed(layer.subsampled_colours, change),
            cached_colour=None,
            edge_samples=None if layer.edge_samples is None else partial(_exposed_samples, layer.edge_samples, change),
            source_sampler=None if layer.source_sampler is None else _exposed_sampler(layer.source_sampler, change),
        )  # fmt: skip


def _exposed(colours: Callable[..., Array], change: Callable[[Array], None]) -> Callable[..., Array]:
    """A function whose colours are exposed."""

    def exposed(*arguments: Any) -> Array:
        colour = colours(*arguments)
        change(colour)
        return colour

    return exposed


def _exposed_samples(
    edge_samples: Callable[[EdgePixels], EdgeSamples], change: Callable[[Array], None], edge_pixels: EdgePixels
) -> EdgeSamples:
    inverse_depth, colour = edge_samples(edge_pixels)
    change(colour)
    return inverse_depth, colour


def _exposed_sampler(sampler: SourceSampler, change: Callable[[Array], None]) -> SourceSampler:
    """A sampler whose colours are exposed."""

    def sample_rows(inverse_depth: np.ndarray, top: int, out: np.ndarray) -> None:
        sampler.sample_rows(inverse_depth, top, out)
        change(out)

    return replace(sampler, sample_rows=sample_rows, sample=_exposed(sampler.sample, change))


def clipped_weight_loss(table: Float[np.ndarray, "3 entries"]) -> np.float32:
    """Share of its weight that a white pixel loses when it goes through ``table``, see :meth:`ExposureCurve.table`.

    The more white is darkened, the less its clipped colour says: the weight falls with the fourth power of the light
    that white becomes, in the channel that is darkened most.
    """
    white = float(srgb_to_linear(np.asarray(table[:, -1], np.float64)).min())
    return np.float32(min(MAX_CLIPPED_WEIGHT_LOSS, 1.0 - white**4))
