# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""Where points and quads fall in an equirectangular image, in numba."""

from __future__ import annotations

import math

import numpy as np

from omnisyn_cli.jit import fast_kernel, inlined
from omnisyn_cli.render.trigonometry import atan2_fast

__all__ = ["WIDE", "find_boxes", "project_points"]

WIDE = 0.5
"""Quads that span more than this azimuth (radians) are near a pole or the camera: all columns are searched."""

BOX_MARGIN = 0.05
"""Pixels added around boxes: more than the error of the fast arctangent and of float32 at 16384 columns."""


@fast_kernel()
def project_points(numbers, pixels, stride, first, last, scale):
    """The (row, col) that points ``first`` to ``last`` fall on.

    ``numbers`` holds x of all points, ``stride`` further on y and z; ``pixels`` gets rows and, ``stride`` further
    on, columns.
    """
    row_scale, row_zero, col_scale, col_zero = scale[0], scale[1], scale[2], scale[3]
    count = last - first  # runs that begin at 0: no index can be negative, so the loop is vectorised
    xs, ys, zs = numbers[first:], numbers[stride + first :], numbers[2 * stride + first :]
    rows, cols = pixels[first:], pixels[stride + first :]
    for k in range(count):
        x, y, z = xs[k], ys[k], zs[k]
        rows[k] = atan2_fast(math.sqrt(x * x + z * z), y) * row_scale + row_zero
        cols[k] = atan2_fast(x, -z) * col_scale + col_zero


@inlined()
def _wrapped(difference, width):
    """A difference of columns brought into [−width/2, width/2]."""
    half = np.float32(0.5) * width
    back = difference - width if difference > half else difference
    return back + width if difference < -half else back


@inlined()
def _row_range(low, high, span, height, width):
    """Rows in which a quad with corners between rows ``low`` and ``high``, ``span`` columns wide, can be seen.

    A great circle between two points bulges towards the nearer pole: ``tan(latitude_max) = tan(latitude)/cos(span/2)``
    is at most span²/16 radians for narrow spans. Wide arcs between two northern points stay north of the southernmost.
    """
    radians = span * (np.float32(2.0 * math.pi) / width)
    margin = np.float32(BOX_MARGIN)
    bulge = radians * radians * (height * np.float32(1.1 / (16.0 * math.pi))) + margin
    middle = np.float32(0.5) * height - np.float32(0.5)
    is_wide = radians >= np.float32(WIDE)
    north = low - margin if low > middle else np.float32(-1.0)
    south = high + margin if high < middle else height
    first, last = north if is_wide else low - bulge, south if is_wide else high + bulge
    return max(np.ceil(first), np.float32(0.0)), min(np.floor(last), height - np.float32(1.0)), is_wide


@inlined()
def _quad_box(row0, row1, row2, row3, col0, col1, col2, col3, height, width):
    """First and last row, leftmost and rightmost place between columns, and whether the quad is wide."""
    zero = np.float32(0.0)
    turn1, turn2, turn3 = _wrapped(col1 - col0, width), _wrapped(col2 - col0, width), _wrapped(col3 - col0, width)
    left, right = min(min(turn1, zero), min(turn2, turn3)), max(max(turn1, zero), max(turn2, turn3))
    low, high = min(min(row0, row1), min(row2, row3)), max(max(row0, row1), max(row2, row3))
    first, last, is_wide = _row_range(low, high, right - left, height, width)
    return first, last, col0 + left, col0 + right, is_wide


@fast_kernel()
def find_boxes(pixels, stride, at0, at1, at2, at3, count, height, width, box):
    """First and last row and column that each of ``count`` quads can touch; all columns where it is wide.

    Corner i of quad k has its row at ``pixels[at{i} + k]`` and its column ``stride`` further on. Columns may lie
    outside the image.
    """
    height32, width32, margin, zero = np.float32(height), np.float32(width), np.float32(BOX_MARGIN), np.float32(0.0)
    row0, row1, row2, row3 = pixels[at0:], pixels[at1:], pixels[at2:], pixels[at3:]
    col0, col1, col2, col3 = row0[stride:], row1[stride:], row2[stride:], row3[stride:]
    for k in range(count):
        first, last, left, right, is_wide = _quad_box(
            row0[k], row1[k], row2[k], row3[k], col0[k], col1[k], col2[k], col3[k], height32, width32
        )
        box[0, k], box[1, k] = first, last
        box[2, k] = zero if is_wide else np.ceil(left - margin)
        box[3, k] = width32 - np.float32(1.0) if is_wide else np.floor(right + margin)
