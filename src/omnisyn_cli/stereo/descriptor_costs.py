"""Costs of matches by what a network knows: distances of descriptors, beside the comparison of windows.

A window looks different from another side, nearer or farther away; descriptors were learned to look alike. They decide
more often, windows more exactly, so both count.
"""

from dataclasses import replace
from functools import partial
from typing import Protocol

import numpy as np
from jaxtyping import Float32, UInt16

from omnisyn_cli.compute.arrays import empty
from omnisyn_cli.compute.jit import fast_kernel
from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.geometry.sweep import swap_cameras_in_epipole_frame
from omnisyn_cli.stereo.rectify import DepthPrior, RectifiedPair, rectify
from omnisyn_cli.stereo.semi_global import FIXED_POINT_SCALE, DisparityRange
from omnisyn_cli.types import View

# Weight of descriptors against windows, in [0, 1], and the squared distance that costs half of what unrelated ones do.
DESCRIPTOR_WEIGHT, HALF_COST_DISTANCE = np.float32(0.6), np.float32(12.0)
LIKENESS_STEP = 2  # of the rows and of the columns every second one is enough to see how alike two images are


class DescriptorModel(Protocol):
    """A trained descriptor network, however it is run."""

    def __call__(self, image: Float32[np.ndarray, "3 height width"]) -> Float32[np.ndarray, "length rows cols"]:
        """Descriptors at half the size of an image whose colours are in [0, 1]."""
        ...


def with_descriptors(pair: RectifiedPair, first: View, second: View, model: DescriptorModel) -> RectifiedPair:
    """The pair with descriptors of both images, which are rectified at twice its size for it.

    The network sees them the same way up whichever is first.
    """
    height, width = pair.size
    fine = rectify(first, second, (2 * height, 2 * width))
    turned = np.ascontiguousarray if pair.is_canonical_order else swap_cameras_in_epipole_frame
    of_first, of_second = (
        turned(np.moveaxis(model(np.moveaxis(turned(image), -1, 0)), 0, -1)) for image in (fine.first, fine.second)
    )
    return replace(pair, descriptors=(of_first, of_second))


def add_to_volume(cost: UInt16[np.ndarray, " costs"], pair: RectifiedPair, disparities: DisparityRange) -> None:
    """Let descriptors of the pair count in the costs of all disparities, fixed-point; where there is a second image."""
    if pair.descriptors is None:
        return
    own, other = pair.descriptors[0], np.ascontiguousarray(pair.descriptors[1].transpose(1, 2, 0))
    usable = np.ascontiguousarray(pair.second_usable.T)
    fill = partial(_add_to_volume, own, other, usable, disparities.lowest, disparities.offsets, cost)
    run_ranges(fill, len(own))


def likeness(pair: RectifiedPair, prior: DepthPrior) -> float:
    """How alike descriptors of both images are on the surface that is expected of the first one, in [0, 1].

    The mean over its usable sphere; 0.5 where squared distances are :data:`HALF_COST_DISTANCE`.
    """
    own, other = pair.descriptors or (None, None)
    seen = (pair.first_usable * np.sin(pair.grid.polar_angle)).astype(np.float32)[::LIKENESS_STEP, ::LIKENESS_STEP]
    disparity, total = pair.grid.disparity(np.square(prior.sqrt_inv_depth)), np.empty(seen.shape, np.float32)
    run_ranges(partial(_measure_likeness, own, other, pair.second_usable, disparity, total), len(total))
    return float((seen * total).sum() / max(seen.sum(), 1e-6))


@fast_kernel()
def _measure_likeness(own, other, usable, disparity, out, begin, end):  # type: ignore[no-untyped-def]
    height, _, length = own.shape
    for row in range(begin, end):
        for col in range(out.shape[1]):
            at, side = row * LIKENESS_STEP, col * LIKENESS_STEP
            target, distance = int(at + disparity[at, side] + np.float32(0.5)), np.float32(0.0)
            out[row, col] = 0.0
            if target >= height or disparity[at, side] < 0.0 or not usable[target, side]:
                continue
            for channel in range(length):
                difference = own[at, side, channel] - other[target, side, channel]
                distance += difference * difference
            out[row, col] = HALF_COST_DISTANCE / (HALF_COST_DISTANCE + distance)


@fast_kernel()
def _add_to_volume(own, other, usable, lowest, offsets, cost, begin, end):  # type: ignore[no-untyped-def]
    height, width, length = own.shape
    total = empty(height, np.float32)
    for row in range(begin, end):
        for col in range(width):
            first = row + lowest[row, col]
            costs = cost[offsets[row * width + col] : offsets[row * width + col + 1]]
            count = np.uint64(max(min(len(costs), height - first), 0))
            distance, seen = total[:count], usable[col, first:]
            for k in range(count):
                distance[k] = np.float32(0.0)
            for channel in range(length):
                value, candidates = own[row, col, channel], other[col, channel, first:]
                for k in range(count):
                    difference = value - candidates[k]
                    distance[k] += difference * difference
            for k in range(count):
                of_windows = np.float32(costs[k])
                of_descriptors = np.float32(FIXED_POINT_SCALE) * distance[k] / (distance[k] + HALF_COST_DISTANCE)
                mixed = of_windows + DESCRIPTOR_WEIGHT * (of_descriptors - of_windows)
                costs[k] = np.uint16(mixed + np.float32(0.5)) if seen[k] else costs[k]
