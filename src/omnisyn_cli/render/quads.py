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


def in_blocks(
    points: Float[np.ndarray, "quads 4 4"], codes: UInt8[np.ndarray, " quads"],
    gaps: Float[np.ndarray, " quads"] | None = None,
) -> QuadBlocks:  # fmt: skip
    """Quads with points of their own, four numbers for each of the four corners, in the same order."""
    count, blocks = len(codes), -(-len(codes) // BLOCK)

    def filled(values: np.ndarray, dtype: type, filling: int = 0) -> np.ndarray:
        out = np.full((blocks * BLOCK, *values.shape[1:]), filling, dtype)
        out[:count] = values
        return out.reshape(blocks, BLOCK, *values.shape[1:])

    corners = BLOCK * np.arange(4 * blocks, dtype=np.int64).reshape(blocks, 4)
    flat = np.ascontiguousarray(filled(points, np.float32).transpose(3, 0, 2, 1)).reshape(4, -1)
    return QuadBlocks(
        flat, corners, filled(codes, np.uint8, REMOVED), NO_GAPS if gaps is None else filled(gaps, np.float32).ravel()
    )


def joined_blocks(first: QuadBlocks, second: QuadBlocks) -> QuadBlocks:
    """The blocks of two lists without gaps."""
    return QuadBlocks(
        np.concatenate([first.points, second.points], axis=1),
        np.concatenate([first.corners, second.corners + first.points.shape[1]]),
        np.concatenate([first.codes, second.codes]),
        NO_GAPS,
    )
