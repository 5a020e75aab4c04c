"""The exact equirectangular rasteriser: every pixel centre of the target against triangles on the sphere, in numba.

A vertex with direction d and inverse depth ρ is the homogeneous vector ``v = R·d + ρ·t`` in the target's frame. The ray
r of a pixel hits the triangle (v0, v1, v2) iff ``e0 = r·(v1×v2)``, ``e1 = r·(v2×v0)``, ``e2 = r·(v0×v1)`` are all >= 0
(and ``det(v0, v1, v2) > 0``: the surface is seen from its front). Then the inverse depth seen is
``(e0·ρ0 + e1·ρ1 + e2·ρ2) / det``; the largest one wins. Straight lines are exact for triangles of any size, infinity is
ρ = 0, and seam and poles only concern the box of pixels in which a triangle is looked for.

:mod:`omnisyn_cli.render.reference` is the same in plain loops without boxes; both must agree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int32

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import direction_tables, pixel_scale
from omnisyn_cli.render.mesh import Mesh
from omnisyn_cli.render.patch_kernels import transform_caps, transform_quarters
from omnisyn_cli.render.quads import QUARTER_WEIGHTS
from omnisyn_cli.render.raster_kernels import (
    BLOCK,
    NOTHING,
    clear,
    find_patch_blocks,
    find_quad_blocks,
    rasterize_patches,
    rasterize_quads,
    transform_vertices,
)
from omnisyn_cli.render.simd import LANES
from omnisyn_cli.threads import run_bands

__all__ = ["NOTHING", "Fragments", "Rasterizer", "rasterize", "tables_for_vectors"]


@dataclass(frozen=True)
class Fragments:
    """What each target pixel sees of one mesh.

    Attributes:
        inverse_depth: ``(height, width)`` 1/metre from the target's centre; negative where nothing is seen.
        face: ``(height, width)`` face number, :data:`NOTHING` where nothing is seen.
    """

    inverse_depth: Float32[np.ndarray, "height width"]
    face: Int32[np.ndarray, "height width"]

    @property
    def visibility(self) -> Bool[np.ndarray, "height width"]:
        """Whether a surface is seen."""
        return np.asarray(self.face != NOTHING)


class Rasterizer:
    """Buffers and tables for one mesh size and one target size, reused from frame to frame.

    What a call returns is overwritten by the next one. Not to be shared between threads.
    """

    def __init__(self, mesh_size: tuple[int, int], size: tuple[int, int], threads: int | None = None) -> None:
        self.mesh_size, self.size, self.threads = mesh_size, size, threads
        height, width = mesh_size
        self._source_tables = tuple(table.astype(np.float32) for table in direction_tables(*mesh_size))
        self._exact_tables = direction_tables(*size)
        self._tables = tables_for_vectors(size)
        self._scale = np.array(pixel_scale(size), np.float32)
        self._vertices = np.zeros((4, height, width + 1 + LANES), np.float32)
        self._pixels = np.zeros((2, *self._vertices.shape[1:]), np.float32)
        self._quad_blocks = np.empty((height - 1, -(-width // BLOCK), 2), np.int32)
        self._fragments = Fragments(np.empty(size, np.float32), np.empty(size, np.int32))
        self._mesh: Mesh | None = None

    def __call__(self, mesh: Mesh, target_from_source: Pose) -> Fragments:
        """Rasterise ``mesh`` as seen from the target; see :func:`rasterize`."""
        self._draw(mesh, target_from_source, self._fragments.face.reshape(-1))
        return self._fragments

    def inverse_depth(self, mesh: Mesh, target_from_source: Pose) -> Float32[np.ndarray, "height width"]:
        """That of the fragments alone, negative where nothing is seen: faces cost time and memory."""
        self._draw(mesh, target_from_source, None)
        return self._fragments.inverse_depth

    def _draw(self, mesh: Mesh, target_from_source: Pose, face: np.ndarray | None) -> None:
        """Write inverse depth and, if there is memory for them, faces."""
        if mesh.size != self.mesh_size:
            raise ValueError(f"expected a mesh of {self.mesh_size} vertices, got {mesh.size}")
        if mesh is not self._mesh:
            self._prepare(mesh)
        self._transform(mesh, target_from_source)
        self._find_blocks()
        run_bands(lambda begin, end: self._fill(face, begin, end), self.size[0], self.threads)

    def _prepare(self, mesh: Mesh) -> None:
        """Flags with room for vectors that read beyond the end, and space for the points of patches."""
        self._mesh = mesh
        self._patches = mesh.patches
        self._quad_codes = np.concatenate([mesh.quads.ravel(), np.zeros(LANES, np.uint8)])
        self._patch_codes = np.concatenate([self._patches.code, np.zeros(LANES, np.uint8)])
        self._points = np.zeros((4, 4, len(self._patch_codes)), np.float32)
        self._patch_pixels = np.zeros((2, *self._points.shape[1:]), np.float32)
        self._patch_blocks = np.empty((-(-len(self._patches.face) // BLOCK), 2), np.int32)

    def _transform(self, mesh: Mesh, pose: Pose) -> None:
        """All points in the frame of the target."""
        rotation, translation = _pose_arrays(pose)
        cut_quads, points = mesh.cut_quads, self._points

        def vertices(begin: int, end: int) -> None:
            transform_vertices(
                mesh.inverse_depth, *self._source_tables, rotation, translation, self._scale,
                self._vertices, self._pixels, begin, end,
            )  # fmt: skip

        def quarters(begin: int, end: int) -> None:
            transform_quarters(
                self._vertices, mesh.quads, cut_quads, QUARTER_WEIGHTS, translation, self._scale,
                points, self._patch_pixels, begin, end,
            )  # fmt: skip

        run_bands(vertices, self.mesh_size[0], self.threads)
        run_bands(quarters, len(cut_quads), self.threads)
        transform_caps(
            mesh.inverse_depth, mesh.caps, self._vertices, rotation, translation, self._scale,
            4 * len(cut_quads), points, self._patch_pixels,
        )  # fmt: skip

    def _find_blocks(self) -> None:
        """Which target rows each block of quads and of patches can touch."""
        if self.threads == 1:  # one band takes everything: nothing has to be sorted into bands
            for blocks in (self._quad_blocks, self._patch_blocks):
                blocks[..., 0], blocks[..., 1] = 0, self.size[0]
            return

        def quads(begin: int, end: int) -> None:
            find_quad_blocks(self._pixels, self.mesh_size[1], *self.size, self._quad_blocks, begin, end)

        def patches(begin: int, end: int) -> None:
            find_patch_blocks(self._patch_pixels, *self.size, self._patch_blocks, begin, end)

        run_bands(quads, len(self._quad_blocks), self.threads)
        run_bands(patches, len(self._patch_blocks), self.threads)

    def _fill(self, face: np.ndarray | None, begin: int, end: int) -> None:
        """Some rows of the target."""
        seen = (self._fragments.inverse_depth, face)
        tables = (self._tables, self._exact_tables)
        clear(*seen, begin, end)
        rasterize_quads(
            self._quad_codes, self.mesh_size[1], self._vertices, self._pixels, self._quad_blocks,
            *tables, *seen, begin, end,
        )  # fmt: skip
        rasterize_patches(
            self._patch_codes, self._patches.face, self._points, self._patch_pixels, self._patch_blocks,
            *tables, *seen, begin, end,
        )  # fmt: skip


def tables_for_vectors(size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Float32 sines and cosines of rows, and sine and negative cosine of columns."""
    sin_polar, cos_polar, sin_azimuth, cos_azimuth = (table.astype(np.float32) for table in direction_tables(*size))
    return sin_polar, cos_polar, sin_azimuth, -cos_azimuth


def rasterize(mesh: Mesh, target_from_source: Pose, size: tuple[int, int], threads: int | None = None) -> Fragments:
    """What each pixel of an equirectangular target of ``size = (height, width)`` sees of ``mesh``.

    Args:
        mesh: surface in the frame of its panorama.
        target_from_source: rigid transform from the panorama's camera frame to the target's.
        size: of the target, any.
        threads: at most this many; the result does not depend on it.

    Returns:
        Fragments of the nearest front face through each pixel centre. Back faces are culled.
    """
    return Rasterizer(mesh.size, size, threads)(mesh, target_from_source)


def _pose_arrays(pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    return np.ascontiguousarray(pose.rotation, np.float64), np.ascontiguousarray(pose.position, np.float64)
