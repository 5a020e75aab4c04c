"""Quads: the byte of one, what is left of a cut one, and lists of them that are drawn.

Quads of two triangles lie between four points: top left, top right, bottom left, bottom right. A quad with a cut edge
is not thrown away: each corner keeps the quarter of the quad that belongs to its own pixel, at its own inverse depth,
joined to those of the corners that it still hangs together with.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Integer, UInt8

__all__ = ["BOTTOM", "FACES_PER_QUARTER", "LEFT", "QUARTER_DIRECTIONS", "QUARTER_INVERSE_DEPTHS", "TOP"]

TOP, RIGHT, BOTTOM, LEFT = 1, 2, 4, 8
CUT_EDGES = TOP | RIGHT | BOTTOM | LEFT
"""Bits of a quad's byte: which of its edges are cut."""
DIAGONAL = 16
"""Set where the quad is split from bottom left to top right, clear from top left to bottom right."""
REMOVED = 32
"""Set where nothing of the quad is drawn."""
FACES_PER_QUAD = 8
FACES_PER_QUARTER = 2

BLOCK = 64
"""Quads that are planned together and that share a range of target rows."""

_CLOCKWISE = (0, 1, 3, 2)
"""The corners of a quad; the edge after the k-th of them is bit k of its byte."""


def _mean_of(*places: int) -> np.ndarray:
    """Weights of the corners at these places of the way around a quad."""
    return np.bincount([_CLOCKWISE[place % 4] for place in places], minlength=4) / len(places)


def _whole_edges(code: int, place: int, step: int) -> int:
    """How many edges from a corner on, at most three, are not cut."""
    edges = [(place + k) % 4 if step > 0 else (place - 1 - k) % 4 for k in range(3)]
    return next((k for k, edge in enumerate(edges) if code & 1 << edge), 3)


def _quarter_weights() -> tuple[np.ndarray, np.ndarray]:
    directions, inverse_depths = np.empty((4, 4, 4)), np.empty((CUT_EDGES + 1, 4, 4, 4))
    for place, corner in enumerate(_CLOCKWISE):
        directions[corner] = (
            _mean_of(place),
            _mean_of(place, place + 1),
            _mean_of(place, place - 1),
            _mean_of(*range(4)),
        )
        for code in range(CUT_EDGES + 1):
            ahead, behind = _whole_edges(code, place, 1), _whole_edges(code, place, -1)
            joined = {(place + k) % 4 for k in range(-behind, ahead + 1)}
            inverse_depths[code, corner] = (
                _mean_of(place), _mean_of(place, place + min(ahead, 1)), _mean_of(place, place - min(behind, 1)),
                _mean_of(*joined),
            )  # fmt: skip
    return directions, inverse_depths


QUARTER_DIRECTIONS, QUARTER_INVERSE_DEPTHS = _quarter_weights()
"""How the points of the quarters of a cut quad follow from its corners.

``(quarter, point, corner)`` for directions, ``(code of cut edges, quarter, point, corner)`` for inverse depths. The
points of a quarter are those of a quad that is split from top left to bottom right: its own corner, the middles of the
edges after and before it (clockwise), and the middle of the quad.
"""


class QuadBlocks(NamedTuple):
    """A list of quads in blocks of :data:`BLOCK` that are drawn together; kernels take it as it is.

    Attributes:
        points: x, y, z of a direction in the frame of the panorama, of any length, and inverse depth, of all points.
        corners: of each block, where in ``points`` the runs of first, second, third and fourth corners begin. Where
            the second run begins one after the first, and the fourth after the third, two runs are shared: quads of a
            row of a grid.
        codes: :data:`DIAGONAL` and :data:`REMOVED` of each quad; blocks are filled up with quads that are not drawn.
        gaps: radians times relative distance by which the edges of quads reach outwards; empty where none does.
    """

    points: Float32[np.ndarray, "4 points"]
    corners: Integer[np.ndarray, "blocks 4"]
    codes: UInt8[np.ndarray, "blocks quads"]
    gaps: Float32[np.ndarray, " all_quads"]


NO_GAPS = np.empty(0, np.float32)


def empty_blocks(count: int, shared_points: int = 0, shared_blocks: int = 0) -> QuadBlocks:
    """Room for quads with points of their own, behind points and blocks that the caller fills; nothing is drawn yet."""
    blocks = -(-count // BLOCK)
    corners = np.empty((shared_blocks + blocks, 4), np.int64)
    corners[shared_blocks:] = shared_points + BLOCK * np.arange(4 * blocks).reshape(blocks, 4)
    codes = np.full((len(corners), BLOCK), REMOVED, np.uint8)
    return QuadBlocks(np.zeros((4, shared_points + 4 * BLOCK * blocks), np.float32), corners, codes, NO_GAPS)


def put(
    blocks: QuadBlocks, shared_blocks: int, first: int,
    points: Float[np.ndarray, "quads 4 4"], codes: UInt8[np.ndarray, " quads"],
) -> None:  # fmt: skip
    """Write quads, from the ``first`` of those with points of their own on: four numbers for each of four corners."""
    block, place = np.divmod(first + np.arange(len(codes)), BLOCK)
    count = len(blocks.codes) - shared_blocks
    own = blocks.points[:, blocks.points.shape[1] - 4 * BLOCK * count :].reshape(4, count, 4, BLOCK)
    own[:, block, :, place] = points.transpose(0, 2, 1)
    blocks.codes[shared_blocks + block, place] = codes


def in_blocks(
    points: Float[np.ndarray, "quads 4 4"], codes: UInt8[np.ndarray, " quads"], gaps: Float[np.ndarray, " quads"]
) -> QuadBlocks:
    """Quads with points of their own, and by how much their edges reach outwards."""
    blocks = empty_blocks(len(codes))
    put(blocks, 0, 0, points, codes)
    return blocks._replace(gaps=np.append(gaps, np.zeros(blocks.codes.size - len(gaps))).astype(np.float32))
