"""A panorama that is asked what it shows where somebody supposes a surface, whatever its own depth says.

A pixel of the target and an inverse depth are a point, and a photograph shows every point somewhere: what it shows
there is the colour of the point, or of what hides it. How far the panorama's own surface is in that direction says
which.
"""

from collections.abc import Callable
from functools import cached_property

import numpy as np
from jaxtyping import Float, Float32

from omnisyn_cli.compute.threads import run_bands
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import direction_tables
from omnisyn_cli.render.reprojection_kernels import measure_occlusion
from omnisyn_cli.render.shade import FULL_CONFIDENCE, Shader
from omnisyn_cli.render.texture import Texture
from omnisyn_cli.types import SourceSampler

__all__ = ["Reprojector"]


class Reprojector:
    """A panorama with its depth, to be asked from any number of places.

    Args:
        texture: makes the photograph, once it is asked for.
        inverse_depth: 1/metre, of the panorama, at any size.
        shader: of the frames' size.
    """

    def __init__(
        self, texture: Callable[[], Texture], inverse_depth: Float[np.ndarray, "rows cols"], shader: Shader
    ) -> None:
        self._make_texture, self._shader = texture, shader
        self._inverse_depth = np.ascontiguousarray(inverse_depth, np.float32)
        self._coarse: Shader | None = None

    def seen_from(self, target_from_source: Pose) -> SourceSampler:
        """What it says to a target."""

        def colour_rows(inverse_depth: np.ndarray, top: int, out: np.ndarray) -> None:
            self._shader.sample_rows(inverse_depth, self._texture, target_from_source, top, out)

        def colour(inverse_depth: np.ndarray) -> Float32[np.ndarray, "height width 4"]:
            shader = self._shader_of(inverse_depth.shape)
            return shader(inverse_depth, FULL_CONFIDENCE, self._texture, target_from_source).copy()

        def nearer(inverse_depth: np.ndarray, least: float) -> Float32[np.ndarray, "height width"]:
            out = np.empty(inverse_depth.shape, np.float32)
            tables = [table.astype(np.float32) for table in direction_tables(*inverse_depth.shape)]
            rotation, position = (
                np.ascontiguousarray(values, np.float32)
                for values in (target_from_source.rotation, target_from_source.position)
            )
            run_bands(
                lambda begin, end: measure_occlusion(
                    inverse_depth, *tables, rotation, position, self._inverse_depth, np.float32(least), out, begin, end
                ),
                len(out),
                self._shader.threads,
            )
            return out

        return SourceSampler(colour_rows, colour, nearer)

    @cached_property
    def _texture(self) -> Texture:
        return self._make_texture()

    def _shader_of(self, size: tuple[int, ...]) -> Shader:
        """Of a size other than the frames'; a fuser asks about one, frame after frame."""
        if self._coarse is None or self._coarse.size != size:
            self._coarse = Shader((size[0], size[1]), self._shader.threads)
        return self._coarse
