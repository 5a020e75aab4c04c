"""Both panoramas of a pair rotated until epipolar lines are meridians, and estimates rotated back.

Everything in this frame is dimensionless: distances count in baselines, so inverse depth is ``ρ · baseline``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, partial

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from omnisyn_cli.compute.threads import both
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.geometry.sampling import rotated_directions, sample_bilinear
from omnisyn_cli.geometry.sphere import UP, pixel_directions, pixel_to_angles
from omnisyn_cli.geometry.sweep import (
    epipole_frame,
    inverse_depth_from_parallax,
    parallax_from_inverse_depth,
    swap_cameras_in_epipole_frame,
)
from omnisyn_cli.types import View

__all__ = ["rectify", "resize_area"]

HALF_TURN_ABOUT_Z = np.diag([-1.0, -1.0, 1.0])
"""Seen from the second panorama the first one lies at the zenith once the frame is turned upside down about z."""

MAX_INVERSE_DEPTH = 20.0
"""In 1/baselines: nothing nearer than a twentieth of a baseline is a valid match; chosen by eye."""

MIN_USABLE_SHARE = 0.99
"""Share of a resampled pixel that the mask must allow: in effect all of it, but for rounding."""


@dataclass(frozen=True)
class RectifiedPair:
    """Two images of one orientation; the second camera lies at the zenith (+y) of the first.

    Attributes:
        first, second: ``(height, width, 3)`` float32 RGB in [0, 1].
        first_usable, second_usable: ``(height, width)``; False where a mask forbids it.
        world_from_frame: ``(3, 3)`` orientation of both.
        baseline: metres.
    """

    first: Float[np.ndarray, "height width 3"]
    second: Float[np.ndarray, "height width 3"]
    first_usable: Bool[np.ndarray, "height width"]
    second_usable: Bool[np.ndarray, "height width"]
    world_from_frame: Float[np.ndarray, "3 3"]
    baseline: float

    @property
    def size(self) -> tuple[int, int]:
        """``(height, width)`` of the images."""
        return self.first.shape[0], self.first.shape[1]

    @cached_property
    def grid(self) -> EpipolarGrid:
        """The pixels of both images."""
        rows = np.arange(self.size[0], dtype=np.float64)[:, None]
        _, polar_angle = pixel_to_angles(rows, np.zeros_like(rows), self.size)
        return EpipolarGrid(pixel_directions(*self.size), polar_angle, np.asarray(self.world_from_frame.T @ UP))

    def reversed(self) -> RectifiedPair:
        """The same pair seen from the second panorama."""
        return RectifiedPair(
            first=swap_cameras_in_epipole_frame(self.second),
            second=swap_cameras_in_epipole_frame(self.first),
            first_usable=swap_cameras_in_epipole_frame(self.second_usable),
            second_usable=swap_cameras_in_epipole_frame(self.first_usable),
            world_from_frame=self.world_from_frame @ HALF_TURN_ABOUT_Z,
            baseline=self.baseline,
        )

    def resized(self, size: tuple[int, int]) -> RectifiedPair:
        """The same pair, reduced to ``size = (height, width)``."""
        if size == self.size:
            return self
        first_usable, second_usable = (
            resize_area(usable.astype(np.float32), size) > MIN_USABLE_SHARE
            for usable in (self.first_usable, self.second_usable)
        )
        return RectifiedPair(
            resize_area(self.first, size),
            resize_area(self.second, size),
            first_usable,
            second_usable,
            self.world_from_frame,
            self.baseline,
        )

    def remap_to_camera(self, pose: Pose, size: tuple[int, int]) -> RemapTable:
        """For each pixel of the first camera's own image of a ``size``: where this frame shows the same direction."""
        return RemapTable.for_directions(rotated_directions(size, self.world_from_frame, pose.rotation), self.size)


@dataclass(frozen=True)
class EpipolarGrid:
    """The pixels of a rectified image, and its two units: rows of disparity, and inverse depth in 1/baselines.

    Attributes:
        directions: unit vectors in the frame of the pair.
        polar_angle: of every row, the angle to the epipole in radians.
        up: the world's up in the frame of the pair.
    """

    directions: Float[np.ndarray, "height width 3"]
    polar_angle: Float[np.ndarray, "height 1"]
    up: Float[np.ndarray, " 3"]

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


def rectify(first: View, second: View, size: tuple[int, int]) -> RectifiedPair:
    """The pair at ``size = (height, width)``; raises ValueError for equal positions."""
    frame, _, baseline = epipole_frame(first.pose, second.pose)
    images = both(*(partial(_rotated_view, view, frame, size) for view in (first, second)))
    usable = [_rotated_mask(view, frame, size) for view in (first, second)]
    return RectifiedPair(images[0], images[1], usable[0], usable[1], frame.rotation, baseline)


def resize_area(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Averages over the area that a new pixel covers; enlarging by a whole factor repeats pixels.

    No new pixel covers anything beyond the border, so seam and poles need no care.
    """
    if image.shape[:2] == size:
        return np.asarray(image, np.float32)
    return np.asarray(cv2.resize(np.ascontiguousarray(image, np.float32), size[::-1], interpolation=cv2.INTER_AREA))


def usable_pixels(view: View, size: tuple[int, int]) -> Bool[np.ndarray, "height width"]:
    """The mask of a view at another size: True where no forbidden pixel contributes."""
    if view.mask is None:
        return np.ones(size, bool)
    return np.asarray(resize_area(view.mask.astype(np.float32), size) > MIN_USABLE_SHARE)


def _rotated_view(view: View, frame: Pose, size: tuple[int, int]) -> Float32[np.ndarray, "height width 3"]:
    return _rotate(resize_area(view.image, size), view.pose, frame, size)


def _rotated_mask(view: View, frame: Pose, size: tuple[int, int]) -> np.ndarray:
    if view.mask is None:
        return np.ones(size, bool)
    return np.asarray(_rotate(usable_pixels(view, size).astype(np.float32), view.pose, frame, size) > MIN_USABLE_SHARE)


def _rotate(image: np.ndarray, pose: Pose, frame: Pose, size: tuple[int, int]) -> np.ndarray:
    """Exact bilinear interpolation: a :class:`RemapTable` has steps of 1/32 pixel, and matching would measure them."""
    return np.asarray(sample_bilinear(image, rotated_directions(size, pose.rotation, frame.rotation)), np.float32)
