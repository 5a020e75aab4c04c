"""Backward warping: what a panorama shows at points that somebody else supposes, whatever its own depth says.

A pixel of the target and an inverse depth are a point, and the photograph shows every point somewhere: it is the colour
of the point, or of what occludes it. The panorama's own depth in that direction tells which.
"""

from collections.abc import Callable
from functools import cached_property

import numpy as np
from jaxtyping import Float, Float32

from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.render.reprojection_kernels import measure_occlusion
from omnisyn_cli.render.shade import FULL_CONFIDENCE, Shader, source_view
from omnisyn_cli.render.texture import Texture
from omnisyn_cli.types import DirectionTables, SourceSampler


class Reprojector:
    """A panorama with its depth that can be warped into any target.

    Args:
        texture: makes the photograph's texture, when it is needed first.
        inverse_depth: 1/metre, of the panorama, at any size.
        shader: of the frames' size.
    """

    def __init__(
        self, texture: Callable[[], Texture], inverse_depth: Float[np.ndarray, "rows cols"], shader: Shader
    ) -> None:
        self._make_texture, self._shader = texture, shader
        self._inverse_depth = np.ascontiguousarray(inverse_depth, np.float32)
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
            run_ranges(
                lambda begin, end: measure_occlusion(
                    inverse_depth, tables, view, self._inverse_depth, least, out, begin, end
                ),
                len(out),
                self._shader.threads,
            )
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
