"""Quads: their flags, the quarters of cut ones, and blocks of quads to be drawn.

A quad of two triangles lies between four points: top left, top right, bottom left, bottom right. A quad with a cut edge
is not thrown away: each corner keeps the quarter of the quad that belongs to its own pixel, at its own inverse depth,
joined to the quarters of the corners that it is still connected with.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Integer, UInt8

TOP, RIGHT, BOTTOM, LEFT = 1, 2, 4, 8
CUT_EDGES = TOP | RIGHT | BOTTOM | LEFT
"""Flags of a quad: which of its edges are cut."""
DIAGONAL = 16  # flag of a quad that is split from bottom left to top right; without it, from top left to bottom right
HOLE_FLAG = 32  # flag of a quad that is not drawn
FACES_PER_QUAD = 8
FACES_PER_QUARTER = 2  # triangles, at most: two in each of the four quarters of a quad with cut edges

BLOCK = 64  # quads that are set up together, and culled together by their range of target pixels. Set by hand.
_CLOCKWISE_CORNERS = (0, 1, 3, 2)  # the corners of a quad; the edge after the k-th of them is bit k of its flags


def _mean_of(*places: int) -> np.ndarray:
    """Weights of the four corners in the mean of those at some places, counted clockwise."""
    return np.bincount([_CLOCKWISE_CORNERS[place % 4] for place in places], minlength=4) / len(places)


def _whole_edges(code: int, place: int, step: int) -> int:
    """How many successive edges from a corner on, at most three, are not cut."""
    edges = [(place + k) % 4 if step > 0 else (place - 1 - k) % 4 for k in range(3)]
    return next((k for k, edge in enumerate(edges) if code & 1 << edge), 3)


def _quarter_weights() -> tuple[np.ndarray, np.ndarray]:
    directions, inverse_depths = np.empty((4, 4, 4)), np.empty((CUT_EDGES + 1, 4, 4, 4))
    for place, corner in enumerate(_CLOCKWISE_CORNERS):
        own, middle = _mean_of(place), _mean_of(*range(4))
        directions[corner] = own, _mean_of(place, place + 1), _mean_of(place, place - 1), middle
        for code in range(CUT_EDGES + 1):
            ahead, behind = _whole_edges(code, place, 1), _whole_edges(code, place, -1)
            joined = {(place + k) % 4 for k in range(-behind, ahead + 1)}
            inverse_depths[code, corner] = (
                _mean_of(place), _mean_of(place, place + min(ahead, 1)), _mean_of(place, place - min(behind, 1)),
                _mean_of(*joined),
            )  # fmt: skip
    return directions, inverse_depths


# Weights of the corners of a cut quad in the points of its quarters: ``(quarter, point, corner)`` for directions,
# ``(cut edges, quarter, point, corner)`` for inverse depths. A quarter is itself a quad, split from its first to its
# fourth point: its own corner, the middles of the edges after and before it (clockwise), and the middle of the quad.
QUARTER_DIRECTIONS, QUARTER_INVERSE_DEPTHS = _quarter_weights()


class QuadBlocks(NamedTuple):
    """Quads to be drawn, in blocks of :data:`BLOCK`; kernels take it as it is."""

    # x, y, z of a direction in the frame of the panorama, of any length, and inverse depth, of all points
    points: Float32[np.ndarray, "4 points"]
    # of each block, where in ``points`` the runs of first, second, third and fourth corners begin. Where the second run
    # begins one after the first, and the fourth after the third, two runs are shared: quads of a row of a grid.
    corners: Integer[np.ndarray, "blocks 4"]
    # flags :data:`DIAGONAL` and :data:`HOLE_FLAG` of each quad; blocks are padded with removed quads
    codes: UInt8[np.ndarray, "blocks quads"]
    # radians times distance by which the edges of each quad reach outwards; empty if none does
    gaps: Float32[np.ndarray, " all_quads"]


class PlacedQuads(NamedTuple):
    """The quads of one block after their points were transformed."""

    corners: tuple[int, int, int, int]  # where in the scratch array the first, second, third and fourth corners begin
    codes: np.ndarray  # flags, see :class:`QuadBlocks`
    gaps: np.ndarray  # likewise; empty where no edge reaches outwards


NO_GAPS = np.empty(0, np.float32)  # of a mesh without cut edges


def empty_blocks(count: int, shared_points: int = 0, shared_blocks: int = 0) -> QuadBlocks:
    """Blocks for quads with own points, after points and blocks that the caller fills; all quads are removed."""
    blocks = -(-count // BLOCK)
    corners = np.empty((shared_blocks + blocks, 4), np.int64)
    corners[shared_blocks:] = shared_points + BLOCK * np.arange(4 * blocks).reshape(blocks, 4)
    codes = np.full((len(corners), BLOCK), HOLE_FLAG, np.uint8)
    return QuadBlocks(np.zeros((4, shared_points + 4 * BLOCK * blocks), np.float32), corners, codes, NO_GAPS)


def write_quads(
    blocks: QuadBlocks, shared_blocks: int, first: int,
    points: Float[np.ndarray, "quads 4 4"], codes: UInt8[np.ndarray, " quads"],
) -> None:  # fmt: skip
    """Write quads with points of their own, and their flags, after ``shared_blocks`` blocks of the caller.

    ``first`` is the index of the first one among those. Points are x, y, z and inverse depth of four corners of each
    quad.
    """
    block, place = np.divmod(first + np.arange(len(codes)), BLOCK)
    count = len(blocks.codes) - shared_blocks
    own = blocks.points[:, blocks.points.shape[1] - 4 * BLOCK * count :].reshape(4, count, 4, BLOCK)
    own[:, block, :, place] = points.transpose(0, 2, 1)
    blocks.codes[shared_blocks + block, place] = codes


def pack_quads(
    points: Float[np.ndarray, "quads 4 4"], codes: UInt8[np.ndarray, " quads"], gaps: Float[np.ndarray, " quads"]
) -> QuadBlocks:
    """Blocks of quads with points of their own, and with gaps."""
    blocks = empty_blocks(len(codes))
    write_quads(blocks, 0, 0, points, codes)
    return blocks._replace(gaps=np.append(gaps, np.zeros(blocks.codes.size - len(gaps))).astype(np.float32))
