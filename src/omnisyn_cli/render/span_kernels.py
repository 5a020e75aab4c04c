# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""Large quads against the rays of an image, row by row, in numba.

On a row of the target an edge is ``P·cos(azimuth − φ) + Q``, so the columns on its inner side are an interval. Where
those of all edges meet, rays are tested, with the row's sine and cosine folded into edges and planes.
"""

from __future__ import annotations

import math

import numpy as np

from omnisyn_cli.jit import fast_kernel, inlined, kernel
from omnisyn_cli.render.quad_kernels import A_LEFT, A_OTHER, A_PLANE, B_OTHER, B_PLANE, B_RIGHT, CUT
from omnisyn_cli.render.simd import LANES, load, splat, store, where
from omnisyn_cli.render.trigonometry import atan2_fast

__all__ = ["SPAN_ROWS", "draw_spans"]

SPAN_ROWS = 64
"""Rows whose spans are found together."""

SLACK = 1e-6
"""Relative error of float32 in the cosine of an interval's end."""

SPAN_MARGIN = 0.5
"""Columns added to both ends of spans: more than the error of the fast arctangent at 16384 columns."""


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
def _restrict_to(plan, row, sign, k, tables, first, count, middle, left, right):
    _restrict(
        sign * plan[row, k], sign * plan[row + 1, k], sign * plan[row + 2, k], plan[row + 3, k], tables[0], tables[1],
        first, count, middle, left, right,
    )  # fmt: skip


@kernel()
def _find_spans(plan, k, tables, first, count, middle, half, spans):
    """First and last azimuth of some rows at which a quad may be seen: of either triangle, and both together."""
    one, other = np.float32(1.0), np.float32(-1.0)
    for i in range(count):
        spans[0, i] = spans[2, i] = -half
        spans[1, i] = spans[3, i] = half
    for row in (A_LEFT, A_OTHER):
        _restrict_to(plan, row, one, k, tables, first, count, middle, spans[0], spans[1])
    for row in (B_RIGHT, B_OTHER):
        _restrict_to(plan, row, one, k, tables, first, count, middle, spans[2], spans[3])
    _restrict_to(plan, CUT, one, k, tables, first, count, middle, spans[0], spans[1])
    _restrict_to(plan, CUT, other, k, tables, first, count, middle, spans[2], spans[3])
    for i in range(count):
        if spans[0, i] > spans[1, i]:
            spans[0, i], spans[1, i] = spans[2, i], spans[3, i]
        elif spans[2, i] <= spans[3, i]:
            spans[0, i], spans[1, i] = min(spans[0, i], spans[2, i]), max(spans[1, i], spans[3, i])


@inlined()
def _folded(plan, row, k, sp, cp):
    """An edge as factors of sine and negative cosine of the azimuth, and a constant."""
    return splat(sp * plan[row, k]), splat(sp * plan[row + 2, k]), splat(cp * plan[row + 1, k] + plan[row + 3, k])


@inlined()
def _folded_plane(plan, row, k, sp, cp):
    return splat(sp * plan[row, k]), splat(sp * plan[row + 2, k]), splat(cp * plan[row + 1, k])


@inlined()
def _value(folded, sine, minus_cosine):
    return sine * folded[0] + (minus_cosine * folded[1] + folded[2])


@inlined()
def _draw_row(plan, k, row, col_first, col_last, tables, out, width):
    """Columns of one row, all inside the image."""
    sin_p, cos_p, sin_a, minus_cos_a = tables
    sp, cp, zero = sin_p[row], cos_p[row], splat(np.float32(0.0))
    cut = _folded(plan, CUT, k, sp, cp)
    a_left, a_other = _folded(plan, A_LEFT, k, sp, cp), _folded(plan, A_OTHER, k, sp, cp)
    b_right, b_other = _folded(plan, B_RIGHT, k, sp, cp), _folded(plan, B_OTHER, k, sp, cp)
    a_plane, b_plane = _folded_plane(plan, A_PLANE, k, sp, cp), _folded_plane(plan, B_PLANE, k, sp, cp)
    for column in range(col_first, col_last + 1, LANES):
        col = min(column, width - LANES)
        at = row * width + col
        old, sine, minus_cosine = load(out, at), load(sin_a, col), load(minus_cos_a, col)
        in_a = _value(cut, sine, minus_cosine) >= zero
        side = where(in_a, _value(a_left, sine, minus_cosine), _value(b_right, sine, minus_cosine))
        other = where(in_a, _value(a_other, sine, minus_cosine), _value(b_other, sine, minus_cosine))
        seen = where(in_a, _value(a_plane, sine, minus_cosine), _value(b_plane, sine, minus_cosine))
        seen = where(seen >= zero, seen, zero)
        store(out, at, where((side >= zero) & (other >= zero) & (seen > old), seen, old))


@kernel()
def draw_spans(plan, k, row_first, row_last, col_first, col_last, tables, out, width, spans):
    """A planned quad against the rays in a box at most as wide as the image; columns outside of it are wrapped."""
    radians = np.float32(2.0 * math.pi / width)
    centre = np.float32(0.5 * (col_first + col_last))
    middle, half = (centre + np.float32(0.5)) * radians - np.float32(math.pi), radians * (centre - col_first)
    for first in range(row_first, row_last + 1, SPAN_ROWS):
        count = min(SPAN_ROWS, row_last + 1 - first)
        _find_spans(plan, k, tables, first, count, middle, np.float32(half), spans)
        for i in range(count):
            if spans[0, i] > spans[1, i]:
                continue
            left = max(col_first, np.int64(math.ceil(centre + spans[0, i] / radians - np.float32(SPAN_MARGIN))))
            right = min(col_last, np.int64(math.floor(centre + spans[1, i] / radians + np.float32(SPAN_MARGIN))))
            if left < 0:
                _draw_row(plan, k, first + i, left + width, min(right + width, width - 1), tables, out, width)
                left = 0
            if right >= width:
                _draw_row(plan, k, first + i, max(left - width, 0), right - width, tables, out, width)
                right = width - 1
            if left <= right:
                _draw_row(plan, k, first + i, left, right, tables, out, width)
