"""The byte of a quad, and how the points of what is left of a cut quad follow from its corners.

A quad with a cut edge is not thrown away: each corner keeps the quarter of the quad that belongs to its own pixel, at
its own inverse depth, joined to those of the corners that it still hangs together with.
"""

from __future__ import annotations

import numpy as np

__all__ = [
    "BOTTOM",
    "CUT_EDGES",
    "DIAGONAL",
    "DIRECTION_WEIGHTS",
    "FACES_PER_QUAD",
    "FACES_PER_QUARTER",
    "INVERSE_DEPTH_WEIGHTS",
    "LEFT",
    "QUARTER_WEIGHTS",
    "REMOVED",
    "RIGHT",
    "TOP",
]

TOP, RIGHT, BOTTOM, LEFT = 1, 2, 4, 8
CUT_EDGES = TOP | RIGHT | BOTTOM | LEFT
"""Bits of a quad's byte: which of its edges are cut."""
DIAGONAL = 16
"""Set where the quad is split from bottom left to top right, clear from top left to bottom right."""
REMOVED = 32
"""Set where nothing of the quad is drawn (all of it is masked)."""
FACES_PER_QUAD = 8
FACES_PER_QUARTER = 2

# Corners of a quad: 0 top left, 1 top right, 2 bottom left, 3 bottom right.
_BESIDE = (1, 0, 3, 2)
_ACROSS = (2, 3, 0, 1)
_EDGE_BESIDE = (TOP, TOP, BOTTOM, BOTTOM)
_EDGE_ACROSS = (LEFT, RIGHT, LEFT, RIGHT)


def _component(corner: int, code: int) -> list[int]:
    """The corners of a quad that hang together with ``corner`` through edges that are not cut."""
    reached, frontier = {corner}, [corner]
    while frontier:
        at = frontier.pop()
        for edge, to in ((_EDGE_BESIDE[at], _BESIDE[at]), (_EDGE_ACROSS[at], _ACROSS[at])):
            if not code & edge and to not in reached:
                reached.add(to)
                frontier.append(to)
    return sorted(reached)


def _mean_of(corners: list[int]) -> np.ndarray:
    return np.bincount(corners, minlength=4) / len(corners)


def _quarter(corner: int, code: int) -> tuple[np.ndarray, np.ndarray]:
    """Direction and inverse-depth weights of the four points of a corner's quarter, in the order of a quad."""
    beside, across = _BESIDE[corner], _ACROSS[corner]
    direction = {corner: [corner], beside: [corner, beside], across: [corner, across], 3 - corner: [0, 1, 2, 3]}
    rho = {
        corner: [corner],
        beside: [corner] if code & _EDGE_BESIDE[corner] else [corner, beside],
        across: [corner] if code & _EDGE_ACROSS[corner] else [corner, across],
        3 - corner: _component(corner, code),
    }
    return np.stack([_mean_of(direction[k]) for k in range(4)]), np.stack([_mean_of(rho[k]) for k in range(4)])


def _weight_tables() -> tuple[np.ndarray, np.ndarray]:
    direction, rho = np.zeros((17, FACES_PER_QUAD, 3, 4)), np.zeros((17, FACES_PER_QUAD, 3, 4))
    falling, rising = np.array([(0, 3, 2), (0, 1, 3)]), np.array([(0, 1, 2), (1, 3, 2)])
    for kind, faces in ((0, falling), (DIAGONAL, rising)):
        direction[kind, :2] = rho[kind, :2] = np.eye(4)[faces]
    for code in range(1, 16):
        for corner in range(4):
            faces = falling if corner in (0, 3) else rising
            quarter_direction, quarter_rho = _quarter(corner, code)
            direction[code, 2 * corner : 2 * corner + 2] = quarter_direction[faces]
            rho[code, 2 * corner : 2 * corner + 2] = quarter_rho[faces]
    return direction, rho


DIRECTION_WEIGHTS, INVERSE_DEPTH_WEIGHTS = _weight_tables()
"""How the corners of faces follow from those of their quad: ``(code, face in quad, corner of face, corner of quad)``.

Codes are those of cut edges; 0 and :data:`DIAGONAL` are whole quads.
"""


def _quarter_weights() -> np.ndarray:
    """Weights ``(code, corner of quad, 32)`` of the points of quarters, numbered ``4·point + quarter``.

    The first half is for directions, the second what the weights for inverse depths have beyond those.
    """
    weights = np.zeros((CUT_EDGES + 1, 4, 2, 4, 4), np.float32)
    for code in range(1, CUT_EDGES + 1):
        for corner in range(4):
            direction, rho = _quarter(corner, code)
            weights[code, :, 0, :, corner], weights[code, :, 1, :, corner] = direction.T, (rho - direction).T
    return weights.reshape(CUT_EDGES + 1, 4, 32)


QUARTER_WEIGHTS = _quarter_weights()
"""How the points of the quarters of a cut quad follow from its corners, see ``transform_quarters``."""
