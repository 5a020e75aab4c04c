# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""The loops of :mod:`omnisyn_cli.render.simplify`, in numba.

A rectangle of quads is *flat* where the two triangles between its corners stay within a bound of inverse depth of every
vertex inside. A plane is linear in the ray: its inverse depth in direction d is ``g·d``.
"""

import math
from typing import NamedTuple

import numpy as np

from omnisyn_cli.compute.jit import inlined, kernel, subkernel
from omnisyn_cli.render.quad_blocks import BOTTOM, CUT_EDGES, LEFT, RIGHT, TOP

COVERED_CODE = 255  # mark of quads in a rectangle that begins elsewhere, and of those that are not drawn
CUT_APART = 254  # mark of cut quads that are drawn as pieces
HEIGHT_CODE = 16  # a rectangle of ``2^i × 2^j`` quads is marked ``HEIGHT_CODE·i + j`` at its first quad


@kernel()
def bound_errors(rho, tables, path, tolerance, bounds, begin, end):
    """Write by how much the inverse depth of each vertex of some rows may err; −1 where there is no surface.

    A point d/ρ seen from ``τ·path`` lies along ``d − ρτ·path``. For each unit of ρ its direction turns by at most
    ``τ|path| / |d − ρτ·path|²``, which is greatest at ``τ = 1/(ρ|path|)`` or at the end of the path.

    ``rho``, ``bounds``: ``(height, width)``. ``tables``: see :func:`omnisyn_cli.geometry.sphere.direction_tables`.
    ``path``: its end, in metres, in the panorama's frame. ``tolerance``: radians by which a vertex may be shifted.
    """
    sin_p, cos_p, sin_a, cos_a = tables
    length = math.sqrt(path[0] * path[0] + path[1] * path[1] + path[2] * path[2])
    for row in range(begin, end):
        for col in range(rho.shape[1]):
            w = rho[row, col]
            if w < 0.0:
                bounds[row, col] = -1.0
                continue
            x, y, z = sin_p[row] * sin_a[col], cos_p[row], -sin_p[row] * cos_a[col]
            share = 1.0 / (w * length) if w * length > 1.0 else 1.0
            x, y, z = x - w * share * path[0], y - w * share * path[1], z - w * share * path[2]
            bounds[row, col] = tolerance * (x * x + y * y + z * z) / (share * length) if length > 0.0 else np.inf


@inlined()
def _is_discontinuity(rho, bounds, row, col, other_row, other_col):
    """Whether the middle of an edge would err too much if its cut became a slope."""
    step = abs(rho[row, col] - rho[other_row, other_col])
    return not step <= 2.0 * min(bounds[row, col], bounds[other_row, other_col])


@kernel()
def mark_cuts(marks, quads, rho, bounds, begin, end):
    """Mark the cut quads of some rows whose cuts cannot become slopes."""
    columns = rho.shape[1]
    for row in range(begin, end):
        for col in range(columns):
            code, right = quads[row, col], (col + 1) % columns
            if marks[row, col] == COVERED_CODE or code & CUT_EDGES == 0:
                continue
            if (
                (code & TOP and _is_discontinuity(rho, bounds, row, col, row, right))
                or (code & BOTTOM and _is_discontinuity(rho, bounds, row + 1, col, row + 1, right))
                or (code & LEFT and _is_discontinuity(rho, bounds, row, col, row + 1, col))
                or (code & RIGHT and _is_discontinuity(rho, bounds, row, right, row + 1, right))
            ):
                marks[row, col] = CUT_APART


@inlined()
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined()
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined()
def _direction(tables, row, col):
    sin_p, cos_p, sin_a, cos_a = tables
    return sin_p[row] * sin_a[col], cos_p[row], -sin_p[row] * cos_a[col]


@inlined()
def _plane(a, b, c, rho_a, rho_b, rho_c):
    """The g for which ``g·d`` is the inverse depth at three directions; not a number where they are on one arc."""
    bc, ca, ab = _cross(b, c), _cross(c, a), _cross(a, b)
    scale = 1.0 / _dot(a, bc)
    return (
        scale * (rho_a * bc[0] + rho_b * ca[0] + rho_c * ab[0]),
        scale * (rho_a * bc[1] + rho_b * ca[1] + rho_c * ab[1]),
        scale * (rho_a * bc[2] + rho_b * ca[2] + rho_c * ab[2]),
    )


@inlined()
def _corners(tables, row, col, below, right):
    return (
        _direction(tables, row, col), _direction(tables, row, right),
        _direction(tables, below, col), _direction(tables, below, right),
    )  # fmt: skip


@inlined()
def _bulge(first, last, middle):
    """How far the middle of a row's vertices lies from the great circle between the outer two, in radians."""
    normal = _cross(first, last)
    return abs(_dot(normal, middle)) / math.sqrt(_dot(normal, normal))


class FlatnessTest(NamedTuple):
    """What decides whether quads may become one."""

    rho: np.ndarray  # ``(height, width)`` inverse depth of the vertices
    bounds: np.ndarray  # of its errors, see :func:`bound_errors`
    tables: tuple[np.ndarray, ...]  # see :func:`omnisyn_cli.geometry.sphere.direction_tables`
    tolerance: float  # radians by which the upper and lower edges may leave their row


@subkernel()
def _is_flat(test, row, col, height, width):
    """Whether ``height × width`` quads may become one: see the module."""
    rho, bounds, tables, tolerance = test
    columns = rho.shape[1]
    below, right, middle = row + height, (col + width) % columns, (col + width // 2) % columns
    d0, d1, d2, d3 = _corners(tables, row, col, below, right)
    if width > 1 and tolerance < max(
        _bulge(d0, d1, _direction(tables, row, middle)), _bulge(d2, d3, _direction(tables, below, middle))
    ):
        return False
    r0, r1, r2, r3 = (
        np.float64(rho[row, col]), np.float64(rho[row, right]), np.float64(rho[below, col]),
        np.float64(rho[below, right]),
    )  # fmt: skip
    if abs(r2 - r1) < abs(r0 - r3):
        cut, a, b = _cross(d1, d2), _plane(d0, d1, d2, r0, r1, r2), _plane(d1, d3, d2, r1, r3, r2)
    else:
        cut, a, b = _cross(d0, d3), _plane(d0, d3, d2, r0, r3, r2), _plane(d0, d1, d3, r0, r1, r3)
    for i in range(row, below + 1):
        for k in range(col, col + width + 1):
            j = k if k < columns else k - columns
            d = _direction(tables, i, j)
            plane = a if _dot(d, cut) >= 0.0 else b
            if not abs(_dot(d, plane) - rho[i, j]) <= bounds[i, j]:
                return False
    return True


@subkernel()
def _merge_pairs(marks, test, tall, wide, down, begin, end):
    """Join rectangles of ``2^tall × 2^wide`` quads in pairs, those below each other if ``down``, else side by side."""
    single = np.uint8(HEIGHT_CODE * tall + wide)
    joined = np.uint8(single + (HEIGHT_CODE if down else 1))
    down_by, across_by = (1 << tall if down else 0), (0 if down else 1 << wide)
    height, width = (1 << tall) + down_by, (1 << wide) + across_by
    for row in range(begin, min(end, len(marks)) - height + 1, height):
        for col in range(0, marks.shape[1] - width + 1, width):
            if marks[row, col] != single or marks[row + down_by, col + across_by] != single:
                continue
            if _is_flat(test, row, col, height, width):
                marks[row, col], marks[row + down_by, col + across_by] = joined, COVERED_CODE


@kernel()
def merge_strips(marks, test, most, begin, end):
    """Merge quads to rectangles as large as they may be, in strips ``begin`` to ``end`` of ``2^most`` rows of quads.

    First to squares, by way of rectangles twice as wide as high; then what is left to longer ones.
    """
    rows = 1 << most
    for strip in range(begin, end):
        first, last = strip * rows, (strip + 1) * rows
        for k in range(most):
            _merge_pairs(marks, test, k, k, False, first, last)
            _merge_pairs(marks, test, k, k + 1, True, first, last)
        for short in range(most):
            for long in range(short, most):
                _merge_pairs(marks, test, long, short, True, first, last)
                _merge_pairs(marks, test, short, long, False, first, last)


@inlined()
def _gap(rho, tables, first, last, row_step, col_step, count, reach):
    """How far vertices between two corners may be seen outside of the edge between them, from anywhere on the path."""
    columns = rho.shape[1]
    a, b = _direction(tables, first[0], first[1]), _direction(tables, last[0], last[1])
    normal = _cross(a, b)
    length = math.sqrt(_dot(normal, normal))
    widest = 0.0
    for k in range(1, count):
        i, j = first[0] + k * row_step, (first[1] + k * col_step) % columns
        d = _direction(tables, i, j)
        along_a, along_b = _dot(_cross(d, b), normal) / length**2, _dot(_cross(a, d), normal) / length**2
        error = rho[i, j] - along_a * rho[first[0], first[1]] - along_b * rho[last[0], last[1]]
        widest = max(widest, max(0.0, -_dot(normal, d) / length) + abs(error) * reach)
    return widest


@inlined()
def _widest_step(rho, quads, row, col, height, width):
    """Largest step of inverse depth at a cut on the rim of a rectangle."""
    columns = rho.shape[1]
    step = 0.0
    for k in range(width):
        i, j = (col + k) % columns, (col + k + 1) % columns
        if quads[row, i] & TOP:
            step = max(step, abs(rho[row, i] - rho[row, j]))
        if quads[row + height - 1, i] & BOTTOM:
            step = max(step, abs(rho[row + height, i] - rho[row + height, j]))
    right, beyond = (col + width - 1) % columns, (col + width) % columns
    for i in range(row, row + height):
        if quads[i, col] & LEFT:
            step = max(step, abs(rho[i, col] - rho[i + 1, col]))
        if quads[i, right] & RIGHT:
            step = max(step, abs(rho[i, beyond] - rho[i + 1, beyond]))
    return step


@kernel()
def measure_gaps(rho, quads, tables, rectangles, reach, gaps, begin, end):
    """Widest crack, in radians times distance, that rectangles could leave along their edges.

    ``reach`` is the length of the path. Beside a cut, pieces of the neighbours end half a step above or below the edge.
    """
    columns = rho.shape[1]
    for k in range(begin, end):
        row, col, height, width = rectangles[k]
        below, right = row + height, (col + width) % columns
        top_left, top_right, bottom_left, bottom_right = (row, col), (row, right), (below, col), (below, right)
        zero, one = np.int64(0), np.int64(1)  # no literals, for each of which numba compiles anew
        widest = _gap(rho, tables, top_left, top_right, zero, one, width, reach)
        widest = max(widest, _gap(rho, tables, bottom_right, bottom_left, zero, columns - 1, width, reach))
        widest = max(widest, _gap(rho, tables, bottom_left, top_left, -one, zero, height, reach))
        widest = max(widest, _gap(rho, tables, top_right, bottom_right, one, zero, height, reach))
        gaps[k] = widest + 0.5 * reach * _widest_step(rho, quads, row, col, height, width)
