"""A mesh with fewer, larger quads where the surface is flat as far as a way can tell.

A rectangle of quads becomes one quad, two triangles between its corners, if no vertex in it would be seen more than an
eighth of a target pixel aside from anywhere on the way, and if its upper and lower edges, arcs of great circles, stay
as close to the rows of the image. Cuts that no such rectangle can tell from a slope are no cuts. What is left of a cut
quad are its quarters, or two halves where it is cut straight across.

Larger quads beside smaller ones share corners but not edges. So that no crack can open between them, the edges of a
merged quad reach outwards by as much as the vertices along them lie outside (see ``gap``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, UInt8

from omnisyn_cli.geometry.sphere import direction_tables
from omnisyn_cli.render.mesh import Mesh
from omnisyn_cli.render.quads import CUT_EDGES, DIAGONAL, QUARTER_WEIGHTS, REMOVED
from omnisyn_cli.render.raster_kernels import BLOCK
from omnisyn_cli.render.simplify_kernels import (
    APART,
    COVERED,
    TALL,
    bound_errors,
    mark_cuts,
    measure_gaps,
    merge_strips,
)
from omnisyn_cli.threads import run_bands

__all__ = ["TOLERANCE", "Tiles", "simplify"]

TOLERANCE = 0.125
"""Target pixels (of the equator) by which a vertex may be seen aside.

On a warehouse walked for 3 m an eighth costs 0.01 dB and a quarter, with 6 % fewer triangles, 0.08 dB.
"""

MOST = 6
"""Rectangles have at most ``2^MOST`` quads along a side, and an eighth of the image."""

NEIGHBOURHOOD = 5
"""Tiles that begin in one square of ``2^NEIGHBOURHOOD`` quads are drawn one after the other."""

MARGIN = 1.1
"""Gaps are closed by this much more: their vertices are joined by arcs that bulge."""

STRAIGHT = {10: ((0, 1, 0, 1), (2, 3, 2, 3)), 5: ((0, 0, 2, 2), (1, 1, 3, 3))}
"""Cut edges that halve a quad, and for each half the corners that its points have their inverse depths from."""

HALVES = {10: ((0, 1, 4, 5), (4, 5, 2, 3)), 5: ((0, 6, 2, 7), (6, 1, 7, 3))}
"""The directions of those points: corners, and from 4 on the middles of the left, right, upper and lower edge."""


@dataclass(frozen=True)
class Tiles:
    """Quads with points of their own, in blocks that are drawn together.

    Attributes:
        points: ``(blocks, 4, 4, BLOCK)``: x, y, z and inverse depth in the frame of the panorama, of the four corners
            of each tile in the order of a quad.
        codes: ``DIAGONAL`` and ``REMOVED`` as for quads; the last block is filled up with tiles that are not drawn.
        gaps: radians times relative distance by which edges reach outwards.
        triangles: how many there are.
    """

    points: Float32[np.ndarray, "blocks 4 4 tiles"]
    codes: UInt8[np.ndarray, "blocks tiles"]
    gaps: Float32[np.ndarray, "blocks tiles"]
    triangles: int


def simplify(
    mesh: Mesh, way: Float[np.ndarray, " 3"], height: int, tolerance: float = TOLERANCE, threads: int | None = None
) -> Tiles:
    """The tiles of a mesh that is seen from a straight way.

    Args:
        mesh: the surface in the frame of its panorama.
        way: metres, in that frame: targets lie between the panorama and this point.
        height: rows of the targets.
        tolerance: in their pixels.
        threads: at most this many; the result does not depend on it.
    """
    angle, tables = tolerance * np.pi / height, direction_tables(*mesh.size)
    marks = _merged(mesh, np.asarray(way, np.float64), angle, tables, threads)
    parts = [_rectangles(mesh, marks, tables, float(np.linalg.norm(way)), threads), *_pieces(mesh, marks), _caps(mesh)]
    points, codes, gaps, places = (np.concatenate(group) for group in zip(*parts, strict=True))
    drawn = (codes & REMOVED) == 0
    order = np.flatnonzero(drawn)[np.argsort(places[drawn], kind="stable")]
    is_cap = places[order] == LAST
    return _in_blocks(points[order], codes[order], gaps[order], int(2 * len(order) - is_cap.sum()))


LAST = np.iinfo(np.int64).max

Part = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Of some tiles: points ``(tiles, 4 corners, 4)``, codes, gaps, and numbers to sort them by."""


def _merged(
    mesh: Mesh, way: np.ndarray, angle: float, tables: tuple[np.ndarray, ...], threads: int | None
) -> np.ndarray:
    """Marks of rectangles, see :data:`TALL`."""
    rho, bounds = mesh.inverse_depth, np.empty(mesh.size, np.float32)
    run_bands(lambda begin, end: bound_errors(rho, *tables, way, angle, bounds, begin, end), len(rho), threads)
    marks = np.where(mesh.quads & REMOVED, np.uint8(COVERED), np.uint8(0))
    run_bands(lambda begin, end: mark_cuts(marks, mesh.quads, rho, bounds, begin, end), len(marks), threads)
    most = min(MOST, max(0, (mesh.size[1] // 8).bit_length() - 1))
    run_bands(
        lambda begin, end: merge_strips(marks, rho, bounds, tables, most, angle, begin, end),
        -(-len(marks) // (1 << most)),
        threads,
    )
    return marks


def _place(row: np.ndarray, col: np.ndarray, columns: int) -> np.ndarray:
    """Numbers that grow from neighbourhood to neighbourhood and, in each, row after row."""
    side = 1 << NEIGHBOURHOOD
    square = (row // side) * (columns // side + 1) + col // side
    return np.asarray((square * side + row % side) * side + col % side, np.int64)


def _points(mesh: Mesh, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """``(..., 4)`` of vertices: direction and inverse depth."""
    sin_p, cos_p, sin_a, cos_a = direction_tables(*mesh.size)
    x, y, z = sin_p[row] * sin_a[col], np.broadcast_to(cos_p[row], row.shape), -sin_p[row] * cos_a[col]
    return np.stack([x, y, z, mesh.inverse_depth[row, col]], -1)


def _vertices(mesh: Mesh, row: np.ndarray, col: np.ndarray, height: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Points of the corners of rectangles."""
    right, below = (col + width) % mesh.size[1], row + height
    return _points(mesh, np.stack([row, row, below, below], -1), np.stack([col, right, col, right], -1))


def _rectangles(
    mesh: Mesh, marks: np.ndarray, tables: tuple[np.ndarray, ...], reach: float, threads: int | None
) -> Part:
    """Merged quads and single ones, all but those of which pieces are drawn."""
    row, col = np.nonzero((marks != COVERED) & (marks != APART))
    mark = marks[row, col].astype(np.int64)
    height, width = 1 << mark // TALL, 1 << mark % TALL
    points = _vertices(mesh, row, col, height, width)
    rho = points[..., 3].astype(np.float32)
    rising = np.abs(rho[:, 2] - rho[:, 1]) < np.abs(rho[:, 0] - rho[:, 3])
    gaps = np.zeros(len(row))
    merged = np.flatnonzero((mark > 0) | ((mesh.quads[row, col] & CUT_EDGES) != 0))
    rectangles, found = np.stack([row, col, height, width], -1)[merged], np.empty(len(merged))
    run_bands(
        lambda begin, end: measure_gaps(mesh.inverse_depth, mesh.quads, tables, rectangles, reach, found, begin, end),
        len(merged),
        threads,
    )
    gaps[merged] = MARGIN * found
    return points, np.where(rising, np.uint8(DIAGONAL), np.uint8(0)), gaps, _place(row, col, mesh.size[1])


def _pieces(mesh: Mesh, marks: np.ndarray) -> list[Part]:
    """What is left of cut quads: halves of those cut straight across, quarters of the others."""
    cut = mesh.cut_quads[marks.ravel()[mesh.cut_quads] == APART]
    code = mesh.quads.ravel()[cut] & CUT_EDGES
    parts = [_halves(mesh, cut[code == kind], kind) for kind in STRAIGHT]
    return [*parts, _quarters(mesh, cut[~np.isin(code, list(STRAIGHT))])]


def _corners(mesh: Mesh, quads: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row, column and corner points of quads."""
    row, col = np.divmod(quads, mesh.size[1])
    one = np.ones_like(row)
    return row, col, _vertices(mesh, row, col, one, one)


def _halves(mesh: Mesh, quads: np.ndarray, kind: int) -> Part:
    row, col, corners = _corners(mesh, quads)
    middles = [(corners[:, a] + corners[:, b]) / 2 for a, b in ((0, 2), (1, 3), (0, 1), (2, 3))]
    all_points = np.concatenate([corners, np.stack(middles, 1)], 1)
    halves = []
    for directions, depths in zip(HALVES[kind], STRAIGHT[kind], strict=True):
        points = all_points[:, list(directions)]
        points[..., 3] = corners[:, list(depths), 3]
        halves.append(points)
    points = np.stack(halves, 1).reshape(-1, 4, 4)
    codes = np.where((points[..., 3] < 0).any(axis=1), np.uint8(REMOVED), np.uint8(0))
    return points, codes, np.zeros(len(points)), np.repeat(_place(row, col, mesh.size[1]), 2)


def _quarters(mesh: Mesh, quads: np.ndarray) -> Part:
    row, col, corners = _corners(mesh, quads)
    weights = QUARTER_WEIGHTS[mesh.quads.ravel()[quads] & CUT_EDGES].astype(np.float64)
    shares, excess = weights[..., :16], weights[..., 16:]
    points = np.einsum("qcp,qcx->qpx", shares, corners)
    points[..., 3] += np.einsum("qcp,qc->qp", excess, corners[..., 3])
    points = points.reshape(-1, 4, 4, 4).transpose(0, 2, 1, 3)  # points come as 4·point + quarter
    rising = np.where([False, True, True, False], np.uint8(DIAGONAL), np.uint8(0))
    codes = np.where(corners[..., 3] < 0, np.uint8(REMOVED), rising)
    places = np.repeat(_place(row, col, mesh.size[1]), 4)
    return points.reshape(-1, 4, 4), codes.ravel(), np.zeros(len(places)), places


def _caps(mesh: Mesh) -> Part:
    """The triangles around both poles, as quads with two points at the pole."""
    height, width = mesh.size
    col = np.arange(width)
    points = np.zeros((2, width, 4, 4))
    for cap, (row, pole, ring) in enumerate(((0, (0, 1), (2, 3)), (height - 1, (2, 3), (0, 1)))):
        points[cap][:, list(pole), 1] = 1.0 - 2.0 * cap
        points[cap][:, list(pole), 3] = mesh.caps[cap, :, :1]
        for side, corner in enumerate(ring):
            points[cap][:, corner] = _points(mesh, np.full(width, row), (col + side) % width)
            points[cap][:, corner, 3] = mesh.caps[cap, :, 1 + side]
    codes = np.where(mesh.caps[..., 0] < 0, np.uint8(REMOVED), np.uint8(0)).ravel()
    return points.reshape(-1, 4, 4), codes, np.zeros(2 * width), np.full(2 * width, LAST)


def _in_blocks(points: np.ndarray, codes: np.ndarray, gaps: np.ndarray, triangles: int) -> Tiles:
    """Blocks of :data:`BLOCK` tiles, the last filled up."""
    count = len(codes)
    blocks = -(-count // BLOCK)
    filled = np.zeros((blocks * BLOCK, 4, 4), np.float32)
    filled[:count] = points
    all_codes, all_gaps = np.full(blocks * BLOCK, REMOVED, np.uint8), np.zeros(blocks * BLOCK, np.float32)
    all_codes[:count], all_gaps[:count] = codes, gaps
    return Tiles(
        np.ascontiguousarray(filled.reshape(blocks, BLOCK, 4, 4).transpose(0, 3, 2, 1)),
        all_codes.reshape(blocks, BLOCK),
        all_gaps.reshape(blocks, BLOCK),
        triangles,
    )
