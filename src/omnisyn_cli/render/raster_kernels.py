# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""The loops of :mod:`omnisyn_cli.render.rasterize`, in numba.

A block of quads goes through all steps in buffers that fit into the nearest cache: its points are moved into the
target's frame and projected, boxes are found, edges and planes are planned, rays are tested.
"""

import numpy as np

from omnisyn_cli.compute.jit import fast_kernel, inlined, kernel
from omnisyn_cli.render.box_kernels import (
    FIRST_COL,
    FIRST_ROW,
    LAST_COL,
    LAST_ROW,
    MOST_POINTS,
    find_boxes,
    place_block,
)
from omnisyn_cli.render.draw_kernels import draw_quads
from omnisyn_cli.render.quad_blocks import BLOCK
from omnisyn_cli.render.quad_kernels import BLOCK_ROWS, plan_quads

__all__ = ["rasterize_blocks"]

NOTHING = -1
"""Face number of pixels that see no surface."""


@kernel()
def find_block_bounds(quads, pose, target, boxes, begin, end):
    """First and last target row, first and last column that blocks ``begin`` to ``end`` can touch."""
    block = np.empty((BLOCK_ROWS, MOST_POINTS), np.float32)
    for k in range(begin, end):
        corners = place_block(quads, k, pose, target.scale, block)
        find_boxes(block, corners, quads.gaps[BLOCK * k : BLOCK * (k + 1)], target.rows[0], target.height, target.width)
        _keep_box(block, boxes, k)


@inlined()
def _keep_box(block, boxes, k):
    boxes[k, 0], boxes[k, 1] = _range(block[FIRST_ROW], block[LAST_ROW])
    boxes[k, 2], boxes[k, 3] = _range(block[FIRST_COL], block[LAST_COL])


@fast_kernel()
def _range(first, last):
    """The smallest and the largest of the rows of a block's quads: a loop of vectors, which numpy's is not."""
    smallest, largest = first[0], last[0]
    for k in range(1, BLOCK):
        smallest, largest = min(smallest, first[k]), max(largest, last[k])
    return np.int32(smallest), np.int32(largest)


@kernel()
def rasterize_blocks(quads, boxes, pose, target, face, begin, end):
    """All quads in target rows ``begin`` to ``end``.

    ``boxes`` are those of :func:`find_block_bounds`; they are written where all rows are drawn. Unless ``face`` is None
    it gets twice the place of the quad that is seen, plus one for its second triangle.
    """
    target.inverse_depth[begin * target.width : end * target.width] = -1.0
    if face is not None:
        face[begin * target.width : end * target.width] = NOTHING
    block = np.empty((BLOCK_ROWS, MOST_POINTS), np.float32)
    is_whole = begin == 0 and end == target.height
    for k in range(len(boxes)):
        if is_whole or (boxes[k, 0] < end and boxes[k, 1] >= begin):
            codes, gaps = quads.codes[k], quads.gaps[BLOCK * k : BLOCK * (k + 1)]
            corners = place_block(quads, k, pose, target.scale, block)
            find_boxes(block, corners, gaps, target.rows[0], target.height, target.width)
            if is_whole:
                _keep_box(block, boxes, k)
            plan_quads(block, corners, codes, gaps, 0, BLOCK)
            draw_quads(block, corners, codes, gaps, 2 * BLOCK * k, target, face, begin, end)
