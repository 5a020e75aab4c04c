# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""Antialiased edges: pixels that show two surfaces are supersampled 2x2.

An *edge pixel* lies beside a depth discontinuity of either layer, and its colours differ from those around it. It
becomes the mean of four samples, the pixels of a picture of twice the size, each blended by the rule. They are a
twentieth of most pictures, and gain what the whole picture at twice the size would, see ``docs/evaluation.md``.
"""

from functools import partial

import numpy as np
from jaxtyping import Shaped, UInt8

from omnisyn_cli.compute.jit import fast_kernel, fast_subkernel, inlined
from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.fusion.blend_kernels import LayerRows, blend_edge_pixels, kernel_rule, quantization_for, source_offset
from omnisyn_cli.fusion.blend_rule import BlendRule
from omnisyn_cli.fusion.ghosts import have_same_position
from omnisyn_cli.fusion.layer_pair import LayerPair
from omnisyn_cli.fusion.pixel_classes import MIN_INVERSE_DEPTH
from omnisyn_cli.geometry.tolerances import SAME_SURFACE_TOLERANCE
from omnisyn_cli.types import EDGE_PIXEL_MULTIPLE, EDGE_TILE_COLUMNS, DirectionTables, EdgePixels, Layer

# Levels of 8 bits by which 3x3 pixels have to vary: below, samples would look like their pixel. Set by hand.
MIN_CONTRAST_LEVELS = 40
TILE_ROWS = 64  # rows whose edge pixels are sampled together. Set by hand.
MIN_SUPERSAMPLING_SHARE = 1.0 / 512.0  # share of the mean below which no level of 8 bits changes
FIRST_LAYER_EDGE, SECOND_LAYER_EDGE = 1, 2  # bits of a mark: which layer has a depth discontinuity there
SKIP_COLUMNS = 64  # pixels that are skipped together if none of them is marked: most rows have no edges. Set by hand.


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
        mark = partial(mark_edge_pixels, first, second, picture, scale, MIN_CONTRAST_LEVELS, self._marks)
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
        count = list_edge_pixels(marks, top, tile_begins, cols, self._tables, sin_a, cos_a)
        cols, sin_a, cos_a = cols[:count], sin_a[: 2 * count], cos_a[: 2 * count]

        def of_layer(layer: Layer, mark: int) -> EdgePixels:
            unknown_counts, known = np.empty_like(tile_begins), np.empty((2, 2 * count), np.float32)
            edge_pixels = EdgePixels(top, cols, tile_begins, unknown_counts, known, sin_a, cos_a)
            prefill_visibility(marks, np.uint8(mark), layer.inverse_depth, edge_pixels)
            return edge_pixels

        return of_layer(layers.first, FIRST_LAYER_EDGE), of_layer(layers.second, SECOND_LAYER_EDGE)


@fast_kernel()
def mark_edge_pixels(first, second, picture, scale, min_contrast, marks, begin, end):
    """Mark pixels of rows ``begin`` to ``end`` beside a depth discontinuity of either layer, if it is visible.

    ``first``, ``second``: inverse depths, negative where nothing is seen. Some channel of their blend ``picture``,
    times ``scale`` in levels of 8 bits, has to vary by ``min_contrast`` over 3x3 pixels. ``marks``, uint8, written:
    bits :data:`FIRST_LAYER_EDGE` and :data:`SECOND_LAYER_EDGE`.
    """
    height, width = marks.shape
    for row in range(begin, end):
        above, below = max(row - 1, 0), min(row + 1, height - 1)
        marks[row] = 0
        _mark_depth_edges(first[above], first[row], first[below], marks[row], np.uint8(FIRST_LAYER_EDGE))
        _mark_depth_edges(second[above], second[row], second[below], marks[row], np.uint8(SECOND_LAYER_EDGE))
        for left in range(0, width, SKIP_COLUMNS):
            right = min(left + SKIP_COLUMNS, width)
            if not _is_any(marks[row], left, right):
                continue
            for col in range(left, right):
                if marks[row, col] and not has_contrast(picture, scale, min_contrast, above, below, col):
                    marks[row, col] = 0


@fast_subkernel()
def _mark_depth_edges(above, rho, below, marks, mark):
    """Mark those pixels of a row that differ in depth from one of their four neighbours; columns wrap."""
    last = len(rho) - 1
    # The seam is a loop of its own, so that LLVM vectorises the inner columns.
    for col in range(1, last):
        here = rho[col]
        is_edge = is_other_surface(here, rho[col - 1]) | is_other_surface(here, rho[col + 1])
        is_edge |= is_other_surface(here, above[col]) | is_other_surface(here, below[col])
        marks[col] |= mark if is_edge else np.uint8(0)
    for col in (0, last):
        here = rho[col]
        is_edge = is_other_surface(here, rho[col - 1]) | is_other_surface(here, rho[0 if col == last else col + 1])
        is_edge |= is_other_surface(here, above[col]) | is_other_surface(here, below[col])
        marks[col] |= mark if is_edge else np.uint8(0)


@fast_subkernel()
def _is_any(marks, begin, end):
    found = np.uint8(0)
    for col in range(begin, end):
        found |= marks[col]
    return found != 0


@inlined(fastmath=True)
def is_other_surface(one, other):
    """:func:`omnisyn_cli.fusion.pixel_classes.is_other_surface` of two pixels; unseen ones count as infinitely far."""
    a, b = max(one, np.float32(0.0)), max(other, np.float32(0.0))
    return abs(a - b) > np.float32(SAME_SURFACE_TOLERANCE) * max(max(a, b), np.float32(MIN_INVERSE_DEPTH))


@inlined(fastmath=True)
def has_contrast(picture, scale, min_contrast, above, below, col):
    """Whether some channel varies enough over 3x3 pixels; rows end, columns wrap."""
    last = picture.shape[1] - 1
    left, right = col - 1 if col > 0 else last, col + 1 if col < last else 0
    for k in range(3):
        lowest, highest = np.float32(255.0), np.float32(0.0)
        for row in range(above, below + 1):
            for at in (left, col, right):
                value = min(max(picture[row, at, k] * scale, np.float32(0.0)), np.float32(255.0))
                lowest, highest = min(lowest, value), max(highest, value)
        # Rounded first, so that float and integer pictures have the same edges.
        if int(highest + np.float32(0.5)) - int(lowest + np.float32(0.5)) >= min_contrast:
            return True
    return False


@fast_kernel()
def list_edge_pixels(marks, top, tile_begins, cols, double_tables, sin_a, cos_a):
    """Marked pixels of some rows as in :class:`omnisyn_cli.types.EdgePixels`, all written; how many, with padding."""
    count, width = 0, marks.shape[1]
    for row in range(len(tile_begins)):
        for left in range(0, width, SKIP_COLUMNS):
            right = min(left + SKIP_COLUMNS, width)
            if not _is_any(marks[top + row], left, right):
                tile_begins[row, left // EDGE_TILE_COLUMNS : -(-right // EDGE_TILE_COLUMNS)] = count
                continue
            for col in range(left, right):
                if col % EDGE_TILE_COLUMNS == 0:
                    tile_begins[row, col // EDGE_TILE_COLUMNS] = count
                if marks[top + row, col]:
                    cols[count] = col
                    count += 1
        while count % EDGE_PIXEL_MULTIPLE != 0:
            cols[count] = -1
            count += 1
        tile_begins[row, -1] = count
    for at in range(count):
        col = max(cols[at], 0)
        for side in range(2):
            sin_a[2 * at + side] = double_tables.sin_a[2 * col + side]
            cos_a[2 * at + side] = double_tables.cos_a[2 * col + side]
    return count


@fast_kernel()
def prefill_visibility(marks, mark, rho, edge_pixels):
    """Write counts and the sample depths that lie on a local plane; those of the layer's own edges are unknown."""
    height, width = marks.shape
    top, cols, tile_begins = edge_pixels.top, edge_pixels.cols, edge_pixels.tile_begins
    unknown_counts, inverse_depth = edge_pixels.unknown_counts, edge_pixels.inverse_depth
    for row in range(len(tile_begins)):
        here, tiles, tile, count = top + row, tile_begins.shape[1] - 1, 0, 0
        above, below = max(here - 1, 0), min(here + 1, height - 1)
        for at in range(tile_begins[row, 0], tile_begins[row, tiles]):
            col = cols[at]
            while col >= 0 and tile * EDGE_TILE_COLUMNS <= col:
                unknown_counts[row, tile] = count
                tile += 1
            left, right = (col - 1 if col > 0 else width - 1), (col + 1 if col < width - 1 else 0)
            is_unknown = col < 0 or marks[here, col] & mark
            count += 1 if is_unknown and col >= 0 else 0
            # Samples lie a quarter of a pixel from the centre; the neighbours are two pixels apart, hence an eighth.
            across = np.float32(0.125) * (rho[here, right] - rho[here, left])
            down = np.float32(0.25) * (rho[below, col] - rho[above, col]) / np.float32(max(below - above, 1))
            for half in range(2):
                for side in range(2):
                    value = rho[here, col] + (across if side else -across) + (down if half else -down)
                    known = max(value, np.float32(0.0)) if rho[here, col] >= np.float32(0.0) else np.float32(-1.0)
                    inverse_depth[half, 2 * at + side] = np.float32(-1.0) if is_unknown else known
        unknown_counts[row, tile:] = count
