"""Colour for a surface: the photograph looked up where each visible point was seen from.

A target ray r that meets a surface at inverse depth ρ meets the point that the source sees in the direction
``Rᵀ(r − ρ·t)``. Nothing else is needed, so the texture has its own resolution, independent of mesh and target.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float32, Integer

from omnisyn_cli.compute.threads import run_bands
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import grid_subsample
from omnisyn_cli.geometry.sphere import direction_tables, pixel_scale
from omnisyn_cli.render.mesh import Mesh
from omnisyn_cli.render.shade_kernels import shade_edge_pixels, shade_rows
from omnisyn_cli.render.texture import CHANNELS, Texture, cubic_weights
from omnisyn_cli.types import EdgePixels

__all__ = ["ConfidenceMap", "Shader", "make_confidence_map"]

InverseDepth = Float32[np.ndarray, "height width"]


@dataclass(frozen=True)
class ConfidenceMap:
    """Trust in the quarters of the quads of a mesh, to be looked up by the texture coordinates of its panorama.

    Attributes:
        values: an image of the quarters, row after row, with a row for each polar cap and one column more, before the
            first; empty where all of it is 1.
        layout: scale and offset from texel rows to rows of this image, the same for columns, numbers per row.
    """

    values: Float32[np.ndarray, " numbers"]
    layout: Float32[np.ndarray, "5"]


def make_confidence_map(mesh: Mesh, texture: Texture) -> ConfidenceMap:
    """Trust in a mesh, for its panorama; in the caps that of the quads beside them."""
    rows, cols, _ = mesh.trust.shape
    image = mesh.trust.reshape(rows, cols, 2, 2).transpose(0, 2, 1, 3).reshape(2 * rows, 2 * cols)
    caps = np.stack([mesh.trust[0, :, :2], mesh.trust[-1, :, 2:]]).min(axis=-1).repeat(2, axis=1)
    bordered = np.pad(np.concatenate([caps[:1], image, caps[1:]]), ((0, 0), (1, 0)), mode="wrap")
    layout: list[float] = []
    for axis, offset in ((0, 2), (2, 4)):
        scale, zero = texture.layout[0, offset : offset + 2]
        mesh_scale, mesh_zero = (2.0 * number for number in pixel_scale(mesh.size)[axis : axis + 2])
        layout += [mesh_scale / scale, mesh_zero + 1.0 - zero * mesh_scale / scale]
    values = bordered.ravel() if (mesh.trust != 1.0).any() else bordered[:0].ravel()
    return ConfidenceMap(values.astype(np.float32, copy=False), np.array([*layout, bordered.shape[1]], np.float32))


FULL_CONFIDENCE = ConfidenceMap(np.empty(0, np.float32), np.zeros(5, np.float32))
"""In everything."""


class Shader:
    """Tables for one target size, and the image it writes; reused from frame to frame."""

    def __init__(self, size: tuple[int, int], threads: int | None = None) -> None:
        self.size, self.threads = size, threads
        self._tables = tuple(table.astype(np.float32) for table in direction_tables(*size))
        self._image = np.empty((*size, CHANNELS), np.float32)

    def __call__(
        self, inverse_depth: InverseDepth, trust: ConfidenceMap, texture: Texture, target_from_source: Pose
    ) -> Float32[np.ndarray, "height width 4"]:
        """Colour and trust of a surface; see :func:`shade`. The next call overwrites the result.

        Args:
            inverse_depth: 1/metre from the target's centre, negative where nothing is seen.
            trust: in the surface.
            texture: the photograph.
            target_from_source: the transform.
        """
        shade_band = self._kernel(trust, texture, target_from_source)
        run_bands(
            lambda begin, end: shade_band(inverse_depth, self._tables, self._image, begin, end),
            self.size[0],
            self.threads,
        )
        return self._image

    def shade_rows_into(
        self, inverse_depth: InverseDepth, trust: ConfidenceMap, texture: Texture, target_from_source: Pose,
        begin: int, end: int, out: Float32[np.ndarray, "rows width 4"],
    ) -> None:  # fmt: skip
        """Rows ``begin`` to ``end`` of what a call gives, into memory of the caller's, in the caller's thread.

        Args:
            inverse_depth: of every pixel.
            trust: in it.
            texture: the photograph.
            target_from_source: the transform.
            begin: first row.
            end: the row after the last.
            out: written.
        """
        sin_p, cos_p, sin_a, cos_a = self._tables
        tables = (sin_p[begin:end], cos_p[begin:end], sin_a, cos_a)
        self._kernel(trust, texture, target_from_source)(inverse_depth[begin:end], tables, out, 0, end - begin)

    def sample_rows(
        self, inverse_depth: Float32[np.ndarray, "rows width"], texture: Texture, target_from_source: Pose, top: int,
        out: Float32[np.ndarray, "rows width 4"],
    ) -> None:  # fmt: skip
        """Colour and alpha where surfaces are supposed in rows from ``top`` on, in the caller's thread.

        Args:
            inverse_depth: of those rows.
            texture: the photograph.
            target_from_source: the transform.
            top: row of the target that the first of them is.
            out: written.
        """
        sin_p, cos_p, sin_a, cos_a = self._tables
        rows = slice(top, top + len(out))
        tables = (sin_p[rows], cos_p[rows], sin_a, cos_a)
        self._kernel(FULL_CONFIDENCE, texture, target_from_source)(inverse_depth, tables, out, 0, len(out))

    def shade_grid(
        self, inverse_depth: InverseDepth, trust: ConfidenceMap, texture: Texture, target_from_source: Pose,
        rows: Integer[np.ndarray, " rows"], cols: Integer[np.ndarray, " cols"],
    ) -> Float32[np.ndarray, "rows cols 4"]:  # fmt: skip
        """What a call gives where some rows and columns cross; arguments as of :meth:`shade_rows_into`."""
        sin_p, cos_p, sin_a, cos_a = self._tables
        some = grid_subsample(inverse_depth, rows, cols)
        tables = (sin_p[rows], cos_p[rows], sin_a[cols], cos_a[cols])
        out = np.empty((len(rows), len(cols), CHANNELS), np.float32)
        shade_band = self._kernel(trust, texture, target_from_source)
        run_bands(lambda begin, end: shade_band(some, tables, out, begin, end), len(rows), self.threads)
        return out

    def samples(
        self, inverse_depth: Float32[np.ndarray, "2 samples"], edge_pixels: EdgePixels, trust: ConfidenceMap, texture: Texture,
        target_from_source: Pose,
    ) -> Float32[np.ndarray, "2 samples 4"]:  # fmt: skip
        """Colour and trust of the samples of spots, in the caller's thread.

        Args:
            inverse_depth: of the samples.
            spots: of rows of the target.
            trust: in the surface.
            texture: the photograph.
            target_from_source: the transform.
        """
        out = np.empty((*inverse_depth.shape, CHANNELS), np.float32)
        sin_p, cos_p = self._rows_of_samples
        rotation, translation, ratio = self._view(texture, target_from_source)
        source = (trust.values, trust.layout, *_as_kernels_take(texture))
        shade_edge_pixels(inverse_depth, edge_pixels, *source, sin_p, cos_p, rotation, translation, ratio / np.float32(2.0), out)
        return out

    @cached_property
    def _rows_of_samples(self) -> tuple[Float32[np.ndarray, " rows"], ...]:
        """Sines and cosines of polar angles."""
        return tuple(table.astype(np.float32) for table in direction_tables(2 * self.size[0], 2 * self.size[1])[:2])

    def _view(self, texture: Texture, target_from_source: Pose) -> tuple[np.ndarray, np.ndarray, np.float32]:
        """Rotation, position, and texels in a pixel of the target, as kernels take them."""
        rotation = np.ascontiguousarray(target_from_source.rotation, np.float32)
        translation = np.ascontiguousarray(target_from_source.position, np.float32)
        return rotation, translation, np.float32(texture.size[0] / self.size[0])

    def _kernel(self, trust: ConfidenceMap, texture: Texture, target_from_source: Pose) -> Callable[..., None]:
        """Takes inverse depth, direction tables, an image, first row and the row after the last."""
        rotation, translation, ratio = self._view(texture, target_from_source)
        source = (trust.values, trust.layout, *_as_kernels_take(texture))

        def band(
            inverse_depth: np.ndarray, tables: tuple[np.ndarray, ...], image: np.ndarray, begin: int, end: int
        ) -> None:
            shade_rows(inverse_depth, *source, *tables, rotation, translation, ratio, image, begin, end)

        return band

    def shade_at_infinity(self, texture: Texture, target_from_source: Pose) -> Float32[np.ndarray, "height width 4"]:
        """The texture as a sphere of infinite radius: only the rotation matters. The next call overwrites it."""
        return self(np.zeros(self.size, np.float32), FULL_CONFIDENCE, texture, target_from_source)

    def rows_at_infinity(
        self, texture: Texture, target_from_source: Pose, begin: int, end: int
    ) -> Float32[np.ndarray, "rows width 4"]:
        """Rows ``begin`` to ``end`` of :meth:`shade_at_infinity`, in memory of their own, in the caller's thread."""
        sky = np.zeros((end - begin, self.size[1]), np.float32)
        out = np.empty((*sky.shape, CHANNELS), np.float32)
        self.sample_rows(sky, texture, target_from_source, begin, out)
        return out


def _as_kernels_take(texture: Texture) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Texels, how they lie, and the weights that go with them."""
    return texture.texels, texture.layout, cubic_weights(str(texture.texels.dtype))


def shade(
    inverse_depth: InverseDepth,
    mesh: Mesh,
    texture: Texture,
    target_from_source: Pose,
    threads: int | None = None,
) -> Float32[np.ndarray, "height width 4"]:
    """Colour of a surface and, as fourth channel, alpha times the trust in it; all 0 where nothing is seen.

    Where the photograph is magnified it is read by Catmull-Rom interpolation; where it is shrunk, two mip levels,
    half a level finer than that, are read bilinearly and mixed.

    Args:
        inverse_depth: what the target sees of ``mesh``, 1/metre, negative where that is nothing.
        mesh: the surface.
        texture: the photograph, in the frame of the mesh.
        target_from_source: the transform that it was seen with.
        threads: at most this many.
    """
    height, width = inverse_depth.shape
    return Shader((height, width), threads)(inverse_depth, make_confidence_map(mesh, texture), texture, target_from_source)
