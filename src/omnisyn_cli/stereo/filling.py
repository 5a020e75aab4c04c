"""Depth where none was measured: planes extrapolated from valid depth, stopping at edges of the image.

A plane is ``inverse_depth = normal · direction``, so extrapolation is a weighted least-squares fit of a normal around
every pixel. The sums of such a fit are images, and an edge-aware recursive filter adds them up over any distance in
linear time.

Source: filter: Gastal and Oliveira, Domain transform for edge-aware image and video processing, 2011.
"""

import math
from functools import partial

import cv2
import numpy as np
from jaxtyping import Bool, Float

from omnisyn_cli.compute.arrays import empty, zeros
from omnisyn_cli.compute.jit import inlined, kernel
from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.geometry.sampling import filter_across_seam
from omnisyn_cli.geometry.sphere import direction_tables, pixel_directions

# Radians over which planes are fitted, widest first; each result is the fallback of the next. Chosen by eye.
PLANE_FIT_RADII_RAD = (0.8, 0.2, 0.05)
# Radians around a pixel that the first guess is taken from, across edges too; chosen by eye.
FIRST_GUESS_RADIUS_RAD = 0.1
# Quantile of valid inverse depths that fills where none are near: gaps show the background more often than not.
BACKGROUND_QUANTILE = 0.2
FILTER_ITERATIONS = 3  # horizontal and vertical passes of the filter per radius, as in the source
COLOUR_EDGE_STRENGTH = 6.0  # distance that a colour difference of 1 adds, in fit radii; chosen by eye
# Weight of the fallback at the pixel itself, against 1 for a valid depth: it decides only where nothing is near.
FALLBACK_WEIGHT = 1e-3
# Ridge against tilts that the data do not ask for, relative to what data spread over the radius would weigh.
TILT_RIDGE = 0.1
# Scale of the robust weights: 10 % of the estimate and 2 % of the greatest inverse depth; chosen by eye.
ROBUST_SCALE_ESTIMATE_SHARE, ROBUST_SCALE_MAXIMUM_SHARE = 0.1, 0.02
# Of the bilateral filter that removes mere texture before edges are taken: pixels, colour, pixels. Chosen by eye.
BILATERAL_WINDOW, BILATERAL_COLOUR_SIGMA, BILATERAL_SPACE_SIGMA = 7, 0.15, 3.0
# Rows that are filtered together, side by side in memory. (Measured: two thirds of the time.)
FILTER_ROWS_PER_GROUP = 16
NORMAL_EQUATION_TERMS = 9  # numbers per pixel: the upper triangle of the matrix, row after row, and the right side


def fill_with_planes(
    inverse_depth: Float[np.ndarray, "height width"], weight: Float[np.ndarray, "height width"],
    guide: Float[np.ndarray, "height width 3"], usable: Bool[np.ndarray, "height width"] | None = None,
) -> Float[np.ndarray, "height width"]:  # fmt: skip
    """The map (any unit, finite, >= 0) with every pixel of ``weight`` below 1 filled in; the others stay as they are.

    A value of a weight between 0 and 1 is a hint: it counts, but gives way. Filling stops at edges of the RGB ``guide``
    where it is ``usable``, by default everywhere. Results lie between the least and the greatest value of weight 1.
    Without any such pixel above 0 they are zeros.
    """
    valid = weight >= 1.0
    if not inverse_depth[valid].any():  # nothing is known, or all of it is infinitely far
        return np.zeros_like(inverse_depth, dtype=np.float32)
    low, high = float(inverse_depth[valid].min()), float(inverse_depth[valid].max())
    values = np.clip(inverse_depth, low, high)
    directions, edges = pixel_directions(*values.shape), _colour_edges(guide, usable)
    estimate = _first_guess(values, valid, directions)
    for radius_rad in PLANE_FIT_RADII_RAD:
        residual = (values - estimate) / (ROBUST_SCALE_ESTIMATE_SHARE * estimate + ROBUST_SCALE_MAXIMUM_SHARE * high)
        robust_weight = np.where(valid, 1.0, 1.0 / (1.0 + residual**2))  # hints far from the estimate hardly count
        fitted = _fit_around_pixels(values, weight * robust_weight, estimate, directions, edges, radius_rad)
        estimate = np.clip(fitted, low, high)
    return np.where(valid, values, estimate).astype(np.float32)


def _first_guess(values: np.ndarray, valid: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Planes fitted across edges, so that a region without any valid depth inside is not left to chance."""
    no_edges = (np.zeros(values.shape), np.zeros(values.shape))
    background = np.full(values.shape, np.quantile(values[valid], BACKGROUND_QUANTILE))
    guess = _fit_around_pixels(values, valid, background, directions, no_edges, FIRST_GUESS_RADIUS_RAD)
    return np.asarray(np.clip(guess, values[valid].min(), values[valid].max()))


def _colour_edges(guide: np.ndarray, usable: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Colour differences to the pixel on the left and to the one above, without mere texture."""
    smooth = partial(
        cv2.bilateralFilter, d=BILATERAL_WINDOW, sigmaColor=BILATERAL_COLOUR_SIGMA, sigmaSpace=BILATERAL_SPACE_SIGMA
    )
    flat = filter_across_seam(smooth, guide.astype(np.float32), min(8, guide.shape[1]))
    left, above = np.roll(flat, 1, axis=1), np.concatenate([flat[:1], flat[:-1]])
    across, down = np.abs(flat - left).sum(axis=-1), np.abs(flat - above).sum(axis=-1)
    if usable is not None:
        across *= usable & np.roll(usable, 1, axis=1)
        down *= usable & np.concatenate([usable[:1], usable[:-1]])
    return across, down


def _fit_around_pixels(
    values: np.ndarray, weight: np.ndarray, fallback: np.ndarray, directions: np.ndarray,
    edges: tuple[np.ndarray, np.ndarray], radius_rad: float,
) -> np.ndarray:  # fmt: skip
    """Value at each pixel of the plane fitted around it."""
    values, weight, fallback = (np.asarray(image, np.float64) for image in (values, weight, fallback))
    sums = _edge_aware_mean(normal_equations(values, weight, directions), edges, radius_rad)
    return np.asarray(fitted_values(sums, fallback, directions, FALLBACK_WEIGHT, TILT_RIDGE * radius_rad**2))


def _edge_aware_mean(channels: np.ndarray, edges: tuple[np.ndarray, np.ndarray], radius_rad: float) -> np.ndarray:
    """Domain transform filter of every channel over about ``radius_rad`` radians on the sphere, in place."""
    height, width = channels.shape[:2]
    sine = direction_tables(height, width)[0]
    distance_across = sine[:, None] * (2.0 * math.pi / width) / radius_rad + COLOUR_EDGE_STRENGTH * edges[0]
    distance_down = math.pi / height / radius_rad + COLOUR_EDGE_STRENGTH * edges[1]
    for k in range(FILTER_ITERATIONS):
        # Equation 14 of the source: standard deviations halve from pass to pass, and their squares sum to 1.
        sigma = math.sqrt(3.0) * 2.0 ** (FILTER_ITERATIONS - k - 1) / math.sqrt(4.0**FILTER_ITERATIONS - 1.0)
        decay = -math.sqrt(2.0) / sigma
        across, down = (np.exp(decay * distance).astype(np.float32) for distance in (distance_across, distance_down))
        run_ranges(partial(_filter_rows, channels, across), -(-height // FILTER_ROWS_PER_GROUP))
        run_ranges(partial(_filter_columns, channels, down), width)
    return channels


@kernel()
def _filter_rows(channels, coupling, begin, end):  # type: ignore[no-untyped-def]
    """Recursive mean along some groups of rows, both ways; ``coupling[r, c]`` couples columns c − 1 and c."""
    height, width, count = channels.shape
    lines = zeros((width, count, FILTER_ROWS_PER_GROUP), np.float32)
    line_coupling = zeros((width, FILTER_ROWS_PER_GROUP), np.float32)
    for group in range(begin, end):
        top, rows = group * FILTER_ROWS_PER_GROUP, min(FILTER_ROWS_PER_GROUP, height - group * FILTER_ROWS_PER_GROUP)
        for lane in range(rows):
            for col in range(width):
                line_coupling[col, lane] = coupling[top + lane, col]
                for i in range(count):
                    lines[col, i, lane] = channels[top + lane, col, i]
        for side in range(2):
            _filter_circular_lines(lines, line_coupling, side)
        for lane in range(rows):
            for col in range(width):
                for i in range(count):
                    channels[top + lane, col, i] = lines[col, i, lane]


@inlined()
def _filter_circular_lines(lines, coupling, side):  # type: ignore[no-untyped-def]
    """Filters rows that lie side by side, ``(columns, channels, rows)``, in one direction.

    A row is a circle without a beginning. A first round from zero tells the state that comes again; the second writes.
    """
    width, count, lanes = lines.shape
    state, remaining = zeros((count, lanes), np.float32), empty(lanes, np.float32)
    remaining[:] = np.float32(1.0)
    for k in range(2 * width):
        col = k % width if side == 0 else width - 1 - k % width
        own = coupling[col] if side == 0 else coupling[(col + 1) % width]
        line = lines[col]
        for i in range(count):
            for lane in range(lanes):
                before = state[i, lane]
                if k == width:  # state = before + remaining · state, solved for the state
                    before /= max(np.float32(1.0) - remaining[lane], np.float32(1e-6))
                state[i, lane] = line[i, lane] + own[lane] * (before - line[i, lane])
                if k >= width:
                    line[i, lane] = state[i, lane]
        for lane in range(lanes):
            remaining[lane] *= own[lane]


@kernel()
def _filter_columns(channels, coupling, begin, end):  # type: ignore[no-untyped-def]
    """Recursive mean along some columns, both ways; ``coupling[r, c]`` couples rows r − 1 and r."""
    height, _, count = channels.shape
    for row in range(1, height):
        _blend_row(channels[row], channels[row - 1], coupling[row], begin, end, count)
    for row in range(height - 2, -1, -1):
        _blend_row(channels[row], channels[row + 1], coupling[row + 1], begin, end, count)


@inlined()
def _blend_row(line, before, coupling, begin, end, count):  # type: ignore[no-untyped-def]
    for col in range(begin, end):
        for i in range(count):
            line[col, i] += coupling[col] * (before[col, i] - line[col, i])


@kernel()
def normal_equations(values, weight, directions):  # type: ignore[no-untyped-def]
    """What every pixel adds to the fit of ``normal · direction = value``: ``(height, width, 9)`` float32."""
    height, width = values.shape
    out = empty((height, width, NORMAL_EQUATION_TERMS), np.float32)
    for row in range(height):
        for col in range(width):
            x, y, z = directions[row, col, 0], directions[row, col, 1], directions[row, col, 2]
            w = weight[row, col]
            v = w * values[row, col]
            out[row, col, 0], out[row, col, 1], out[row, col, 2] = w * x * x, w * x * y, w * x * z
            out[row, col, 3], out[row, col, 4], out[row, col, 5] = w * y * y, w * y * z, w * z * z
            out[row, col, 6], out[row, col, 7], out[row, col, 8] = v * x, v * y, v * z
    return out


@kernel()
def fitted_values(sums, fallback, directions, fallback_weight, tilt_ridge):  # type: ignore[no-untyped-def]
    """The value at every pixel of the plane that is fitted around it, ``(height, width)`` float64.

    ``sums`` are those of :func:`normal_equations` around each pixel. The plane is drawn to ``fallback`` at the pixel
    itself by ``fallback_weight`` > 0. ``tilt_ridge`` is relative to the trace of the matrix. The matrix is positive
    definite: along the ray by the fallback, across it by the ridge, however little is known.
    """
    height, width = fallback.shape
    out = empty((height, width), np.float64)
    for row in range(height):
        for col in range(width):
            x, y, z = directions[row, col, 0], directions[row, col, 1], directions[row, col, 2]
            s = sums[row, col]
            ridge = tilt_ridge * (np.float64(s[0]) + np.float64(s[3]) + np.float64(s[5])) + 1e-9
            along = fallback_weight - ridge
            m00, m01, m02 = s[0] + along * x * x + ridge, s[1] + along * x * y, s[2] + along * x * z
            m11, m12, m22 = s[3] + along * y * y + ridge, s[4] + along * y * z, s[5] + along * z * z + ridge
            drawn = fallback_weight * fallback[row, col]
            b0, b1, b2 = s[6] + drawn * x, s[7] + drawn * y, s[8] + drawn * z
            l10, l20 = m01 / m00, m02 / m00  # L·D·Lᵀ
            d1 = m11 - l10 * m01
            l21 = (m12 - l20 * m01) / d1
            d2 = m22 - l20 * m02 - l21 * l21 * d1
            b1 -= l10 * b0
            b2 -= l20 * b0 + l21 * b1
            n2 = b2 / d2
            n1 = b1 / d1 - l21 * n2
            n0 = b0 / m00 - l10 * n1 - l20 * n2
            out[row, col] = n0 * x + n1 * y + n2 * z
    return out
