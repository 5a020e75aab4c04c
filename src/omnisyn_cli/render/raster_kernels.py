# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""The loops of :mod:`omnisyn_cli.render.rasterize`, in numba.

Points are float32, ``(axis, row, col)`` for the vertices of a mesh and ``(axis, corner, patch)`` for patches, and are
handed to kernels flat, so that both are the same: four corners, each a run of numbers.
"""

from __future__ import annotations

import numpy as np

from omnisyn_cli.jit import fast_kernel, kernel
from omnisyn_cli.render.box_kernels import find_boxes, project_points
from omnisyn_cli.render.quad_kernels import PLAN_ROWS, draw_quads, plan_quads
from omnisyn_cli.render.quads import FACES_PER_QUAD
from omnisyn_cli.render.simd import LANES, load, store, where

__all__ = [
    "BLOCK",
    "NOTHING",
    "clear",
    "find_patch_blocks",
    "find_quad_blocks",
    "rasterize_patches",
    "rasterize_quads",
    "transform_vertices",
]

NOTHING = -1
"""Face number of pixels that see no surface."""

BLOCK = 64
"""Quads that are planned together and that share a range of target rows."""


@fast_kernel()
def transform_vertices(rho, sin_p, cos_p, sin_a, cos_a, rotation, translation, scale, vertices, pixels, begin, end):
    """Write v = R·d + ρ·t, ρ and the (row, col) that v falls on, for some rows; column 0 comes again at the end."""
    width = rho.shape[1]
    columns = vertices.shape[2]
    stride = vertices.shape[1] * columns
    flat, flat_pixels = vertices.reshape(-1), pixels.reshape(-1)
    for row in range(begin, end):
        for axis in range(3):
            sine, cosine = np.float32(rotation[axis, 0] * sin_p[row]), np.float32(-rotation[axis, 2] * sin_p[row])
            constant, shift = np.float32(rotation[axis, 1] * cos_p[row]), np.float32(translation[axis])
            for col in range(width):
                vertices[axis, row, col] = sine * sin_a[col] + constant + cosine * cos_a[col] + shift * rho[row, col]
        vertices[3, row, :width] = rho[row]
        at = row * columns
        for axis in range(4):
            vertices[axis, row, width] = vertices[axis, row, 0]
        project_points(flat, flat_pixels, stride, at, at + width + 1, scale)


@kernel()
def _find_rows(pixels, stride, at0, at1, at2, at3, count, height, width, box):
    """First and last row that any of ``count`` quads can touch, see :func:`find_boxes`."""
    box[0, count:], box[1, count:] = height, -1.0
    find_boxes(pixels, stride, at0, at1, at2, at3, count, height, width, box)
    first, last = load(box[0], 0), load(box[1], 0)
    for k in range(LANES, BLOCK, LANES):
        top, bottom = load(box[0], k), load(box[1], k)
        first, last = where(first > top, top, first), where(bottom > last, bottom, last)
    store(box[0], 0, first)
    store(box[1], 0, last)
    return np.int32(box[0, :LANES].min()), np.int32(box[1, :LANES].max())


@kernel()
def find_quad_blocks(pixels, columns, height, width, block_rows, begin, end):
    """First and last target row that each block of the rows of quads ``begin`` to ``end`` can touch."""
    row_length = pixels.shape[2]
    stride, flat = pixels.shape[1] * row_length, pixels.reshape(-1)
    box = np.empty((4, BLOCK), np.float32)
    for row in range(begin, end):
        for block in range(block_rows.shape[1]):
            count = min(BLOCK, columns - block * BLOCK)
            at = row * row_length + block * BLOCK
            below = at + row_length
            first, last = _find_rows(flat, stride, at, at + 1, below, below + 1, count, height, width, box)
            block_rows[row, block, 0], block_rows[row, block, 1] = first, last


@kernel()
def find_patch_blocks(pixels, height, width, block_rows, begin, end):
    """First and last target row that blocks ``begin`` to ``end`` of patches can touch."""
    length = pixels.shape[2]
    stride, flat = 4 * length, pixels.reshape(-1)
    box = np.empty((4, BLOCK), np.float32)
    for block in range(begin, end):
        at, count = block * BLOCK, min(BLOCK, length - block * BLOCK)
        first, last = _find_rows(
            flat, stride, at, at + length, at + 2 * length, at + 3 * length, count, height, width, box
        )
        block_rows[block, 0], block_rows[block, 1] = first, last


@kernel()
def clear(inverse_depth, face, begin, end):
    """Nothing is seen in target rows ``begin`` to ``end``."""
    inverse_depth[begin:end] = -1.0
    if face is not None:
        width = inverse_depth.shape[1]
        face[begin * width : end * width] = NOTHING


@kernel()
def rasterize_quads(
    codes, columns, vertices, pixels, block_rows, tables, exact_tables, inverse_depth, face, begin, end
):
    """The whole quads of a mesh in target rows ``begin`` to ``end``; ``codes`` are its flags, row after row.

    ``face`` is flat, or None: then only inverse depth is written.
    """
    height, width = inverse_depth.shape
    row_length = vertices.shape[2]
    stride = vertices.shape[1] * row_length
    points, places = vertices.reshape(-1), pixels.reshape(-1)
    out_rho = inverse_depth.reshape(-1)
    plan, box = np.empty((PLAN_ROWS, BLOCK), np.float32), np.empty((4, BLOCK), np.float32)
    faces = np.empty(BLOCK, np.int32)
    for row in range(block_rows.shape[0]):
        for block in range(block_rows.shape[1]):
            if block_rows[row, block, 1] < begin or block_rows[row, block, 0] >= end:
                continue
            first = row * columns + block * BLOCK
            count = min(BLOCK, columns - block * BLOCK)
            at = row * row_length + block * BLOCK
            below = at + row_length
            for k in range(count):
                faces[k] = FACES_PER_QUAD * (first + k)
            find_boxes(places, stride, at, at + 1, below, below + 1, count, height, width, box)
            plan_quads(points, stride, at, at + 1, below, below + 1, codes, None, first, count, plan)
            draw_quads(
                points, stride, at, at + 1, below, below + 1, codes, None, first, count, plan, box, faces,
                tables, exact_tables, out_rho, face, width, begin, end,
            )  # fmt: skip


@kernel()
def rasterize_patches(codes, faces, points, pixels, block_rows, tables, exact_tables, inverse_depth, face, begin, end):
    """All patches in target rows ``begin`` to ``end``; ``codes`` and ``faces`` are their flags and numbers.

    ``face`` is flat, or None: then only inverse depth is written.
    """
    height, width = inverse_depth.shape
    length = points.shape[2]
    stride = 4 * length
    flat, places = points.reshape(-1), pixels.reshape(-1)
    out_rho = inverse_depth.reshape(-1)
    plan, box = np.empty((PLAN_ROWS, BLOCK), np.float32), np.empty((4, BLOCK), np.float32)
    for block in range(block_rows.shape[0]):
        if block_rows[block, 1] < begin or block_rows[block, 0] >= end:
            continue
        at = block * BLOCK
        at1, at2, at3 = at + length, at + 2 * length, at + 3 * length
        count = min(BLOCK, len(faces) - at)
        find_boxes(places, stride, at, at1, at2, at3, count, height, width, box)
        plan_quads(flat, stride, at, at1, at2, at3, codes, None, at, count, plan)
        draw_quads(
            flat, stride, at, at1, at2, at3, codes, None, at, count, plan, box, faces[at:],
            tables, exact_tables, out_rho, face, width, begin, end,
        )  # fmt: skip
