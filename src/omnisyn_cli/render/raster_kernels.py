"""The loops of :mod:`omnisyn_cli.render.rasterize`, in numba.

Everything that is drawn is a quad of two triangles on the four points

::

    0 ─── 1     falling diagonal: A = (0, 3, 2), B = (0, 1, 3)
    │     │
    2 ─── 3     rising diagonal:  A = (0, 1, 2), B = (1, 3, 2)

be it a quad of the mesh, a quarter of one that is cut, or a cap (with two points at the pole and one empty triangle).
Points are float32 in memory and float64 in every product: neighbours must agree on which side of an edge a ray lies.
"""

from __future__ import annotations

import math

import numpy as np

from omnisyn_cli.jit import fast_kernel, inlined, inlined_contracting, kernel
from omnisyn_cli.render.mesh import BOTTOM, CUT_EDGES, DIAGONAL, FACES_PER_QUAD, LEFT, REMOVED, RIGHT, TOP
from omnisyn_cli.render.trigonometry import atan2_fast

__all__ = [
    "BLOCK",
    "NOTHING",
    "clear",
    "find_block_rows",
    "find_cut_rows",
    "rasterize_caps",
    "rasterize_cuts",
    "rasterize_quads",
    "transform_vertices",
]

NOTHING = -1
"""Face number of pixels that see no surface."""

EDGE_ON = 1e-13
"""Determinants below this are triangles seen edge-on: they cover nothing."""

BLOCK = 32
"""Quads of one row whose boxes are found together and that share a range of target rows."""

WIDE = 0.5
"""Quads that span more than this azimuth (radians) are near a pole or the camera: all columns are searched."""

BOX_MARGIN = 0.05
"""Pixels added around boxes: more than the error of the fast arctangent and of float32 at 16384 columns."""


@fast_kernel()
def transform_vertices(rho, sin_p, cos_p, sin_a, cos_a, rotation, translation, scale, vertices, pixels, begin, end):
    """Write v = R·d + ρ·t, ρ and the (row, col) that v falls on, for some rows; column 0 comes again at the end."""
    r = rotation.astype(np.float32)
    t = translation.astype(np.float32)
    width = rho.shape[1]
    for row in range(begin, end):
        sp, y = sin_p[row], cos_p[row]
        for col in range(width):
            x, z, w = sp * sin_a[col], -sp * cos_a[col], rho[row, col]
            vx = r[0, 0] * x + r[0, 1] * y + r[0, 2] * z + w * t[0]
            vy = r[1, 0] * x + r[1, 1] * y + r[1, 2] * z + w * t[1]
            vz = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z + w * t[2]
            vertices[0, row, col] = vx
            vertices[1, row, col] = vy
            vertices[2, row, col] = vz
            vertices[3, row, col] = w
            pixels[0, row, col] = atan2_fast(math.sqrt(vx * vx + vz * vz), vy) * scale[0] + scale[1]
            pixels[1, row, col] = atan2_fast(vx, -vz) * scale[2] + scale[3]
        for axis in range(4):
            vertices[axis, row, width] = vertices[axis, row, 0]
        for axis in range(2):
            pixels[axis, row, width] = pixels[axis, row, 0]


@inlined()
def _wrapped(difference, width):
    """A difference of columns brought into [−width/2, width/2]."""
    half = np.float32(0.5) * width
    back = difference - width if difference > half else difference
    return back + width if difference < -half else back


@inlined()
def _row_range(low, high, span, height, width):
    """Rows in which a triangle with vertices between rows ``low`` and ``high``, ``span`` columns wide, can be seen.

    A great circle between two points bulges towards the nearer pole: ``tan(latitude_max) = tan(latitude)/cos(span/2)``
    is at most span²/16 radians for narrow spans. Wide arcs between two northern points stay north of the southernmost.
    """
    radians = span * np.float32(2.0 * math.pi / width)
    if radians < WIDE:
        bulge = radians * radians * np.float32(height * (1.1 / (16.0 * math.pi))) + np.float32(BOX_MARGIN)
        return low - bulge, high + bulge
    middle = np.float32(0.5 * height - 0.5)
    north, south = np.float32(-1.0), np.float32(height)
    if high < middle:
        return north, high + np.float32(BOX_MARGIN)
    if low > middle:
        return low - np.float32(BOX_MARGIN), south
    return north, south


@kernel()
def find_block_rows(pixels, height, width, block_rows, begin, end):
    """First and last target row that each block of quads can touch."""
    width32 = np.float32(width)
    columns = pixels.shape[2] - 1
    for row in range(begin, end):
        for block in range(block_rows.shape[1]):
            low, high, span = np.float32(1e9), np.float32(-1e9), np.float32(0.0)
            for col in range(block * BLOCK, min(block * BLOCK + BLOCK, columns)):
                p0, p1 = pixels[0, row, col], pixels[0, row, col + 1]
                p2, p3 = pixels[0, row + 1, col], pixels[0, row + 1, col + 1]
                low = min(low, min(min(p0, p1), min(p2, p3)))
                high = max(high, max(max(p0, p1), max(p2, p3)))
                base = pixels[1, row, col]
                turn1 = _wrapped(pixels[1, row, col + 1] - base, width32)
                turn2 = _wrapped(pixels[1, row + 1, col] - base, width32)
                turn3 = _wrapped(pixels[1, row + 1, col + 1] - base, width32)
                left = min(min(turn1, np.float32(0.0)), min(turn2, turn3))
                right = max(max(turn1, np.float32(0.0)), max(turn2, turn3))
                span = max(span, right - left)
            first, last = _row_range(low, high, span, height, width)
            block_rows[row, block, 0] = max(0, math.ceil(first))
            block_rows[row, block, 1] = min(height - 1, math.floor(last))


@kernel()
def clear(inverse_depth, face, begin, end):
    """Nothing is seen in target rows ``begin`` to ``end``."""
    inverse_depth[begin:end] = -1.0
    face[begin:end] = NOTHING


@inlined()
def _cross(ax, ay, az, bx, by, bz):
    """The product a × b, rounded so that b × a is exactly its negative: neighbours agree on the side of every ray."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@inlined_contracting()
def _dot(ax, ay, az, bx, by, bz):
    return ax * bx + ay * by + az * bz


@kernel(fastmath={"contract"})
def _draw_quad(
    x0, y0, z0, w0, x1, y1, z1, w1, x2, y2, z2, w2, x3, y3, z3, w3, rising, face,
    row_first, row_last, col_first, col_last, sin_p, cos_p, sin_a, cos_a, out_rho, out_face,
):  # fmt: skip
    """Both triangles of a quad against the rays in a box; columns outside the image are wrapped.

    A ray with ``r·cut >= 0`` can only hit triangle A, which has the left edge, one with ``r·cut <= 0`` only B, which
    has the right one; top and bottom change sides with the diagonal. On either the inverse depth is ``r·g`` (a plane
    is linear in the ray), where g sums the edges, each weighted with the inverse depth of the corner opposite.
    """
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
    if not (has_a or has_b):
        return
    scale_a, scale_b = 1.0 / det_a, 1.0 / det_b
    a_cut, a_left, a_other = a_cut * scale_a, a_left * scale_a, a_other * scale_a
    b_cut, b_right, b_other = b_cut * scale_b, b_right * scale_b, b_other * scale_b
    ga_x, gb_x = cx * a_cut + lx * a_left + ax * a_other, rx * b_right + bx * b_other - cx * b_cut
    ga_y, gb_y = cy * a_cut + ly * a_left + ay * a_other, ry * b_right + by * b_other - cy * b_cut
    ga_z, gb_z = cz * a_cut + lz * a_left + az * a_other, rz * b_right + bz * b_other - cz * b_cut
    width = out_rho.shape[1]
    for row in range(row_first, row_last + 1):
        sp, y = sin_p[row], cos_p[row]
        for turned in range(col_first, col_last + 1):
            col = turned + width if turned < 0 else (turned - width if turned >= width else turned)
            x, z = sp * sin_a[col], -sp * cos_a[col]
            side = _dot(x, y, z, cx, cy, cz)
            in_a = has_a and side >= 0.0 and _dot(x, y, z, lx, ly, lz) >= 0.0 and _dot(x, y, z, ax, ay, az) >= 0.0
            if in_a:
                seen = np.float32(max(0.0, _dot(x, y, z, ga_x, ga_y, ga_z)))
                if seen > out_rho[row, col]:
                    out_rho[row, col] = seen
                    out_face[row, col] = face
            in_b = has_b and side <= 0.0 and _dot(x, y, z, rx, ry, rz) >= 0.0 and _dot(x, y, z, bx, by, bz) >= 0.0
            if in_b:
                seen = np.float32(max(0.0, _dot(x, y, z, gb_x, gb_y, gb_z)))
                if seen > out_rho[row, col]:
                    out_rho[row, col] = seen
                    out_face[row, col] = face + 1


@inlined()
def _find_boxes(row0, row1, col0, col1, count, height, width, box):
    """First and last target row and column of ``count`` quads between two rows of points, and whether they are wide."""
    width32, zero, margin = np.float32(width), np.float32(0.0), np.float32(BOX_MARGIN)
    wide = np.float32(WIDE * width / (2.0 * math.pi))
    for k in range(count):
        base = col0[k]
        turn1 = _wrapped(col0[k + 1] - base, width32)
        turn2, turn3 = _wrapped(col1[k] - base, width32), _wrapped(col1[k + 1] - base, width32)
        left, right = min(min(turn1, zero), min(turn2, turn3)), max(max(turn1, zero), max(turn2, turn3))
        low = min(min(row0[k], row0[k + 1]), min(row1[k], row1[k + 1]))
        high = max(max(row0[k], row0[k + 1]), max(row1[k], row1[k + 1]))
        first, last = _row_range(low, high, right - left, height, width)
        box[0, k], box[1, k] = math.ceil(first), math.floor(last)
        box[2, k], box[3, k] = math.ceil(base + left - margin), math.floor(base + right + margin)
        box[4, k] = right - left - wide


@kernel()
def rasterize_quads(quads, vertices, pixels, block_rows, sin_p, cos_p, sin_a, cos_a, out_rho, out_face, begin, end):
    """The whole quads in target rows ``begin`` to ``end``."""
    height, width = out_rho.shape
    columns = quads.shape[1]
    box = np.empty((5, BLOCK), np.float32)
    for row in range(quads.shape[0]):
        for block in range(block_rows.shape[1]):
            if block_rows[row, block, 1] < begin or block_rows[row, block, 0] >= end:
                continue
            first_col = block * BLOCK
            count = min(BLOCK, columns - first_col)
            _find_boxes(
                pixels[0, row, first_col:], pixels[0, row + 1, first_col:],
                pixels[1, row, first_col:], pixels[1, row + 1, first_col:], count, height, width, box,
            )  # fmt: skip
            for k in range(count):
                col = first_col + k
                code = quads[row, col]
                row_first, row_last = max(np.int64(box[0, k]), begin), min(np.int64(box[1, k]), end - 1)
                col_first, col_last = np.int64(box[2, k]), np.int64(box[3, k])
                if box[4, k] >= 0.0:
                    col_first, col_last = np.int64(0), np.int64(width - 1)
                if code & (REMOVED | CUT_EDGES) or row_first > row_last or col_first > col_last:
                    continue
                x0, y0, z0, w0 = _point(vertices, row, col)
                x1, y1, z1, w1 = _point(vertices, row, col + 1)
                x2, y2, z2, w2 = _point(vertices, row + 1, col)
                x3, y3, z3, w3 = _point(vertices, row + 1, col + 1)
                _draw_quad(
                    x0, y0, z0, w0, x1, y1, z1, w1, x2, y2, z2, w2, x3, y3, z3, w3,
                    (code & DIAGONAL) != 0, FACES_PER_QUAD * (row * columns + col),
                    row_first, row_last, col_first, col_last, sin_p, cos_p, sin_a, cos_a, out_rho, out_face,
                )  # fmt: skip


@inlined()
def _point(vertices, row, col):
    return (
        np.float64(vertices[0, row, col]), np.float64(vertices[1, row, col]), np.float64(vertices[2, row, col]),
        np.float64(vertices[3, row, col]),
    )  # fmt: skip


@kernel()
def _moved(v, change, t):
    """A homogeneous point whose inverse depth changes by ``change``."""
    return (v[0] + change * t[0], v[1] + change * t[1], v[2] + change * t[2])


@kernel()
def _middle(a, b):
    return (0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2]))


@kernel()
def _quarter_inverse_depths(corner, code, depths):
    """Inverse depths of a cut quad's quarter: at its corner, half way beside, half way across, at the centre.

    Half way along an edge that is not cut lies the mean of its ends, at the centre the mean of all corners that hang
    together with this one.
    """
    own, beside, across = depths[corner], depths[corner ^ 1], depths[corner ^ 2]
    cut_beside, opposite_beside = (TOP, BOTTOM) if corner < 2 else (BOTTOM, TOP)
    cut_across, opposite_across = (LEFT, RIGHT) if corner & 1 == 0 else (RIGHT, LEFT)
    total, count = own, 1.0
    if not code & cut_beside or not code & (cut_across | opposite_beside | opposite_across):
        total, count = total + beside, count + 1.0
    if not code & cut_across or not code & (cut_beside | opposite_across | opposite_beside):
        total, count = total + across, count + 1.0
    if not code & (cut_beside | opposite_across) or not code & (cut_across | opposite_beside):
        total, count = total + depths[corner ^ 3], count + 1.0
    at_beside = own if code & cut_beside else 0.5 * (own + beside)
    at_across = own if code & cut_across else 0.5 * (own + across)
    return own, at_beside, at_across, total / count


@kernel()
def _quarter(corner, code, points, depths, t):
    """Points and inverse depths of a cut quad's quarter, in the order of a quad (0, 1, 2, 3)."""
    w_own, w_beside, w_across, w_centre = _quarter_inverse_depths(corner, code, depths)
    own, beside, across = points[corner], points[corner ^ 1], points[corner ^ 2]
    mean = 0.25 * (depths[0] + depths[1] + depths[2] + depths[3])
    at_beside = _moved(_middle(own, beside), w_beside - 0.5 * (w_own + depths[corner ^ 1]), t)
    at_across = _moved(_middle(own, across), w_across - 0.5 * (w_own + depths[corner ^ 2]), t)
    at_centre = _moved(_middle(_middle(points[0], points[1]), _middle(points[2], points[3])), w_centre - mean, t)
    if corner == 0:
        return own, at_beside, at_across, at_centre, w_own, w_beside, w_across, w_centre
    if corner == 1:
        return at_beside, own, at_centre, at_across, w_beside, w_own, w_centre, w_across
    if corner == 2:
        return at_across, at_centre, own, at_beside, w_across, w_centre, w_own, w_beside
    return at_centre, at_across, at_beside, own, w_centre, w_across, w_beside, w_own


@kernel()
def _vertex(vertices, row, col):
    return np.float64(vertices[0, row, col]), np.float64(vertices[1, row, col]), np.float64(vertices[2, row, col])


@kernel()
def _corners(rho, vertices, row, col):
    """The four points of a quad and their inverse depths."""
    nxt = col + 1 if col + 1 < rho.shape[1] else 0
    points = (
        _vertex(vertices, row, col), _vertex(vertices, row, nxt),
        _vertex(vertices, row + 1, col), _vertex(vertices, row + 1, nxt),
    )  # fmt: skip
    depths = (
        np.float64(rho[row, col]), np.float64(rho[row, nxt]),
        np.float64(rho[row + 1, col]), np.float64(rho[row + 1, nxt]),
    )  # fmt: skip
    return points, depths


@kernel()
def _box(p0, p1, p2, p3, height, width):
    """First and last row and column that a quad of any four points can touch; all columns where it is wide."""
    row_scale, col_scale = np.float32(height / math.pi), np.float32(width / (2.0 * math.pi))
    low, high, left, right, base = np.float32(1e9), np.float32(-1e9), np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for index, p in enumerate((p0, p1, p2, p3)):
        x, y, z = np.float32(p[0]), np.float32(p[1]), np.float32(p[2])
        row = atan2_fast(math.sqrt(x * x + z * z), y) * row_scale - np.float32(0.5)
        col = atan2_fast(x, -z) * col_scale + np.float32(0.5 * width - 0.5)
        if index == 0:
            base = col
        turn = _wrapped(col - base, np.float32(width))
        low, high, left, right = min(low, row), max(high, row), min(left, turn), max(right, turn)
    first, last = _row_range(low, high, right - left, height, width)
    if right - left >= WIDE * col_scale:
        return math.ceil(first), math.floor(last), 0, width - 1
    margin = np.float32(BOX_MARGIN)
    first_col, last_col = math.ceil(base + left - margin), math.floor(base + right + margin)
    return math.ceil(first), math.floor(last), first_col, last_col


@kernel()
def _draw_points(
    p0, p1, p2, p3, w0, w1, w2, w3, rising, face, sin_p, cos_p, sin_a, cos_a, out_rho, out_face, begin, end
):  # fmt: skip
    """Any quad given by its points."""
    height, width = out_rho.shape
    row_first, row_last, col_first, col_last = _box(p0, p1, p2, p3, height, width)
    row_first, row_last = max(row_first, begin), min(row_last, end - 1)
    if row_first > row_last or col_first > col_last:
        return
    _draw_quad(
        p0[0], p0[1], p0[2], w0, p1[0], p1[1], p1[2], w1, p2[0], p2[1], p2[2], w2, p3[0], p3[1], p3[2], w3,
        rising, face, row_first, row_last, col_first, col_last, sin_p, cos_p, sin_a, cos_a, out_rho, out_face,
    )  # fmt: skip


@kernel()
def find_cut_rows(rho, quads, cut_quads, vertices, t, height, width, cut_rows, begin, end):
    """First and last target row that the quarters of each cut quad can touch."""
    columns = rho.shape[1]
    for k in range(begin, end):
        row, col = cut_quads[k] // columns, cut_quads[k] % columns
        points, depths = _corners(rho, vertices, row, col)
        first, last = height, -1
        for corner in range(4):
            p0, p1, p2, p3, _, _, _, _ = _quarter(corner, quads[row, col], points, depths, t)
            row_first, row_last, _, _ = _box(p0, p1, p2, p3, height, width)
            first, last = min(first, row_first), max(last, row_last)
        cut_rows[k, 0], cut_rows[k, 1] = max(0, first), min(height - 1, last)


@kernel()
def rasterize_cuts(
    rho, quads, cut_quads, cut_rows, vertices, t, sin_p, cos_p, sin_a, cos_a, out_rho, out_face, begin, end
):  # fmt: skip
    """The quarters of cut quads in target rows ``begin`` to ``end``."""
    columns = rho.shape[1]
    for k in range(len(cut_quads)):
        if cut_rows[k, 1] < begin or cut_rows[k, 0] >= end:
            continue
        row, col = cut_quads[k] // columns, cut_quads[k] % columns
        points, depths = _corners(rho, vertices, row, col)
        for corner in range(4):
            if depths[corner] < 0.0:
                continue
            p0, p1, p2, p3, w0, w1, w2, w3 = _quarter(corner, quads[row, col], points, depths, t)
            face = FACES_PER_QUAD * cut_quads[k] + 2 * corner
            _draw_points(
                p0, p1, p2, p3, w0, w1, w2, w3, corner == 1 or corner == 2, face,
                sin_p, cos_p, sin_a, cos_a, out_rho, out_face, begin, end,
            )  # fmt: skip


@kernel()
def rasterize_caps(rho, caps, vertices, rotation, t, sin_p, cos_p, sin_a, cos_a, out_rho, out_face, begin, end):
    """The fans around the poles in target rows ``begin`` to ``end``."""
    height, columns = rho.shape
    base = FACES_PER_QUAD * (height - 1) * columns
    for cap in range(2):
        ring, sign = (0, 1.0) if cap == 0 else (height - 1, -1.0)
        for col in range(columns):
            nxt = col + 1 if col + 1 < columns else 0
            if caps[cap, col, 0] < 0.0:
                continue
            w_pole = np.float64(caps[cap, col, 0])
            w_a, w_b = np.float64(caps[cap, col, 1]), np.float64(caps[cap, col, 2])
            pole = _moved((sign * rotation[0, 1], sign * rotation[1, 1], sign * rotation[2, 1]), w_pole, t)
            a = _moved(_vertex(vertices, ring, col), w_a - rho[ring, col], t)
            b = _moved(_vertex(vertices, ring, nxt), w_b - rho[ring, nxt], t)
            face = base + cap * columns + col
            if cap == 0:
                _draw_points(
                    pole, pole, a, b, w_pole, w_pole, w_a, w_b, False, face,
                    sin_p, cos_p, sin_a, cos_a, out_rho, out_face, begin, end,
                )  # fmt: skip
            else:
                _draw_points(
                    a, b, pole, pole, w_a, w_b, w_pole, w_pole, False, face - 1,
                    sin_p, cos_p, sin_a, cos_a, out_rho, out_face, begin, end,
                )  # fmt: skip
