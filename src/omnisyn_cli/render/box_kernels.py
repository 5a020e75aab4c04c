# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""A block of quads moved into the target's frame, and where it falls in an equirectangular image, in numba."""

import math

import numpy as np

from omnisyn_cli.compute.jit import fast_kernel, inlined, kernel
from omnisyn_cli.render.quad_blocks import BLOCK
from omnisyn_cli.render.simd import LANES, load, splat, store
from omnisyn_cli.render.trigonometry import atan2_fast

__all__ = ["WIDE"]

WIDE = 0.5
"""Quads that span more than this azimuth (radians) are near a pole or the camera: all columns are searched."""

BOX_MARGIN = 0.05
"""Pixels added around boxes: more than the error of the fast arctangent and of float32 at 16384 columns."""

CLOSE = 0.5
"""An edge that reaches outwards is taken to be at least this share as near as the nearer of its ends."""

STEEP = 1.4
"""Wide quads within an angle of this (radians) have boxes all the same; for larger ones all columns are searched."""

X, Y, Z, INVERSE_DEPTH, ROW, COL = range(6)
"""Rows of a block, the numbers that kernels keep of it: its points in the frame of the target, and what pixels they
fall on."""

FIRST_ROW, LAST_ROW, FIRST_COL, LAST_COL = range(6, 10)
"""Rows with the boxes of its quads: the pixels that each can touch. Columns may lie outside the image."""

FREE = 10
"""The first row that is none of those."""

MOST_POINTS = 4 * BLOCK + 2 * LANES


@kernel()
def place_block(quads, k, pose, scale, block):
    """Write the points of block ``k`` in the frame of the target, and the pixels they fall on.

    All points go through the same instructions, so that those that quads share remain the same.

    Returns:
        Where in ``block`` the first, second, third and fourth corners begin.
    """
    r00, r01, r02, t0 = splat(pose[0][0]), splat(pose[0][1]), splat(pose[0][2]), splat(pose[0][3])
    r10, r11, r12, t1 = splat(pose[1][0]), splat(pose[1][1]), splat(pose[1][2]), splat(pose[1][3])
    r20, r21, r22, t2 = splat(pose[2][0]), splat(pose[2][1]), splat(pose[2][2]), splat(pose[2][3])
    points, corners = quads.points, quads.corners
    is_shared = corners[k, 1] == corners[k, 0] + 1
    at, count = 0, BLOCK + LANES if is_shared else BLOCK
    for corner in range(0, 4, 2 if is_shared else 1):
        begin = corners[k, corner]
        for i in range(0, count, LANES):
            x, y = load(points[0], begin + i), load(points[1], begin + i)
            z, w = load(points[2], begin + i), load(points[3], begin + i)
            store(block[X], at + i, r00 * x + (r01 * y + (r02 * z + t0 * w)))
            store(block[Y], at + i, r10 * x + (r11 * y + (r12 * z + t1 * w)))
            store(block[Z], at + i, r20 * x + (r21 * y + (r22 * z + t2 * w)))
            store(block[INVERSE_DEPTH], at + i, w)
        at += count
    _project_points(block, at, scale)
    return (0, 1, count, count + 1) if is_shared else (0, count, 2 * count, 3 * count)


@fast_kernel()
def _project_points(block, count, scale):
    """The (row, col) that the first points fall on."""
    row_scale, row_zero, col_scale, col_zero = scale
    xs, ys, zs, rows, cols = block[X], block[Y], block[Z], block[ROW], block[COL]
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
def _find_plain_boxes(block, corners, height, width):
    """Boxes of the quads of a block but for gaps; all columns where one is wide."""
    height32, width32, margin, zero = np.float32(height), np.float32(width), np.float32(BOX_MARGIN), np.float32(0.0)
    rows, cols, (at0, at1, at2, at3) = block[ROW], block[COL], corners
    row0, row1, row2, row3 = rows[at0:], rows[at1:], rows[at2:], rows[at3:]
    col0, col1, col2, col3 = cols[at0:], cols[at1:], cols[at2:], cols[at3:]
    first_row, last_row, first_col, last_col = block[FIRST_ROW], block[LAST_ROW], block[FIRST_COL], block[LAST_COL]
    for k in range(BLOCK):
        first, last, left, right, is_wide = _quad_box(
            row0[k], row1[k], row2[k], row3[k], col0[k], col1[k], col2[k], col3[k], height32, width32
        )
        first_row[k], last_row[k] = first, last
        first_col[k] = zero if is_wide else np.ceil(left - margin)
        last_col[k] = width32 - np.float32(1.0) if is_wide else np.floor(right + margin)


@inlined()
def _corner(block, at):
    """A point, and how far away it is."""
    x, y, z = block[X, at], block[Y, at], block[Z, at]
    return x, y, z, math.sqrt(x * x + y * y + z * z) + np.float32(1e-20)


@kernel()
def surround(block, corners, k, gap, height, width):
    """The box of the smallest cap around the middle of a quad: tight where it is near a pole of the target."""
    ax = ay = az = np.float32(0.0)
    nearest = np.float32(1e30)
    for corner in corners:
        x, y, z, distance = _corner(block, corner + k)
        ax, ay, az, nearest = ax + x / distance, ay + y / distance, az + z / distance, min(nearest, distance)
    length = math.sqrt(ax * ax + ay * ay + az * az) + 1e-20
    closeness = 1.0
    for corner in corners:
        x, y, z, distance = _corner(block, corner + k)
        closeness = min(closeness, (ax * x + ay * y + az * z) / (length * distance))
    radius = math.acos(max(closeness - 1e-6, -1.0)) + gap / (CLOSE * nearest)
    if radius > STEEP:
        return
    polar, azimuth = math.acos(max(-1.0, min(1.0, float(ay / length)))), math.atan2(ax, -az)
    rows, cols = height / math.pi, width / (2.0 * math.pi)
    block[FIRST_ROW, k] = max(block[FIRST_ROW, k], np.float32(math.floor((polar - radius) * rows - 0.5)))
    block[LAST_ROW, k] = min(block[LAST_ROW, k], np.float32(math.ceil((polar + radius) * rows - 0.5)))
    if radius < polar < math.pi - radius:
        reach = math.asin(min(1.0, math.sin(radius) / math.sin(polar)))
        left, right = (azimuth - reach + math.pi) * cols - 0.5, (azimuth + reach + math.pi) * cols - 0.5
        if right - left < width - 2:
            block[FIRST_COL, k], block[LAST_COL, k] = np.float32(math.floor(left)), np.float32(math.ceil(right))


@kernel()
def _widen(block, corners, k, gap, sin_p, height, width):
    """Make room for what the edges of a quad reach outwards."""
    nearest = np.float32(1e30)
    for corner in corners:
        nearest = min(nearest, _corner(block, corner + k)[3])
    angle = gap / (np.float32(CLOSE) * nearest)
    rows = np.ceil(min(angle * np.float32(height / math.pi), np.float32(height)))
    first, last = (
        max(block[FIRST_ROW, k] - rows, np.float32(0.0)),
        min(block[LAST_ROW, k] + rows, np.float32(height - 1)),
    )
    narrowest = min(sin_p[np.int64(first)], sin_p[np.int64(last)])
    cols = np.ceil(min(angle / narrowest * np.float32(width / (2.0 * math.pi)), np.float32(width)))
    left, right = block[FIRST_COL, k] - cols, block[LAST_COL, k] + cols
    if right - left >= np.float32(width - 1):
        left, right = np.float32(0.0), np.float32(width - 1)
    block[FIRST_ROW, k], block[LAST_ROW, k], block[FIRST_COL, k], block[LAST_COL, k] = first, last, left, right


@kernel()
def find_boxes(block, corners, gaps, sin_p, height, width):
    """Boxes of the quads of a placed block, with room for their ``gaps`` if there are any."""
    _find_plain_boxes(block, corners, height, width)
    for k in range(len(gaps)):
        if gaps[k] > 0.0 and block[FIRST_ROW, k] <= block[LAST_ROW, k]:
            _widen(block, corners, k, gaps[k], sin_p, height, width)
