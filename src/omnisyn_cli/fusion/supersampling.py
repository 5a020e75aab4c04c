"""Edges that are neither jagged nor a pixel off: pixels that show two surfaces are means of four samples.

A pixel beside a jump of either surface whose colours differ from those around it is a *spot*: visibility, colours and
weights are found at the four pixels of a picture of twice the size, blended by the rule one by one, and averaged. That
is a twentieth of most pictures, and gains what the whole picture at twice the size would: on generated walks full of
edges 0.65 dB with true depth, 0.2 dB with estimated depth; figures are in ``docs/evaluation.md``.
"""

import numpy as np
from jaxtyping import Shaped, UInt8

from omnisyn_cli.compute.threads import run_bands
from omnisyn_cli.fusion.blend_kernels import LayerRows, Tables, blend_edge_pixels, offset_of, quantization_for, rule_of
from omnisyn_cli.fusion.blend_rule import BlendRule
from omnisyn_cli.fusion.ghosts import have_same_position
from omnisyn_cli.fusion.layer_pair import LayerPair
from omnisyn_cli.fusion.supersampling_kernels import list_edge_pixels, mark_edge_pixels, prefill_visibility
from omnisyn_cli.geometry.sphere import direction_tables
from omnisyn_cli.types import EDGE_PIXEL_MULTIPLE, EDGE_TILE_COLUMNS, EdgePixels, Layer

CONTRAST = 40
"""Levels of 8 bits: where all nine pixels are more alike than that, samples would look like their pixel."""

ROWS = 64
"""Of a band whose samples are found together."""


LEAST_SHARE = 1.0 / 512.0
"""Of samples, below which no level of 8 bits changes by them."""


class EdgeSupersampler:
    """Gives the pixels at edges of frames of one size the mean of their samples; reused from frame to frame.

    Args:
        size: height and width of the frames.
        threads: at most this many; None is one per core.
    """

    def __init__(self, size: tuple[int, int], threads: int | None = None) -> None:
        self.size, self.threads = size, threads
        double = direction_tables(2 * size[0], 2 * size[1])
        self._tables = Tables(*(table.astype(np.float32) for table in double))
        self._marks = np.empty(size, np.uint8)

    def __call__(self, views: LayerPair, rule: BlendRule, out: Shaped[np.ndarray, "height width 3"]) -> None:
        """Change a picture where it has edges: not at the ends of the way, where photographs are shown as they are.

        Args:
            views: what it was blended of, with samples.
            rule: how they were; samples set in as strictly as it does.
            out: the picture, numbers or samples of it.
        """
        height, _ = self.size
        share, numbers, storing = np.float32(rule.strictness), rule_of(rule), quantization_for(out)
        if share < LEAST_SHARE or have_same_position(views.first, views.second):
            return
        marks = self.marked(views, out)

        def sample(begin: int, end: int) -> None:
            for top in range(begin * ROWS, min(end * ROWS, height), ROWS):
                edge_pixels = self._spots(marks, views, top, min(top + ROWS, height))
                if len(edge_pixels[0].cols) == 0:
                    continue
                (rho_a, colour_a), (rho_b, colour_b) = views.samples(*edge_pixels)
                first = LayerRows(colour_a, rho_a, offset_of(views.first))
                second = LayerRows(colour_b, rho_b, offset_of(views.second))
                blend_edge_pixels(first, second, numbers, self._tables, edge_pixels[0], share, storing, out)

        run_bands(sample, -(-height // ROWS), self.threads)

    def marked(self, views: LayerPair, picture: Shaped[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, "height width"]:
        """Not 0 at spots, see :func:`omnisyn_cli.fusion.supersampling_kernels.mark_edge_pixels`; the next call overwrites it."""
        first, second = views.first.inverse_depth, views.second.inverse_depth
        scale = np.float32(255.0 if picture.dtype.kind == "f" else 255.0 / np.iinfo(picture.dtype).max)
        run_bands(
            lambda begin, end: mark_edge_pixels(first, second, picture, scale, CONTRAST, self._marks, begin, end),
            self.size[0],
            self.threads,
        )
        return self._marks

    def _spots(
        self, marks: UInt8[np.ndarray, "height width"], views: LayerPair, top: int, bottom: int
    ) -> tuple[EdgePixels, EdgePixels]:
        """Those of some rows: the same ones for both views, of each of which other samples are known."""
        most = int(np.count_nonzero(marks[top:bottom])) + (EDGE_PIXEL_MULTIPLE - 1) * (bottom - top)
        begins = np.empty((bottom - top, -(-self.size[1] // EDGE_TILE_COLUMNS) + 1), np.int32)
        cols, sin_a, cos_a = np.empty(most, np.int32), np.empty(2 * most, np.float32), np.empty(2 * most, np.float32)
        count = list_edge_pixels(marks, top, begins, cols, self._tables.sin_a, self._tables.cos_a, sin_a, cos_a)
        cols, sin_a, cos_a = cols[:count], sin_a[: 2 * count], cos_a[: 2 * count]

        def of_view(view: Layer, mark: int) -> EdgePixels:
            counts, known = np.empty_like(begins), np.empty((2, 2 * count), np.float32)
            prefill_visibility(marks, np.uint8(mark), view.inverse_depth, top, begins, cols, counts, known)
            return EdgePixels(top, cols, begins, counts, known, sin_a, cos_a)

        return of_view(views.first, 1), of_view(views.second, 2)
