"""Both panoramas of a pair rotated until epipolar lines are meridians, and estimates rotated back.

Everything in this frame is dimensionless: distances count in baselines, so inverse depth is ``ρ · baseline``.
"""

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from jaxtyping import Bool, Float, Float32

from omnisyn_cli.compute.threads import both
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.geometry.resize import MIN_USABLE_SHARE, resize_area, resize_mask
from omnisyn_cli.geometry.sampling import rotated_directions, sample_bilinear
from omnisyn_cli.geometry.sphere import UP, pixel_directions, pixel_to_angles
from omnisyn_cli.geometry.sweep import epipole_frame, swap_cameras_in_epipole_frame
from omnisyn_cli.stereo.depth_prior import DepthPrior, DisparityPrior
from omnisyn_cli.stereo.epipolar_grid import EpipolarGrid
from omnisyn_cli.types import View

# Seen from the second panorama the first one lies at the zenith once the frame is turned upside down about z.
HALF_TURN_ABOUT_Z = np.diag([-1.0, -1.0, 1.0])


@dataclass(frozen=True)
class RectifiedPair:
    """Two images of one orientation; the second camera lies at the zenith (+y) of the first."""

    # float32 RGB in [0, 1]
    first: Float[np.ndarray, "height width 3"]
    second: Float[np.ndarray, "height width 3"]
    # ``(height, width)``; False where a mask forbids it
    first_usable: Bool[np.ndarray, "height width"]
    second_usable: Bool[np.ndarray, "height width"]
    world_from_frame: Float[np.ndarray, "3 3"]  # orientation of both
    baseline: float  # metres
    # what is expected of both cameras' depth, each in the frame of its own direction; None for nothing
    priors: tuple[DepthPrior, DepthPrior] | None = None

    @property
    def size(self) -> tuple[int, int]:
        """``(height, width)`` of the images."""
        return self.first.shape[0], self.first.shape[1]

    @property
    def is_canonical_order(self) -> bool:
        """True of either a pair or its reverse, by the places of the cameras alone: so both have the same planes."""
        way = self.world_from_frame[:, 1]
        return bool(way[np.abs(way).argmax()] > 0)

    @cached_property
    def grid(self) -> EpipolarGrid:
        """The pixels of both images."""
        rows = np.arange(self.size[0], dtype=np.float64)[:, None]
        _, polar_angle = pixel_to_angles(rows, np.zeros_like(rows), self.size)
        return EpipolarGrid(pixel_directions(*self.size), polar_angle, np.asarray(self.world_from_frame.T @ UP))

    @cached_property
    def prior(self) -> DisparityPrior | None:
        """What disparities of the first image cost beside what is matched."""
        return None if self.priors is None else self.priors[0].in_rows(self.grid)

    def reversed(self) -> "RectifiedPair":
        """The same pair seen from the second panorama."""
        return RectifiedPair(
            first=swap_cameras_in_epipole_frame(self.second),
            second=swap_cameras_in_epipole_frame(self.first),
            first_usable=swap_cameras_in_epipole_frame(self.second_usable),
            second_usable=swap_cameras_in_epipole_frame(self.first_usable),
            world_from_frame=self.world_from_frame @ HALF_TURN_ABOUT_Z,
            baseline=self.baseline,
            priors=None if self.priors is None else self.priors[::-1],
        )

    def resized(self, size: tuple[int, int]) -> "RectifiedPair":
        """The same pair, reduced to ``size = (height, width)``."""
        if size == self.size:
            return self
        first_usable, second_usable = (resize_mask(usable, size) for usable in (self.first_usable, self.second_usable))
        first, second = (resize_area(image, size) for image in (self.first, self.second))
        priors = None
        if self.priors is not None:
            of_first, of_second = (DepthPrior(*(resize_area(each, size) for each in prior)) for prior in self.priors)
            priors = of_first, of_second
        return RectifiedPair(first, second, first_usable, second_usable, self.world_from_frame, self.baseline, priors)

    def remap_to(self, rotation: Float[np.ndarray, "3 3"], size: tuple[int, int]) -> RemapTable:
        """For each pixel of an image of a ``size`` in a world-from-camera ``rotation``: where this frame shows it."""
        return RemapTable.for_directions(rotated_directions(size, self.world_from_frame, rotation), self.size)


def rectify(first: View, second: View, size: tuple[int, int]) -> RectifiedPair:
    """The pair at ``size = (height, width)``; raises ValueError for equal positions."""
    frame, _, baseline = epipole_frame(first.pose, second.pose)
    images = both(*(partial(_rotated_view, view, frame, size) for view in (first, second)))
    usable = [_rotated_mask(view, frame, size) for view in (first, second)]
    return RectifiedPair(images[0], images[1], usable[0], usable[1], frame.rotation, baseline)


def usable_pixels(view: View, size: tuple[int, int]) -> Bool[np.ndarray, "height width"]:
    """The mask of a view at another size: True where no forbidden pixel contributes."""
    return np.ones(size, bool) if view.mask is None else resize_mask(view.mask, size)


def _rotated_view(view: View, frame: Pose, size: tuple[int, int]) -> Float32[np.ndarray, "height width 3"]:
    return _rotate(resize_area(view.image, size), view.pose, frame, size)


def _rotated_mask(view: View, frame: Pose, size: tuple[int, int]) -> np.ndarray:
    if view.mask is None:
        return np.ones(size, bool)
    return np.asarray(_rotate(usable_pixels(view, size).astype(np.float32), view.pose, frame, size) > MIN_USABLE_SHARE)


def _rotate(image: np.ndarray, pose: Pose, frame: Pose, size: tuple[int, int]) -> np.ndarray:
    """Exact bilinear interpolation: a :class:`RemapTable` has steps of 1/32 pixel, and matching would measure them."""
    return np.asarray(sample_bilinear(image, rotated_directions(size, pose.rotation, frame.rotation)), np.float32)
