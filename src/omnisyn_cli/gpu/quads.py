"""A mesh as points and quads on a device: everything about it that does not change from frame to frame.

Whole quads share the vertices of the mesh; quarters of cut quads and the triangles of the caps have points of their own
(:mod:`omnisyn_cli.render.mesh`). Points stay in the frame of the panorama, as directions with inverse depths, so that a
target's frame is one product away: ``v = R·d + ρ·t``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Integer
from torch import Tensor

from omnisyn_cli.render.mesh import Mesh
from omnisyn_cli.render.quads import CUT_EDGES, DIAGONAL, QUARTER_WEIGHTS, REMOVED

__all__ = ["Quads", "quads_of"]


@dataclass(frozen=True)
class Quads:
    """What is drawn of a mesh, in the order in which it is drawn: whole quads, quarters, caps.

    Attributes:
        direction: of the points in the frame of the panorama; not all of length one.
        inverse_depth: of the points, 1/metre.
        corner: indices of each quad's points: top left, top right, bottom left, bottom right.
        is_rising: split from bottom left to top right, else from top left to bottom right.
        triangles: how many of these have an area.
    """

    direction: Float[Tensor, "points 3"]
    inverse_depth: Float[Tensor, " points"]
    corner: Integer[Tensor, "quads 4"]
    is_rising: Bool[Tensor, " quads"]
    triangles: int


def quads_of(mesh: Mesh, device: torch.device) -> Quads:
    """The quads of a mesh: 32 bytes for every point, 33 for every quad."""
    whole = np.flatnonzero((mesh.quads.ravel() & (CUT_EDGES | REMOVED)) == 0)
    vertex_direction = mesh.vertex_directions()[: mesh.inverse_depth.size]
    vertex_rho = mesh.inverse_depth.ravel().astype(np.float64)
    quarter_direction, quarter_rho = _quarter_points(mesh, vertex_direction, vertex_rho)
    cap_direction, cap_rho, cap_corner = _cap_points(mesh, vertex_direction)
    quarter_corner = np.arange(len(quarter_rho)).reshape(-1, 4)
    patches = mesh.patches
    drawn = (patches.code & REMOVED) == 0
    own = np.concatenate([quarter_corner, cap_corner + len(quarter_rho)])[drawn] + len(vertex_rho)
    falling_or_rising = np.concatenate([mesh.quads.ravel()[whole], patches.code[drawn]]) & DIAGONAL

    def there(array: np.ndarray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(device)

    return Quads(
        there(np.concatenate([vertex_direction, quarter_direction, cap_direction])),
        there(np.concatenate([vertex_rho, quarter_rho, cap_rho])),
        there(np.concatenate([_corners_of(whole, mesh.size[1]), own])),
        there(falling_or_rising != 0),
        mesh.face_count(),
    )


def _corners_of(quad: np.ndarray, width: int) -> Integer[np.ndarray, "quads 4"]:
    """Vertices of quads of the mesh; columns wrap."""
    row, col = quad // width, quad % width
    left, right = row * width + col, row * width + (col + 1) % width
    return np.stack([left, right, left + width, right + width], axis=-1)


def _quarter_points(
    mesh: Mesh, direction: np.ndarray, rho: np.ndarray
) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, " points"]]:
    """Four points for each of the four quarters of every cut quad."""
    corner = _corners_of(mesh.cut_quads, mesh.size[1])
    weight = QUARTER_WEIGHTS[mesh.quads.ravel()[mesh.cut_quads] & CUT_EDGES].astype(np.float64)
    shares, excess = weight[..., :16], weight[..., 16:]
    points = np.einsum("qcp,qcx->qpx", shares, direction[corner])  # numbered 4·point + quarter
    depths = np.einsum("qcp,qc->qp", shares + excess, rho[corner])
    points, depths = points.reshape(-1, 4, 4, 3).swapaxes(1, 2), depths.reshape(-1, 4, 4).swapaxes(1, 2)
    return points.reshape(-1, 3), depths.reshape(-1)


def _cap_points(
    mesh: Mesh, direction: np.ndarray
) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, " points"], Integer[np.ndarray, "caps 4"]]:
    """Three points for every cap triangle, and the quads, with two corners at the pole, that are made of them."""
    width = mesh.size[1]
    poles = np.broadcast_to(mesh.vertex_directions()[-2:, None], (2, width, 3))
    rings = direction.reshape(*mesh.size, 3)[[0, -1]]
    points = np.stack([poles, rings, np.roll(rings, -1, axis=1)], axis=2)
    pole = 3 * np.arange(2 * width)
    north, south = pole[:width, None] + [0, 0, 1, 2], pole[width:, None] + [1, 2, 0, 0]
    return points.reshape(-1, 3), mesh.caps.reshape(-1).astype(np.float64), np.concatenate([north, south])
