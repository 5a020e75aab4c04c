# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""Triangle setup for quads, in numba: edge functions and planes that rays are tested against.

The four points of a quad and its triangles::

    0 ─── 1     split from 0 to 3: A = (0, 3, 2), B = (0, 1, 3)
    │     │
    2 ─── 3     one that is split from 2 to 1 is turned by 90° first: then 1, 3, 0, 2 are its corners

A ray with ``r·cut >= 0`` can only hit triangle A, with the left and bottom edges; one with ``r·cut < 0`` only B, with
the right and top edges. On either, the inverse depth is ``r·g``, because a plane is linear in the ray; g sums the
edges, each weighted by the inverse depth of the opposite corner.

Eight quads are set up at a time, in float64, and rounded to float32 once. Rays are tested in float32, eight neighbours
at a time, against edges moved outwards by more than their rounding. So neighbouring quads overlap by half a microradian
and never leave a gap. Planes seen edge-on, for which float32 is too coarse, and quads across the seam are drawn in
float64.
"""

import numpy as np

from omnisyn_cli.compute.jit import inlined, subkernel
from omnisyn_cli.render.box_kernels import FIRST_FREE_ROW, INVERSE_DEPTH, X, Y, Z
from omnisyn_cli.render.quad_blocks import DIAGONAL, HOLE_FLAG
from omnisyn_cli.render.simd import LANES, broadcast, has_bits, load, store, to_float32, to_float64, where

EDGE_ON_DETERMINANT = 1e-13  # determinants below this are triangles seen edge-on: they cover nothing
EDGE_OVERLAP_RADIANS = np.float32(5e-7)  # by which edges are moved outwards: float32 tests err by less than 4.2e-7
# Largest ratio of a plane's slope to its inverse depth at which float32 keeps 1e-4 of the inverse depth.
MAX_FLOAT32_SLOPE = 100.0
# 1/metre: beyond 10 km nobody tells depth from infinity, so errors there may be as large as at 10 km.
NEAR_INFINITY_INVERSE_DEPTH = 1e-4
# Offset that moves an edge of an invisible triangle so far inwards that no ray passes it.
UNREACHABLE_OFFSET = np.float32(-1e30)

# Rows of a block with the setups of its quads: edges (x, y, z, offset), planes (x, y, z), precision of drawing.
# ``OTHER`` is the bottom edge of A and the top edge of B. They are no ints, for each of which kernels compile anew.
CUT, A_LEFT, A_OTHER, B_RIGHT, B_OTHER, A_PLANE, B_PLANE, PRECISION = (
    np.int64(FIRST_FREE_ROW + k) for k in (0, 4, 8, 12, 16, 20, 23, 26)
)
BLOCK_ROWS = int(PRECISION) + 1  # all rows of a block
SKIPPED_QUAD, IN_FLOAT32, IN_FLOAT64 = np.float32(0.0), np.float32(1.0), np.float32(2.0)  # values of :data:`PRECISION`


def split_quad(p0, p1, p2, p3):
    """Edges and planes of a quad that is split from its first corner to its fourth.

    Points are ``(x, y, z, inverse depth)`` of anything that has ``+``, ``-`` and ``*``: vectors, numbers, tensors.
    Returns the edges cut, left, bottom, right and top, then for each triangle its determinant, and its plane times the
    determinant.
    """

    def cross(a, b):
        return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]

    def dot(a, b):
        return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]

    def times(a, number):
        return a[0] * number, a[1] * number, a[2] * number

    def plus(a, b):
        return a[0] + b[0], a[1] + b[1], a[2] + b[2]

    def minus(a, b):
        return a[0] - b[0], a[1] - b[1], a[2] - b[2]

    cut, left, bottom, right, top = cross(p0, p3), cross(p2, p0), cross(p3, p2), cross(p1, p3), cross(p0, p1)
    plane_a = plus(plus(times(cut, p2[3]), times(left, p3[3])), times(bottom, p0[3]))
    plane_b = minus(plus(times(right, p0[3]), times(top, p3[3])), times(cut, p1[3]))
    return cut, left, bottom, right, top, dot(p0, bottom), plane_a, dot(p0, right), plane_b


split_exactly = inlined()(split_quad)


@inlined()
def _vectors_of(block, at):
    """x, y, z and inverse depth of eight points."""
    return (
        to_float64(load(block[X], at)), to_float64(load(block[Y], at)), to_float64(load(block[Z], at)),
        to_float64(load(block[INVERSE_DEPTH], at)),
    )  # fmt: skip


@inlined()
def _choice(mask, a, b):
    """Each point from ``a`` where the mask is set, else from ``b``."""
    return where(mask, a[0], b[0]), where(mask, a[1], b[1]), where(mask, a[2], b[2]), where(mask, a[3], b[3])


@inlined()
def _smaller(a, b):
    return where(a >= b, b, a)


@inlined()
def _larger(a, b):
    return where(a >= b, a, b)


@inlined()
def _magnitude(a):
    return _larger(a, broadcast(np.float32(0.0)) - a)


@inlined()
def _size(vector):
    """The 1-norm, a cheap bound of the length of a vector."""
    return _magnitude(vector[0]) + _magnitude(vector[1]) + _magnitude(vector[2])


@inlined()
def _times(vector, number):
    return vector[0] * number, vector[1] * number, vector[2] * number


@inlined()
def _store(block, row, k, vector):
    """Write a vector rounded to float32, and return it so."""
    x, y, z = to_float32(vector[0]), to_float32(vector[1]), to_float32(vector[2])
    store(block[row], k, x)
    store(block[row + 1], k, y)
    store(block[row + 2], k, z)
    return x, y, z


@inlined()
def _store_edge(block, row, k, edge, is_seen, gap, a, b):
    """Write an edge, moved outwards by rounding and a gap; edges of invisible triangles let no ray in."""
    length = _size((to_float32(b[0] - a[0]), to_float32(b[1] - a[1]), to_float32(b[2] - a[2])))
    outwards = broadcast(EDGE_OVERLAP_RADIANS) * _size(_store(block, row, k, edge)) + gap * length
    store(block[row + 3], k, where(is_seen, outwards, broadcast(UNREACHABLE_OFFSET)))


@inlined()
def _square(a):
    return a[0] * a[0] + a[1] * a[1] + a[2] * a[2]


@subkernel()
def set_up_quads(block, quads, begin, end):
    """Write edges and planes of the quads ``begin`` to ``end`` of a block, rounded to whole vectors.

    ``quads``: :class:`omnisyn_cli.render.quad_blocks.PlacedQuads`; edges are moved outwards by their gaps.
    """
    codes, gaps, (at0, at1, at2, at3) = quads.codes, quads.gaps, quads.corners
    zero, one, none = broadcast(0.0), broadcast(1.0), broadcast(np.float32(0.0))
    for k in range(begin // LANES * LANES, end, LANES):
        q0, q1 = _vectors_of(block, at0 + k), _vectors_of(block, at1 + k)
        q2, q3 = _vectors_of(block, at2 + k), _vectors_of(block, at3 + k)
        rising = has_bits(codes, k, np.uint8(DIAGONAL))
        p0, p1 = _choice(rising, q1, q0), _choice(rising, q3, q1)
        p2, p3 = _choice(rising, q0, q2), _choice(rising, q2, q3)
        cut, left, bottom, right, top, det_a, plane_a, det_b, plane_b = split_exactly(p0, p1, p2, p3)
        has_a, has_b = det_a > broadcast(EDGE_ON_DETERMINANT), det_b > broadcast(EDGE_ON_DETERMINANT)
        scale_a = where(has_a, one, zero) / where(has_a, det_a, one)
        scale_b = where(has_b, one, zero) / where(has_b, det_b, one)
        offset = broadcast(EDGE_OVERLAP_RADIANS) * _size(_store(block, CUT, k, cut))
        # Between two triangles the cut only chooses one. If there is one triangle, it is an outer edge like the others.
        store(block[CUT + 3], k, where(has_a, where(has_b, none, offset), none - offset))
        gap = load(gaps, k) if len(gaps) > 0 else none
        _store_edge(block, A_LEFT, k, left, has_a, gap, p2, p0)
        _store_edge(block, A_OTHER, k, bottom, has_a, gap, p3, p2)
        _store_edge(block, B_RIGHT, k, right, has_b, gap, p1, p3)
        _store_edge(block, B_OTHER, k, top, has_b, gap, p0, p1)
        farthest = _larger(_larger(_square(p0), _square(p1)), _larger(_square(p2), _square(p3)))
        least = _smaller(_smaller(p0[3], p1[3]), _smaller(p2[3], p3[3]))
        least = _larger(least, broadcast(NEAR_INFINITY_INVERSE_DEPTH))
        limit = broadcast(MAX_FLOAT32_SLOPE * MAX_FLOAT32_SLOPE) * (least * least)
        plane_a, plane_b = _times(plane_a, scale_a), _times(plane_b, scale_b)
        _store(block, A_PLANE, k, plane_a)
        _store(block, B_PLANE, k, plane_b)
        gentle = (limit >= _square(plane_a) * farthest) & (limit >= _square(plane_b) * farthest)
        how = where(has_a | has_b, where(gentle, broadcast(IN_FLOAT32), broadcast(IN_FLOAT64)), broadcast(SKIPPED_QUAD))
        store(block[PRECISION], k, where(has_bits(codes, k, np.uint8(HOLE_FLAG)), broadcast(SKIPPED_QUAD), how))
