"""The pixels of a rectified image, and its two units: rows of disparity, and inverse depth in 1/baselines."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.geometry.sweep import inverse_depth_from_parallax, parallax_from_inverse_depth

# In 1/baselines: nothing nearer than a twentieth of a baseline is a valid match; chosen by eye.
MAX_INVERSE_DEPTH = 20.0


@dataclass(frozen=True)
class EpipolarGrid:
    """The pixels of a rectified image, and its two units: rows of disparity, and inverse depth in 1/baselines."""

    directions: Float[np.ndarray, "height width 3"]  # unit vectors in the frame of the pair
    polar_angle: Float[np.ndarray, "height 1"]  # of each row, to the epipole (radians)
    up: Float[np.ndarray, " 3"]  # the world's, in the frame of the pair

    @property
    def height(self) -> int:
        """Rows."""
        return int(self.polar_angle.shape[0])

    @property
    def sin_elevation(self) -> Float[np.ndarray, "height width"]:
        """Sine of the elevation above the horizon."""
        return np.asarray(self.directions @ self.up)

    def disparity(self, inverse_depth: np.ndarray) -> Float[np.ndarray, "height width"]:
        """Rows for an inverse depth; −1 where it is negative (behind the camera)."""
        parallax = parallax_from_inverse_depth(self.polar_angle, np.maximum(inverse_depth, 0.0))
        return np.where(inverse_depth < 0, -1.0, parallax * (self.height / math.pi)).astype(np.float32)

    def inverse_depth(self, disparity: np.ndarray, row: np.ndarray | None = None) -> Float[np.ndarray, "*pixels"]:
        """In 1/baselines, in [0, :data:`MAX_INVERSE_DEPTH`]; of whole images, or of single pixels in some rows."""
        parallax = np.maximum(disparity, 0.0) * (math.pi / self.height)
        inverse_depth = inverse_depth_from_parallax(self._polar_angle_of(row), parallax)
        return np.asarray(np.minimum(inverse_depth, MAX_INVERSE_DEPTH))

    def inverse_depth_per_row(
        self, disparity: np.ndarray, row: np.ndarray | None = None
    ) -> Float[np.ndarray, "*pixels"]:
        """How much inverse depth one row of disparity is worth: the derivative of ``sin δ / sin(polar_angle + δ)``."""
        polar_angle = self._polar_angle_of(row)
        far_angle = np.minimum(polar_angle + disparity * (math.pi / self.height), math.pi - 1e-3)
        return np.asarray(np.sin(polar_angle) / np.sin(far_angle) ** 2 * (math.pi / self.height))

    def _polar_angle_of(self, row: np.ndarray | None) -> np.ndarray:
        return self.polar_angle if row is None else self.polar_angle[row, 0]

    def is_away_from_epipoles(self, degrees: float) -> Bool[np.ndarray, "height 1"]:
        """Rows that are farther than an angle from both epipoles, where parallax vanishes."""
        return np.asarray(np.sin(self.polar_angle) > math.sin(math.radians(degrees)))
