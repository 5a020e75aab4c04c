# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""Warp candidates: colours of both photographs, warped backwards at depth hypotheses.

Where a layer's depth is wrong, mostly beside edges, neither layer has the right colour, but the photographs do. So each
pixel gets two depth hypotheses, the nearest and the farthest surface that either layer shows around it, and both
photographs are sampled at both (:class:`omnisyn_cli.types.SourceSampler`): four candidates for its colour, also in
holes. And what the other photograph shows at a layer's own depth, and whether the point is occluded there, tells which
layer to believe.

Input channels of fusion networks, part 2 (``CANDIDATE_CHANNELS`` of them, float32), after those of
:mod:`omnisyn_cli.fusion.input_channels`:

* ``CROSS_VIEW``: for the surface of the first layer, then for that of the second, in the other view: its colour (3),
  the mean difference of the colours, how far it is occluded, and how far the other surface lies behind it, in [0, 1],
* ``CANDIDATE_RGB``: both photographs at the farthest hypothesis, then at the nearest (3 each),
* ``HYPOTHESIS_DEPTHS``: √(inverse depth × baseline) of the farthest and of the nearest hypothesis,
* ``HYPOTHESIS_OCCLUSION``: how far each candidate is occluded (positive) or in front of its view's surface, in [−1, 1],
* ``CANDIDATE_DIFFERENCE``: mean difference of both photographs at the farthest and at the nearest hypothesis.
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Shaped

from omnisyn_cli.compute.arrays import empty
from omnisyn_cli.compute.jit import fast_kernel, inlined
from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.fusion.blend_kernels import Quantization, coarse_position, quantization_for, quantize
from omnisyn_cli.fusion.blend_rule import LayerArrays
from omnisyn_cli.fusion.input_channels import INPUT_CHANNELS, MAX_GAP, sqrt_inverse_depth
from omnisyn_cli.fusion.layer_pair import TILE_ROWS
from omnisyn_cli.fusion.window_filters import dilate
from omnisyn_cli.geometry.tolerances import OCCLUSION_SCALE
from omnisyn_cli.types import SourceSampler

# First channel of each group that the candidates add, and how many they add. Checkpoints depend on them.
CROSS_VIEW, CANDIDATE_RGB, HYPOTHESIS_DEPTHS, HYPOTHESIS_OCCLUSION, CANDIDATE_DIFFERENCE = (
    INPUT_CHANNELS + k for k in (0, 12, 24, 26, 30)
)
CANDIDATE_CHANNELS = 32
# Candidates are sampled at so many times the height of the network's input, and averaged. Set by hand.
CANDIDATE_SCALE = 2
# Pixels, at the size of the candidates, within which the nearest and the farthest surface are taken. Set by hand.
HYPOTHESIS_WINDOW_RADIUS = 4
# Inverse depth × baseline that occlusion is relative to at least: parallax below 0.06° says nothing.
MIN_SCALED_INVERSE_DEPTH = 1e-3
# Relative difference of inverse depth at which the occlusion channels saturate, as ``DEPTH_GAP`` does.
MAX_OCCLUSION = OCCLUSION_SCALE * MAX_GAP
# Below it a candidate is not sampled, which saves time; up to twice that it fades in. A fresh network gives less.
MIN_CANDIDATE_WEIGHT = np.float32(0.02)
NOT_SEEN_INVERSE_DEPTH = np.float32(1e9)  # stands for unseen pixels in a minimum, because it is nearer than everything

Picture = Shaped[np.ndarray, "height width 3"]


@dataclass(frozen=True)
class WarpCandidates:
    """What both photographs show at two depth hypotheses."""

    # ``(CANDIDATE_CHANNELS, height, width)``, at the size of the network's input
    channels: Float32[np.ndarray, "channels height width"]
    # inverse depth from the target of the farthest and of the nearest surface around every pixel, at
    # :data:`CANDIDATE_SCALE` times that size
    hypotheses: Float32[np.ndarray, "2 rows cols"]
    source_samplers: tuple[SourceSampler, SourceSampler]  # of both views

    def mix_in(self, weights: Float32[np.ndarray, "4 height width"], picture: Picture, threads: int | None) -> None:
        """Blend the candidates into a picture, float32 or unsigned integers.

        Weights are of both photographs at the farthest hypothesis, then at the nearest, of any size; the picture has
        the rest.
        """
        height, quantization = len(picture), quantization_for(picture)
        weights = sampled_weights(weights)
        max_of_row = weights.max(axis=(0, 2))

        def mix(begin: int, end: int) -> None:
            for top in range(begin * TILE_ROWS, min(end * TILE_ROWS, height), TILE_ROWS):
                bottom = min(top + TILE_ROWS, height)
                above, below = (row * len(max_of_row) // height for row in (top, bottom - 1))
                # One coarse row more on each side, because weights are interpolated.
                if max_of_row[max(above - 1, 0) : below + 2].any():
                    self._mix_tile(weights, picture[top:bottom], top, height, quantization)

        run_ranges(mix, -(-height // TILE_ROWS), threads)

    def candidates(self, size: tuple[int, int]) -> Float32[np.ndarray, "4 height width 4"]:
        """RGB and alpha of all candidates, in the order of their weights, for a frame of ``size``."""
        points, everywhere = np.empty(size, np.float32), np.ones((1, 1), np.float32)
        colours = np.empty((4, *size, 4), np.float32)
        for k, (colour, sampler) in enumerate(zip(colours, 2 * self.source_samplers, strict=True)):
            hypothesis_rows(self.hypotheses[k // 2], everywhere, 0, size[0], points)
            sampler.sample_rows(points, 0, colour)
        return colours

    def _mix_tile(self, weights: np.ndarray, rows: Picture, top: int, height: int, quantization: Quantization) -> None:
        points, colour = np.empty(rows.shape[:2], np.float32), np.empty((*rows.shape[:2], 4), np.float32)
        total = np.zeros_like(colour)
        for k, (weight, sampler) in enumerate(zip(weights, 2 * self.source_samplers, strict=True)):
            if hypothesis_rows(self.hypotheses[k // 2], weight, top, height, points):
                sampler.sample_rows(points, top, colour)
                accumulate_candidate(weight, colour, top, height, total)
        mix_rows(total, quantization, rows)


def sampled_weights(weights: Float32[np.ndarray, "4 height width"]) -> Float32[np.ndarray, "4 height width"]:
    """Weights of candidates without the small ones, which are not sampled."""
    return weights * np.clip(weights / MIN_CANDIDATE_WEIGHT - np.float32(1.0), 0.0, 1.0)


def make_warp_candidates(
    first: LayerArrays, second: LayerArrays, source_samplers: tuple[SourceSampler, SourceSampler], baseline: float,
    threads: int | None,
) -> WarpCandidates:  # fmt: skip
    """Sample both photographs, ``baseline`` apart, at all hypotheses, in layers at :data:`CANDIDATE_SCALE`."""
    hypotheses, colours = depth_hypotheses(first, second), (first.colour, second.colour)
    # In the order of CandidateArrays: each layer's surface in the other view, then both views at both hypotheses.
    points = [*map(_layer_points, (first, second)), *hypotheses.repeat(2, axis=0)]
    samplers = [*source_samplers[::-1], *source_samplers, *source_samplers]
    min_inverse_depth = MIN_SCALED_INVERSE_DEPTH / baseline
    arrays = CandidateArrays(
        np.stack([sampler.sample(each) for sampler, each in zip(samplers, points, strict=True)]),
        np.stack([sampler.occlusion(each, min_inverse_depth) for sampler, each in zip(samplers, points, strict=True)]),
        sqrt_inverse_depth(hypotheses * np.float32(baseline)),
        np.float32(MAX_OCCLUSION),
    )
    channels = np.empty((CANDIDATE_CHANNELS, *(count // CANDIDATE_SCALE for count in hypotheses.shape[1:])), np.float32)
    average = partial(average_candidates, colours, np.stack(points[:2]), arrays, channels)
    run_ranges(average, channels.shape[1], threads)
    return WarpCandidates(channels, hypotheses, source_samplers)


def depth_hypotheses(first: LayerArrays, second: LayerArrays) -> Float32[np.ndarray, "2 rows cols"]:
    """Inverse depth of the farthest and of the nearest surface that is seen around every pixel; 0 where none is."""
    seen = [_layer_points(layer) for layer in (first, second)]
    nearest = dilate(np.maximum(*seen), HYPOTHESIS_WINDOW_RADIUS)
    visible = [np.where(rho < 0.0, NOT_SEEN_INVERSE_DEPTH, rho) for rho in seen]
    farthest = -dilate(-np.minimum(*visible), HYPOTHESIS_WINDOW_RADIUS)
    nearest = np.maximum(nearest, np.float32(0.0))
    return np.stack([np.minimum(farthest, nearest), nearest])


def _layer_points(layer: LayerArrays) -> Float32[np.ndarray, "rows cols"]:
    """Inverse depth of what a layer shows; −1 where it shows nothing."""
    return np.asarray(np.where(layer.is_seen, layer.clipped_inverse_depth, -1.0), np.float32)


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
