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
from omnisyn_cli.render.raster_kernels import (
    BLOCK,
    NOTHING,
    clear,
    find_block_rows,
    find_cut_rows,
    rasterize_caps,
    rasterize_cuts,
    rasterize_quads,
    transform_vertices,
)
from omnisyn_cli.threads import run_bands

__all__ = ["NOTHING", "Fragments", "Rasterizer", "rasterize"]


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

    The fragments that a call returns are overwritten by the next one. Not to be shared between threads.
    """

    def __init__(self, mesh_size: tuple[int, int], size: tuple[int, int], threads: int | None = None) -> None:
        self.mesh_size, self.size, self.threads = mesh_size, size, threads
        height, width = mesh_size
        self._source_tables = tuple(table.astype(np.float32) for table in direction_tables(*mesh_size))
        self._target_tables = direction_tables(*size)
        self._vertices = np.empty((4, height, width + 1), np.float32)
        self._pixels = np.empty((2, height, width + 1), np.float32)
        self._block_rows = np.empty((height - 1, -(-width // BLOCK), 2), np.int32)
        self._fragments = Fragments(np.empty(size, np.float32), np.empty(size, np.int32))

    def __call__(self, mesh: Mesh, target_from_source: Pose) -> Fragments:
        """Rasterise ``mesh`` as seen from the target; see :func:`rasterize`."""
        if mesh.size != self.mesh_size:
            raise ValueError(f"expected a mesh of {self.mesh_size} vertices, got {mesh.size}")
        rotation, translation = _pose_arrays(target_from_source)
        height = self.mesh_size[0]
        scale = np.array(pixel_scale(self.size), np.float32)
        cut_quads = mesh.cut_quads
        cut_rows = np.empty((len(cut_quads), 2), np.int32)

        def transform(begin: int, end: int) -> None:
            transform_vertices(
                mesh.inverse_depth, *self._source_tables, rotation, translation, scale, self._vertices, self._pixels,
                begin, end,
            )  # fmt: skip

        def block(begin: int, end: int) -> None:
            find_block_rows(self._pixels, self.size[0], self.size[1], self._block_rows, begin, end)

        def fill(begin: int, end: int) -> None:
            clear(self._fragments.inverse_depth, self._fragments.face, begin, end)
            rasterize_quads(
                mesh.quads, self._vertices, self._pixels, self._block_rows,
                *self._target_tables, self._fragments.inverse_depth, self._fragments.face, begin, end,
            )  # fmt: skip
            rasterize_cuts(
                mesh.inverse_depth, mesh.quads, cut_quads, cut_rows, self._vertices, translation,
                *self._target_tables, self._fragments.inverse_depth, self._fragments.face, begin, end,
            )  # fmt: skip
            rasterize_caps(
                mesh.inverse_depth, mesh.caps, self._vertices, rotation, translation,
                *self._target_tables, self._fragments.inverse_depth, self._fragments.face, begin, end,
            )  # fmt: skip

        def find_cut(begin: int, end: int) -> None:
            find_cut_rows(
                mesh.inverse_depth, mesh.quads, cut_quads, self._vertices, translation, *self.size, cut_rows, begin, end
            )

        run_bands(transform, height, self.threads)
        if self.threads == 1:  # one band takes everything: nothing has to be sorted into bands
            self._block_rows[..., 0], self._block_rows[..., 1] = 0, self.size[0]
            cut_rows[:, 0], cut_rows[:, 1] = 0, self.size[0]
        else:
            run_bands(find_cut, len(cut_quads), self.threads)
            run_bands(block, height - 1, self.threads)
        run_bands(fill, self.size[0], self.threads)
        return self._fragments


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
