"""The exact equirectangular rasteriser: the rays of all pixel centres against triangles on the sphere, in numba.

A vertex with direction d and inverse depth ρ is the homogeneous vector ``v = R·d + ρ·t`` in the target's frame. The ray
r of a pixel hits the triangle (v0, v1, v2) iff ``e0 = r·(v1×v2)``, ``e1 = r·(v2×v0)``, ``e2 = r·(v0×v1)`` are all >= 0
(and ``det(v0, v1, v2) > 0``: the surface is seen from its front). Then the inverse depth seen is
``(e0·ρ0 + e1·ρ1 + e2·ρ2) / det``; the largest one wins. Straight lines are exact for triangles of any size, infinity is
ρ = 0, and seam and poles only concern the bounding boxes of triangles.
"""

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from jaxtyping import Bool, Float32, Int32

from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.geometry.perspective import PerspectiveSize, target_tables
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_scale
from omnisyn_cli.render.draw_kernels import Target
from omnisyn_cli.render.mesh import Mesh
from omnisyn_cli.render.quad_blocks import QuadBlocks
from omnisyn_cli.render.raster_kernels import (
    NO_FACE,
    find_block_bounds,
    rasterize_blocks,
    rasterize_edge_pixels,
)
from omnisyn_cli.types import EdgePixels

__all__ = ["NO_FACE", "Fragments", "Rasterizer", "rasterize", "rows_of", "target_of", "view_of"]


@dataclass(frozen=True)
class Fragments:
    """What each target pixel sees of one mesh."""

    # 1/metre from the target's centre; negative where nothing is seen
    inverse_depth: Float32[np.ndarray, "height width"]
    face: Int32[np.ndarray, "height width"]  # face number, :data:`NO_FACE` where nothing is seen

    @property
    def visibility(self) -> Bool[np.ndarray, "height width"]:
        """Whether a surface is seen."""
        return np.asarray(self.face != NO_FACE)


class Rasterizer:
    """Rasterises into panoramas or perspective pictures of one size; these have no samples of edge pixels.

    Tables and image are reused from frame to frame, by one caller at a time.
    """

    def __init__(self, size: tuple[int, int], threads: int | None = None) -> None:
        self.size, self.threads = size, threads
        self._inverse_depth = np.empty(size, np.float32)
        self._target = target_of(size, self._inverse_depth)
        self._view = view_of(size) if isinstance(size, PerspectiveSize) else None
        self._boxes = np.empty((0, 4), np.int32)

    @property
    def samples_edges(self) -> bool:
        """Whether edge pixels have samples."""
        return self._view is None

    @cached_property
    def _double_target(self) -> Target:
        """The target of twice the size, whose pixels are the samples of edge pixels."""
        return target_of((2 * self.size[0], 2 * self.size[1]), np.empty(0, np.float32))

    def __call__(
        self, quads: QuadBlocks, target_from_source: Pose, face: Int32[np.ndarray, " pixels"] | None = None
    ) -> Float32[np.ndarray, "height width"]:
        """Inverse depth from the target's centre, negative where nothing is seen; the next call overwrites it.

        In perspective pictures it is inverse distance along the axis.

        ``face``, if given, is written row after row: twice the index in ``quads`` of what is seen, plus one for the
        second triangle of a quad. It takes more time.
        """
        pose, boxes = rows_of(target_from_source), np.empty((len(quads.codes), 4), np.int32)
        if self.threads != 1:  # one thread draws all rows at once, and needs no culling by rows
            find_bounds = partial(find_block_bounds, quads, pose, self._target, self._view, boxes)
            run_ranges(find_bounds, len(boxes), self.threads)
        draw = partial(rasterize_blocks, quads, boxes, pose, self._target, self._view, face)
        run_ranges(draw, self.size[0], self.threads)
        self._boxes = boxes
        return self._inverse_depth

    def edge_samples(
        self, quads: QuadBlocks, target_from_source: Pose, edge_pixels: EdgePixels
    ) -> Float32[np.ndarray, "2 samples"]:
        """Inverse depth of the samples of edge pixels, negative where nothing is seen, in the caller's thread.

        Quads and pose are those of the last call, whose block bounds are used.
        """
        out, pose = edge_pixels.inverse_depth.copy(), rows_of(target_from_source)
        rasterize_edge_pixels(quads, self._boxes, pose, self._double_target, edge_pixels, out.reshape(-1))
        return out


def target_of(size: tuple[int, int], inverse_depth: Float32[np.ndarray, "*size"]) -> Target:
    """A target of a size, as kernels take it."""
    sin_p, cos_p, sin_a, cos_a = target_tables(size)
    rows, cols = np.stack([sin_p, cos_p]), np.stack([sin_a, -cos_a])
    row_scale, row_zero, col_scale, col_zero = map(np.float32, pixel_scale(size))
    return Target(
        rows.astype(np.float32), cols.astype(np.float32), rows, cols, (row_scale, row_zero, col_scale, col_zero),
        inverse_depth.reshape(-1), size[0], size[1],
    )  # fmt: skip


def view_of(size: PerspectiveSize) -> tuple[np.float32, ...]:
    """A perspective view as kernels take it: its focal length in pixels, half of its height and width at distance 1."""
    return tuple(map(np.float32, (size.focal, *size.half_extent)))


def rows_of(pose: Pose) -> tuple[tuple[np.float32, ...], ...]:
    """Three rows of a rotation with the shift behind them, as kernels take it."""
    return tuple(tuple(map(np.float32, (*row, shift))) for row, shift in zip(pose.rotation, pose.position, strict=True))


def rasterize(mesh: Mesh, target_from_source: Pose, size: tuple[int, int], threads: int | None = None) -> Fragments:
    """What each pixel of an equirectangular target of any ``size = (height, width)`` sees of ``mesh``.

    Fragments of the nearest front face through each pixel centre; back faces are culled. The result does not depend on
    ``threads``.
    """
    drawn = np.empty(size[0] * size[1], np.int32)
    inverse_depth = Rasterizer(size, threads)(mesh.blocks, target_from_source, drawn)
    return Fragments(inverse_depth, mesh.face_numbers(drawn).astype(np.int32).reshape(size))
