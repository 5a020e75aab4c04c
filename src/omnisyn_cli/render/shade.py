"""Shading: the photograph is looked up in the direction in which its camera saw each visible point.

A target ray r that meets a surface at inverse depth ρ meets the point that the source sees in the direction
``Rᵀ(r − ρ·t)``. Nothing else is needed, so the texture has its own resolution, independent of mesh and target.

Points may also be supposed by somebody else: a photograph shows every point somewhere, in its colour or that of what
occludes it. The panorama's own depth in that direction tells which.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from jaxtyping import Float, Float32, Integer

from omnisyn_cli.compute.arrays import empty
from omnisyn_cli.compute.jit import fast_kernel
from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.compute.trigonometry import atan2_fast
from omnisyn_cli.geometry.perspective import pixels_per_radian
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import grid_subsample
from omnisyn_cli.geometry.sphere import pixel_scale
from omnisyn_cli.render.mesh import Mesh
from omnisyn_cli.render.shade_kernels import (
    LEVEL,
    SourceView,
    TextureArrays,
    X,
    Y,
    Z,
    find_source_directions,
    shade_edge_pixels,
    shade_rows,
)
from omnisyn_cli.render.texture import CHANNELS, Texture, cubic_weights
from omnisyn_cli.types import DirectionTables, EdgePixels, SourceSampler

InverseDepth = Float32[np.ndarray, "height width"]


@dataclass(frozen=True)
class ConfidenceMap:
    """Confidence of the quarters of a mesh's quads, to be looked up by texture coordinates of its panorama."""

    # an image of the quarters, row after row, with a row for each polar cap and a column before the first, which
    # repeats the last; empty if all of it is 1
    values: Float32[np.ndarray, " numbers"]
    # scale and offset from texel rows to rows of this image, the same for columns, numbers per row
    layout: Float32[np.ndarray, "5"]


def make_confidence_map(mesh: Mesh, texture: Texture) -> ConfidenceMap:
    """The confidence map of a mesh; the polar caps get the confidence of the quads beside them."""
    outer = np.stack([mesh.surface_confidence[0, :, :2], mesh.surface_confidence[-1, :, 2:]])
    caps = outer.min(axis=-1).repeat(2, axis=1)
    bordered = np.pad(np.concatenate([caps[:1], mesh.quarter_image, caps[1:]]), ((0, 0), (1, 0)), mode="wrap")
    layout: list[float] = []
    for axis, offset in ((0, 2), (2, 4)):
        scale, zero = texture.layout[0, offset : offset + 2]
        mesh_scale, mesh_zero = (2.0 * number for number in pixel_scale(mesh.size)[axis : axis + 2])
        layout += [mesh_scale / scale, mesh_zero + 1.0 - zero * mesh_scale / scale]
    values = bordered.ravel() if (mesh.surface_confidence != 1.0).any() else bordered[:0].ravel()
    return ConfidenceMap(values.astype(np.float32, copy=False), np.array([*layout, bordered.shape[1]], np.float32))


FULL_CONFIDENCE = ConfidenceMap(np.empty(0, np.float32), np.zeros(5, np.float32))  # of any surface: 1 everywhere


class Shader:
    """Shades surfaces seen by targets of one size. Its tables and its image are reused from frame to frame."""

    def __init__(self, size: tuple[int, int], threads: int | None = None) -> None:
        self.size, self.threads = size, threads
        self._tables = DirectionTables.of_target(size)
        self._image = np.empty((*size, CHANNELS), np.float32)

    def __call__(
        self, inverse_depth: InverseDepth, confidence: ConfidenceMap, texture: Texture, target_from_source: Pose
    ) -> Float32[np.ndarray, "height width 4"]:
        """Colour of a surface and, as fourth channel, alpha times its confidence; all 0 where nothing is seen.

        Inverse depth is in 1/metre from the target's centre, negative where nothing is seen. Where the photograph is
        magnified it is read by Catmull-Rom interpolation. Where it is minified, two mip levels, half a level finer than
        its footprint, are read bilinearly and mixed. The next call overwrites the result.
        """
        shade_tile = self._tile_shader(confidence, texture, target_from_source)
        run_ranges(partial(shade_tile, inverse_depth, self._tables, self._image), self.size[0], self.threads)
        return self._image

    def shade_rows_into(
        self, inverse_depth: InverseDepth, confidence: ConfidenceMap, texture: Texture, target_from_source: Pose,
        begin: int, end: int, out: Float32[np.ndarray, "rows width 4"],
    ) -> None:  # fmt: skip
        """Rows ``begin`` to ``end`` of what a call gives, into the caller's buffer, in the caller's thread."""
        shade_tile = self._tile_shader(confidence, texture, target_from_source)
        shade_tile(inverse_depth[begin:end], self._tables.of_rows(slice(begin, end)), out, 0, end - begin)

    def sample_rows(
        self, inverse_depth: Float32[np.ndarray, "rows width"], texture: Texture, target_from_source: Pose, top: int,
        out: Float32[np.ndarray, "rows width 4"],
    ) -> None:  # fmt: skip
        """Colour and alpha at given depths, with full confidence, in rows from ``top`` on, in the caller's thread."""
        tables = self._tables.of_rows(slice(top, top + len(out)))
        self._tile_shader(FULL_CONFIDENCE, texture, target_from_source)(inverse_depth, tables, out, 0, len(out))

    def shade_grid(
        self, inverse_depth: InverseDepth, confidence: ConfidenceMap, texture: Texture, target_from_source: Pose,
        rows: Integer[np.ndarray, " rows"], cols: Integer[np.ndarray, " cols"],
    ) -> Float32[np.ndarray, "rows cols 4"]:  # fmt: skip
        """What a call gives at the crossings of some rows and columns; arguments as of :meth:`shade_rows_into`."""
        sampled, tables = grid_subsample(inverse_depth, rows, cols), self._tables.of_rows(rows).of_cols(cols)
        out = np.empty((len(rows), len(cols), CHANNELS), np.float32)
        shade_tile = self._tile_shader(confidence, texture, target_from_source)
        run_ranges(partial(shade_tile, sampled, tables, out), len(rows), self.threads)
        return out

    def shade_edges(
        self, inverse_depth: Float32[np.ndarray, "2 samples"], edge_pixels: EdgePixels, confidence: ConfidenceMap,
        texture: Texture, target_from_source: Pose,
    ) -> Float32[np.ndarray, "2 samples 4"]:  # fmt: skip
        """Colour and weight of the samples of edge pixels, given their inverse depth, in the caller's thread."""
        out = np.empty((*inverse_depth.shape, CHANNELS), np.float32)
        double, view = self._double_tables, source_view(target_from_source, texture.size[0] / self.size[0])
        view = view._replace(texels_per_pixel=view.texels_per_pixel / np.float32(2.0))
        arrays = _texture_arrays(confidence, texture)
        shade_edge_pixels(inverse_depth, edge_pixels, arrays, double.sin_p, double.cos_p, view, out)
        return out

    @cached_property
    def _double_tables(self) -> DirectionTables:
        """Of a target of twice the size, whose pixels are the samples of edge pixels."""
        return DirectionTables.of_size(2 * self.size[0], 2 * self.size[1])

    def _tile_shader(
        self, confidence: ConfidenceMap, texture: Texture, target_from_source: Pose
    ) -> Callable[[np.ndarray, DirectionTables, np.ndarray, int, int], None]:
        """The kernel of one surface; takes inverse depth, tables, an image, first row and the row after the last."""
        view = source_view(target_from_source, pixels_per_radian(texture.size) / pixels_per_radian(self.size))
        return partial(shade_rows, _texture_arrays(confidence, texture), view)

    def shade_at_infinity(self, texture: Texture, target_from_source: Pose) -> Float32[np.ndarray, "height width 4"]:
        """The texture as a sphere of infinite radius: only the rotation matters. The next call overwrites it."""
        return self(np.zeros(self.size, np.float32), FULL_CONFIDENCE, texture, target_from_source)

    def rows_at_infinity(
        self, texture: Texture, target_from_source: Pose, begin: int, end: int
    ) -> Float32[np.ndarray, "rows width 4"]:
        """Rows ``begin`` to ``end`` of :meth:`shade_at_infinity`, in a new array, in the caller's thread."""
        sky = np.zeros((end - begin, self.size[1]), np.float32)
        out = np.empty((*sky.shape, CHANNELS), np.float32)
        self.sample_rows(sky, texture, target_from_source, begin, out)
        return out


def source_view(target_from_source: Pose, texels_per_pixel: float) -> SourceView:
    """Where a source is seen from, as kernels take it."""
    rotation = np.ascontiguousarray(target_from_source.rotation, np.float32)
    position = np.ascontiguousarray(target_from_source.position, np.float32)
    return SourceView(rotation, position, np.float32(texels_per_pixel))


def _texture_arrays(confidence: ConfidenceMap, texture: Texture) -> TextureArrays:
    weights = cubic_weights(str(texture.texels.dtype))
    return TextureArrays(confidence.values, confidence.layout, texture.texels, texture.layout, weights)


class Reprojector:
    """A panorama with its depth (1/metre, at any size) that can be warped into any target.

    ``texture`` makes the photograph's texture, when it is needed first; the shader is of the frames' size.
    """

    def __init__(
        self, texture: Callable[[], Texture], inverse_depth: Float[np.ndarray, "rows cols"], shader: Shader
    ) -> None:
        self._make_texture, self._shader = texture, shader
        self.inverse_depth = np.ascontiguousarray(inverse_depth, np.float32)
        self._small_shader: Shader | None = None

    def sampler(self, target_from_source: Pose) -> SourceSampler:
        """Backward warping into one target."""

        def sample_rows(inverse_depth: np.ndarray, top: int, out: np.ndarray) -> None:
            self._shader.sample_rows(inverse_depth, self._texture, target_from_source, top, out)

        def sample(inverse_depth: np.ndarray) -> Float32[np.ndarray, "height width 4"]:
            shader = self._shader_of(inverse_depth.shape)
            return shader(inverse_depth, FULL_CONFIDENCE, self._texture, target_from_source).copy()

        def occlusion(inverse_depth: np.ndarray, min_inverse_depth: float) -> Float32[np.ndarray, "height width"]:
            out = np.empty(inverse_depth.shape, np.float32)
            tables, view = DirectionTables.of_size(*inverse_depth.shape), source_view(target_from_source, 1.0)
            least = np.float32(min_inverse_depth)
            measure = partial(_measure_occlusion, inverse_depth, tables, view, self.inverse_depth, least, out)
            run_ranges(measure, len(out), self._shader.threads)
            return out

        return SourceSampler(sample_rows, sample, occlusion)

    @cached_property
    def _texture(self) -> Texture:
        return self._make_texture()

    def _shader_of(self, size: tuple[int, ...]) -> Shader:
        """Of a size other than the frames'; a fuser asks for one such size, frame after frame."""
        if self._small_shader is None or self._small_shader.size != size:
            self._small_shader = Shader((size[0], size[1]), self._shader.threads)
        return self._small_shader


@fast_kernel()
def _measure_occlusion(rho, tables, view, surface, min_inverse_depth, out, begin, end):  # type: ignore[no-untyped-def]
    """By how much a panorama's own surface is nearer to it than points, for target rows ``begin`` to ``end``.

    ``rho`` ``(height, width)``: inverse depth of the points from the target; negative where there is none. ``tables``:
    :class:`omnisyn_cli.types.DirectionTables` of the target. ``view``:
    :class:`omnisyn_cli.render.shade_kernels.SourceView`. ``surface`` ``(rows, cols)``: inverse depth of the panorama.
    ``out``: difference of inverse depth, seen from the panorama, over the larger of both and ``min_inverse_depth``;
    positive where the surface hides the point, 0 where there is no point.
    """
    width, (rows, cols) = rho.shape[1], surface.shape
    row_scale, col_scale = np.float32(rows / math.pi), np.float32(cols / (2.0 * math.pi))
    coordinates, zero = empty((4, width), np.float32), np.float32(0.0)
    for row in range(begin, end):
        find_source_directions(
            rho[row], tables.sin_p[row], tables.cos_p[row], tables.sin_a, tables.cos_a, view, coordinates
        )
        for col in range(width):
            dx, dz = coordinates[X, col], coordinates[Z, col]
            coordinates[Y, col] = atan2_fast(math.sqrt(dx * dx + dz * dz), coordinates[Y, col]) * row_scale
            coordinates[X, col] = (atan2_fast(dx, -dz) + np.float32(math.pi)) * col_scale
            # The length of the direction is the point's distance from the source over that from the target.
            distance_ratio = math.sqrt(coordinates[LEVEL, col]) + np.float32(1e-9)
            coordinates[LEVEL, col] = max(rho[row, col], zero) / distance_ratio
        for col in range(width):
            i = min(max(np.int32(coordinates[Y, col]), 0), rows - 1)
            j = min(max(np.int32(coordinates[X, col]), 0), cols - 1)
            expected, own = coordinates[LEVEL, col], surface[i, j]
            difference = (own - expected) / max(expected, own, min_inverse_depth)
            out[row, col] = difference if rho[row, col] >= zero else zero
