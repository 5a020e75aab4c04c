# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""The loops of :mod:`omnisyn_cli.render.rasterize`, in numba.

A block of quads goes through all steps in a scratch array that fits into the L1 cache: its points are transformed into
the target's frame and projected, boxes are found, edges and planes are set up, rays are tested.
"""

import numpy as np

from omnisyn_cli.compute.arrays import empty
from omnisyn_cli.compute.jit import fast_subkernel, inlined, kernel
from omnisyn_cli.render.box_kernels import (
    FIRST_COL,
    FIRST_ROW,
    LAST_COL,
    LAST_ROW,
    MAX_BLOCK_POINTS,
    find_quad_boxes,
    place_quads,
)
from omnisyn_cli.render.draw_kernels import draw_quads
from omnisyn_cli.render.quad_blocks import BLOCK
from omnisyn_cli.render.quad_kernels import BLOCK_ROWS, set_up_quads

NO_FACE = -1  # face number of pixels that see no surface


@kernel()
def find_block_bounds(quads, pose, target, boxes, begin, end):
    """Write first and last target row, first and last column that blocks ``begin`` to ``end`` can touch."""
    block = empty((BLOCK_ROWS, MAX_BLOCK_POINTS), np.float32)
    for k in range(begin, end):
        placed = place_quads(quads, k, pose, target.scale, block)
        find_quad_boxes(block, placed, target.rows[0], target.height, target.width)
        _write_bounds(block, boxes, k)


@inlined()
def _write_bounds(block, boxes, k):
    boxes[k, 0], boxes[k, 1] = _range(block[FIRST_ROW], block[LAST_ROW])
    boxes[k, 2], boxes[k, 3] = _range(block[FIRST_COL], block[LAST_COL])


@fast_subkernel()
def _range(first, last):
    """Minimum and maximum over the quads of a block; LLVM vectorises this loop, but not numpy's reductions."""
    smallest, largest = first[0], last[0]
    for k in range(1, BLOCK):
        smallest, largest = min(smallest, first[k]), max(largest, last[k])
    return np.int32(smallest), np.int32(largest)


@kernel()
def rasterize_blocks(quads, boxes, pose, target, face, begin, end):
    """Draw all quads in rows ``begin`` to ``end`` of :class:`omnisyn_cli.render.draw_kernels.Target`.

    ``boxes``: of :func:`find_block_bounds`; written if all rows are drawn at once. ``pose``: three rows of a rotation
    with the shift behind them, target from panorama. ``face``: written, twice the index of the quad that is seen, plus
    one for its second triangle; None if nobody wants it.
    """
    target.inverse_depth[begin * target.width : end * target.width] = -1.0
    if face is not None:
        face[begin * target.width : end * target.width] = NO_FACE
    block = empty((BLOCK_ROWS, MAX_BLOCK_POINTS), np.float32)
    is_whole = begin == 0 and end == target.height
    for k in range(len(boxes)):
        if is_whole or (boxes[k, 0] < end and boxes[k, 1] >= begin):
            placed = place_quads(quads, k, pose, target.scale, block)
            find_quad_boxes(block, placed, target.rows[0], target.height, target.width)
            if is_whole:
                _write_bounds(block, boxes, k)
            set_up_quads(block, placed, np.int64(0), np.int64(BLOCK))  # types as elsewhere: compiled once
            draw_quads(block, placed, 2 * BLOCK * k, target, face, begin, end)
