# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""Meshes drawn on a GPU: a thread sets up a quad and tests the rays of the pixels in its box.

The nearest surface is the maximum of inverse depths, which are not negative: their bits, as an integer, have the same
order, and an atomic maximum does not mind who comes first. Large boxes, and quads that float32 is too coarse for, go to
a list, and a block of threads draws each of them. Boxes, setups and tests are those of :mod:`omnisyn_cli.render`.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import cuda

from omnisyn_cli.compute.trigonometry import atan2_fast
from omnisyn_cli.render import box_kernels as box
from omnisyn_cli.render import quad_kernels as quad
from omnisyn_cli.render.draw_kernels import exact_corners, exact_setup, intersect_exactly
from omnisyn_cli.render.quad_blocks import BLOCK, HOLE_FLAG
from omnisyn_cli.render.raster_kernels import perspective_box
from omnisyn_cli.synthesis.device.cuda_device import device_function, kernel
from omnisyn_cli.types import EDGE_TILE_COLUMNS

LARGE_BOX = 256  # pixels of a box from which on a block of threads draws it. Set by hand.
BOX_ROWS = box.FIRST_FREE_ROW  # of the scratch array of one quad, as of the processor's block of quads
UNSEEN_BITS = int(np.float32(-1.0).view(np.int32))  # bits of the inverse depth where nothing is seen
CORNERS = (0, 1, 2, 3)  # columns of the scratch array
SKIPPED_WAY, THREAD_WAY, BLOCK_WAY = 0, 1, 2  # how a quad is drawn


class DeviceQuads(NamedTuple):
    """:class:`omnisyn_cli.render.quad_blocks.QuadBlocks` on the device, with a list of quads for blocks of threads."""

    points: Any
    corners: Any
    codes: Any  # one after the other
    gaps: Any
    listed: Any
    count: Any  # how many are listed


class DeviceTarget(NamedTuple):
    """What is drawn to: all pixels of a picture, or the four samples of its edge pixels."""

    # bits of inverse depths, :data:`UNSEEN_BITS` where nothing is seen: of pixels row after row, or four for each pixel
    nearest: Any
    # see :class:`omnisyn_cli.render.draw_kernels.Target`; of twice the picture's size for samples
    rows: Any
    cols: Any
    exact_rows: Any
    exact_cols: Any
    scale: tuple[np.float32, ...]
    perspective: tuple[np.float32, ...]  # see :func:`omnisyn_cli.render.rasterize.view_of`; zeros for a panorama
    height: int
    width: int
    marks: Any  # of the pixels whose samples are drawn
    mark: int  # the bit of a mark that counts; 0 draws all pixels


@kernel(fastmath=True)
def clear(count, group):
    """Nothing is seen yet, and nothing is listed."""
    nearest, listed = group
    for number in range(cuda.grid(1), count, cuda.gridsize(1)):
        if number < len(nearest):
            nearest[number] = UNSEEN_BITS
        if number == 0:
            listed[0] = 0


@device_function
def _place_corner(points, at, pose, scale, block, k):
    """A point in the frame of the target, and its pixel."""
    (r00, r01, r02, t0), (r10, r11, r12, t1), (r20, r21, r22, t2) = pose
    row_scale, row_zero, col_scale, col_zero = scale
    px, py, pz, w = points[0, at], points[1, at], points[2, at], points[3, at]
    x = r00 * px + (r01 * py + (r02 * pz + t0 * w))
    y = r10 * px + (r11 * py + (r12 * pz + t1 * w))
    z = r20 * px + (r21 * py + (r22 * pz + t2 * w))
    block[box.X, k], block[box.Y, k], block[box.Z, k], block[box.INVERSE_DEPTH, k] = x, y, z, w
    block[box.ROW, k] = atan2_fast(np.float32(math.sqrt(x * x + z * z)), y) * row_scale + row_zero
    block[box.COL, k] = atan2_fast(x, -z) * col_scale + col_zero


@device_function
def _find_box(quads, number, pose, target, block):
    """Place a quad in the scratch array; first and last row, first and last column of its box, empty if none."""
    if quads.codes[number] & HOLE_FLAG:
        return 0, -1, 0, -1
    k, corners, height, width = number % BLOCK, number // BLOCK, target.height, target.width
    for corner in range(4):
        _place_corner(quads.points, quads.corners[corners, corner] + k, pose, target.scale, block, corner)
    gap = _gap_of(quads, number)
    if target.perspective[0] > np.float32(0.0):
        first, last, left, right = perspective_box(block, CORNERS, 0, gap, target.perspective, height, width)
        return int(first), int(last), int(left), int(right)
    rows = (block[box.ROW, 0], block[box.ROW, 1], block[box.ROW, 2], block[box.ROW, 3])
    cols = (block[box.COL, 0], block[box.COL, 1], block[box.COL, 2], block[box.COL, 3])
    first, last, left, right, is_wide = box.quad_box(rows, cols, np.float32(height), np.float32(width))
    margin = np.float32(box.BOX_MARGIN_PIXELS)
    block[box.FIRST_ROW, 0] = np.float32(max(math.ceil(first), 0))
    block[box.LAST_ROW, 0] = np.float32(min(math.floor(last), height - 1))
    block[box.FIRST_COL, 0] = np.float32(0.0) if is_wide else np.float32(math.ceil(left - margin))
    block[box.LAST_COL, 0] = np.float32(width - 1) if is_wide else np.float32(math.floor(right + margin))
    if gap > np.float32(0.0) and block[box.FIRST_ROW, 0] <= block[box.LAST_ROW, 0]:
        box.widen_box(block, CORNERS, 0, gap, target.rows[0], height, width)
    if block[box.LAST_COL, 0] - block[box.FIRST_COL, 0] >= np.float32(width - 1):
        box.tighten_wide_box(block, CORNERS, 0, gap, height, width)
    return (
        int(block[box.FIRST_ROW, 0]),
        int(block[box.LAST_ROW, 0]),
        int(block[box.FIRST_COL, 0]),
        int(block[box.LAST_COL, 0]),
    )


@device_function
def _gap_of(quads, number):
    return quads.gaps[number] if len(quads.gaps) > 0 else np.float32(0.0)


@device_function
def _size(vector):
    return abs(vector[0]) + abs(vector[1]) + abs(vector[2])


@device_function
def _square(vector):
    return vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]


@device_function
def _rounded(vector, scale):
    return np.float32(vector[0] * scale), np.float32(vector[1] * scale), np.float32(vector[2] * scale)


@device_function
def _edge(edge, is_seen, gap, a, b):
    """An edge in float32 with its offset, see :func:`omnisyn_cli.render.quad_kernels.set_up_quads`."""
    rounded = _rounded(edge, 1.0)
    length = _size((np.float32(b[0] - a[0]), np.float32(b[1] - a[1]), np.float32(b[2] - a[2])))
    outwards = quad.EDGE_OVERLAP_RADIANS * _size(rounded) + gap * length
    return rounded[0], rounded[1], rounded[2], outwards if is_seen else quad.UNREACHABLE_OFFSET


@device_function
def _set_up(quads, number, block):
    """Edges and planes of a placed quad in float32, and whether it is skipped, or float32 is too coarse."""
    p0, p1, p2, p3 = exact_corners(block, CORNERS, quads.codes[number], 0)
    cut, left, bottom, right, top, det_a, plane_a, det_b, plane_b = quad.split_exactly(p0, p1, p2, p3)
    has_a, has_b, gap = det_a > quad.EDGE_ON_DETERMINANT, det_b > quad.EDGE_ON_DETERMINANT, _gap_of(quads, number)
    scale_a, scale_b = 1.0 / det_a if has_a else 0.0, 1.0 / det_b if has_b else 0.0
    c0, c1, c2 = _rounded(cut, 1.0)
    offset = np.float32(0.0)
    if has_a != has_b:
        offset = quad.EDGE_OVERLAP_RADIANS * _size((c0, c1, c2)) * (np.float32(1.0) if has_a else np.float32(-1.0))
    setup = (
        (c0, c1, c2, offset), _edge(left, has_a, gap, p2, p0), _edge(bottom, has_a, gap, p3, p2),
        _edge(right, has_b, gap, p1, p3), _edge(top, has_b, gap, p0, p1),
        _rounded(plane_a, scale_a), _rounded(plane_b, scale_b),
    )  # fmt: skip
    farthest = max(max(_square(p0), _square(p1)), max(_square(p2), _square(p3)))
    least = max(min(min(p0[3], p1[3]), min(p2[3], p3[3])), quad.NEAR_INFINITY_INVERSE_DEPTH)
    slope = max(_square(plane_a) * scale_a * scale_a, _square(plane_b) * scale_b * scale_b)
    is_gentle = slope * farthest <= quad.MAX_FLOAT32_SLOPE * quad.MAX_FLOAT32_SLOPE * least * least
    return setup, (THREAD_WAY if is_gentle else BLOCK_WAY) if has_a or has_b else SKIPPED_WAY


@device_function
def _along(edge, x, y, z):
    return x * edge[0] + (z * edge[2] + (y * edge[1] + edge[3]))


@device_function
def _place_of(target, row, unwrapped):
    """Where the inverse depth of a pixel, or of a sample, is, and its column; −1 if that is not drawn."""
    width = target.width
    col = unwrapped + width if unwrapped < 0 else (unwrapped - width if unwrapped >= width else unwrapped)
    if target.mark == 0:
        return row * width + col, col
    begin, pixel = (row >> 1) * (width >> 1), col >> 1
    if target.marks[begin + pixel]:  # the processor draws all samples of a tile that has one of unknown depth
        first = pixel - pixel % EDGE_TILE_COLUMNS
        for other in range(first, min(first + EDGE_TILE_COLUMNS, width >> 1)):
            if target.marks[begin + other] & target.mark:
                return 4 * (begin + pixel) + 2 * (row & 1) + (col & 1), col
    return -1, col


@device_function
def _bits(inverse_depth):
    """Of an inverse depth that is not negative; a zero has to have no sign, its bits would come last."""
    return np.float32(inverse_depth if inverse_depth > np.float32(0.0) else np.float32(0.0)).view(np.int32)


@device_function
def _test(setup, target, row, unwrapped):
    """Where a quad is seen on a ray, and the bits of its inverse depth; −1 where it is not."""
    (at, col), zero = _place_of(target, row, unwrapped), np.float32(0.0)
    if at < 0:
        return at, np.int32(-1)
    cut, a_left, a_other, b_right, b_other, a_plane, b_plane = setup
    sine = target.rows[0, row]
    x, y, z = sine * target.cols[0, col], target.rows[1, row], sine * target.cols[1, col]
    in_a = _along(cut, x, y, z) >= zero
    side = _along(a_left, x, y, z) if in_a else _along(b_right, x, y, z)
    other = _along(a_other, x, y, z) if in_a else _along(b_other, x, y, z)
    plane = a_plane if in_a else b_plane
    is_seen = side >= zero and other >= zero
    return at if is_seen else -1, _bits(x * plane[0] + (z * plane[2] + y * plane[1]))


@device_function
def _test_exactly(quads, number, block, target, row, unwrapped):
    """The same in float64, for quads that few pixels show."""
    at, col = _place_of(target, row, unwrapped)
    if at < 0:
        return at, np.int32(-1)
    setup = exact_setup(exact_corners(block, CORNERS, quads.codes[number], 0), np.float64(_gap_of(quads, number)))
    sine = target.exact_rows[0, row]
    x, z = sine * target.exact_cols[0, col], sine * target.exact_cols[1, col]
    seen, _ = intersect_exactly(setup, x, target.exact_rows[1, row], z)
    return at if seen >= np.float32(0.0) else -1, _bits(seen)


@kernel
def draw(quads, pose, target):
    """Draw the quads with small boxes, a thread each, and list the others."""
    block = cuda.local.array((BOX_ROWS, 4), np.float32)
    for number in range(cuda.grid(1), len(quads.codes), cuda.gridsize(1)):
        first_row, last_row, left, right = _find_box(quads, number, pose, target, block)
        if first_row > last_row or left > right:
            continue
        setup, how = _set_up(quads, number, block)
        if how == SKIPPED_WAY:
            continue
        if how == BLOCK_WAY or (last_row - first_row + 1) * (right - left + 1) > LARGE_BOX:
            quads.listed[cuda.atomic.add(quads.count, 0, 1)] = number
            continue
        for row in range(first_row, last_row + 1):
            for col in range(left, right + 1):
                at, bits = _test(setup, target, row, col)
                if at >= 0:
                    cuda.atomic.max(target.nearest, at, bits)


@kernel
def draw_listed(quads, pose, target):
    """Draw the listed quads, a block each."""
    block = cuda.local.array((BOX_ROWS, 4), np.float32)
    for place in range(cuda.blockIdx.x, quads.count[0], cuda.gridDim.x):
        number = quads.listed[place]
        first_row, last_row, left, right = _find_box(quads, number, pose, target, block)
        setup, how = _set_up(quads, number, block)
        for row in range(first_row, last_row + 1):
            for col in range(left + cuda.threadIdx.x, right + 1, cuda.blockDim.x):
                if how == THREAD_WAY:
                    at, bits = _test(setup, target, row, col)
                else:
                    at, bits = _test_exactly(quads, number, block, target, row, col)
                if at >= 0:
                    cuda.atomic.max(target.nearest, at, bits)
