"""Filters of depth maps: speckles removed, the median, and upsampling guided by the image."""

import math
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int64

from omnisyn_cli.compute.arrays import empty
from omnisyn_cli.compute.jit import fast_kernel, inlined
from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.geometry.sampling import add_border, filter_across_seam
from omnisyn_cli.geometry.tolerances import SAME_SURFACE_TOLERANCE

# Inverse depths as the whole numbers of 16 bits that OpenCV's speckle filter takes: sixteen per relative step.
SPECKLE_LEVELS_PER_STEP, SPECKLE_LEVEL_OF_ONE, SPECKLE_MAX_LEVEL, SPECKLE_INVALID_LEVEL = 16, 16000, 32000, -1000
# Columns from over the seam that the speckle filter sees: an island of so few pixels is hardly wider.
SPECKLE_SEAM_COLUMNS = 64
MEDIAN_WINDOW = 5  # side in pixels of the squares that medians are taken of: the largest that OpenCV knows for floats
UPSAMPLE_RADIUS = 3  # low pixels of the border; windows are 2 · 3 − 1 = 5 low pixels wide
# 1 / (2 σ²) of the spatial weights in :func:`joint_upsample`: σ is one and a half low pixels.
UPSAMPLE_SPATIAL_DECAY = np.float32(1.0 / 4.5)
# Decay of the weights per colour difference, summed over the channels; chosen by eye.
UPSAMPLE_COLOUR_DECAY = np.float32(12.0)
# Ratio of the greatest to the least inverse depth in a window up to which it shows one smooth surface.
SMOOTH_WINDOW_RATIO = np.float32(1.0 + SAME_SURFACE_TOLERANCE)
BISECTION_STEPS = 12  # of the weighted median: its error is 1/4096 of the range in the window
MIN_ISLAND_PIXELS = 20  # at half size: smaller islands of depth are mistakes more often than things


def remove_speckles(
    inverse_depth: Float[np.ndarray, "height width"], valid: Bool[np.ndarray, "height width"]
) -> Bool[np.ndarray, "height width"]:
    """``valid`` without small islands whose inverse depth, in any unit, is not that of the surface around."""
    logarithm = np.log2(np.maximum(inverse_depth, 1e-4)) / math.log2(1.0 + SAME_SURFACE_TOLERANCE)
    steps = logarithm * float(SPECKLE_LEVELS_PER_STEP) + float(SPECKLE_LEVEL_OF_ONE)
    levels = np.where(valid, np.clip(steps, 0, SPECKLE_MAX_LEVEL), SPECKLE_INVALID_LEVEL).astype(np.int16)
    limits = (SPECKLE_INVALID_LEVEL, MIN_ISLAND_PIXELS, SPECKLE_LEVELS_PER_STEP)
    seam = min(SPECKLE_SEAM_COLUMNS, levels.shape[1])
    kept = filter_across_seam(lambda padded: np.asarray(cv2.filterSpeckles(padded, *limits)[0]), levels, seam)
    return np.asarray(valid & (kept != SPECKLE_INVALID_LEVEL))


def median_filter(values: Float32[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width"]:
    """The median of the square around each pixel, across the seam; at the poles the last rows are repeated."""
    return filter_across_seam(partial(cv2.medianBlur, ksize=MEDIAN_WINDOW), values, MEDIAN_WINDOW // 2)


class UpsampleWindows(NamedTuple):
    """Along one axis, around each pixel: the first low pixel, counted from the border, and weights of the window."""

    first: Int64[np.ndarray, " count"]
    weight: Float32[np.ndarray, "count window"]

    @staticmethod
    def along_axis(count: int, low_count: int) -> "UpsampleWindows":
        """For ``count`` pixels that cover the same as ``low_count`` low ones."""
        center = ((np.arange(count) + 0.5) * (low_count / count) - 0.5 + UPSAMPLE_RADIUS).astype(np.float32)
        first = np.floor(center + np.float32(0.5)).astype(np.int64) - UPSAMPLE_RADIUS + 1
        offset = first[:, None] + np.arange(2 * UPSAMPLE_RADIUS - 1) - center[:, None]
        return UpsampleWindows(first, np.exp(-UPSAMPLE_SPATIAL_DECAY * offset * offset).astype(np.float32))


def joint_upsample(
    inverse_depth: Float[np.ndarray, "low_height low_width"],
    low_guide: Float[np.ndarray, "low_height low_width 3"],
    guide: Float[np.ndarray, "height width 3"],
) -> Float[np.ndarray, "height width"]:
    """The map at the size of ``guide``, its discontinuities moved to the edges of the image.

    Every pixel takes the weighted median of the low pixels around it, where those of its own colour weigh most. The
    result is the mean of the values near that median, so that planes stay smooth.

    Source: Kopf et al., Joint bilateral upsampling, 2007, with a median instead of the mean.
    """
    (height, width), (low_height, low_width) = guide.shape[:2], inverse_depth.shape
    out = np.empty((height, width), np.float32)
    low, low_colours = (add_border(each, UPSAMPLE_RADIUS).astype(np.float32) for each in (inverse_depth, low_guide))
    rows, cols = UpsampleWindows.along_axis(height, low_height), UpsampleWindows.along_axis(width, low_width)
    run_ranges(partial(_upsample_rows, low, low_colours, guide.astype(np.float32), rows, cols, out), height)
    return out


@fast_kernel()
def _upsample_rows(low, low_guide, guide, rows, cols, out, begin, end):  # type: ignore[no-untyped-def]
    side = rows.weight.shape[1]
    value, weight = empty(side * side, np.float32), empty(side * side, np.float32)
    for row in range(begin, end):
        r0, row_weight = rows.first[row], rows.weight[row]
        for col in range(out.shape[1]):
            c0, col_weight = cols.first[col], cols.weight[col]
            least, greatest = np.float32(np.inf), np.float32(-np.inf)
            for i in range(side):
                for j in range(side):
                    found = low[r0 + i, c0 + j]
                    weight[side * i + j], value[side * i + j] = row_weight[i] * col_weight[j], found
                    least, greatest = min(least, found), max(greatest, found)
            if greatest > SMOOTH_WINDOW_RATIO * least:  # colours matter only where there is an edge
                for k in range(side * side):
                    difference = np.float32(0.0)
                    for i in range(3):
                        difference += abs(low_guide[r0 + k // side, c0 + k % side, i] - guide[row, col, i])
                    weight[k] *= np.exp(-UPSAMPLE_COLOUR_DECAY * difference)
            out[row, col] = _inlier_mean(value, weight, _weighted_median(value, weight, least, greatest))


@inlined()
def _weighted_median(value, weight, least, greatest):  # type: ignore[no-untyped-def]
    """By bisection between the least and the greatest value; on a smooth surface any value will do."""
    low, high = least, greatest
    if high <= SMOOTH_WINDOW_RATIO * low:
        return high
    half = np.float32(0.0)
    for k in range(value.shape[0]):
        half += np.float32(0.5) * weight[k]
    for _ in range(BISECTION_STEPS):
        middle = np.float32(0.5) * (low + high)
        below = np.float32(0.0)
        for k in range(value.shape[0]):
            if value[k] <= middle:
                below += weight[k]
        if below >= half:
            high = middle
        else:
            low = middle
    return high


@inlined()
def _inlier_mean(value, weight, median):  # type: ignore[no-untyped-def]
    """The weighted mean of the values on the surface of the median; the nearest value if there are none."""
    total, mean = np.float32(0.0), np.float32(0.0)
    nearest, gap = value[0], np.float32(np.inf)
    for k in range(value.shape[0]):
        distance = abs(value[k] - median)
        if distance < gap:
            nearest, gap = value[k], distance
        if distance <= np.float32(SAME_SURFACE_TOLERANCE) * median:
            total += weight[k]
            mean += weight[k] * value[k]
    return mean / total if total > 0 else nearest
