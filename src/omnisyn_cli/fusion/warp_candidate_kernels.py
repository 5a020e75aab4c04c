# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""The loops of :mod:`omnisyn_cli.fusion.warp_candidates` over the rows of a frame, in numba."""

import math
from typing import NamedTuple

import numpy as np

from omnisyn_cli.compute.arrays import empty
from omnisyn_cli.compute.jit import fast_kernel, inlined
from omnisyn_cli.fusion.blend_kernels import coarse_position, quantize


class CandidateArrays(NamedTuple):
    """All that was sampled of both photographs, at the size of the candidates.

    The six samples of a pixel are: [0] the second view at the first layer's surface, [1] the first view at the second
    layer's; [2, 3] both views at the farthest hypothesis, [4, 5] at the nearest.
    """

    colours: np.ndarray  # ``(6, rows, cols, 4)`` RGB and alpha
    occlusion: np.ndarray  # ``(6, rows, cols)`` see :class:`omnisyn_cli.types.SourceSampler`
    # ``(2, rows, cols)`` √(inverse depth × baseline) of the farthest and of the nearest hypothesis
    sqrt_depths: np.ndarray
    max_occlusion: np.float32  # at which the channels saturate


@inlined(fastmath=True)
def _pixels_between_columns(j, width, cols):
    """The pixels whose centres lie between those of coarse columns ``j`` and ``j + 1``: first, and after the last."""
    begin = math.ceil((j + 0.5) * width / cols - 0.5)
    return max(0, begin), min(width, math.ceil((j + 1.5) * width / cols - 0.5))


@inlined(fastmath=True)
def interpolate_down_columns(values, row, j, height):
    """Values of a coarse map in a row of the frame, at coarse columns ``j`` and ``j + 1``; columns wrap."""
    rows, cols = values.shape
    i, down = coarse_position(row, height, rows)
    upper, lower, left_col, right_col = max(i, 0), min(i + 1, rows - 1), j % cols, (j + 1) % cols
    left = values[upper, left_col] + down * (values[lower, left_col] - values[upper, left_col])
    return left, values[upper, right_col] + down * (values[lower, right_col] - values[upper, right_col])


@fast_kernel()
def hypothesis_rows(hypothesis, weight, top, height, points):
    """The points to sample in rows of a frame of ``height`` rows, from ``top`` on; returns whether there are any.

    ``hypothesis`` ``(rows, cols)`` is inverse depth, ``weight`` that of the candidate at a size of its own. ``points``
    ``(rows, width)`` are written: the nearest neighbour's inverse depth, −1 where the candidate has no weight.
    """
    (rows, cols), width, zero = hypothesis.shape, points.shape[1], np.float32(0.0)
    is_any = False
    for k in range(len(points)):
        i = (top + k) * rows // height
        for j in range(-1, weight.shape[1]):
            begin, end = _pixels_between_columns(j, width, weight.shape[1])
            left, right = interpolate_down_columns(weight, top + k, j, height)
            if max(left, right) > zero:
                is_any = True
                for col in range(begin, end):
                    points[k, col] = hypothesis[i, col * cols // width]
            else:
                points[k, begin:end] = np.float32(-1.0)
    return is_any


@fast_kernel()
def accumulate_candidate(weight, colour, top, height, total):
    """Add a candidate's weighted RGB and weight, bilinear across the seam times alpha, to rows from ``top`` on."""
    width, cols, half = total.shape[1], weight.shape[1], np.float32(0.5)
    step = np.float32(cols / width)
    for k in range(len(total)):
        for j in range(-1, cols):
            left, right = interpolate_down_columns(weight, top + k, j, height)
            if max(left, right) <= np.float32(0.0):
                continue
            begin, end = _pixels_between_columns(j, width, cols)
            for col in range(begin, end):
                across = (np.float32(col) + half) * step - half - np.float32(j)
                own = colour[k, col, 3] * (left + across * (right - left))
                for channel in range(3):
                    total[k, col, channel] += own * colour[k, col, channel]
                total[k, col, 3] += own


@fast_kernel()
def mix_rows(total, quantization, picture):
    """Replace a share of some rows of a picture by the weighted sum ``total`` of candidates."""
    one, zero = np.float32(1.0), np.float32(0.0)
    for k in range(len(total)):
        for col in range(total.shape[1]):
            taken = min(total[k, col, 3], one)
            if taken > zero:
                for channel in range(3):
                    own = np.float32(picture[k, col, channel]) / quantization.scale
                    picture[k, col, channel] = quantize((one - taken) * own + total[k, col, channel], quantization)


@inlined(fastmath=True)
def _mean_absolute_difference(one, other):
    """Mean absolute difference of two colours."""
    return (abs(one[0] - other[0]) + abs(one[1] - other[1]) + abs(one[2] - other[2])) * np.float32(1.0 / 3.0)


@inlined(fastmath=True)
def _saturated(occlusion, max_occlusion):
    """Occlusion as a channel, in [−1, 1]."""
    return min(max(occlusion / max_occlusion, -np.float32(1.0)), np.float32(1.0))


@inlined(fastmath=True)
def _add_cross_view(k, colour, points, arrays, row, col, values):
    """Add layer ``k``'s cross-view channels of one pixel to ``values``; returns 1, or 0 where it shows nothing."""
    zero = np.float32(0.0)
    if points[k, row, col] < zero:
        return 0
    occlusion = _saturated(arrays.occlusion[k, row, col], arrays.max_occlusion)
    other = arrays.colours[k, row, col]
    for channel in range(3):
        values[channel] += other[channel]
    values[3] += _mean_absolute_difference(other, colour[row, col])
    values[4] += max(occlusion, zero)
    values[5] += max(-occlusion, zero)
    return 1


@inlined(fastmath=True)
def _add_candidates(arrays, row, col, share, values):
    """Add a share of the candidate channels of one pixel to ``values``."""
    for candidate in range(4):
        for k in range(3):
            values[3 * candidate + k] += share * arrays.colours[2 + candidate, row, col, k]
        values[14 + candidate] += share * _saturated(arrays.occlusion[2 + candidate, row, col], arrays.max_occlusion)
    for k in range(2):
        first, second = arrays.colours[2 + 2 * k, row, col], arrays.colours[3 + 2 * k, row, col]
        values[12 + k] += share * arrays.sqrt_depths[k, row, col]
        values[18 + k] += share * _mean_absolute_difference(first, second)


@fast_kernel()
def average_candidates(layer_colours, layer_points, arrays, channels, begin, end):
    """All channels of :mod:`omnisyn_cli.fusion.warp_candidates` for some of their rows: means over blocks of pixels.

    ``layer_points``, ``(2, rows, cols)``: inverse depths; nothing counts where negative. ``channels`` are written.
    """
    scale = layer_points.shape[1] // channels.shape[1]
    share, values = np.float32(1.0 / (scale * scale)), empty(len(channels), np.float32)
    for i in range(begin, end):
        for j in range(channels.shape[2]):
            values[:] = np.float32(0.0)
            first_count, second_count = 0, 0
            for row in range(scale * i, scale * (i + 1)):
                for col in range(scale * j, scale * (j + 1)):
                    first_count += _add_cross_view(0, layer_colours[0], layer_points, arrays, row, col, values[:6])
                    second_count += _add_cross_view(1, layer_colours[1], layer_points, arrays, row, col, values[6:12])
                    _add_candidates(arrays, row, col, share, values[12:])
            first_scale, second_scale = np.float32(max(first_count, 1)), np.float32(max(second_count, 1))
            for k in range(len(values)):  # an assignment of slices takes 3 s to compile
                channels[k, i, j] = values[k] / (first_scale if k < 6 else second_scale if k < 12 else np.float32(1.0))
