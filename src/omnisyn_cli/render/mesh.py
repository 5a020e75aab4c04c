"""A mesh from an inverse-depth panorama, cut at depth discontinuities (paper, section 3.3).

The vertices are the pixel centres, so the topology is the image's own grid and is never stored: a :class:`Mesh` is an
inverse depth per vertex and one byte per quad. Quad ``(row, col)`` lies between the vertices ``(row, col)``,
``(row, col + 1)``, ``(row + 1, col)`` and ``(row + 1, col + 1)``; columns wrap, so the seam is closed. Two fans of
triangles, the caps, close the poles.

Where neighbouring vertices belong to different surfaces their edge is *cut*. A quad with a cut edge is not thrown
away: each corner keeps the quarter of the quad that belongs to its own pixel, at its own inverse depth. Seen from where
it was taken the mesh therefore has no holes, and a silhouette lies half way between the pixels of its two sides.

Faces are numbered ``8·quad + k``: a whole quad has k = 0, 1; a cut quad has two triangles for each of its four corners,
k = 2·corner + {0, 1}. The caps follow: ``8·quads + width·cap + col``, the north (cap 0) first.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int32, Integer, UInt8

from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.render.quads import (
    BOTTOM,
    CUT_EDGES,
    DIAGONAL,
    DIRECTION_WEIGHTS,
    FACES_PER_QUAD,
    INVERSE_DEPTH_WEIGHTS,
    LEFT,
    REMOVED,
    RIGHT,
    TOP,
)
from omnisyn_cli.render.trust import trust_of_quarters

__all__ = [
    "Cut",
    "FaceCorners",
    "Mesh",
    "Patches",
    "Triangles",
    "build_mesh",
    "mask_of_vertices",
]

NO_SURFACE = -1e-9
"""Inverse depth of masked vertices: any negative number would do, a small one keeps float32 exact beside them."""

_TINY = 1e-12


@dataclass(frozen=True)
class Cut:
    """When two neighbouring vertices belong to different surfaces.

    Attributes:
        relative: largest step of inverse depth relative to the nearer vertex, in (0, 1]. None switches the test off.
        metres: largest step of depth (the paper's criterion, there 2 m). None switches the test off.
    """

    relative: float | None = 0.05
    metres: float | None = None


@dataclass(frozen=True)
class Mesh:
    """A panorama's surface as seen from its own centre.

    Attributes:
        inverse_depth: ``(height, width)`` float32, 1/metre, of the vertices; negative where there is no surface.
        quads: ``(height - 1, width)`` one byte of flags per quad.
        caps: ``(2, width, 3)`` float32: inverse depth of (pole, left, right) of each cap triangle, north then south;
            negative where it is not drawn.
        trust: ``(height - 1, width, 4)`` float32 in (0, 1]: how much the colour seen on each quarter of each quad is
            worth in a blend; in a whole quad all four are equal.
    """

    inverse_depth: Float[np.ndarray, "height width"]
    quads: UInt8[np.ndarray, "height-1 width"]
    caps: Float[np.ndarray, "2 width 3"]
    trust: Float[np.ndarray, "height-1 width 4"]

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in vertices."""
        height, width = self.inverse_depth.shape
        return height, width

    @cached_property
    def patches(self) -> Patches:
        """What of the mesh is no whole quad."""
        return _patches(self)

    @cached_property
    def cut_quads(self) -> Integer[np.ndarray, " cuts"]:
        """Flat indices of the drawn quads with at least one cut edge, ascending."""
        return np.flatnonzero(((self.quads & CUT_EDGES) != 0) & ((self.quads & REMOVED) == 0))

    def faces(self) -> Integer[np.ndarray, " faces"]:
        """The numbers of all faces that are drawn, ascending."""
        flat = self.quads.ravel()
        per_quad = np.where(flat & REMOVED, 0, np.where(flat & CUT_EDGES, FACES_PER_QUAD, 2))
        kept = np.arange(FACES_PER_QUAD) < per_quad[:, None]
        has_surface = self.inverse_depth.ravel()[self._quad_vertices(np.arange(flat.size))] >= 0
        kept &= np.repeat(has_surface, 2, axis=1) | (per_quad[:, None] == 2)
        caps = np.flatnonzero((self.caps >= 0).all(axis=-1))
        return np.concatenate([np.flatnonzero(kept), FACES_PER_QUAD * flat.size + caps])

    def face_count(self) -> int:
        """How many faces are drawn: the length of :meth:`faces`, which is not made for it."""
        whole = np.count_nonzero((self.quads & (CUT_EDGES | REMOVED)) == 0)
        quarters = np.count_nonzero(self.inverse_depth.ravel()[self._quad_vertices(self.cut_quads)] >= 0)
        return int(2 * (whole + quarters) + np.count_nonzero((self.caps >= 0).all(axis=-1)))

    def vertex_directions(self) -> Float[np.ndarray, "vertices 3"]:
        """Unit vector of every vertex in the frame of the panorama, row after row, and of the two poles."""
        return np.concatenate([pixel_directions(*self.size).reshape(-1, 3), _POLES])

    def triangles(self) -> Triangles:
        """Every face as an explicit triangle in the frame of the panorama, for the reference and for export."""
        faces = self.faces()
        corners = self.corners(faces)
        directions = self.vertex_directions()
        inverse_depth = np.concatenate([self.inverse_depth.reshape(-1).astype(np.float64), np.zeros(2)])
        direction = np.einsum("fvk,fkx->fvx", corners.direction_weight, directions[corners.vertex])
        rho = np.einsum("fvk,fk->fv", corners.inverse_depth_weight, inverse_depth[corners.vertex])
        return Triangles(faces, direction, rho + corners.inverse_depth_offset)

    def corners(self, faces: Integer[np.ndarray, " faces"]) -> FaceCorners:
        """How the corners of faces follow from the vertices of the mesh; linear, so gradients can flow through it."""
        quad_count = self.quads.size
        is_cap = faces >= FACES_PER_QUAD * quad_count
        quad = np.where(is_cap, 0, faces // FACES_PER_QUAD)
        vertex = self._quad_vertices(quad)
        code = self.quads.ravel()[quad]
        kind = np.where(code & CUT_EDGES, code & CUT_EDGES, code & DIAGONAL)
        direction_weight = DIRECTION_WEIGHTS[kind, faces % FACES_PER_QUAD]
        inverse_depth_weight = INVERSE_DEPTH_WEIGHTS[kind, faces % FACES_PER_QUAD]
        offset = np.zeros((len(faces), 3))
        cap = faces[is_cap] - FACES_PER_QUAD * quad_count
        vertex[is_cap] = self._cap_vertices(cap)
        direction_weight[is_cap] = _CAP_WEIGHTS
        inverse_depth_weight[is_cap] = 0.0
        offset[is_cap] = self._cap_inverse_depth(cap)
        return FaceCorners(vertex, direction_weight, inverse_depth_weight, offset)

    def _quad_vertices(self, quad: np.ndarray) -> np.ndarray:
        width = self.size[1]
        row, col = quad // width, quad % width
        right, above, below = (col + 1) % width, row * width, (row + 1) * width
        return np.stack([above + col, above + right, below + col, below + right], -1)

    def _cap_vertices(self, cap: np.ndarray) -> np.ndarray:
        height, width = self.size
        south, col = cap // width, cap % width
        ring = np.where(south == 1, (height - 1) * width, 0)
        first, second = ring + col, ring + (col + 1) % width
        left, right = np.where(south == 1, first, second), np.where(south == 1, second, first)
        pole = height * width + south
        return np.stack([pole, left, right, pole], -1)

    def _cap_inverse_depth(self, cap: np.ndarray) -> np.ndarray:
        south, col = cap // self.size[1], cap % self.size[1]
        pole, first, second = np.moveaxis(self.caps[south, col].astype(np.float64), -1, 0)
        return np.where(south[:, None] == 1, np.stack([pole, first, second], -1), np.stack([pole, second, first], -1))


@dataclass(frozen=True)
class Patches:
    """Quads with points of their own: four quarters of each cut quad, then the triangles of both caps, north first.

    Attributes:
        face: number of the first triangle of each.
        code: :data:`DIAGONAL` and :data:`REMOVED` as for quads.
    """

    face: Int32[np.ndarray, " patches"]
    code: UInt8[np.ndarray, " patches"]


def _patches(mesh: Mesh) -> Patches:
    corner = np.arange(4)
    quarters = (FACES_PER_QUAD * mesh.cut_quads[:, None] + 2 * corner).ravel()
    is_masked = mesh.inverse_depth.ravel()[mesh._quad_vertices(mesh.cut_quads)] < 0
    rising = _flag(DIAGONAL, (corner == 1) | (corner == 2))
    caps = FACES_PER_QUAD * mesh.quads.size + np.arange(2 * mesh.size[1])
    caps[mesh.size[1] :] -= 1  # a southern cap is the second triangle of its patch
    code = np.concatenate([(rising | _flag(REMOVED, is_masked)).ravel(), _flag(REMOVED, mesh.caps[..., 0] < 0).ravel()])
    return Patches(np.concatenate([quarters, caps]).astype(np.int32), code)


@dataclass(frozen=True)
class FaceCorners:
    """Corners of faces as weighted sums over four vertices of the mesh.

    ``direction = Σ direction_weight · direction[vertex]`` (not normalised) and
    ``inverse_depth = Σ inverse_depth_weight · inverse_depth[vertex] + inverse_depth_offset``. Vertices
    ``height·width`` and ``height·width + 1`` are the poles.
    """

    vertex: Integer[np.ndarray, "faces 4"]
    direction_weight: Float[np.ndarray, "faces 3 4"]
    inverse_depth_weight: Float[np.ndarray, "faces 3 4"]
    inverse_depth_offset: Float[np.ndarray, "faces 3"]


@dataclass(frozen=True)
class Triangles:
    """Explicit triangles: homogeneous points ``direction / inverse_depth``, clockwise seen from the centre."""

    face: Integer[np.ndarray, " faces"]
    direction: Float[np.ndarray, "faces 3 3"]
    inverse_depth: Float[np.ndarray, "faces 3"]


def build_mesh(
    inverse_depth: Float[np.ndarray, "height width"],
    cut: Cut | None = None,
    mask: Bool[np.ndarray, "height width"] | None = None,
    confidence: Float[np.ndarray, "height width"] | None = None,
) -> Mesh:
    """Mesh of an inverse-depth panorama.

    Args:
        inverse_depth: 1/metre, finite and not negative; 0 is infinitely far. At least 2×2 pixels.
        cut: where surfaces are separated; by default at relative steps above 0.05.
        mask: False where the panorama shows nothing usable; such vertices get no surface.
        confidence: in [0, 1], of the inverse depths; by default 1.

    Raises:
        ValueError: on values that are negative or not finite, or an image smaller than 2×2.
    """
    rho = np.ascontiguousarray(inverse_depth, dtype=np.float32)
    if rho.ndim != 2 or min(rho.shape) < 2:
        raise ValueError(f"expected an inverse-depth image of at least 2×2 pixels, got shape {rho.shape}")
    if not np.isfinite(rho).all() or (rho < 0).any():
        raise ValueError("expected finite inverse depths >= 0, got negative or non-finite values; fill them first")
    cut = cut or Cut()
    beside, below = _cut_edges(rho, cut, axis=1), _cut_edges(rho, cut, axis=0)
    if mask is not None:
        beside |= mask != np.roll(mask, -1, axis=1)
        below |= mask[:-1] != mask[1:]
    quads = _flag(TOP, beside[:-1]) | _flag(BOTTOM, beside[1:]) | _flag(LEFT, below)
    quads |= _flag(RIGHT, np.roll(below, -1, axis=1))
    right = np.roll(rho, -1, axis=1)
    falling, rising = np.abs(rho[:-1] - right[1:]), np.abs(rho[1:] - right[:-1])
    quads |= _flag(DIAGONAL, rising < falling)
    caps = _caps(rho, beside, mask)
    if mask is not None:
        quads |= _flag(REMOVED, ~_any_corner(mask))
        rho = np.where(mask, rho, np.float32(NO_SURFACE))
    return Mesh(rho, quads, caps, trust_of_quarters(rho, (quads & CUT_EDGES) != 0, confidence))


def _flag(bit: int, where: np.ndarray) -> np.ndarray:
    return np.where(where, np.uint8(bit), np.uint8(0))


def mask_of_vertices(
    mask: Bool[np.ndarray, "rows cols"] | None, size: tuple[int, ...]
) -> Bool[np.ndarray, "height width"] | None:
    """A photograph's mask at the size of a mesh: True where any pixel of a vertex may be used (alpha does the rest)."""
    if mask is None:
        return None
    for axis in (0, 1):
        mask = np.logical_or.reduceat(mask, np.arange(size[axis]) * mask.shape[axis] // size[axis], axis=axis)
    return mask


def _any_corner(mask: np.ndarray) -> np.ndarray:
    rows = mask[:-1] | mask[1:]
    return np.asarray(rows | np.roll(rows, -1, axis=1))


def _cut_edges(rho: np.ndarray, cut: Cut, axis: int) -> np.ndarray:
    """Whether the edge from each vertex to the next along ``axis`` is cut; columns wrap, rows end."""
    following = np.roll(rho, -1, axis=axis) if axis == 1 else rho[1:]
    rho = rho if axis == 1 else rho[:-1]
    step = following - rho
    is_cut = np.zeros(step.shape, dtype=bool)
    if cut.relative is not None:
        is_cut |= np.abs(step) > cut.relative * np.maximum(np.maximum(rho, following), _TINY)
    if cut.metres is not None:
        is_cut |= np.abs(step) > cut.metres * rho * following
    return is_cut


def _caps(rho: np.ndarray, beside: np.ndarray, mask: np.ndarray | None) -> np.ndarray:
    """Cap triangles: a smooth fan where the ring is whole, a flat wedge of the farther side where it is cut."""
    caps = np.empty((2, rho.shape[1], 3), np.float32)
    for cap, row in enumerate((0, -1)):
        first, second = rho[row], np.roll(rho[row], -1)
        farther = np.minimum(first, second)
        smooth = np.stack([np.full_like(first, np.median(first)), first, second], axis=-1)
        caps[cap] = farther[:, None] if beside[row].any() else smooth
        if mask is not None:
            caps[cap, ~(mask[row] & np.roll(mask[row], -1))] = NO_SURFACE
    return caps


_POLES = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
_CAP_WEIGHTS = np.eye(4)[:3]
