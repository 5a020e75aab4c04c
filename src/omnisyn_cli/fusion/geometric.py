"""Geometric fusion: blending by rules, without a network; then holes are filled and edges supersampled.

The blend weights are in :mod:`omnisyn_cli.fusion.blend_rule`. Things that moved between the photographs come from one
of the layers alone (:mod:`omnisyn_cli.fusion.ghosts`).
"""

import numpy as np
from jaxtyping import Float32, Shaped

from omnisyn_cli.fusion.blend_kernels import LayerRows, blend_rows, kernel_rule, quantization_for, source_offset
from omnisyn_cli.fusion.blend_rule import BlendRule
from omnisyn_cli.fusion.confidence import confidence_step
from omnisyn_cli.fusion.fill import HoleFiller
from omnisyn_cli.fusion.ghosts import GhostRemover, have_same_position
from omnisyn_cli.fusion.layer_pair import TILE_ROWS, LayerPair, LayerPairShader
from omnisyn_cli.fusion.supersampling import EdgeSupersampler
from omnisyn_cli.types import DirectionTables, Layer

__all__ = ["TILE_ROWS", "Confidence", "GeometricFuser", "Picture"]

Picture = Shaped[np.ndarray, "height width 3"]
Confidence = Float32[np.ndarray, "height width"]


class GeometricFuser:
    """A :class:`omnisyn_cli.types.Fuser` that blends by rules and supersamples ``edges``. Not shared by threads."""

    def __init__(self, size: tuple[int, int], threads: int | None = None, *, edges: bool = True) -> None:
        self.size, self.threads = size, threads
        self._supersampler = EdgeSupersampler(size, threads) if edges else None
        self.tiles, self.is_seen = LayerPairShader(size, threads), np.empty(size, np.uint8)
        self._tables = DirectionTables.of_target(size)
        self.ghosts, self._filler = GhostRemover(size, threads=threads), HoleFiller(size, threads)
        self._picture: np.ndarray | None = None

    @property
    def supersamples(self) -> bool:
        """Whether edges are."""
        return self._supersampler is not None

    def twin(self, threads: int) -> "GeometricFuser":
        """One that makes the same frames in buffers of its own: for another thread."""
        return GeometricFuser(self.size, threads, edges=self.supersamples)

    def __call__(
        self, first: Layer, second: Layer, t: float, out: Picture | None = None, confidence: Confidence | None = None
    ) -> Picture:
        """The fused picture, without holes, never negative; see :class:`omnisyn_cli.types.Fuser`."""
        out, rule = self._output_buffer(out), BlendRule.at(t)
        if self.ghosts.is_full_resolution:
            first, second = self.tiles.with_cached_colours(first, second)
        layers = self._with_confidence(first, second, confidence)
        suppression = None if have_same_position(first, second) else self.ghosts(first, second, rule)
        self.blend(layers.with_step(suppression), rule, out)
        return out

    def blend_by_rule(
        self, first: Layer, second: Layer, t: float, out: Picture | None = None, confidence: Confidence | None = None
    ) -> Picture:
        """As a call, but by the blend rule alone: ghosts stay."""
        out = self._output_buffer(out)
        self.blend(self._with_confidence(first, second, confidence), BlendRule.at(t), out)
        return out

    def blend(self, layers: LayerPair, rule: BlendRule, out: Picture) -> None:
        """Blend two layers into float32 >= 0 or unsigned integers, fill the holes and supersample the edges."""
        offset_a, offset_b = (source_offset(layer) for layer in (layers.first, layers.second))
        quantization, scalars, (colours, weights) = quantization_for(out), kernel_rule(rule), self._filler.half

        def blend_tile(top: int, bottom: int, first: np.ndarray, second: np.ndarray) -> None:
            rows, halved = slice(top, bottom), slice(top // 2, (bottom + 1) // 2)
            blend_rows(
                LayerRows(first, layers.first.inverse_depth[rows], offset_a),
                LayerRows(second, layers.second.inverse_depth[rows], offset_b),
                scalars, self._tables.of_rows(rows), quantization,
                out[rows], self.is_seen[rows], colours[halved], weights[halved],
            )  # fmt: skip

        self.tiles(layers, blend_tile)
        self._filler.fill(out, self.is_seen)
        if self._supersampler is not None and layers.has_edge_samples:
            self._supersampler(layers, rule, out)

    def _with_confidence(self, first: Layer, second: Layer, confidence: Confidence | None) -> LayerPair:
        """Both layers, with the step that writes ``confidence`` if that is given."""
        if confidence is None:
            return LayerPair(first, second)
        step = confidence_step(first.inverse_depth, second.inverse_depth, confidence)
        return LayerPair(first, second).with_step(step)

    def _output_buffer(self, out: Picture | None) -> Picture:
        """The caller's buffer, or one that is reused from frame to frame."""
        if out is not None:
            return out
        if self._picture is None:
            self._picture = np.empty((*self.size, 3), np.float32)
        return self._picture
