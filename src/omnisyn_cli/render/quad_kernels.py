# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""Quads of two triangles against the rays of an equirectangular image, in numba.

The four points of a quad and its triangles::

    0 ─── 1     falling diagonal: A = (0, 3, 2), B = (0, 1, 3)
    │     │
    2 ─── 3     rising diagonal:  A = (0, 1, 2), B = (1, 3, 2)

A ray with ``r·cut >= 0`` can only hit triangle A, which has the left edge, one with ``r·cut < 0`` only B, which has the
right one; top and bottom change sides with the diagonal. On either the inverse depth is ``r·g`` (a plane is linear in
the ray), where g sums the edges, each weighted with the inverse depth of the corner opposite.

Edges and planes of eight quads are found at a time, in float64, and rounded to float32 once. Rays are tested in
float32, eight neighbours at a time, against edges moved outwards by more than their rounding: neighbouring quads
overlap by half a microradian and never leave a gap. Where float32 is too coarse for the inverse depth (planes seen
edge-on) and across the seam a quad is drawn in float64.
"""

from __future__ import annotations

import numpy as np

from omnisyn_cli.jit import inlined, inlined_contracting, kernel
from omnisyn_cli.render.quads import CUT_EDGES, DIAGONAL, REMOVED
from omnisyn_cli.render.simd import (
    LANES,
    double,
    has_bits,
    load,
    load_halves,
    pair,
    single,
    splat,
    store,
    store_halves,
    where,
)

__all__ = [
    "A_LEFT",
    "A_OTHER",
    "A_PLANE",
    "B_OTHER",
    "B_PLANE",
    "B_RIGHT",
    "CUT",
    "DRAWN",
    "EDGE_ON",
    "IN_FLOAT32",
    "NOT_AT_ALL",
    "PLAN_ROWS",
    "draw_quads",
    "plan_quads",
]  # fmt: skip

EDGE_ON = 1e-13
"""Determinants below this are triangles seen edge-on: they cover nothing."""

OVERLAP = np.float32(5e-7)
"""Radians by which edges are moved outwards: float32 tests err by less than 4.2e-7."""

STEEPEST = 100.0
"""Largest ratio of a plane's slope to its inverse depth at which float32 keeps 1e-4 of the inverse depth."""

NEVER = np.float32(-1e30)
"""Moves the edge of a triangle that is not seen so far inwards that no ray passes it."""

CUT, A_LEFT, A_OTHER, B_RIGHT, B_OTHER, A_PLANE, B_PLANE, DRAWN = 0, 4, 8, 12, 16, 20, 23, 26
"""Rows of a plan: edges as (x, y, z, offset), planes as (x, y, z), and how a quad is drawn."""
PLAN_ROWS = 27

NOT_AT_ALL, IN_FLOAT32, IN_FLOAT64 = np.float32(0.0), np.float32(1.0), np.float32(2.0)

HIDDEN = np.uint8(CUT_EDGES | REMOVED)
RISING = np.uint8(DIAGONAL)


@inlined()
def _cross(ax, ay, az, bx, by, bz):
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@inlined_contracting()
def _dot(ax, ay, az, bx, by, bz):
    return ax * bx + ay * by + az * bz


@inlined()
def _point(numbers, stride, at):
    """x, y, z and inverse depth of the same corner of eight quads."""
    return (
        double(load(numbers, at)), double(load(numbers, at + stride)),
        double(load(numbers, at + 2 * stride)), double(load(numbers, at + 3 * stride)),
    )  # fmt: skip


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
def _size(x, y, z):
    """At least the length of a vector."""
    return _magnitude(x) + _magnitude(y) + _magnitude(z)


@inlined()
def _store_edge(plan, row, k, x, y, z):
    """Returns by how much the edge is moved outwards."""
    x, y, z = single(x), single(y), single(z)
    store(plan[row], k, x)
    store(plan[row + 1], k, y)
    store(plan[row + 2], k, z)
    return splat(OVERLAP) * _size(x, y, z)


@inlined()
def _beyond(gap, x0, y0, z0, x1, y1, z1):
    """By how much an edge between two points is moved outwards to close a gap."""
    return gap * _size(single(x1 - x0), single(y1 - y0), single(z1 - z0))


@inlined()
def _store_plane(plan, row, k, x, y, z):
    store(plan[row], k, single(x))
    store(plan[row + 1], k, single(y))
    store(plan[row + 2], k, single(z))


@inlined()
def _is_gentle(x, y, z, farthest, least):
    """Whether float32 keeps enough digits of ``r·(x, y, z)`` for rays to points of these squared properties."""
    slope = x * x + y * y + z * z
    return splat(STEEPEST * STEEPEST) * least >= slope * farthest


@kernel()
def plan_quads(numbers, stride, at0, at1, at2, at3, codes, gaps, first, count, plan):
    """Edges and planes of ``count`` quads.

    ``numbers`` holds x of all points, ``stride`` further on y, then z and inverse depth; corner i of the first quad is
    at ``at{i}``, its flags are ``codes[first]``. Up to a multiple of eight is read and written. Where there are
    ``gaps``, edges are moved outwards by them besides.
    """
    zero, one = splat(0.0), splat(1.0)
    for k in range(0, count, LANES):
        x0, y0, z0, w0 = _point(numbers, stride, at0 + k)
        x1, y1, z1, w1 = _point(numbers, stride, at1 + k)
        x2, y2, z2, w2 = _point(numbers, stride, at2 + k)
        x3, y3, z3, w3 = _point(numbers, stride, at3 + k)
        rising = has_bits(codes, first + k, RISING)
        lx, ly, lz = _cross(x2, y2, z2, x0, y0, z0)
        rx, ry, rz = _cross(x1, y1, z1, x3, y3, z3)
        tx, ty, tz = _cross(x0, y0, z0, x1, y1, z1)
        bx, by, bz = _cross(x3, y3, z3, x2, y2, z2)
        cx, cy, cz = _cross(
            where(rising, x1, x0), where(rising, y1, y0), where(rising, z1, z0),
            where(rising, x2, x3), where(rising, y2, y3), where(rising, z2, z3),
        )  # fmt: skip
        det_a = where(rising, x2 * tx + y2 * ty + z2 * tz, x0 * bx + y0 * by + z0 * bz)
        det_b = where(rising, x1 * bx + y1 * by + z1 * bz, x0 * rx + y0 * ry + z0 * rz)
        ax, ay, az = where(rising, tx, bx), where(rising, ty, by), where(rising, tz, bz)
        bx, by, bz = where(rising, bx, tx), where(rising, by, ty), where(rising, bz, tz)
        has_a, has_b = det_a > splat(EDGE_ON), det_b > splat(EDGE_ON)
        scale_a = where(has_a, one, zero) / where(has_a, det_a, one)
        scale_b = where(has_b, one, zero) / where(has_b, det_b, one)
        a_cut, a_left, a_other = where(rising, w0, w2), where(rising, w1, w3), where(rising, w2, w0)
        b_cut, b_right, b_other = where(rising, w3, w1), where(rising, w2, w0), where(rising, w1, w3)
        px = scale_a * (cx * a_cut + lx * a_left + ax * a_other)
        py = scale_a * (cy * a_cut + ly * a_left + ay * a_other)
        pz = scale_a * (cz * a_cut + lz * a_left + az * a_other)
        qx = scale_b * (rx * b_right + bx * b_other - cx * b_cut)
        qy = scale_b * (ry * b_right + by * b_other - cy * b_cut)
        qz = scale_b * (rz * b_right + bz * b_other - cz * b_cut)
        offset = _store_edge(plan, CUT, k, cx, cy, cz)
        none, never = splat(np.float32(0.0)), splat(NEVER)
        store(plan[CUT + 3], k, where(has_a, where(has_b, none, offset), none - offset))
        a_left_out, a_other_out = _store_edge(plan, A_LEFT, k, lx, ly, lz), _store_edge(plan, A_OTHER, k, ax, ay, az)
        b_right_out, b_other_out = _store_edge(plan, B_RIGHT, k, rx, ry, rz), _store_edge(plan, B_OTHER, k, bx, by, bz)
        if gaps is not None:
            gap = load(gaps, first + k)
            top, bottom = _beyond(gap, x0, y0, z0, x1, y1, z1), _beyond(gap, x3, y3, z3, x2, y2, z2)
            a_left_out = a_left_out + _beyond(gap, x2, y2, z2, x0, y0, z0)
            a_other_out = a_other_out + where(rising, top, bottom)
            b_right_out = b_right_out + _beyond(gap, x1, y1, z1, x3, y3, z3)
            b_other_out = b_other_out + where(rising, bottom, top)
        store(plan[A_LEFT + 3], k, where(has_a, a_left_out, never))
        store(plan[A_OTHER + 3], k, where(has_a, a_other_out, never))
        store(plan[B_RIGHT + 3], k, where(has_b, b_right_out, never))
        store(plan[B_OTHER + 3], k, where(has_b, b_other_out, never))
        _store_plane(plan, A_PLANE, k, px, py, pz)
        _store_plane(plan, B_PLANE, k, qx, qy, qz)
        far = _larger(
            _larger(x0 * x0 + y0 * y0 + z0 * z0, x1 * x1 + y1 * y1 + z1 * z1),
            _larger(x2 * x2 + y2 * y2 + z2 * z2, x3 * x3 + y3 * y3 + z3 * z3),
        )
        least = _smaller(_smaller(w0, w1), _smaller(w2, w3))
        least = least * least
        gentle = _is_gentle(px, py, pz, far, least) & _is_gentle(qx, qy, qz, far, least)
        how = where(gentle, splat(IN_FLOAT32), splat(IN_FLOAT64))
        how = where(has_bits(codes, first + k, HIDDEN), splat(NOT_AT_ALL), where(has_a | has_b, how, splat(NOT_AT_ALL)))
        store(plan[DRAWN], k, how)


@inlined()
def _edge(plan, row, k, x, y, z):
    """An edge against eight rays; not negative inside."""
    return x * splat(plan[row, k]) + (
        z * splat(plan[row + 2, k]) + (y * splat(plan[row + 1, k]) + splat(plan[row + 3, k]))
    )


@inlined()
def _plane(plan, row, k, x, y, z):
    return x * splat(plan[row, k]) + (z * splat(plan[row + 2, k]) + y * splat(plan[row + 1, k]))


@inlined()
def _seen(plan, k, x, y, z, old):
    """Inverse depth of a quad on eight rays, whether it is nearer than ``old``, and whether its triangle is A."""
    zero = splat(np.float32(0.0))
    in_a = _edge(plan, CUT, k, x, y, z) >= zero
    side = where(in_a, _edge(plan, A_LEFT, k, x, y, z), _edge(plan, B_RIGHT, k, x, y, z))
    other = where(in_a, _edge(plan, A_OTHER, k, x, y, z), _edge(plan, B_OTHER, k, x, y, z))
    seen = _larger(where(in_a, _plane(plan, A_PLANE, k, x, y, z), _plane(plan, B_PLANE, k, x, y, z)), zero)
    return seen, (side >= zero) & (other >= zero) & (seen > old), in_a


@inlined()
def _draw_wide(plan, k, faces, row_first, row_last, col_first, col_last, tables, out_rho, out_face, width):
    """One planned quad against the rays in a box, all of it inside the image: eight columns of one row at a time."""
    sin_p, cos_p, sin_a, minus_cos_a = tables
    face_a = face_b = splat(np.int32(0))
    if out_face is not None:
        face_a, face_b = splat(np.int32(faces[k])), splat(np.int32(faces[k] + 1))
    for row in range(row_first, row_last + 1):
        sp, y = splat(sin_p[row]), splat(cos_p[row])
        for column in range(col_first, col_last + 1, LANES):
            col = min(column, width - LANES)
            at = row * width + col
            old = load(out_rho, at)
            seen, wins, in_a = _seen(plan, k, sp * load(sin_a, col), y, sp * load(minus_cos_a, col), old)
            store(out_rho, at, where(wins, seen, old))
            if out_face is not None:
                store(out_face, at, where(wins, where(in_a, face_a, face_b), load(out_face, at)))


@inlined()
def _draw_narrow(plan, k, faces, row_first, row_last, col_first, tables, out_rho, out_face, width):
    """The same for boxes of up to four columns: those of two rows at a time."""
    sin_p, cos_p, sin_a, minus_cos_a = tables
    col = min(col_first, width - LANES // 2)
    sine, minus_cosine = load_halves(sin_a, col, col), load_halves(minus_cos_a, col, col)
    face_a = face_b = splat(np.int32(0))
    if out_face is not None:
        face_a, face_b = splat(np.int32(faces[k])), splat(np.int32(faces[k] + 1))
    for row in range(row_first, row_last + 1, 2):
        below = min(row + 1, row_last)
        sp, y = pair(sin_p[row], sin_p[below]), pair(cos_p[row], cos_p[below])
        at, at_below = row * width + col, below * width + col
        old = load_halves(out_rho, at, at_below)
        seen, wins, in_a = _seen(plan, k, sp * sine, y, sp * minus_cosine, old)
        store_halves(out_rho, at, at_below, where(wins, seen, old))
        if out_face is not None:
            old_face = load_halves(out_face, at, at_below)
            store_halves(out_face, at, at_below, where(wins, where(in_a, face_a, face_b), old_face))


@inlined()
def _minus_size(x0, y0, z0, x1, y1, z1):
    return -(abs(x1 - x0) + abs(y1 - y0) + abs(z1 - z0))


@kernel(fastmath={"contract"})
def draw_float64(
    x0, y0, z0, w0, x1, y1, z1, w1, x2, y2, z2, w2, x3, y3, z3, w3, rising, gap, faces, k,
    row_first, row_last, col_first, col_last, tables, out_rho, out_face, width,
):  # fmt: skip
    """Both triangles of a quad against the rays in a box; columns outside the image are wrapped."""
    sin_p, cos_p, sin_a, cos_a = tables
    lx, ly, lz = _cross(x2, y2, z2, x0, y0, z0)
    rx, ry, rz = _cross(x1, y1, z1, x3, y3, z3)
    if rising:
        cx, cy, cz = _cross(x1, y1, z1, x2, y2, z2)
        ax, ay, az = _cross(x0, y0, z0, x1, y1, z1)
        bx, by, bz = _cross(x3, y3, z3, x2, y2, z2)
        det_a, det_b = _dot(x2, y2, z2, ax, ay, az), _dot(x1, y1, z1, bx, by, bz)
        a_cut, a_left, a_other, b_cut, b_right, b_other = w0, w1, w2, w3, w2, w1
    else:
        cx, cy, cz = _cross(x0, y0, z0, x3, y3, z3)
        ax, ay, az = _cross(x3, y3, z3, x2, y2, z2)
        bx, by, bz = _cross(x0, y0, z0, x1, y1, z1)
        det_a, det_b = _dot(x0, y0, z0, ax, ay, az), _dot(x0, y0, z0, rx, ry, rz)
        a_cut, a_left, a_other, b_cut, b_right, b_other = w2, w3, w0, w1, w0, w3
    has_a, has_b = det_a > EDGE_ON, det_b > EDGE_ON
    scale_a, scale_b = 1.0 / det_a, 1.0 / det_b
    left_out, right_out = gap * _minus_size(x0, y0, z0, x2, y2, z2), gap * _minus_size(x1, y1, z1, x3, y3, z3)
    top_out, bottom_out = gap * _minus_size(x0, y0, z0, x1, y1, z1), gap * _minus_size(x2, y2, z2, x3, y3, z3)
    a_out, b_out = (top_out, bottom_out) if rising else (bottom_out, top_out)
    a_cut, a_left, a_other = a_cut * scale_a, a_left * scale_a, a_other * scale_a
    b_cut, b_right, b_other = b_cut * scale_b, b_right * scale_b, b_other * scale_b
    px, qx = cx * a_cut + lx * a_left + ax * a_other, rx * b_right + bx * b_other - cx * b_cut
    py, qy = cy * a_cut + ly * a_left + ay * a_other, ry * b_right + by * b_other - cy * b_cut
    pz, qz = cz * a_cut + lz * a_left + az * a_other, rz * b_right + bz * b_other - cz * b_cut
    for row in range(row_first, row_last + 1):
        sp, y = sin_p[row], cos_p[row]
        for turned in range(col_first, col_last + 1):
            col = turned + width if turned < 0 else (turned - width if turned >= width else turned)
            at = row * width + col
            x, z = sp * sin_a[col], -sp * cos_a[col]
            side = _dot(x, y, z, cx, cy, cz)
            left, other = _dot(x, y, z, lx, ly, lz), _dot(x, y, z, ax, ay, az)
            if has_a and side >= 0.0 and left >= left_out and other >= a_out:
                seen = np.float32(max(0.0, _dot(x, y, z, px, py, pz)))
                if seen > out_rho[at]:
                    out_rho[at] = seen
                    if out_face is not None:
                        out_face[at] = faces[k]
            right, other = _dot(x, y, z, rx, ry, rz), _dot(x, y, z, bx, by, bz)
            if has_b and side <= 0.0 and right >= right_out and other >= b_out:
                seen = np.float32(max(0.0, _dot(x, y, z, qx, qy, qz)))
                if seen > out_rho[at]:
                    out_rho[at] = seen
                    if out_face is not None:
                        out_face[at] = faces[k] + 1


@inlined()
def _corner(numbers, stride, at):
    return (
        np.float64(numbers[at]), np.float64(numbers[at + stride]), np.float64(numbers[at + 2 * stride]),
        np.float64(numbers[at + 3 * stride]),
    )  # fmt: skip


@kernel()
def draw_quads(
    numbers, stride, at0, at1, at2, at3, codes, gaps, first, count, plan, box, faces, tables, exact_tables,
    out_rho, out_face, width, begin, end,
):  # fmt: skip
    """Quads planned by :func:`plan_quads` in rows ``begin`` to ``end``.

    ``box`` are first and last row and column of each, ``faces`` their numbers; the images are flat. Without
    ``out_face`` only inverse depth is written.
    """
    for k in range(count):
        if plan[DRAWN, k] == NOT_AT_ALL:
            continue
        row_first, row_last = max(np.int64(box[0, k]), begin), min(np.int64(box[1, k]), end - 1)
        col_first, col_last = np.int64(box[2, k]), np.int64(box[3, k])
        if row_first > row_last or col_first > col_last:
            continue
        if plan[DRAWN, k] == IN_FLOAT32 and col_first >= 0 and col_last < width and width >= LANES:
            if col_last - col_first < LANES // 2:
                _draw_narrow(plan, k, faces, row_first, row_last, col_first, tables, out_rho, out_face, width)
            else:
                _draw_wide(plan, k, faces, row_first, row_last, col_first, col_last, tables, out_rho, out_face, width)
            continue
        gap = 0.0 if gaps is None else np.float64(gaps[first + k])
        x0, y0, z0, w0 = _corner(numbers, stride, at0 + k)
        x1, y1, z1, w1 = _corner(numbers, stride, at1 + k)
        x2, y2, z2, w2 = _corner(numbers, stride, at2 + k)
        x3, y3, z3, w3 = _corner(numbers, stride, at3 + k)
        draw_float64(
            x0, y0, z0, w0, x1, y1, z1, w1, x2, y2, z2, w2, x3, y3, z3, w3, (codes[first + k] & DIAGONAL) != 0,
            gap, faces, k, row_first, row_last, col_first, col_last, exact_tables, out_rho, out_face, width,
        )  # fmt: skip
