# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""Bounding boxes, in numba: a block of quads in the target's frame, and the pixels that each quad can touch."""

import math

import numpy as np

from omnisyn_cli.compute.jit import fast_subkernel, inlined, kernel, subkernel
from omnisyn_cli.compute.trigonometry import atan2_fast
from omnisyn_cli.render.quad_blocks import BLOCK, PlacedQuads
from omnisyn_cli.render.simd import LANES, broadcast, load, store

# Quads that span more azimuth than this are near a pole or the camera: their boxes have all columns. Set by hand.
WIDE_QUAD_RADIANS = 0.5
# Added around boxes: more than the error of the fast arctangent and of float32 at 16384 columns.
BOX_MARGIN_PIXELS = 0.05
# Points of an edge are assumed to be at least this share as far as the nearer of its ends. Set by hand.
MIN_EDGE_DISTANCE_RATIO = 0.5
# Wide quads inside a spherical cap of at most this radius get a tight box after all. Set by hand, below π/2.
MAX_CAP_RADIANS = 1.4

# Rows of a block, the scratch array of 64 quads: points in the frame of the target, and the pixels they project to.
X, Y, Z, INVERSE_DEPTH, ROW, COL = range(6)
# Rows with the boxes of the quads. Columns may lie outside the image: then they wrap.
FIRST_ROW, LAST_ROW, FIRST_COL, LAST_COL = range(6, 10)
FIRST_FREE_ROW = 10  # the first row for others
MAX_BLOCK_POINTS = 4 * BLOCK + 2 * LANES  # corners of a block's quads, and room for two more vectors


@subkernel()
def place_quads(quads, k, pose, scale, block):
    """Transform the points of block ``k`` of quads into the frame of the target, and project them to pixels.

    All points go through the same instructions, so that points which quads share stay identical. ``pose`` has three
    rows of a rotation with the shift behind them, target from panorama. For ``scale`` see
    :func:`omnisyn_cli.geometry.sphere.pixel_scale`. ``block`` is written. Returns
    :class:`omnisyn_cli.render.quad_blocks.PlacedQuads`.
    """
    r00, r01, r02, t0 = broadcast(pose[0][0]), broadcast(pose[0][1]), broadcast(pose[0][2]), broadcast(pose[0][3])
    r10, r11, r12, t1 = broadcast(pose[1][0]), broadcast(pose[1][1]), broadcast(pose[1][2]), broadcast(pose[1][3])
    r20, r21, r22, t2 = broadcast(pose[2][0]), broadcast(pose[2][1]), broadcast(pose[2][2]), broadcast(pose[2][3])
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
    begins = (0, 1, count, count + 1) if is_shared else (0, count, 2 * count, 3 * count)
    return PlacedQuads(begins, quads.codes[k], quads.gaps[BLOCK * k : BLOCK * (k + 1)])


@fast_subkernel()
def _project_points(block, count, scale):
    """Project the first ``count`` points to (row, col)."""
    row_scale, row_zero, col_scale, col_zero = scale
    xs, ys, zs, rows, cols = block[X], block[Y], block[Z], block[ROW], block[COL]
    for k in range(count):
        x, y, z = xs[k], ys[k], zs[k]
        rows[k] = atan2_fast(math.sqrt(x * x + z * z), y) * row_scale + row_zero
        cols[k] = atan2_fast(x, -z) * col_scale + col_zero


@inlined()
def _wrapped(difference, width):
    """A difference of columns, wrapped into [−width/2, width/2]."""
    half = np.float32(0.5) * width
    back = difference - width if difference > half else difference
    return back + width if difference < -half else back


@inlined()
def _row_range(low, high, span, height, width):
    """Rows in which a quad with corners between rows ``low`` and ``high``, ``span`` columns wide, can be seen.

    A great circle between two points bulges towards the nearer pole: ``tan(latitude_max) = tan(latitude)/cos(span/2)``.
    That is at most span²/16 radians for narrow spans; 1.1 is the margin for the higher orders. Wide arcs between two
    northern points stay north of the southernmost.
    """
    radians = span * (np.float32(2.0 * math.pi) / width)
    margin = np.float32(BOX_MARGIN_PIXELS)
    bulge = radians * radians * (height * np.float32(1.1 / (16.0 * math.pi))) + margin
    middle = np.float32(0.5) * height - np.float32(0.5)
    is_wide = radians >= np.float32(WIDE_QUAD_RADIANS)
    north = low - margin if low > middle else np.float32(-1.0)
    south = high + margin if high < middle else height
    first, last = north if is_wide else low - bulge, south if is_wide else high + bulge
    return first, last, is_wide


@inlined()
def quad_box(rows, cols, height, width):
    """First and last row, leftmost and rightmost column, none of them rounded, and whether the quad is wide."""
    zero, (row0, row1, row2, row3), (col0, col1, col2, col3) = np.float32(0.0), rows, cols
    turn1, turn2, turn3 = _wrapped(col1 - col0, width), _wrapped(col2 - col0, width), _wrapped(col3 - col0, width)
    left, right = min(min(turn1, zero), min(turn2, turn3)), max(max(turn1, zero), max(turn2, turn3))
    low, high = min(min(row0, row1), min(row2, row3)), max(max(row0, row1), max(row2, row3))
    first, last, is_wide = _row_range(low, high, right - left, height, width)
    return first, last, col0 + left, col0 + right, is_wide


@fast_subkernel()
def _find_boxes_without_gaps(block, corners, height, width):
    """Boxes of the quads of a block, without room for gaps; all columns where a quad is wide."""
    height32, width32 = np.float32(height), np.float32(width)
    margin, zero = np.float32(BOX_MARGIN_PIXELS), np.float32(0.0)
    rows, cols, (at0, at1, at2, at3) = block[ROW], block[COL], corners
    row0, row1, row2, row3 = rows[at0:], rows[at1:], rows[at2:], rows[at3:]
    col0, col1, col2, col3 = cols[at0:], cols[at1:], cols[at2:], cols[at3:]
    first_row, last_row, first_col, last_col = block[FIRST_ROW], block[LAST_ROW], block[FIRST_COL], block[LAST_COL]
    for k in range(BLOCK):
        first, last, left, right, is_wide = quad_box(
            (row0[k], row1[k], row2[k], row3[k]), (col0[k], col1[k], col2[k], col3[k]), height32, width32
        )
        first_row[k] = max(np.ceil(first), zero)
        last_row[k] = min(np.floor(last), height32 - np.float32(1.0))
        first_col[k] = zero if is_wide else np.ceil(left - margin)
        last_col[k] = width32 - np.float32(1.0) if is_wide else np.floor(right + margin)


@inlined()
def _corner(block, at):
    """A point, and its distance."""
    x, y, z = block[X, at], block[Y, at], block[Z, at]
    return x, y, z, math.sqrt(x * x + y * y + z * z) + np.float32(1e-20)


@subkernel()
def tighten_wide_box(block, corners, k, gap, height, width):
    """Shrink the box of a wide quad to that of a spherical cap around its middle; tight near a pole of the target.

    A cap that does not hold a pole spans the azimuths ``± asin(sin radius / sin polar)``.
    """
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
    radius = math.acos(max(closeness - 1e-6, -1.0)) + gap / (MIN_EDGE_DISTANCE_RATIO * nearest)
    if radius > MAX_CAP_RADIANS:
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
def widen_box(block, corners, k, gap, sin_p, height, width):
    """Widen a box by the gap of its quad: an angle is more columns near a pole."""
    nearest = np.float32(1e30)
    for corner in corners:
        nearest = min(nearest, _corner(block, corner + k)[3])
    angle = gap / (np.float32(MIN_EDGE_DISTANCE_RATIO) * nearest)
    rows = np.float32(math.ceil(min(angle * np.float32(height / math.pi), np.float32(height))))
    first = max(block[FIRST_ROW, k] - rows, np.float32(0.0))
    last = min(block[LAST_ROW, k] + rows, np.float32(height - 1))
    narrowest = min(sin_p[np.int64(first)], sin_p[np.int64(last)])
    cols = np.float32(math.ceil(min(angle / narrowest * np.float32(width / (2.0 * math.pi)), np.float32(width))))
    left, right = block[FIRST_COL, k] - cols, block[LAST_COL, k] + cols
    if right - left >= np.float32(width - 1):
        left, right = np.float32(0.0), np.float32(width - 1)
    block[FIRST_ROW, k], block[LAST_ROW, k], block[FIRST_COL, k], block[LAST_COL, k] = first, last, left, right


@subkernel()
def find_quad_boxes(block, quads, sin_p, height, width):
    """Boxes of the quads of a transformed block, which is changed, with room for their gaps if there are any.

    ``quads``: :class:`omnisyn_cli.render.quad_blocks.PlacedQuads`. ``sin_p``: sines of the polar angles of the target.
    """
    _find_boxes_without_gaps(block, quads.corners, height, width)
    for k in range(len(quads.gaps)):
        if quads.gaps[k] > 0.0 and block[FIRST_ROW, k] <= block[LAST_ROW, k]:
            widen_box(block, quads.corners, k, quads.gaps[k], sin_p, height, width)
