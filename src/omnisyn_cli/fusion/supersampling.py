"""Antialiased edges: pixels that show two surfaces are supersampled 2x2.

An *edge pixel* lies beside a depth discontinuity of either layer, and its colours differ from those around it. It
becomes the mean of four samples, the pixels of a picture of twice the size, each blended by the rule. They are a
twentieth of most pictures, and gain what the whole picture at twice the size would, see ``docs/evaluation.md``.
"""

from functools import partial

import numpy as np
from jaxtyping import Shaped, UInt8

from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.fusion import supersampling_kernels as kernels
from omnisyn_cli.fusion.blend_kernels import LayerRows, blend_edge_pixels, kernel_rule, quantization_for, source_offset
from omnisyn_cli.fusion.blend_rule import BlendRule
from omnisyn_cli.fusion.ghosts import have_same_position
from omnisyn_cli.fusion.layer_pair import LayerPair
from omnisyn_cli.types import EDGE_PIXEL_MULTIPLE, EDGE_TILE_COLUMNS, DirectionTables, EdgePixels, Layer

# Levels of 8 bits by which 3x3 pixels have to vary: below, samples would look like their pixel. Set by hand.
MIN_CONTRAST_LEVELS = 40
TILE_ROWS = 64  # rows whose edge pixels are sampled together. Set by hand.
MIN_SUPERSAMPLING_SHARE = 1.0 / 512.0  # share of the mean below which no level of 8 bits changes


class EdgeSupersampler:
    """Replaces the edge pixels of frames of one size by the mean of their samples; reused from frame to frame."""

    def __init__(self, size: tuple[int, int], threads: int | None = None) -> None:
        self.size, self.threads = size, threads
        self._tables = DirectionTables.of_size(2 * size[0], 2 * size[1])
        self._marks = np.empty(size, np.uint8)

    def __call__(self, layers: LayerPair, rule: BlendRule, out: Shaped[np.ndarray, "height width 3"]) -> None:
        """Supersample the edges of what a rule blended, by its occlusion strength: ends are the photographs."""
        height, _ = self.size
        share, scalars, quantization = np.float32(rule.occlusion_strength), kernel_rule(rule), quantization_for(out)
        if share < MIN_SUPERSAMPLING_SHARE or have_same_position(layers.first, layers.second):
            return
        marks = self.mark(layers, out)

        def sample(begin: int, end: int) -> None:
            for top in range(begin * TILE_ROWS, min(end * TILE_ROWS, height), TILE_ROWS):
                edge_pixels = self._edge_pixels(marks, layers, top, min(top + TILE_ROWS, height))
                if len(edge_pixels[0].cols) == 0:
                    continue
                (rho_a, colour_a), (rho_b, colour_b) = layers.edge_samples(*edge_pixels)
                first = LayerRows(colour_a, rho_a, source_offset(layers.first))
                second = LayerRows(colour_b, rho_b, source_offset(layers.second))
                blend_edge_pixels(first, second, scalars, self._tables, edge_pixels[0], share, quantization, out)

        run_ranges(sample, -(-height // TILE_ROWS), self.threads)

    def mark(
        self, layers: LayerPair, picture: Shaped[np.ndarray, "height width 3"]
    ) -> UInt8[np.ndarray, "height width"]:
        """Marks of edge pixels, see :func:`mark_edge_pixels`; the next call overwrites them."""
        first, second = layers.first.inverse_depth, layers.second.inverse_depth
        scale = np.float32(255.0 if picture.dtype.kind == "f" else 255.0 / np.iinfo(picture.dtype).max)
        mark = partial(kernels.mark_edge_pixels, first, second, picture, scale, MIN_CONTRAST_LEVELS, self._marks)
        run_ranges(mark, self.size[0], self.threads)
        return self._marks

    def _edge_pixels(
        self, marks: UInt8[np.ndarray, "height width"], layers: LayerPair, top: int, bottom: int
    ) -> tuple[EdgePixels, EdgePixels]:
        """Those of some rows. Both layers get the same pixels, but know the depth of different samples."""
        padding = (EDGE_PIXEL_MULTIPLE - 1) * (bottom - top)
        capacity = int(np.count_nonzero(marks[top:bottom])) + padding
        tile_begins = np.empty((bottom - top, -(-self.size[1] // EDGE_TILE_COLUMNS) + 1), np.int32)
        cols = np.empty(capacity, np.int32)
        sin_a, cos_a = np.empty(2 * capacity, np.float32), np.empty(2 * capacity, np.float32)
        count = kernels.list_edge_pixels(marks, top, tile_begins, cols, self._tables, sin_a, cos_a)
        cols, sin_a, cos_a = cols[:count], sin_a[: 2 * count], cos_a[: 2 * count]

        def of_layer(layer: Layer, mark: int) -> EdgePixels:
            unknown_counts, known = np.empty_like(tile_begins), np.empty((2, 2 * count), np.float32)
            edge_pixels = EdgePixels(top, cols, tile_begins, unknown_counts, known, sin_a, cos_a)
            kernels.prefill_visibility(marks, np.uint8(mark), layer.inverse_depth, edge_pixels)
            return edge_pixels

        return of_layer(layers.first, kernels.FIRST_LAYER_EDGE), of_layer(layers.second, kernels.SECOND_LAYER_EDGE)
