# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""Quads of two triangles against the rays of an equirectangular image, in numba.

The four points of a quad and its triangles::

    0 ─── 1     split from 0 to 3: A = (0, 3, 2), B = (0, 1, 3)
    │     │
    2 ─── 3     one that is split from 2 to 1 is turned by a quarter first: 1, 3, 0, 2 are its corners then

A ray with ``r·cut >= 0`` can only hit triangle A, which has the left edge and that below, one with ``r·cut < 0`` only
B, which has the right one and that above. On either the inverse depth is ``r·g`` (a plane is linear in the ray), where
g sums the edges, each weighted with the inverse depth of the corner opposite.

Edges and planes of eight quads are found at a time, in float64, and rounded to float32 once. Rays are tested in
float32, eight neighbours at a time, against edges moved outwards by more than their rounding: neighbouring quads
overlap by half a microradian and never leave a gap. Where float32 is too coarse for the inverse depth (planes seen
edge-on) and across the seam a quad is drawn in float64.
"""

import numpy as np

from omnisyn_cli.compute.jit import inlined, kernel
from omnisyn_cli.render.box_kernels import FREE, INVERSE_DEPTH, X, Y, Z
from omnisyn_cli.render.quad_blocks import DIAGONAL, REMOVED
from omnisyn_cli.render.simd import (
    LANES,
    double,
    has_bits,
    load,
    single,
    splat,
    store,
    where,
)

__all__ = ["EDGE_ON", "split_quad"]

EDGE_ON = 1e-13
"""Determinants below this are triangles seen edge-on: they cover nothing."""

OVERLAP = np.float32(5e-7)
"""Radians by which edges are moved outwards: float32 tests err by less than 4.2e-7."""

STEEPEST = 100.0
"""Largest ratio of a plane's slope to its inverse depth at which float32 keeps 1e-4 of the inverse depth."""

FARTHEST = 1e-4
"""1/metre: what is farther away is told from infinity by nobody, and may be as wrong as what is this far."""

NEVER = np.float32(-1e30)
"""Moves the edge of a triangle that is not seen so far inwards that no ray passes it."""

CUT, A_LEFT, A_OTHER, B_RIGHT, B_OTHER, A_PLANE, B_PLANE, DRAWN = (FREE + k for k in (0, 4, 8, 12, 16, 20, 23, 26))
"""Rows of a block with the plans of its quads: edges (x, y, z, offset), planes (x, y, z), and how a quad is drawn."""

BLOCK_ROWS = DRAWN + 1
"""All rows of a block."""


NOT_AT_ALL, IN_FLOAT32, IN_FLOAT64 = np.float32(0.0), np.float32(1.0), np.float32(2.0)


def split_quad(p0, p1, p2, p3):
    """Edges and planes of a quad that is split from its first corner to its fourth.

    Points are ``(x, y, z, inverse depth)`` of anything that has ``+``, ``-`` and ``*``: vectors, numbers, tensors.
    Returned are the edges cut, left, bottom, right and top, and of both triangles the determinant and the plane times
    that.
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
        double(load(block[X], at)), double(load(block[Y], at)), double(load(block[Z], at)),
        double(load(block[INVERSE_DEPTH], at)),
    )  # fmt: skip


@inlined()
def _choice(mask, a, b):
    """A point or another."""
    return where(mask, a[0], b[0]), where(mask, a[1], b[1]), where(mask, a[2], b[2]), where(mask, a[3], b[3])


@inlined()
def _smaller(a, b):
    return where(a >= b, b, a)


@inlined()
def _larger(a, b):
    return where(a >= b, a, b)


@inlined()
def _magnitude(a):
    return _larger(a, splat(np.float32(0.0)) - a)


@inlined()
def _size(vector):
    """At least the length of a vector."""
    return _magnitude(vector[0]) + _magnitude(vector[1]) + _magnitude(vector[2])


@inlined()
def _times(vector, number):
    return vector[0] * number, vector[1] * number, vector[2] * number


@inlined()
def _store(block, row, k, vector):
    """Write a vector, rounded to float32, and return that."""
    x, y, z = single(vector[0]), single(vector[1]), single(vector[2])
    store(block[row], k, x)
    store(block[row + 1], k, y)
    store(block[row + 2], k, z)
    return x, y, z


@inlined()
def _store_edge(block, row, k, edge, is_seen, gap, a, b):
    """An edge between two points, moved outwards by rounding and a gap, or where it is not seen inwards beyond rays."""
    length = _size((single(b[0] - a[0]), single(b[1] - a[1]), single(b[2] - a[2])))
    outwards = splat(OVERLAP) * _size(_store(block, row, k, edge)) + gap * length
    store(block[row + 3], k, where(is_seen, outwards, splat(NEVER)))


@inlined()
def _square(a):
    return a[0] * a[0] + a[1] * a[1] + a[2] * a[2]


@kernel()
def plan_quads(block, corners, codes, gaps, begin, end):
    """Edges and planes of the quads ``begin`` to ``end`` of a block, whole vectors of them.

    Where there are ``gaps``, edges are moved outwards by them besides.
    """
    zero, one, none, (at0, at1, at2, at3) = splat(0.0), splat(1.0), splat(np.float32(0.0)), corners
    for k in range(begin // LANES * LANES, end, LANES):
        q0, q1 = _vectors_of(block, at0 + k), _vectors_of(block, at1 + k)
        q2, q3 = _vectors_of(block, at2 + k), _vectors_of(block, at3 + k)
        rising = has_bits(codes, k, np.uint8(DIAGONAL))
        p0, p1 = _choice(rising, q1, q0), _choice(rising, q3, q1)
        p2, p3 = _choice(rising, q0, q2), _choice(rising, q2, q3)
        cut, left, bottom, right, top, det_a, plane_a, det_b, plane_b = split_exactly(p0, p1, p2, p3)
        has_a, has_b = det_a > splat(EDGE_ON), det_b > splat(EDGE_ON)
        scale_a = where(has_a, one, zero) / where(has_a, det_a, one)
        scale_b = where(has_b, one, zero) / where(has_b, det_b, one)
        offset = splat(OVERLAP) * _size(_store(block, CUT, k, cut))
        store(block[CUT + 3], k, where(has_a, where(has_b, none, offset), none - offset))
        gap = load(gaps, k) if len(gaps) > 0 else none
        _store_edge(block, A_LEFT, k, left, has_a, gap, p2, p0)
        _store_edge(block, A_OTHER, k, bottom, has_a, gap, p3, p2)
        _store_edge(block, B_RIGHT, k, right, has_b, gap, p1, p3)
        _store_edge(block, B_OTHER, k, top, has_b, gap, p0, p1)
        far = _larger(_larger(_square(p0), _square(p1)), _larger(_square(p2), _square(p3)))
        least = _smaller(_smaller(p0[3], p1[3]), _smaller(p2[3], p3[3]))
        least = _larger(least, splat(FARTHEST))
        steepest = splat(STEEPEST * STEEPEST) * (least * least)
        plane_a, plane_b = _times(plane_a, scale_a), _times(plane_b, scale_b)
        _store(block, A_PLANE, k, plane_a)
        _store(block, B_PLANE, k, plane_b)
        gentle = (steepest >= _square(plane_a) * far) & (steepest >= _square(plane_b) * far)
        how = where(has_a | has_b, where(gentle, splat(IN_FLOAT32), splat(IN_FLOAT64)), splat(NOT_AT_ALL))
        store(block[DRAWN], k, where(has_bits(codes, k, np.uint8(REMOVED)), splat(NOT_AT_ALL), how))
