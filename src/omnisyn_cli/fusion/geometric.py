"""Fusion without a network: a soft choice per pixel, then the holes are filled from their far side.

How much a view counts for a pixel is said in :mod:`omnisyn_cli.fusion.blend_rule`. Things that moved between the photographs
are shown by one of the views alone (:mod:`omnisyn_cli.fusion.ghosts`).
"""

import numpy as np
from jaxtyping import Float32, Shaped

from omnisyn_cli.fusion.blend_kernels import (
    LayerRows,
    Tables,
    blend_rows,
    offset_of,
    quantization_for,
    rule_of,
)
from omnisyn_cli.fusion.blend_rule import BlendOptions, BlendRule
from omnisyn_cli.fusion.confidence import confidence_step
from omnisyn_cli.fusion.fill import HoleFiller
from omnisyn_cli.fusion.ghosts import GhostRemover, have_same_position
from omnisyn_cli.fusion.layer_pair import ROWS, LayerPair, RowTileRunner
from omnisyn_cli.fusion.supersampling import EdgeSupersampler
from omnisyn_cli.geometry.sphere import direction_tables
from omnisyn_cli.types import ColourStep, Layer

__all__ = ["ROWS", "GeometricFuser"]

Picture = Shaped[np.ndarray, "height width 3"]
Confidence = Float32[np.ndarray, "height width"]


class GeometricFuser:
    """Blends the renderings of two views; implements :class:`omnisyn_cli.types.Fuser`. Not shared between threads.

    Args:
        size: height and width of the frames.
        options: of the rule.
        threads: at most this many; None is one per core.
        edges: whether pixels at edges are means of samples, see :mod:`omnisyn_cli.fusion.supersampling`, where renderings have
            some.

    Attributes:
        bands: runs through those of both renderings.
        is_seen: of the last picture that was painted: 0 in holes, else 1.
    """

    def __init__(
        self, size: tuple[int, int], options: BlendOptions | None = None, threads: int | None = None, *,
        edges: bool = True,
    ) -> None:  # fmt: skip
        self.size, self.options, self.threads = size, options or BlendOptions(), threads
        self._edges = EdgeSupersampler(size, threads) if edges else None
        self.bands, self.is_seen = RowTileRunner(size, threads), np.empty(size, np.uint8)
        self._tables = Tables(*(table.astype(np.float32) for table in direction_tables(*size)))
        self._ghosts, self._filler = GhostRemover(size, threads=threads), HoleFiller(size, threads)
        self._image: np.ndarray | None = None

    def __call__(
        self, first: Layer, second: Layer, t: float, out: Picture | None = None,
        confidence: Confidence | None = None,
    ) -> Picture:  # fmt: skip
        """The fused picture, every pixel of it filled, never negative; see :class:`omnisyn_cli.types.Fuser`."""
        out, rule = self._memory(out), BlendRule.at(t, self.options)
        if self._ghosts.is_full_resolution:
            first, second = self.bands.held(first, second)
        self.paint(self._judged(first, second, confidence).then(self._suppression(first, second, rule)), rule, out)
        return out

    def paint(self, views: LayerPair, rule: BlendRule, out: Picture) -> None:
        """Blend two renderings and fill the holes.

        Args:
            views: both, and what is done to their colours.
            rule: how they are blended.
            out: written: numbers >= 0, or samples.
        """
        offsets, (sin_p, cos_p, sin_a, cos_a) = [offset_of(view) for view in (views.first, views.second)], self._tables
        storing, numbers, (colours, weights) = quantization_for(out), rule_of(rule), self._filler.half

        def blend(top: int, bottom: int, first: np.ndarray, second: np.ndarray) -> None:
            rows, pairs = slice(top, bottom), slice(top // 2, (bottom + 1) // 2)
            blend_rows(
                LayerRows(first, views.first.inverse_depth[rows], offsets[0]),
                LayerRows(second, views.second.inverse_depth[rows], offsets[1]),
                numbers, Tables(sin_p[rows], cos_p[rows], sin_a, cos_a), storing,
                out[rows], self.is_seen[rows], colours[pairs], weights[pairs],
            )  # fmt: skip

        self.bands(views, blend)
        self._filler.fill(out, self.is_seen)
        if self._edges is not None and views.has_edge_samples:
            self._edges(views, rule, out)

    def _suppression(self, first: Layer, second: Layer, rule: BlendRule) -> ColourStep | None:
        """What suppresses ghosts, where there are any."""
        return None if have_same_position(first, second) else self._ghosts(first, second, rule)

    def _judged(self, first: Layer, second: Layer, confidence: Confidence | None) -> LayerPair:
        """Both renderings, their confidence to be written on the way if it is asked for."""
        if confidence is None:
            return LayerPair(first, second)
        return LayerPair(first, second).then(confidence_step(first.inverse_depth, second.inverse_depth, confidence))

    def _memory(self, out: Picture | None) -> Picture:
        """Where the picture goes."""
        if out is not None:
            return out
        if self._image is None:
            self._image = np.empty((*self.size, 3), np.float32)
        return self._image
