# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""Two layers joined on a GPU, a thread for a pixel or a few: the steps of :mod:`omnisyn_cli.fusion`."""

from typing import Any, NamedTuple

import numpy as np
from numba import cuda

from omnisyn_cli.fusion.blend_kernels import (
    KernelRule,
    Quantization,
    blend_shares,
    coarse_position,
    quantize,
    view_weights,
)
from omnisyn_cli.fusion.confidence import ConfidenceTolerances, pixel_confidence
from omnisyn_cli.fusion.fill import fill_pixel, pull_pixel
from omnisyn_cli.fusion.supersampling import MIN_CONTRAST_LEVELS, has_contrast, is_other_surface
from omnisyn_cli.fusion.warp_candidates import interpolate_down_columns
from omnisyn_cli.synthesis.device.cuda_device import device_function, kernel
from omnisyn_cli.synthesis.device.cuda_shade_kernels import DeviceLayer, add, offset_of, shade, suppressed


class DeviceFrame(NamedTuple):
    """A picture that is made, and what it is made by."""

    first: DeviceLayer
    second: DeviceLayer
    rows: Any  # sines and cosines of the polar angles
    cols: Any  # sines and negative cosines of the azimuths
    double_rows: Any  # the same of a picture of twice the size
    double_cols: Any
    rule: KernelRule
    quantization: Quantization
    share: np.float32  # of the mean of its samples in an edge pixel
    strength: Any  # of ghosts by cell, see :class:`omnisyn_cli.fusion.ghosts.GhostSuppression`; empty without ghosts
    cell_size: int
    image: Any
    seen: Any  # 0 in holes, else 1
    confidence: Any  # of each pixel; empty if nobody wants it
    tolerances: ConfidenceTolerances
    colours: Any  # of half the size, for the pyramid that fills holes
    weights: Any
    marks: Any  # of edge pixels, row after row: which views have an edge there


@device_function(fastmath=True)
def _mixed(frame, a, b, rho_a, rho_b, ray, row, col):
    """RGB and weight for holes around it of two colours in a pixel, by the rule and without ghosts."""
    (x, y, z), zero = ray, np.float32(0.0)
    rho_a, rho_b = max(rho_a, zero), max(rho_b, zero)
    weight_a, weight_b = suppressed(frame.strength, frame.cell_size, a[3], b[3], row, col)
    weights = view_weights(
        weight_a, rho_a, offset_of(frame.first), weight_b, rho_b, offset_of(frame.second), x, y, z, frame.rule
    )
    share_a, share_b, fill_weight = blend_shares(weights, rho_a, rho_b)
    return (
        max(zero, share_a * a[0] + share_b * b[0]), max(zero, share_a * a[1] + share_b * b[1]),
        max(zero, share_a * a[2] + share_b * b[2]), fill_weight,
    )  # fmt: skip


@device_function(fastmath=True)
def _ray(rows, cols, row, col):
    return rows[0, row] * cols[0, col], rows[1, row], rows[0, row] * cols[1, col]


@device_function(fastmath=True)
def _shade_both(frame, rho_a, rho_b, ray, scale):
    """Exposed colours of both views with their blend weights, for a pixel of a size in pixels."""
    (x, y, z), first, second = ray, frame.first, frame.second
    a = shade(first, rho_a, x, y, z, scale * first.texels_per_pixel, True)
    return a, shade(second, rho_b, x, y, z, scale * second.texels_per_pixel, True)


@device_function(fastmath=True)
def _blend_pixel(frame, row, col):
    """Write a pixel; RGB and weight for holes around it before rounding."""
    at, ray = row * frame.seen.shape[1] + col, _ray(frame.rows, frame.cols, row, col)
    rho_a, rho_b = frame.first.inverse_depth[at], frame.second.inverse_depth[at]
    a, b = _shade_both(frame, rho_a, rho_b, ray, np.float32(1.0))
    if len(frame.confidence) > 0:
        frame.confidence[row, col] = pixel_confidence(a, rho_a, b, rho_b, frame.tolerances)
    mixed = _mixed(frame, a, b, rho_a, rho_b, ray, row, col)
    for k in range(3):
        frame.image[row, col, k] = quantize(mixed[k], frame.quantization)
    frame.seen[row, col] = 1 if mixed[3] > np.float32(0.0) else 0
    return mixed


@device_function(fastmath=True)
def _blend(number, frame):
    height, width = frame.seen.shape
    i, j = number // frame.weights.shape[1], number % frame.weights.shape[1]
    red = green = blue = total = np.float32(0.0)
    for row in range(2 * i, min(2 * i + 2, height)):
        for col in range(2 * j, min(2 * j + 2, width)):
            r, g, b, weight = _blend_pixel(frame, row, col)
            red, green, blue, total = red + weight * r, green + weight * g, blue + weight * b, total + weight
    share = np.float32(1.0) / max(total, np.float32(1e-37))
    frame.weights[i, j] = total
    frame.colours[i, j, 0], frame.colours[i, j, 1], frame.colours[i, j, 2] = red * share, green * share, blue * share


@kernel(fastmath=True)
def blend(count, frame):
    """Four pixels, and the pixel of half the size that they are in the pyramid that fills holes."""
    for number in range(cuda.grid(1), count, cuda.gridsize(1)):
        _blend(number, frame)


@device_function(fastmath=True)
def _shade_grid(number, group):
    frame, rows, cols, depths, colours = group
    i, j = number // len(cols), number % len(cols)
    at = rows[i] * frame.seen.shape[1] + cols[j]
    rho_a, rho_b = frame.first.inverse_depth[at], frame.second.inverse_depth[at]
    a, b = _shade_both(frame, rho_a, rho_b, _ray(frame.rows, frame.cols, rows[i], cols[j]), np.float32(1.0))
    depths[0, i, j], depths[1, i, j] = rho_a, rho_b
    for k in range(4):
        colours[0, i, j, k], colours[1, i, j, k] = a[k], b[k]


@kernel(fastmath=True)
def shade_grid(count, group):
    """Inverse depth and exposed colours of both views where some rows and columns cross."""
    for number in range(cuda.grid(1), count, cuda.gridsize(1)):
        _shade_grid(number, group)


@device_function(fastmath=True)
def _pull(number, group):
    colour, weight, coarse_colour, coarse_weight = group
    row, col = number // coarse_weight.shape[1], number % coarse_weight.shape[1]
    pull_pixel(colour, weight, coarse_colour, coarse_weight, row, col)


@kernel(fastmath=True)
def pull(count, group):
    """A pixel of the next coarser level of the pyramid."""
    for number in range(cuda.grid(1), count, cuda.gridsize(1)):
        _pull(number, group)


@device_function(fastmath=True)
def _fill(number, group):
    coarse_colour, coarse_weight, colour, weight, keeps_weight, quantization = group
    row, col = number // weight.shape[1], number % weight.shape[1]
    if not weight[row, col] > 0:
        fill_pixel(coarse_colour, coarse_weight, colour, weight, keeps_weight, quantization, row, col)


@kernel(fastmath=True)
def fill(count, group):
    """A pixel, if it is a hole, from the next coarser level."""
    for number in range(cuda.grid(1), count, cuda.gridsize(1)):
        _fill(number, group)


@device_function(fastmath=True)
def _is_edge(rho, row, col, height, width):
    """Whether a pixel differs in depth from one of its four neighbours; columns wrap, rows end."""
    here = rho[row * width + col]
    left, right = row * width + (col - 1 if col > 0 else width - 1), row * width + (col + 1 if col < width - 1 else 0)
    above, below = max(row - 1, 0) * width + col, min(row + 1, height - 1) * width + col
    across = is_other_surface(here, rho[left]) or is_other_surface(here, rho[right])
    return across or is_other_surface(here, rho[above]) or is_other_surface(here, rho[below])


@device_function(fastmath=True)
def _prefill(view, mark, row, col, height, width):
    """Inverse depth of the samples of a pixel that lie on a local plane; those of the view's own edges are unknown."""
    rho, at = view.inverse_depth, row * width + col
    left, right = row * width + (col - 1 if col > 0 else width - 1), row * width + (col + 1 if col < width - 1 else 0)
    above, below = max(row - 1, 0), min(row + 1, height - 1)
    across = np.float32(0.125) * (rho[right] - rho[left])
    down = np.float32(0.25) * (rho[below * width + col] - rho[above * width + col]) / np.float32(max(below - above, 1))
    for k in range(4):
        value = rho[at] + (across if k & 1 else -across) + (down if k & 2 else -down)
        known = max(value, np.float32(0.0)) if rho[at] >= np.float32(0.0) else np.float32(-1.0)
        view.samples[4 * at + k] = np.float32(-1.0) if mark & view.mark else known


@device_function(fastmath=True)
def _mark_edges(number, frame):
    height, width = frame.seen.shape
    row, col = number // width, number % width
    mark = frame.first.mark if _is_edge(frame.first.inverse_depth, row, col, height, width) else 0
    mark |= frame.second.mark if _is_edge(frame.second.inverse_depth, row, col, height, width) else 0
    above, below, scale = max(row - 1, 0), min(row + 1, height - 1), np.float32(255.0) / frame.quantization.scale
    if mark and not has_contrast(frame.image, scale, MIN_CONTRAST_LEVELS, above, below, col):
        mark = 0
    frame.marks[number] = mark
    if mark:
        _prefill(frame.first, mark, row, col, height, width)
        _prefill(frame.second, mark, row, col, height, width)


@kernel(fastmath=True)
def mark_edges(count, frame):
    """Mark a pixel that is supersampled, see :func:`omnisyn_cli.fusion.supersampling.mark_edge_pixels`."""
    for number in range(cuda.grid(1), count, cuda.gridsize(1)):
        _mark_edges(number, frame)


@device_function(fastmath=True)
def _own(frame, row, col, k):
    """A channel of a pixel as it is."""
    return np.float32(frame.image[row, col, k]) / frame.quantization.scale


@device_function(fastmath=True)
def _supersample(number, frame):
    if not frame.marks[number]:
        return
    row, col, zero = number // frame.seen.shape[1], number % frame.seen.shape[1], np.float32(0.0)
    red = green = blue = zero
    for k in range(4):
        ray = _ray(frame.double_rows, frame.double_cols, 2 * row + (k >> 1), 2 * col + (k & 1))
        rho_a, rho_b = frame.first.samples[4 * number + k], frame.second.samples[4 * number + k]
        a, b = _shade_both(frame, rho_a, rho_b, ray, np.float32(0.5))
        mixed = _mixed(frame, a, b, rho_a, rho_b, ray, row, col)
        is_seen = mixed[3] > zero
        red += mixed[0] if is_seen else _own(frame, row, col, 0)
        green += mixed[1] if is_seen else _own(frame, row, col, 1)
        blue += mixed[2] if is_seen else _own(frame, row, col, 2)
    total = (red, green, blue)
    for k in range(3):
        own = _own(frame, row, col, k)
        value = own + frame.share * (np.float32(0.25) * total[k] - own)
        frame.image[row, col, k] = quantize(value, frame.quantization)


@kernel(fastmath=True)
def supersample(count, frame):
    """Move a marked pixel towards the mean of its four samples; unseen ones count as the pixel."""
    for number in range(cuda.grid(1), count, cuda.gridsize(1)):
        _supersample(number, frame)


@device_function(fastmath=True)
def _weight_at(weights, row, col, height, width):
    """A coarse map in a pixel, bilinear; columns wrap."""
    j, across = coarse_position(col, width, weights.shape[1])
    left, right = interpolate_down_columns(weights, row, j, height)
    return left + across * (right - left)


@device_function(fastmath=True)
def _mix_candidates(number, group):
    frame, weights, hypotheses = group
    height, width = frame.seen.shape
    row, col, zero = number // width, number % width, np.float32(0.0)
    x, y, z = _ray(frame.rows, frame.cols, row, col)
    i, j = row * hypotheses.shape[1] // height, col * hypotheses.shape[2] // width
    total = (zero, zero, zero, zero)
    for k in range(4):
        weight = _weight_at(weights[k], row, col, height, width)
        if weight > zero:
            view = frame.first if k % 2 == 0 else frame.second
            colour = shade(view, hypotheses[k // 2, i, j], x, y, z, view.texels_per_pixel, False)
            total = add(total, (colour[0], colour[1], colour[2], np.float32(1.0)), weight * colour[3])
    taken = min(total[3], np.float32(1.0))
    if taken > zero:
        for k in range(3):
            value = (np.float32(1.0) - taken) * _own(frame, row, col, k) + total[k]
            frame.image[row, col, k] = quantize(value, frame.quantization)


@kernel(fastmath=True)
def mix_candidates(count, group):
    """Mix what both photographs show at two depths into a pixel, see :mod:`omnisyn_cli.fusion.warp_candidates`."""
    for number in range(cuda.grid(1), count, cuda.gridsize(1)):
        _mix_candidates(number, group)
