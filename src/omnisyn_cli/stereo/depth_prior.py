"""The depth that is expected of a panorama, as a cost beside that of matching.

Depths within a tolerance cost nothing, so that matching alone decides between them; others cost more.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, UInt16

from omnisyn_cli.compute.jit import fast_kernel
from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.geometry.remap import RemapTable
from omnisyn_cli.stereo.epipolar_grid import EpipolarGrid
from omnisyn_cli.stereo.semi_global import FIXED_POINT_SCALE, DisparityRange

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
