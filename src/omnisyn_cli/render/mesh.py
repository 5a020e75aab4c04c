"""A mesh from an inverse-depth panorama, cut at depth discontinuities (paper, section 3.3).

The vertices are the pixel centres, so the topology is the image's own grid and is never stored: a :class:`Mesh` is an
inverse depth per vertex and one byte per quad. Quad ``(row, col)`` lies between the vertices ``(row, col)``,
``(row, col + 1)``, ``(row + 1, col)`` and ``(row + 1, col + 1)``; columns wrap, so the seam is closed. Two fans of
triangles, the caps, close the poles.

Where neighbouring vertices belong to different surfaces their edge is *cut*. A quad with a cut edge is not thrown
away: each corner keeps the quarter of the quad that belongs to its own pixel, at its own inverse depth. Seen from where
it was taken the mesh therefore has no holes, and a silhouette lies half way between the pixels of its two sides.

Faces are numbered ``8·quad + k``: a whole quad has k = 0, 1; a cut quad has two triangles for each of its four corners,
k = 2·corner + {0, 1}. The caps follow: ``8·quads + 2·(width·cap + col)``, the north (cap 0) first.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from array_api_compat import array_namespace, device
from jaxtyping import Bool, Float, Integer, UInt8

from omnisyn_cli.geometry.sampling import max_pool
from omnisyn_cli.geometry.sphere import UP, direction_tables, pixel_directions
from omnisyn_cli.geometry.tolerances import MESH_CUT_STEP
from omnisyn_cli.render.quad_blocks import (
    BLOCK,
    BOTTOM,
    CUT_EDGES,
    DIAGONAL,
    FACES_PER_QUAD,
    HOLE_FLAG,
    LEFT,
    QUARTER_DIRECTIONS,
    QUARTER_INVERSE_DEPTHS,
    RIGHT,
    TOP,
    QuadBlocks,
    empty_blocks,
    write_quads,
)
from omnisyn_cli.render.surface_confidence import quarter_confidence

Array = Any  # numpy.ndarray or torch.Tensor

# Of masked vertices: any negative number would do, a small one keeps float32 exact beside them.
MASKED_INVERSE_DEPTH = -1e-9
MIN_INVERSE_DEPTH = 1e-12  # 1/metre that steps are relative to at least, so that nothing is cut at infinity
CUT_QUADS_AT_A_TIME = 1 << 12  # cut quads of which pieces are made at a time, to bound memory. Set by hand.


@dataclass(frozen=True)
class Cut:
    """When two neighbouring vertices belong to different surfaces."""

    # largest step of inverse depth relative to the nearer vertex, in (0, 1]. None switches the test off.
    relative: float | None = MESH_CUT_STEP
    metres: float | None = None  # largest step of depth (the paper's criterion, there 2 m). None switches the test off.


@dataclass(frozen=True)
class Mesh:
    """The surface of a panorama, in its own frame."""

    # float32, 1/metre, of the vertices; negative where there is no surface
    inverse_depth: Float[np.ndarray, "height width"]
    quads: UInt8[np.ndarray, "height-1 width"]  # one byte of flags per quad
    # float32 in (0, 1] of each quarter of each quad, see :mod:`omnisyn_cli.render.surface_confidence`; in a whole quad
    # all four are equal
    surface_confidence: Float[np.ndarray, "height-1 width 4"]

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in vertices."""
        height, width = self.inverse_depth.shape
        return height, width

    @property
    def is_whole(self) -> Bool[np.ndarray, "height-1 width"]:
        """Quads that are drawn without cuts."""
        return np.asarray((self.quads & (CUT_EDGES | HOLE_FLAG)) == 0)

    @property
    def quarter_image(self) -> Float[np.ndarray, "quarter_rows quarter_cols"]:
        """The confidence of quarters as they lie beside each other."""
        rows, cols, _ = self.surface_confidence.shape
        return self.surface_confidence.reshape(rows, cols, 2, 2).transpose(0, 2, 1, 3).reshape(2 * rows, 2 * cols)

    @cached_property
    def cut_quads(self) -> Integer[np.ndarray, " cuts"]:
        """Flat indices of the drawn quads with at least one cut edge, ascending."""
        return np.flatnonzero(((self.quads & CUT_EDGES) != 0) & ((self.quads & HOLE_FLAG) == 0))

    def face_count(self) -> int:
        """How many faces are drawn, without making them."""
        quarters = np.count_nonzero(self.inverse_depth.ravel()[self.vertices_of(self.cut_quads)] >= 0)
        is_used = self.inverse_depth[[0, -1]] >= 0
        caps = np.count_nonzero(is_used & np.roll(is_used, -1, axis=1))
        return int(2 * (np.count_nonzero(self.is_whole) + quarters) + caps)

    def vertices_of(self, quads: Integer[np.ndarray, " quads"]) -> Integer[np.ndarray, "quads 4"]:
        """Flat indices of the corners of quads."""
        width = self.size[1]
        right = np.where(quads % width == width - 1, quads - width + 1, quads + 1)
        return np.stack([quads, right, quads + width, right + width], -1)

    def directions_of(self, vertices: Integer[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch 3"]:
        """Unit vectors in the frame of the panorama; vertices are counted row after row."""
        (row, col), (sin_p, cos_p, sin_a, cos_a) = np.divmod(vertices, self.size[1]), self._tables
        return np.stack([sin_p[row] * sin_a[col], cos_p[row], -sin_p[row] * cos_a[col]], axis=-1)

    @cached_property
    def _tables(self) -> tuple[np.ndarray, ...]:
        return direction_tables(*self.size)

    def piece_inverse_depths(self, vertices: Float[Array, "height width"]) -> Float[Array, "pieces 4"]:
        """Inverse depths of the points of pieces, from those of the vertices; numpy, or torch with gradients.

        Pieces are what has points of its own: quarters of cut quads, then both caps, whose triangles are quads with two
        points at the pole. A piece with a negative inverse depth is not drawn.
        """
        return array_namespace(vertices).concat([self._quarters(vertices, self.cut_quads), *self._caps(vertices)])

    def _quarters(self, vertices: Float[Array, "height width"], quads: Integer[np.ndarray, " quads"]) -> Array:
        xp = array_namespace(vertices)
        weights = QUARTER_INVERSE_DEPTHS[self.quads.ravel()[quads] & CUT_EDGES]
        weights = xp.asarray(weights, dtype=vertices.dtype, device=device(vertices))
        corners = xp.reshape(vertices, (-1,))[self.vertices_of(quads)]
        return xp.reshape(xp.matmul(weights, corners[:, None, :, None]), (-1, 4))

    def _caps(self, vertices: Float[Array, "height width"]) -> list[Array]:
        """Inverse depths of the caps: a smooth fan if no edge around the pole is cut, else one depth per wedge."""
        xp, caps = array_namespace(vertices), []
        for row, edge in ((0, TOP), (-1, BOTTOM)):
            ring, following = vertices[row], xp.roll(vertices[row], -1)
            ordered, middle = xp.sort(ring), self.size[1] // 2
            pole = 0.5 * (ordered[middle] + ordered[(self.size[1] - 1) // 2]) + xp.zeros_like(ring)
            if (self.quads[row] & edge).any():
                ring = following = pole = xp.minimum(ring, following)
            caps.append((pole, ring, following))
        return _around_poles(*zip(*caps, strict=True))

    def pieces(self) -> Iterator[Float[np.ndarray, "pieces 4 4"]]:
        """Directions and inverse depths of the points of pieces, some pieces at a time; the last are the caps.

        Every piece is split from its first point to its fourth.
        """
        for quads in np.split(self.cut_quads, range(CUT_QUADS_AT_A_TIME, len(self.cut_quads), CUT_QUADS_AT_A_TIME)):
            corners = self.directions_of(self.vertices_of(quads))
            directions = np.einsum("qpc,ncx->nqpx", QUARTER_DIRECTIONS, corners).reshape(-1, 4, 3)
            yield _with_depths(directions, self._quarters(self.inverse_depth, quads))
        rings = self.directions_of(np.arange(self.inverse_depth.size).reshape(self.size)[[0, -1]])
        caps = _around_poles(np.broadcast_to(np.stack([UP, -UP])[:, None], rings.shape), rings, np.roll(rings, -1, 1))
        yield _with_depths(np.concatenate(caps), np.concatenate(self._caps(self.inverse_depth)))

    @cached_property
    def blocks(self) -> QuadBlocks:
        """The quads to draw, for :mod:`omnisyn_cli.render.rasterize`: rows of whole quads, then pieces."""
        (height, width), across = self.size, -(-self.size[1] // BLOCK)
        count, shared = 4 * len(self.cut_quads) + 2 * width, height * (width + 1)
        blocks = empty_blocks(count, shared, (height - 1) * across)
        grid = blocks.points[:, :shared].reshape(4, height, width + 1)  # the first column comes again at the end
        for row, vertices in enumerate(np.arange(height * width).reshape(height, width)):
            grid[:3, row, :width] = self.directions_of(vertices).T
        grid[3, :, :width] = self.inverse_depth
        grid[..., width] = grid[..., 0]
        begin = ((width + 1) * np.arange(height - 1)[:, None] + BLOCK * np.arange(across)).reshape(-1, 1)
        blocks.corners[: len(begin)] = begin + np.array([0, 1, width + 1, width + 2])
        codes = blocks.codes[: len(begin)].reshape(height - 1, -1)
        codes[:, :width] = np.where(self.is_whole, self.quads & DIAGONAL, HOLE_FLAG)
        first = 0
        for points in self.pieces():
            is_drawn = (points[..., 3] >= 0).all(axis=-1)
            write_quads(blocks, len(begin), first, points, np.where(is_drawn, np.uint8(0), np.uint8(HOLE_FLAG)))
            first += len(points)
        return blocks

    def piece_numbers(self) -> Integer[np.ndarray, " pieces"]:
        """Half of the number of the first face of each piece."""
        quarters = 4 * self.cut_quads[:, None] + np.arange(4)
        return np.concatenate([quarters.ravel(), 4 * self.quads.size + np.arange(2 * self.size[1])])

    def face_numbers(self, drawn: Integer[np.ndarray, "*pixels"]) -> Integer[np.ndarray, "*pixels"]:
        """Face numbers from rasterised ones: twice the index in :attr:`blocks`, plus one for second triangles."""
        rows, width = self.quads.shape
        place, across = drawn >> 1, -(-width // BLOCK) * BLOCK
        whole = 4 * (place // across * width + place % across)
        piece = np.append(self.piece_numbers(), 0)[np.clip(place - rows * across, -1, None)]
        return np.where(drawn < 0, drawn, 2 * np.where(place < rows * across, whole, piece) + (drawn & 1))

    @cached_property
    def surface(self) -> "Surface":
        """The drawn quads and their points as index lists."""
        whole = np.flatnonzero(self.is_whole)
        corner = self.vertices_of(whole)
        rising = (self.quads.ravel()[whole] & DIAGONAL) != 0
        corner[rising] = corner[rising][:, [1, 3, 0, 2]]  # turned, so that it is split from first to fourth as well
        points = np.concatenate(list(self.pieces()))
        drawn = np.flatnonzero((points[..., 3] >= 0).all(axis=-1))
        corner = np.concatenate([corner, self.inverse_depth.size + 4 * drawn[:, None] + np.arange(4)])
        number = np.concatenate([4 * whole, self.piece_numbers()[drawn]])
        order = np.argsort(number, kind="stable")
        return Surface(
            np.concatenate([pixel_directions(*self.size).reshape(-1, 3), points[..., :3].reshape(-1, 3)]),
            np.concatenate([self.inverse_depth.ravel().astype(np.float64), points[..., 3].ravel()]),
            corner[order], number[order],
        )  # fmt: skip

    def triangles(self) -> "Triangles":
        """Every face as an explicit triangle in the panorama's frame, for the reference rasteriser and for export."""
        surface = self.surface
        face = (2 * surface.number[:, None] + [0, 1]).ravel()
        corner = surface.corner[:, TRIANGLES].reshape(-1, 3)
        kept = (face < FACES_PER_QUAD * self.quads.size) | (face % 2 == 0)  # caps have one
        return Triangles(face[kept], surface.direction[corner[kept]], surface.inverse_depth[corner[kept]])


def _with_depths(directions: np.ndarray, inverse_depths: np.ndarray) -> Float[np.ndarray, "pieces 4 4"]:
    return np.concatenate([directions, inverse_depths[..., None]], axis=-1)


def _around_poles(poles: Iterable[Array], rings: Iterable[Array], following: Iterable[Array]) -> list[Array]:
    """The four points of every triangle of the two caps: what is at the pole, left and right of it, north first."""
    (top, bottom), (first, last), (after_first, after_last) = poles, rings, following
    xp = array_namespace(top)
    sides = ((top, first, after_first), (bottom, after_last, last))
    return [xp.stack([pole, pole, left, right], axis=1) for pole, left, right in sides]


@dataclass(frozen=True)
class Surface:
    """The drawn quads of a mesh and their points."""

    # of all points: the vertices, then four for each piece; not all of length one
    direction: Float[np.ndarray, "points 3"]
    inverse_depth: Float[np.ndarray, " points"]  # of the same; negative where there is no surface
    # indices of each quad's points; it is split from the first to the fourth, see :data:`TRIANGLES`
    corner: Integer[np.ndarray, "quads 4"]
    number: Integer[np.ndarray, " quads"]  # half of the number of the first face of each quad, ascending

    def corners_of(self, faces: Integer[np.ndarray, " faces"]) -> Integer[np.ndarray, "faces 3"]:
        """Indices of the points of drawn faces."""
        quad = np.searchsorted(self.number, faces // 2)
        return np.asarray(np.take_along_axis(self.corner[quad], TRIANGLES[faces % 2], axis=1))


# Corners of the two triangles of a quad that is split from its first corner to its fourth.
TRIANGLES = np.array([(0, 3, 2), (0, 1, 3)])


@dataclass(frozen=True)
class Triangles:
    """Explicit triangles: homogeneous points ``direction / inverse_depth``, clockwise seen from the centre."""

    face: Integer[np.ndarray, " faces"]
    direction: Float[np.ndarray, "faces 3 3"]
    inverse_depth: Float[np.ndarray, "faces 3"]


def build_mesh(
    inverse_depth: Float[np.ndarray, "height width"], cut: Cut | None = None,
    mask: Bool[np.ndarray, "height width"] | None = None, confidence: Float[np.ndarray, "height width"] | None = None,
) -> Mesh:  # fmt: skip
    """Mesh of an inverse-depth panorama: 1/metre, finite and not negative, 0 infinitely far; at least 2×2 pixels.

    By default surfaces are cut at relative steps above 0.05. Vertices get no surface where ``mask`` is False: nothing
    usable is shown there. ``confidence`` in [0, 1] is of the inverse depths; by default 1. ValueError: values are
    negative or not finite, or the image is smaller than 2×2.
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
    if mask is not None:
        quads |= _flag(HOLE_FLAG, ~_any_corner(mask))
        rho = np.where(mask, rho, np.float32(MASKED_INVERSE_DEPTH))
    return Mesh(rho, quads, quarter_confidence(rho, (quads & CUT_EDGES) != 0, confidence))


def _flag(bit: int, where: np.ndarray) -> np.ndarray:
    return np.where(where, np.uint8(bit), np.uint8(0))


def mask_of_vertices(
    mask: Bool[np.ndarray, "rows cols"] | None, size: tuple[int, ...]
) -> Bool[np.ndarray, "height width"] | None:
    """A photograph's mask at the size of a mesh: True where any pixel of a vertex may be used (alpha does the rest)."""
    return None if mask is None else max_pool(mask, size)


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
        is_cut |= np.abs(step) > cut.relative * np.maximum(np.maximum(rho, following), MIN_INVERSE_DEPTH)
    if cut.metres is not None:
        is_cut |= np.abs(step) > cut.metres * rho * following
    return is_cut
