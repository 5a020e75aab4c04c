"""Mesh simplification: larger quads where the surface is flat, as far as a camera path can tell.

A rectangle of quads becomes one quad, two triangles between its corners, on two conditions. No vertex in it may be seen
more than an eighth of a target pixel from its true place, from anywhere on the path. And its upper and lower edges,
arcs of great circles, stay as close to the rows of the image. Cuts that such a rectangle cannot tell from a slope are
dropped. A quad that stays cut is drawn as its quarters, or as two halves where it is cut straight across.

Larger quads beside smaller ones share corners but not edges. So that no crack can open between them, the edges of a
merged quad reach outwards by as much as the vertices along them lie outside (its *gap*).
"""

from functools import partial

import numpy as np
from jaxtyping import Float, Integer

from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.geometry.sphere import direction_tables
from omnisyn_cli.render.mesh import Mesh
from omnisyn_cli.render.quad_blocks import CUT_EDGES, DIAGONAL, HOLE_FLAG, QuadBlocks, pack_quads
from omnisyn_cli.render.simplify_kernels import (
    COVERED_CODE,
    CUT_APART,
    HEIGHT_CODE,
    FlatnessTest,
    bound_errors,
    mark_cuts,
    measure_gaps,
    merge_strips,
)

# Target pixels (at the equator) by which a vertex may be shifted. On a warehouse walked for 3 m an eighth costs 0.01 dB
# and a quarter, with 6 % fewer triangles, 0.08 dB.
MAX_SHIFT_PIXELS = 0.125
# Rectangles have at most 2 to this power quads along a side, and at most an eighth of the image. Set by hand.
MAX_SIDE_LOG2 = 6
# Quads that begin in one square of 2 to this power quads a side are drawn one after the other, for the cache. Set by
# hand.
DRAW_ORDER_LOG2 = 5
GAP_MARGIN = 1.1  # factor of gaps: between their vertices edges are arcs that bulge. Set by hand.
# Flags of cut edges that halve a quad, and the points of both halves as indices into the 16 points of its quarters.
STRAIGHT_CUTS = {10: ((0, 4, 2, 5), (9, 14, 8, 12)), 5: ((0, 1, 8, 10), (6, 4, 13, 12))}


def simplify(
    mesh: Mesh, path: Float[np.ndarray, " 3"], height: int, tolerance: float = MAX_SHIFT_PIXELS,
    threads: int | None = None,
) -> tuple[QuadBlocks, int]:  # fmt: skip
    """The quads to draw for a mesh that is seen from a straight path, and how many triangles they are.

    Targets of ``height`` rows lie between the panorama and ``path``, in metres in its frame. ``tolerance`` is in pixels
    of these. The result does not depend on ``threads``.
    """
    angle, tables = tolerance * np.pi / height, direction_tables(*mesh.size)
    rho, bounds, end_of_path = mesh.inverse_depth, np.empty(mesh.size, np.float32), np.asarray(path, np.float64)
    run_ranges(partial(bound_errors, rho, tables, end_of_path, angle, bounds), len(rho), threads)
    marks = _merge(mesh, bounds, angle, tables, threads)
    parts = [_rectangles(mesh, marks, tables, float(np.linalg.norm(path)), threads), *_pieces(mesh, marks)]
    points, codes, gaps, orders = (np.concatenate(group) for group in zip(*parts, strict=True))
    drawn = (codes & HOLE_FLAG) == 0
    order = np.flatnonzero(drawn)[np.argsort(orders[drawn], kind="stable")]
    is_cap = orders[order] == CAP_ORDER
    return pack_quads(points[order], codes[order], gaps[order]), int(2 * len(order) - is_cap.sum())


def flat_rectangles(
    mesh: Mesh, share: float, angle: float, threads: int | None = None
) -> tuple[Integer[np.ndarray, "rectangles 4"], Float[np.ndarray, "pieces 4 4"]]:
    """The same for a surface that is seen from anywhere, without gaps, as rectangles of quads and pieces.

    No vertex is infinitely far; it may be moved along its ray by ``share`` of its distance. An edge may leave its row
    of the image by ``angle`` radians. Returns first row, first column, height and width of each rectangle, in quads;
    and directions and inverse depths of the points of pieces, see :meth:`omnisyn_cli.render.mesh.Mesh.pieces`.
    """
    rho = mesh.inverse_depth
    marks = _merge(mesh, np.where(rho < 0, -1, share * rho).astype(np.float32), angle,
                    direction_tables(*mesh.size), threads)  # fmt: skip
    row, col, height, width = _rectangle_list(marks)
    pieces = [points[(codes & HOLE_FLAG) == 0] for points, codes, _, _ in _pieces(mesh, marks)]
    return np.stack([row, col, height, width], -1), np.concatenate(pieces)


CAP_ORDER = np.iinfo(np.int64).max  # sort key of the caps, which are drawn last
# Of some quads: points ``(quads, 4 corners, 4)``, codes, gaps, and numbers to sort them by.
Part = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def _merge(
    mesh: Mesh, bounds: np.ndarray, angle: float, tables: tuple[np.ndarray, ...], threads: int | None
) -> np.ndarray:
    """Marks of rectangles (:data:`HEIGHT_CODE`) whose inverse depths err by no more than ``bounds``."""
    rho = mesh.inverse_depth
    marks = np.where(mesh.quads & HOLE_FLAG, np.uint8(COVERED_CODE), np.uint8(0))
    run_ranges(partial(mark_cuts, marks, mesh.quads, rho, bounds), len(marks), threads)
    most = min(MAX_SIDE_LOG2, max(0, (mesh.size[1] // 8).bit_length() - 1))
    merge = partial(merge_strips, marks, FlatnessTest(rho, bounds, tables, angle), most)
    run_ranges(merge, -(-len(marks) // (1 << most)), threads)
    return marks


def _draw_order(row: np.ndarray, col: np.ndarray, columns: int) -> np.ndarray:
    """Sort keys of quads: square after square, and row after row in each."""
    side = 1 << DRAW_ORDER_LOG2
    square = (row // side) * (columns // side + 1) + col // side
    return np.asarray((square * side + row % side) * side + col % side, np.int64)


def _rectangle_list(marks: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """First row and column, height and width of all rectangles."""
    row, col = np.nonzero((marks != COVERED_CODE) & (marks != CUT_APART))
    mark = marks[row, col].astype(np.int64)
    return row, col, 1 << mark // HEIGHT_CODE, 1 << mark % HEIGHT_CODE


def _rectangles(
    mesh: Mesh, marks: np.ndarray, tables: tuple[np.ndarray, ...], reach: float, threads: int | None
) -> Part:
    """Merged quads and single ones, all but those that are drawn as pieces."""
    row, col, height, width = _rectangle_list(marks)
    right, below = (col + width) % mesh.size[1], row + height
    corner = np.stack([row, row, below, below], -1) * mesh.size[1] + np.stack([col, right, col, right], -1)
    rho = mesh.inverse_depth.ravel()[corner]
    points = np.concatenate([mesh.directions_of(corner), rho[..., None]], axis=-1, dtype=np.float32)
    rising = np.abs(rho[:, 2] - rho[:, 1]) < np.abs(rho[:, 0] - rho[:, 3])
    gaps = np.zeros(len(row))
    merged = np.flatnonzero((height * width > 1) | ((mesh.quads[row, col] & CUT_EDGES) != 0))
    rectangles, found = np.stack([row, col, height, width], -1)[merged], np.empty(len(merged))
    measure = partial(measure_gaps, mesh.inverse_depth, mesh.quads, tables, rectangles, reach, found)
    run_ranges(measure, len(merged), threads)
    gaps[merged] = GAP_MARGIN * found
    return points, np.where(rising, np.uint8(DIAGONAL), np.uint8(0)), gaps, _draw_order(row, col, mesh.size[1])


def _pieces(mesh: Mesh, marks: np.ndarray) -> list[Part]:
    """Pieces: halves of quads that are cut straight across, quarters of other cut quads, and the caps."""
    points, count = np.concatenate(list(mesh.pieces()), dtype=np.float32), 4 * len(mesh.cut_quads)
    is_cut_apart = marks.ravel()[mesh.cut_quads] == CUT_APART
    kind = mesh.quads.ravel()[mesh.cut_quads] & CUT_EDGES
    quarters = points[:count].reshape(-1, 16, 4)
    order = _draw_order(*np.divmod(mesh.cut_quads, mesh.size[1]), mesh.size[1])
    groups = [(quarters[is_cut_apart & (kind == code)][:, halves], order[is_cut_apart & (kind == code)])
              for code, halves in STRAIGHT_CUTS.items()]  # fmt: skip
    others = is_cut_apart & ~np.isin(kind, list(STRAIGHT_CUTS))
    groups += [(quarters[others].reshape(-1, 4, 4, 4), order[others]), (points[None, count:], np.array([CAP_ORDER]))]
    return [_part(group, at) for group, at in groups]


def _part(points: np.ndarray, order: np.ndarray) -> Part:
    """Groups ``(orders, quads, 4 corners, 4)`` of quads; a quad with a point without a surface is removed."""
    orders, points = np.repeat(order, points.shape[1]), points.reshape(-1, 4, 4)
    codes = np.where((points[..., 3] < 0).any(axis=-1), np.uint8(HOLE_FLAG), np.uint8(0))
    return points, codes, np.zeros(len(points)), orders
