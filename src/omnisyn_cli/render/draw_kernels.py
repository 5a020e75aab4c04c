# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""Planned quads against the rays in their boxes, in numba.

Small boxes are tested whole, eight rays at a time. For large ones the columns that a quad can be seen in are found row
by row first: on a row of the target an edge is ``P·cos(azimuth − φ) + Q``, so those on its inner side are an interval.
"""

import math
from typing import NamedTuple

import numpy as np

from omnisyn_cli.compute.jit import fast_kernel, inlined, inlined_contracting, kernel
from omnisyn_cli.render.box_kernels import (
    COL,
    FIRST_COL,
    FIRST_ROW,
    INVERSE_DEPTH,
    LAST_COL,
    LAST_ROW,
    X,
    Y,
    Z,
    surround,
)
from omnisyn_cli.render.quad_blocks import BLOCK, DIAGONAL
from omnisyn_cli.render.quad_kernels import (
    A_LEFT,
    A_OTHER,
    A_PLANE,
    B_OTHER,
    B_PLANE,
    B_RIGHT,
    CUT,
    DRAWN,
    EDGE_ON,
    IN_FLOAT32,
    NOT_AT_ALL,
    split_exactly,
)
from omnisyn_cli.render.simd import LANES, load, load_halves, pair, splat, store, store_halves, where
from omnisyn_cli.render.trigonometry import atan2_fast

SPANNED = 24
"""Columns of a box from which on spans are found row by row."""

SPAN_ROWS = 64
"""Rows whose spans are found together."""

SLACK = 1e-6
"""Relative error of float32 in the cosine of an interval's end."""

SPAN_MARGIN = 0.5
"""Columns added to both ends of spans: more than the error of the fast arctangent at 16384 columns."""


class Target(NamedTuple):
    """The image that is drawn to.

    Attributes:
        rows: sines and cosines of the polar angles, float32.
        cols: sines and negative cosines of the azimuths.
        exact_rows: the same in float64.
        exact_cols: likewise.
        scale: see :func:`omnisyn_cli.geometry.sphere.pixel_scale`.
        inverse_depth: row after row.
        height: rows.
        width: columns.
    """

    rows: np.ndarray
    cols: np.ndarray
    exact_rows: np.ndarray
    exact_cols: np.ndarray
    scale: tuple[np.float32, ...]
    inverse_depth: np.ndarray
    height: int
    width: int


@inlined()
def _edge(block, row, k, x, y, z):
    """An edge against eight rays; not negative inside."""
    return x * splat(block[row, k]) + (
        z * splat(block[row + 2, k]) + (y * splat(block[row + 1, k]) + splat(block[row + 3, k]))
    )


@inlined()
def _plane(block, row, k, x, y, z):
    return x * splat(block[row, k]) + (z * splat(block[row + 2, k]) + y * splat(block[row + 1, k]))


@inlined()
def seen_on_rays(block, k, x, y, z, old):
    """Inverse depth of a quad on eight rays, whether it is nearer than ``old``, and whether its triangle is A."""
    zero = splat(np.float32(0.0))
    in_a = _edge(block, CUT, k, x, y, z) >= zero
    side = where(in_a, _edge(block, A_LEFT, k, x, y, z), _edge(block, B_RIGHT, k, x, y, z))
    other = where(in_a, _edge(block, A_OTHER, k, x, y, z), _edge(block, B_OTHER, k, x, y, z))
    seen = where(in_a, _plane(block, A_PLANE, k, x, y, z), _plane(block, B_PLANE, k, x, y, z))
    seen = where(seen >= zero, seen, zero)
    return seen, (side >= zero) & (other >= zero) & (seen > old), in_a


@inlined()
def _folded(block, row, k, sp, cp):
    """An edge on a row, as factors of sine and negative cosine of the azimuth, and a constant."""
    return splat(sp * block[row, k]), splat(sp * block[row + 2, k]), splat(cp * block[row + 1, k] + block[row + 3, k])


@inlined()
def _folded_plane(block, row, k, sp, cp):
    return splat(sp * block[row, k]), splat(sp * block[row + 2, k]), splat(cp * block[row + 1, k])


@inlined()
def _value(folded, sine, minus_cosine):
    return sine * folded[0] + (minus_cosine * folded[1] + folded[2])


@inlined()
def _draw_row(block, k, number, row, col_first, col_last, target, face):
    """Columns of one row, all inside the image, eight at a time; faces have ``number`` and the one after it."""
    rows, cols = target.rows, target.cols
    out, width, sp, cp, zero = target.inverse_depth, target.width, rows[0, row], rows[1, row], splat(np.float32(0.0))
    cut = _folded(block, CUT, k, sp, cp)
    a_left, a_other = _folded(block, A_LEFT, k, sp, cp), _folded(block, A_OTHER, k, sp, cp)
    b_right, b_other = _folded(block, B_RIGHT, k, sp, cp), _folded(block, B_OTHER, k, sp, cp)
    a_plane, b_plane = _folded_plane(block, A_PLANE, k, sp, cp), _folded_plane(block, B_PLANE, k, sp, cp)
    for column in range(col_first, col_last + 1, LANES):
        col = min(column, width - LANES)
        at = row * width + col
        old, sine, minus_cosine = load(out, at), load(cols[0], col), load(cols[1], col)
        in_a = _value(cut, sine, minus_cosine) >= zero
        side = where(in_a, _value(a_left, sine, minus_cosine), _value(b_right, sine, minus_cosine))
        other = where(in_a, _value(a_other, sine, minus_cosine), _value(b_other, sine, minus_cosine))
        seen = where(in_a, _value(a_plane, sine, minus_cosine), _value(b_plane, sine, minus_cosine))
        seen = where(seen >= zero, seen, zero)
        wins = (side >= zero) & (other >= zero) & (seen > old)
        store(out, at, where(wins, seen, old))
        if face is not None:
            faces = where(in_a, splat(np.int32(number)), splat(np.int32(number + 1)))
            store(face, at, where(wins, faces, load(face, at)))


@inlined()
def _draw_wide(block, k, number, row_first, row_last, col_first, col_last, target, face):
    """A box inside the image, eight columns of one row at a time."""
    rows, cols, out, width = target.rows, target.cols, target.inverse_depth, target.width
    for row in range(row_first, row_last + 1):
        sp, y = splat(rows[0, row]), splat(rows[1, row])
        for column in range(col_first, col_last + 1, LANES):
            col = min(column, width - LANES)
            at = row * width + col
            old = load(out, at)
            seen, wins, in_a = seen_on_rays(block, k, sp * load(cols[0], col), y, sp * load(cols[1], col), old)
            store(out, at, where(wins, seen, old))
            if face is not None:
                faces = where(in_a, splat(np.int32(number)), splat(np.int32(number + 1)))
                store(face, at, where(wins, faces, load(face, at)))


@inlined()
def _draw_narrow(block, k, number, row_first, row_last, col_first, target, face):
    """Boxes of up to four columns: those of two rows at a time."""
    rows, cols = target.rows, target.cols
    out, width = target.inverse_depth, target.width
    col = min(col_first, width - LANES // 2)
    sine, minus_cosine = load_halves(cols[0], col, col), load_halves(cols[1], col, col)
    for row in range(row_first, row_last + 1, 2):
        below = min(row + 1, row_last)
        sp, y = pair(rows[0, row], rows[0, below]), pair(rows[1, row], rows[1, below])
        at, at_below = row * width + col, below * width + col
        old = load_halves(out, at, at_below)
        seen, wins, in_a = seen_on_rays(block, k, sp * sine, y, sp * minus_cosine, old)
        store_halves(out, at, at_below, where(wins, seen, old))
        if face is not None:
            faces = where(in_a, splat(np.int32(number)), splat(np.int32(number + 1)))
            store_halves(face, at, at_below, where(wins, faces, load_halves(face, at, at_below)))


@fast_kernel()
def _restrict(ex, ey, ez, offset, sin_p, cos_p, first, count, middle, left, right):
    """Take what lies outside of an edge from the ends of azimuths [left, right], which are relative to ``middle``."""
    reach, one, pi = math.sqrt(ex * ex + ez * ez), np.float32(1.0), np.float32(math.pi)
    height = abs(ey) + abs(offset)
    outside = atan2_fast(-ex, ez) - middle
    outside = outside - np.float32(2.0 * math.pi) * np.floor((outside + pi) / np.float32(2.0 * math.pi))
    rows_sin, rows_cos = sin_p[first:], cos_p[first:]
    for i in range(count):
        scale = one / (reach * rows_sin[i] + np.float32(1e-30))
        cosine = (ey * rows_cos[i] + offset) * scale + np.float32(SLACK) * (one + height * scale)
        cosine = min(max(cosine, -one), one)
        width = atan2_fast(math.sqrt(one - cosine * cosine), cosine)
        low, high, begin, end = outside - width, outside + width, left[i], right[i]
        left[i] = high if low <= begin and high > begin else begin
        right[i] = low if high >= end and low < end else end


@inlined()
def _restrict_to(block, row, sign, k, rows, first, count, middle, left, right):
    _restrict(
        sign * block[row, k], sign * block[row + 1, k], sign * block[row + 2, k], block[row + 3, k], rows[0], rows[1],
        first, count, middle, left, right,
    )  # fmt: skip


@kernel()
def _find_spans(block, k, rows, first, count, middle, half, spans):
    """First and last azimuth of some rows at which a quad may be seen: of either triangle, and both together."""
    one, other = np.float32(1.0), np.float32(-1.0)
    for i in range(count):
        spans[0, i] = spans[2, i] = -half
        spans[1, i] = spans[3, i] = half
    for row in (A_LEFT, A_OTHER):
        _restrict_to(block, row, one, k, rows, first, count, middle, spans[0], spans[1])
    for row in (B_RIGHT, B_OTHER):
        _restrict_to(block, row, one, k, rows, first, count, middle, spans[2], spans[3])
    _restrict_to(block, CUT, one, k, rows, first, count, middle, spans[0], spans[1])
    _restrict_to(block, CUT, other, k, rows, first, count, middle, spans[2], spans[3])
    for i in range(count):
        if spans[0, i] > spans[1, i]:
            spans[0, i], spans[1, i] = spans[2, i], spans[3, i]
        elif spans[2, i] <= spans[3, i]:
            spans[0, i], spans[1, i] = min(spans[0, i], spans[2, i]), max(spans[1, i], spans[3, i])


@kernel()
def _draw_spans(block, k, number, row_first, row_last, col_first, col_last, target, face):
    """A box at most as wide as the image, row by row; columns outside of it are wrapped."""
    width, spans = target.width, np.empty((4, SPAN_ROWS), np.float32)
    radians = np.float32(2.0 * math.pi / width)
    centre = np.float32(0.5 * (col_first + col_last))
    middle, half = (centre + np.float32(0.5)) * radians - np.float32(math.pi), radians * (centre - col_first)
    for first in range(row_first, row_last + 1, SPAN_ROWS):
        count = min(SPAN_ROWS, row_last + 1 - first)
        _find_spans(block, k, target.rows, first, count, middle, np.float32(half), spans)
        for i in range(count):
            if spans[0, i] > spans[1, i]:
                continue
            left = max(col_first, np.int64(math.ceil(centre + spans[0, i] / radians - np.float32(SPAN_MARGIN))))
            right = min(col_last, np.int64(math.floor(centre + spans[1, i] / radians + np.float32(SPAN_MARGIN))))
            for turn in (-width, 0, width):
                begin, end = max(left + turn, 0), min(right + turn, width - 1)
                if begin <= end:
                    _draw_row(block, k, number, first + i, begin, end, target, face)


@inlined_contracting()
def _along(x, y, z, vector):
    return x * vector[0] + y * vector[1] + z * vector[2]


@inlined()
def _divided(vector, number):
    return vector[0] / number, vector[1] / number, vector[2] / number


@inlined()
def _outwards(gap, a, b):
    return -gap * (abs(b[0] - a[0]) + abs(b[1] - a[1]) + abs(b[2] - a[2]))


@inlined_contracting()
def exact_quad(p0, p1, p2, p3, gap):
    """Both triangles of a quad in float64: edges, by how much they reach outwards, planes, and which there are."""
    cut, left, bottom, right, top, det_a, plane_a, det_b, plane_b = split_exactly(p0, p1, p2, p3)
    return (
        cut, (left, _outwards(gap, p2, p0)), (bottom, _outwards(gap, p3, p2)), (right, _outwards(gap, p1, p3)),
        (top, _outwards(gap, p0, p1)), det_a > EDGE_ON, _divided(plane_a, det_a), det_b > EDGE_ON,
        _divided(plane_b, det_b),
    )  # fmt: skip


@inlined_contracting()
def seen_exactly(quad, x, y, z):
    """Inverse depth of such a quad on a ray, negative beside it, and 1 for its second triangle, else 0."""
    cut, left, bottom, right, top, has_a, plane_a, has_b, plane_b = quad
    side = _along(x, y, z, cut)
    seen, second = np.float32(-1.0), 0
    is_in_a = side >= 0.0 and _along(x, y, z, left[0]) >= left[1] and _along(x, y, z, bottom[0]) >= bottom[1]
    is_in_b = side <= 0.0 and _along(x, y, z, right[0]) >= right[1] and _along(x, y, z, top[0]) >= top[1]
    if has_a and is_in_a:
        seen = np.float32(max(0.0, _along(x, y, z, plane_a)))
    if has_b and is_in_b:
        other = np.float32(max(0.0, _along(x, y, z, plane_b)))
        if other > seen:
            seen, second = other, 1
    return seen, second


@kernel(fastmath={"contract"})
def _draw_float64(p0, p1, p2, p3, gap, number, row_first, row_last, col_first, col_last, target, face):
    """Both triangles of a quad against the rays in a box; columns outside the image are wrapped."""
    rows, cols = target.exact_rows, target.exact_cols
    out, width = target.inverse_depth, target.width
    quad = exact_quad(p0, p1, p2, p3, gap)
    for row in range(row_first, row_last + 1):
        sp, y = rows[0, row], rows[1, row]
        for turned in range(col_first, col_last + 1):
            col = turned + width if turned < 0 else (turned - width if turned >= width else turned)
            at = row * width + col
            seen, second = seen_exactly(quad, sp * cols[0, col], y, sp * cols[1, col])
            if seen > out[at]:
                out[at] = seen
                if face is not None:
                    face[at] = number + second


@inlined()
def _point(block, at):
    return (
        np.float64(block[X, at]), np.float64(block[Y, at]), np.float64(block[Z, at]),
        np.float64(block[INVERSE_DEPTH, at]),
    )  # fmt: skip


@inlined()
def exact_corners(block, corners, code, k):
    """Of a quad, in the order in which it is split from the first to the fourth."""
    at0, at1, at2, at3 = corners
    q0, q1, q2, q3 = _point(block, at0 + k), _point(block, at1 + k), _point(block, at2 + k), _point(block, at3 + k)
    return (q1, q3, q0, q2) if code & DIAGONAL else (q0, q1, q2, q3)


@kernel()
def draw_quads(block, corners, codes, gaps, number, target, face, begin, end):
    """The planned quads of a block in rows ``begin`` to ``end``.

    The faces of the first have ``number`` and the one after it, those of the next the next two, and go to ``face``
    unless it is None.
    """
    width = target.width
    for k in range(BLOCK):
        if block[DRAWN, k] == NOT_AT_ALL:
            continue
        col_first, col_last = np.int64(block[FIRST_COL, k]), np.int64(block[LAST_COL, k])
        if col_last - col_first >= width - 1:
            surround(block, corners, k, gaps[k] if len(gaps) > 0 else np.float32(0.0), target.height, width)
            col_first, col_last = np.int64(block[FIRST_COL, k]), np.int64(block[LAST_COL, k])
        row_first, row_last = max(np.int64(block[FIRST_ROW, k]), begin), min(np.int64(block[LAST_ROW, k]), end - 1)
        if row_first > row_last or col_first > col_last:
            continue
        is_exact_enough = block[DRAWN, k] == IN_FLOAT32 and width >= LANES
        if is_exact_enough and col_last - col_first >= SPANNED:
            if col_last - col_first >= width - 1:  # around the quad, so that spans can be cut from both ends
                col_first = np.int64(block[COL, corners[0] + k]) - width // 2
                col_last = col_first + width - 1
            _draw_spans(block, k, number + 2 * k, row_first, row_last, col_first, col_last, target, face)
        elif is_exact_enough and col_first >= 0 and col_last < width:
            if col_last - col_first < LANES // 2:
                _draw_narrow(block, k, number + 2 * k, row_first, row_last, col_first, target, face)
            else:
                _draw_wide(block, k, number + 2 * k, row_first, row_last, col_first, col_last, target, face)
        else:
            p0, p1, p2, p3 = exact_corners(block, corners, codes[k], k)
            gap = np.float64(gaps[k]) if len(gaps) > 0 else 0.0
            _draw_float64(p0, p1, p2, p3, gap, number + 2 * k, row_first, row_last, col_first, col_last, target, face)
