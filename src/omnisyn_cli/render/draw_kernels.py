# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""Rasterisation of set-up quads against the rays of the pixels in their boxes, in numba.

Small boxes are tested whole, eight rays at a time. In wide ones the visible columns are found row by row first: on a
row of the target an edge function is ``P·cos(azimuth − φ) + Q``, so its inner side is an interval of azimuths, a span.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from omnisyn_cli.compute.arrays import empty
from omnisyn_cli.compute.jit import fast_subkernel, inlined, inlined_contracting, subkernel
from omnisyn_cli.compute.trigonometry import atan2_fast
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
    tighten_wide_box,
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
    EDGE_ON_DETERMINANT,
    IN_FLOAT32,
    PRECISION,
    SKIPPED_QUAD,
    split_exactly,
)
from omnisyn_cli.render.simd import LANES, broadcast, load, load_halves, pair, store, store_halves, where

# Width of a box from which on spans are found: below, testing three vectors is cheaper. Set by hand.
MIN_SPAN_COLUMNS = 24
SPAN_ROWS = 64  # rows whose spans are found together, in vectorised loops. Set by hand.
COSINE_SLACK = 1e-6  # relative error of float32 in the cosine of a span's end, by which spans are widened
SPAN_MARGIN_COLUMNS = 0.5  # added to both ends of spans: more than the error of the fast arctangent at 16384 columns


class Target(NamedTuple):
    """The image that is drawn to."""

    # sines and cosines of the polar angles; sines and negative cosines of the azimuths; float32
    rows: np.ndarray
    cols: np.ndarray
    # the same in float64
    exact_rows: np.ndarray
    exact_cols: np.ndarray
    scale: tuple[np.float32, ...]  # see :func:`omnisyn_cli.geometry.sphere.pixel_scale`
    inverse_depth: np.ndarray  # row after row
    # rows and columns
    height: int
    width: int


class Box(NamedTuple):
    """Pixels of a target, both ends included."""

    first_row: int | np.integer[Any]
    last_row: int | np.integer[Any]
    first_col: int | np.integer[Any]
    last_col: int | np.integer[Any]


@inlined()
def _edge(block, row, k, x, y, z):
    """An edge function of quad ``k`` on eight rays; not negative inside."""
    return x * broadcast(block[row, k]) + (
        z * broadcast(block[row + 2, k]) + (y * broadcast(block[row + 1, k]) + broadcast(block[row + 3, k]))
    )


@inlined()
def _plane(block, row, k, x, y, z):
    """Inverse depth of a plane on eight rays."""
    return x * broadcast(block[row, k]) + (z * broadcast(block[row + 2, k]) + y * broadcast(block[row + 1, k]))


@inlined()
def intersect_rays(block, k, x, y, z, old):
    """Inverse depth of quad ``k`` on eight rays, whether it is nearer than ``old``, and whether its triangle is A."""
    zero = broadcast(np.float32(0.0))
    in_a = _edge(block, CUT, k, x, y, z) >= zero
    side = where(in_a, _edge(block, A_LEFT, k, x, y, z), _edge(block, B_RIGHT, k, x, y, z))
    other = where(in_a, _edge(block, A_OTHER, k, x, y, z), _edge(block, B_OTHER, k, x, y, z))
    seen = where(in_a, _plane(block, A_PLANE, k, x, y, z), _plane(block, B_PLANE, k, x, y, z))
    seen = where(seen >= zero, seen, zero)
    return seen, (side >= zero) & (other >= zero) & (seen > old), in_a


@inlined()
def _edge_on_row(block, row, k, sp, cp):
    """An edge function on a row of the target: factors of sine and negative cosine of the azimuth, and a constant."""
    constant = broadcast(cp * block[row + 1, k] + block[row + 3, k])
    return broadcast(sp * block[row, k]), broadcast(sp * block[row + 2, k]), constant


@inlined()
def _plane_on_row(block, row, k, sp, cp):
    """The same of a plane."""
    return broadcast(sp * block[row, k]), broadcast(sp * block[row + 2, k]), broadcast(cp * block[row + 1, k])


@inlined()
def _evaluate(on_row, sine, minus_cosine):
    return sine * on_row[0] + (minus_cosine * on_row[1] + on_row[2])


@inlined()
def _draw_row(block, k, number, row, first_col, last_col, target, face):
    """Columns of one row, all inside the image, eight at a time; faces have ``number`` and the one after it."""
    rows, cols = target.rows, target.cols
    out, width, sp, cp = target.inverse_depth, target.width, rows[0, row], rows[1, row]
    zero, cut = broadcast(np.float32(0.0)), _edge_on_row(block, CUT, k, sp, cp)
    a_left, a_other = _edge_on_row(block, A_LEFT, k, sp, cp), _edge_on_row(block, A_OTHER, k, sp, cp)
    b_right, b_other = _edge_on_row(block, B_RIGHT, k, sp, cp), _edge_on_row(block, B_OTHER, k, sp, cp)
    a_plane, b_plane = _plane_on_row(block, A_PLANE, k, sp, cp), _plane_on_row(block, B_PLANE, k, sp, cp)
    for column in range(first_col, last_col + 1, LANES):
        # The last vector begins earlier instead of beyond the row: pixels may be tested twice.
        col = min(column, width - LANES)
        at = row * width + col
        old, sine, minus_cosine = load(out, at), load(cols[0], col), load(cols[1], col)
        in_a = _evaluate(cut, sine, minus_cosine) >= zero
        side = where(in_a, _evaluate(a_left, sine, minus_cosine), _evaluate(b_right, sine, minus_cosine))
        other = where(in_a, _evaluate(a_other, sine, minus_cosine), _evaluate(b_other, sine, minus_cosine))
        seen = where(in_a, _evaluate(a_plane, sine, minus_cosine), _evaluate(b_plane, sine, minus_cosine))
        seen = where(seen >= zero, seen, zero)
        wins = (side >= zero) & (other >= zero) & (seen > old)
        store(out, at, where(wins, seen, old))
        if face is not None:
            faces = where(in_a, broadcast(np.int32(number)), broadcast(np.int32(number + 1)))
            store(face, at, where(wins, faces, load(face, at)))


@inlined()
def _draw_box(block, k, number, box, target, face):
    """A box inside the image, eight columns of one row at a time."""
    rows, cols, out, width = target.rows, target.cols, target.inverse_depth, target.width
    for row in range(box.first_row, box.last_row + 1):
        sp, y = broadcast(rows[0, row]), broadcast(rows[1, row])
        for column in range(box.first_col, box.last_col + 1, LANES):
            col = min(column, width - LANES)
            at = row * width + col
            old = load(out, at)
            seen, wins, in_a = intersect_rays(block, k, sp * load(cols[0], col), y, sp * load(cols[1], col), old)
            store(out, at, where(wins, seen, old))
            if face is not None:
                faces = where(in_a, broadcast(np.int32(number)), broadcast(np.int32(number + 1)))
                store(face, at, where(wins, faces, load(face, at)))


@inlined()
def _draw_narrow_box(block, k, number, box, target, face):
    """A box of up to four columns: two rows at a time, so that no lane is idle."""
    rows, cols = target.rows, target.cols
    out, width = target.inverse_depth, target.width
    col = min(box.first_col, width - LANES // 2)
    sine, minus_cosine = load_halves(cols[0], col, col), load_halves(cols[1], col, col)
    for row in range(box.first_row, box.last_row + 1, 2):
        below = min(row + 1, box.last_row)
        sp, y = pair(rows[0, row], rows[0, below]), pair(rows[1, row], rows[1, below])
        at, at_below = row * width + col, below * width + col
        old = load_halves(out, at, at_below)
        seen, wins, in_a = intersect_rays(block, k, sp * sine, y, sp * minus_cosine, old)
        store_halves(out, at, at_below, where(wins, seen, old))
        if face is not None:
            faces = where(in_a, broadcast(np.int32(number)), broadcast(np.int32(number + 1)))
            store_halves(face, at, at_below, where(wins, faces, load_halves(face, at, at_below)))


@inlined()
def _edge_vector(block, row, k, sign):
    """Factors of x, y, z and the constant of an edge function; ``sign`` −1 turns its inner side round."""
    return sign * block[row, k], sign * block[row + 1, k], sign * block[row + 2, k], block[row + 3, k]


@fast_subkernel()
def _clip_row_spans(edge, rows, first, count, middle, left, right):
    """Clip the spans of ``count`` rows from ``first`` on, azimuths ``left`` to ``right``, to the inner side of an edge.

    An edge function is negative within an angle ``width`` of the azimuth ``outside``, which is opposite to its
    horizontal normal. Only what reaches an end of a span is cut off, so a span stays one interval. ``rows`` are sines
    and cosines of the polar angles of the target; the ends of spans are relative to ``middle``. For ``edge`` see
    :func:`_edge_vector`.
    """
    ex, ey, ez, offset = edge
    reach, one, pi = math.sqrt(ex * ex + ez * ez), np.float32(1.0), np.float32(math.pi)
    height = abs(ey) + abs(offset)
    outside = atan2_fast(-ex, ez) - middle
    outside = outside - np.float32(2.0 * math.pi) * np.floor((outside + pi) / np.float32(2.0 * math.pi))
    rows_sin, rows_cos = rows[0, first:], rows[1, first:]
    for i in range(count):
        scale = one / (reach * rows_sin[i] + np.float32(1e-30))
        cosine = (ey * rows_cos[i] + offset) * scale + np.float32(COSINE_SLACK) * (one + height * scale)
        cosine = min(max(cosine, -one), one)
        width = atan2_fast(math.sqrt(one - cosine * cosine), cosine)
        low, high, begin, end = outside - width, outside + width, left[i], right[i]
        left[i] = high if low <= begin and high > begin else begin
        right[i] = low if high >= end and low < end else end


@subkernel()
def _find_spans(block, k, rows, first, count, middle, half, spans):
    """First and last azimuth, relative to ``middle``, of ``count`` rows from ``first`` on at which a quad may be seen.

    ``half``: of the box's width, in radians. ``rows``: sines and cosines of the polar angles of the target. ``spans``
    ``(4, rows)``: [0, 1] are written, of both triangles together; [2, 3] are scratch.
    """
    one, other = np.float32(1.0), np.float32(-1.0)
    for i in range(count):
        spans[0, i] = spans[2, i] = -half
        spans[1, i] = spans[3, i] = half
    for row in (A_LEFT, A_OTHER):
        _clip_row_spans(_edge_vector(block, row, k, one), rows, first, count, middle, spans[0], spans[1])
    for row in (B_RIGHT, B_OTHER):
        _clip_row_spans(_edge_vector(block, row, k, one), rows, first, count, middle, spans[2], spans[3])
    _clip_row_spans(_edge_vector(block, CUT, k, one), rows, first, count, middle, spans[0], spans[1])
    _clip_row_spans(_edge_vector(block, CUT, k, other), rows, first, count, middle, spans[2], spans[3])
    for i in range(count):
        if spans[0, i] > spans[1, i]:
            spans[0, i], spans[1, i] = spans[2, i], spans[3, i]
        elif spans[2, i] <= spans[3, i]:
            spans[0, i], spans[1, i] = min(spans[0, i], spans[2, i]), max(spans[1, i], spans[3, i])


@subkernel()
def _draw_spans(block, k, number, box, target, face):
    """A box at most as wide as the image, row by row; columns outside of the image wrap."""
    width, spans = target.width, empty((4, SPAN_ROWS), np.float32)
    radians = np.float32(2.0 * math.pi / width)
    centre = np.float32(0.5 * (box.first_col + box.last_col))
    middle, half = (centre + np.float32(0.5)) * radians - np.float32(math.pi), radians * (centre - box.first_col)
    for first in range(box.first_row, box.last_row + 1, SPAN_ROWS):
        count = min(SPAN_ROWS, box.last_row + 1 - first)
        _find_spans(block, k, target.rows, first, count, middle, np.float32(half), spans)
        for i in range(count):
            if spans[0, i] > spans[1, i]:
                continue
            margin = np.float32(SPAN_MARGIN_COLUMNS)
            left = max(box.first_col, np.int64(math.ceil(centre + spans[0, i] / radians - margin)))
            right = min(box.last_col, np.int64(math.floor(centre + spans[1, i] / radians + margin)))
            for turn in (-width, 0, width):
                begin, end = max(left + turn, 0), min(right + turn, width - 1)
                if begin <= end:
                    _draw_row(block, k, number, first + i, begin, end, target, face)


@inlined_contracting()
def _dot(x, y, z, vector):
    return x * vector[0] + y * vector[1] + z * vector[2]


@inlined()
def _divide(vector, number):
    return vector[0] / number, vector[1] / number, vector[2] / number


@inlined()
def _gap_offset(gap, a, b):
    """The value of an edge function down to which a ray counts as inside: the edge reaches outwards by ``gap``."""
    return -gap * (abs(b[0] - a[0]) + abs(b[1] - a[1]) + abs(b[2] - a[2]))


@inlined_contracting()
def exact_setup(points, gap):
    """Edges with their offsets, planes, and which triangles there are, of a quad in float64."""
    p0, p1, p2, p3 = points
    cut, left, bottom, right, top, det_a, plane_a, det_b, plane_b = split_exactly(p0, p1, p2, p3)
    return (
        cut, (left, _gap_offset(gap, p2, p0)), (bottom, _gap_offset(gap, p3, p2)), (right, _gap_offset(gap, p1, p3)),
        (top, _gap_offset(gap, p0, p1)), det_a > EDGE_ON_DETERMINANT, _divide(plane_a, det_a),
        det_b > EDGE_ON_DETERMINANT, _divide(plane_b, det_b),
    )  # fmt: skip


@inlined_contracting()
def intersect_exactly(setup, x, y, z):
    """Inverse depth of an :func:`exact_setup` on a ray, negative beside it, and 1 for its second triangle, else 0."""
    cut, left, bottom, right, top, has_a, plane_a, has_b, plane_b = setup
    side = _dot(x, y, z, cut)
    seen, second = np.float32(-1.0), 0
    is_in_a = side >= 0.0 and _dot(x, y, z, left[0]) >= left[1] and _dot(x, y, z, bottom[0]) >= bottom[1]
    is_in_b = side <= 0.0 and _dot(x, y, z, right[0]) >= right[1] and _dot(x, y, z, top[0]) >= top[1]
    if has_a and is_in_a:
        seen = np.float32(max(0.0, _dot(x, y, z, plane_a)))
    if has_b and is_in_b:
        other = np.float32(max(0.0, _dot(x, y, z, plane_b)))
        if other > seen:
            seen, second = other, 1
    return seen, second


@subkernel(fastmath={"contract"})
def _draw_exactly(points, gap, number, box, target, face):
    """Both triangles of a quad in float64 against the rays in a box; columns outside the image wrap."""
    rows, cols = target.exact_rows, target.exact_cols
    out, width = target.inverse_depth, target.width
    setup = exact_setup(points, gap)
    for row in range(box.first_row, box.last_row + 1):
        sp, y = rows[0, row], rows[1, row]
        for unwrapped in range(box.first_col, box.last_col + 1):
            col = unwrapped + width if unwrapped < 0 else (unwrapped - width if unwrapped >= width else unwrapped)
            at = row * width + col
            seen, second = intersect_exactly(setup, sp * cols[0, col], y, sp * cols[1, col])
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
    """The corners of quad ``k`` in float64, in the order in which it is split from the first to the fourth."""
    at0, at1, at2, at3 = corners
    q0, q1, q2, q3 = _point(block, at0 + k), _point(block, at1 + k), _point(block, at2 + k), _point(block, at3 + k)
    return (q1, q3, q0, q2) if code & DIAGONAL else (q0, q1, q2, q3)


@subkernel()
def draw_quads(block, quads, number, target, view, face, begin, end):
    """Draw the set-up quads of a block in target rows ``begin`` to ``end``.

    ``quads``: :class:`omnisyn_cli.render.quad_blocks.PlacedQuads`. ``number``: of the first face; each quad has two.
    ``target``: :class:`Target`. ``view``: None for a panorama. ``face``: face numbers, row after row, written; None if
    nobody wants them.
    """
    width = target.width
    for k in range(BLOCK):
        if block[PRECISION, k] == SKIPPED_QUAD:
            continue
        first_col, last_col = np.int64(block[FIRST_COL, k]), np.int64(block[LAST_COL, k])
        if view is None and last_col - first_col >= width - 1:
            own_gap = quads.gaps[k] if len(quads.gaps) > 0 else np.float32(0.0)
            tighten_wide_box(block, quads.corners, k, own_gap, target.height, width)
            first_col, last_col = np.int64(block[FIRST_COL, k]), np.int64(block[LAST_COL, k])
        first_row, last_row = max(np.int64(block[FIRST_ROW, k]), begin), min(np.int64(block[LAST_ROW, k]), end - 1)
        if first_row > last_row or first_col > last_col:
            continue
        is_float32 = block[PRECISION, k] == IN_FLOAT32 and width >= LANES
        if view is None and is_float32 and last_col - first_col >= MIN_SPAN_COLUMNS:
            if last_col - first_col >= width - 1:  # centred on the quad, so that spans can be clipped at both ends
                first_col = np.int64(block[COL, quads.corners[0] + k]) - width // 2
                last_col = first_col + width - 1
            _draw_spans(block, k, number + 2 * k, Box(first_row, last_row, first_col, last_col), target, face)
            continue
        box = Box(first_row, last_row, first_col, last_col)
        if is_float32 and first_col >= 0 and last_col < width:
            if last_col - first_col < LANES // 2:
                _draw_narrow_box(block, k, number + 2 * k, box, target, face)
            else:
                _draw_box(block, k, number + 2 * k, box, target, face)
        else:
            gap = np.float64(quads.gaps[k]) if len(quads.gaps) > 0 else 0.0
            points = exact_corners(block, quads.corners, quads.codes[k], k)
            _draw_exactly(points, gap, number + 2 * k, box, target, face)
