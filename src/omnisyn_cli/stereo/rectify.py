"""Both panoramas of a pair rotated until epipolar lines are meridians, and estimates rotated back.

Everything in this frame is dimensionless: distances count in baselines, so inverse depth is ``ρ · baseline``.
"""

import math
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt16

from omnisyn_cli.compute.jit import fast_kernel
from omnisyn_cli.compute.threads import both, run_ranges
from omnisyn_cli.geometry import sweep
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.geometry.resize import MIN_USABLE_SHARE, resize_area, resize_mask
from omnisyn_cli.geometry.sampling import rotated_directions, sample_bilinear
from omnisyn_cli.geometry.sphere import UP, pixel_directions, pixel_to_angles
from omnisyn_cli.stereo.semi_global import FIXED_POINT_SCALE, DisparityRange
from omnisyn_cli.types import View

Descriptors = Float32[np.ndarray, "height width length"]

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
        parallax = sweep.parallax_from_inverse_depth(self.polar_angle, np.maximum(inverse_depth, 0.0))
        return np.where(inverse_depth < 0, -1.0, parallax * (self.height / math.pi)).astype(np.float32)

    def inverse_depth(self, disparity: np.ndarray, row: np.ndarray | None = None) -> Float[np.ndarray, "*pixels"]:
        """In 1/baselines, in [0, :data:`MAX_INVERSE_DEPTH`]; of whole images, or of single pixels in some rows."""
        parallax = np.maximum(disparity, 0.0) * (math.pi / self.height)
        inverse_depth = sweep.inverse_depth_from_parallax(self._polar_angle_of(row), parallax)
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


MIN_SQRT_INV_DEPTH = 0.3  # smaller √(inverse depth × baseline) count as that large where shares of it are taken
RAMP_SHARE = 0.1  # beyond the tolerance the cost rises over this share of √(inverse depth × baseline) to its limit
MAX_PRIOR_COST = 0.4  # limit of the cost where the prior is confident: unrelated windows cost 1
# Up to the first confidence nothing costs anything, from the second on the limit is full.
MIN_CONFIDENCE, FULL_COST_CONFIDENCE = 0.2, 0.4


class DepthPrior(NamedTuple):
    """The depth that is expected of one panorama, in the frame of a camera or of a pair."""

    sqrt_inv_depth: Float32[np.ndarray, "height width"]  # √(inverse depth × baseline)
    tolerance: Float32[np.ndarray, "height width"]  # what differs by less from it costs nothing
    confidence: Float32[np.ndarray, "height width"]  # the probability that depth is within 10 %

    def remapped(self, table: RemapTable) -> "DepthPrior":
        """In another frame."""
        return DepthPrior(*(table.bilinear(each) for each in self))

    def scaled(self, factor: np.float32) -> "DepthPrior":
        """With √(inverse depth) times a factor."""
        return DepthPrior(factor * self.sqrt_inv_depth, factor * self.tolerance, self.confidence)

    def in_rows(self, grid: EpipolarGrid) -> "DisparityPrior":
        """In rows of disparity, for maps in the frame of a pair."""
        ramp = RAMP_SHARE * np.maximum(self.sqrt_inv_depth, MIN_SQRT_INV_DEPTH)
        far, near = self.sqrt_inv_depth - self.tolerance, self.sqrt_inv_depth + self.tolerance
        least, lower, upper, greatest = (
            grid.disparity(np.square(np.maximum(each, 0.0))) for each in (far - ramp, far, near, near + ramp)
        )
        below, above = np.maximum(lower - least, 1e-3), np.maximum(greatest - upper, 1e-3)
        sureness = (self.confidence - MIN_CONFIDENCE) / (FULL_COST_CONFIDENCE - MIN_CONFIDENCE)
        limit = np.float32(MAX_PRIOR_COST) * np.clip(sureness, 0.0, 1.0)
        return DisparityPrior(lower, upper, limit / below, limit / above, limit)


class DisparityPrior(NamedTuple):
    """What disparities cost beside what is matched."""

    # rows between which they cost nothing
    lower: Float32[np.ndarray, "height width"]
    upper: Float32[np.ndarray, "height width"]
    # of each row below and above these
    below: Float32[np.ndarray, "height width"]
    above: Float32[np.ndarray, "height width"]
    limit: Float32[np.ndarray, "height width"]  # the greatest cost

    def cost(self, disparity: Float[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width"]:
        """Of one surface."""
        short, long = np.maximum(self.lower - disparity, 0.0), np.maximum(disparity - self.upper, 0.0)
        return np.asarray(np.minimum(self.below * short + self.above * long, self.limit), np.float32)

    def add_to(self, costs: UInt16[np.ndarray, " costs"], disparities: DisparityRange) -> None:
        """Add what all disparities of the ranges cost, in fixed-point numbers."""
        run_ranges(partial(_add_rows, costs, disparities.lowest, disparities.offsets, tuple(self)), len(self.limit))


@fast_kernel()
def _add_rows(costs, lowest, offsets, maps, begin, end):  # type: ignore[no-untyped-def]
    lower, upper, below, above, limit = maps
    width = lowest.shape[1]
    for row in range(begin, end):
        for col in range(width):
            most = limit[row, col]
            if most <= 0:
                continue
            own = costs[offsets[row * width + col] : offsets[row * width + col + 1]]
            for k in range(len(own)):
                disparity = np.float32(lowest[row, col] + k)
                short = max(lower[row, col] - disparity, np.float32(0.0))
                long = max(disparity - upper[row, col], np.float32(0.0))
                cost = min(below[row, col] * short + above[row, col] * long, most)
                own[k] += np.uint16(cost * np.float32(FIXED_POINT_SCALE) + np.float32(0.5))


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
    are_priors_candidates: bool = False  # pixels may lie on what is expected itself: most matches are wrong
    # of both images, whose squared distances say how likely two pixels show the same; None: windows are compared
    descriptors: tuple[Descriptors, Descriptors] | None = None

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
            first=sweep.swap_cameras_in_epipole_frame(self.second),
            second=sweep.swap_cameras_in_epipole_frame(self.first),
            first_usable=sweep.swap_cameras_in_epipole_frame(self.second_usable),
            second_usable=sweep.swap_cameras_in_epipole_frame(self.first_usable),
            world_from_frame=self.world_from_frame @ HALF_TURN_ABOUT_Z,
            baseline=self.baseline,
            priors=None if self.priors is None else self.priors[::-1],
            descriptors=None if self.descriptors is None else (
                sweep.swap_cameras_in_epipole_frame(self.descriptors[1]),
                sweep.swap_cameras_in_epipole_frame(self.descriptors[0]),
            ),
            are_priors_candidates=self.are_priors_candidates,
        )  # fmt: skip

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
    frame, _, baseline = sweep.epipole_frame(first.pose, second.pose)
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
