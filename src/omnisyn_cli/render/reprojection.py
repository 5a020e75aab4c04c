"""Backward warping: what a panorama shows at points that somebody else supposes, whatever its own depth says.

A pixel of the target and an inverse depth are a point, and the photograph shows every point somewhere: it is the colour
of the point, or of what occludes it. The panorama's own depth in that direction tells which.
"""

import math
from collections.abc import Callable
from functools import cached_property, partial

import numpy as np
from jaxtyping import Float, Float32

from omnisyn_cli.compute.arrays import empty
from omnisyn_cli.compute.jit import fast_kernel
from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.compute.trigonometry import atan2_fast
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.render.shade import FULL_CONFIDENCE, Shader, source_view
from omnisyn_cli.render.shade_kernels import LEVEL, X, Y, Z, find_source_directions
from omnisyn_cli.render.texture import Texture
from omnisyn_cli.types import DirectionTables, SourceSampler


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
