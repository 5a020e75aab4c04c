"""Depth where none was measured: planes carried on from what is known, stopping at edges of the image.

A plane is ``inverse_depth = normal · direction``, so carrying planes on is a weighted least-squares fit of a normal
around every pixel. The sums of such a fit are images, and an edge-aware recursive filter adds them up over any
distance in linear time.

Source: filter: Gastal and Oliveira, Domain transform for edge-aware image and video processing, 2011.
"""

import math
from functools import partial

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int64

from omnisyn_cli.compute.jit import fast_kernel, inlined, kernel
from omnisyn_cli.compute.threads import run_bands
from omnisyn_cli.geometry.sampling import add_border, filter_across_seam
from omnisyn_cli.geometry.sphere import direction_tables, pixel_directions
from omnisyn_cli.stereo.filling_kernels import fitted_values, normal_equations

__all__ = ["fill"]

REACHES = (0.8, 0.2, 0.05)
"""Radians over which planes are carried on, widest first; each is the fallback of the next."""

SURROUNDINGS = 0.1
"""Radians around a pixel that the first guess is taken from, edges or not."""

BACKGROUND = 0.2
"""Quantile of what is known that fills where nothing is near: gaps show the background more often than not."""

ROUNDS = 3
"""Horizontal and vertical passes of the filter per reach."""

EDGE = 6.0
"""How much longer the way across a colour difference of 1 is, in reaches."""

FALLBACK_WEIGHT = 1e-3
FLATNESS = 0.1
"""Ridge against tilts that the data do not ask for, relative to what data spread over the reach would weigh."""

SIDE_BY_SIDE = 16
"""Rows that are walked together: what they have at one column lies side by side."""

SPREAD = np.float32(1.0 / 4.5)
"""Of the spatial weights in :func:`upsample`: a standard deviation of one and a half low pixels."""

WINDOW = 5
"""Side in pixels of the squares that medians are taken of."""


def fill(
    inverse_depth: Float[np.ndarray, "height width"],
    weight: Float[np.ndarray, "height width"],
    guide: Float[np.ndarray, "height width 3"],
    usable: Bool[np.ndarray, "height width"] | None = None,
) -> Float[np.ndarray, "height width"]:
    """The map with every pixel of weight below 1 filled in; pixels of weight 1 stay as they are.

    Args:
        inverse_depth: any unit, finite, >= 0.
        weight: in [0, 1]; between 0 and 1 a value is a hint: it counts, but gives way.
        guide: RGB whose edges stop the filling.
        usable: False where the guide means nothing, so that its edges do not count; by default True everywhere.

    Returns:
        Values between the least and the greatest with weight 1. Without any such pixel: zeros.
    """
    known = weight >= 1.0
    if not known.any():
        return np.zeros_like(inverse_depth, dtype=np.float32)
    low, high = float(inverse_depth[known].min()), float(inverse_depth[known].max())
    values = np.clip(inverse_depth, low, high)
    directions, edges = pixel_directions(*values.shape), _edges(guide, usable)
    estimate = _surroundings(values, known, directions)
    for reach in REACHES:
        residual = (values - estimate) / (0.1 * estimate + 0.02 * high)
        doubt = np.where(known, 1.0, 1.0 / (1.0 + residual**2))
        estimate = np.clip(_planes(values, weight * doubt, estimate, directions, edges, reach), low, high)
    return np.where(known, values, estimate).astype(np.float32)


def _surroundings(values: np.ndarray, known: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """A first guess that no edge shuts out, so that a region with nothing known inside is not left to chance."""
    no_edges = (np.zeros(values.shape), np.zeros(values.shape))
    far = np.full(values.shape, np.quantile(values[known], BACKGROUND))
    guess = _planes(values, known.astype(np.float64), far, directions, no_edges, SURROUNDINGS)
    return np.asarray(np.clip(guess, values[known].min(), values[known].max()))


def _edges(guide: np.ndarray, usable: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Colour differences to the pixel on the left and to the one above, of what is no mere texture."""
    smooth = partial(cv2.bilateralFilter, d=7, sigmaColor=0.15, sigmaSpace=3.0)
    flat = filter_across_seam(smooth, guide.astype(np.float32), min(8, guide.shape[1]))
    left, above = np.roll(flat, 1, axis=1), np.concatenate([flat[:1], flat[:-1]])
    across, down = np.abs(flat - left).sum(axis=-1), np.abs(flat - above).sum(axis=-1)
    if usable is not None:
        across *= usable & np.roll(usable, 1, axis=1)
        down *= usable & np.concatenate([usable[:1], usable[:-1]])
    return across, down


def _planes(
    values: np.ndarray,
    weight: np.ndarray,
    fallback: np.ndarray,
    directions: np.ndarray,
    edges: tuple[np.ndarray, np.ndarray],
    reach: float,
) -> np.ndarray:
    """Value at each pixel of the plane fitted around it."""
    values, weight, fallback = (np.asarray(image, np.float64) for image in (values, weight, fallback))
    sums = _smooth(normal_equations(values, weight, directions), edges, reach)
    return np.asarray(fitted_values(sums, fallback, directions, FALLBACK_WEIGHT, FLATNESS * reach**2))


def _smooth(channels: np.ndarray, edges: tuple[np.ndarray, np.ndarray], reach: float) -> np.ndarray:
    """Edge-aware mean of every channel over about ``reach`` radians, in place."""
    height, width = channels.shape[:2]
    sine = direction_tables(height, width)[0]
    way_across = sine[:, None] * (2.0 * math.pi / width) / reach + EDGE * edges[0]
    way_down = math.pi / height / reach + EDGE * edges[1]
    for k in range(ROUNDS):
        share = math.sqrt(3.0) * 2.0 ** (ROUNDS - k - 1) / math.sqrt(4.0**ROUNDS - 1.0)
        decay = -math.sqrt(2.0) / share
        across, down = (np.exp(decay * way).astype(np.float32) for way in (way_across, way_down))
        run_bands(partial(_pass_across, channels, across), -(-height // SIDE_BY_SIDE))
        run_bands(partial(_pass_down, channels, down), width)
    return channels


@kernel()
def _pass_across(channels, keep, begin, end):  # type: ignore[no-untyped-def]
    """Recursive mean along some groups of rows, both ways; ``keep[r, c]`` couples columns c − 1 and c.

    A first round from zero tells the state that comes back to itself: the row is a circle without a beginning.
    """
    height, width, count = channels.shape
    lines, share = np.zeros((width, count, SIDE_BY_SIDE), np.float32), np.zeros((width, SIDE_BY_SIDE), np.float32)
    for group in range(begin, end):
        top, rows = group * SIDE_BY_SIDE, min(SIDE_BY_SIDE, height - group * SIDE_BY_SIDE)
        for lane in range(rows):
            for col in range(width):
                share[col, lane] = keep[top + lane, col]
                for i in range(count):
                    lines[col, i, lane] = channels[top + lane, col, i]
        for side in range(2):
            _walk_around(lines, share, side)
        for lane in range(rows):
            for col in range(width):
                for i in range(count):
                    channels[top + lane, col, i] = lines[col, i, lane]


@inlined()
def _walk_around(lines, share, side):  # type: ignore[no-untyped-def]
    """Two rounds along rows that lie side by side, ``(columns, channels, rows)``: the second one writes."""
    width, count, lanes = lines.shape
    state, left = np.zeros((count, lanes), np.float32), np.ones(lanes, np.float32)
    for k in range(2 * width):
        col = k % width if side == 0 else width - 1 - k % width
        own = share[col] if side == 0 else share[(col + 1) % width]
        line = lines[col]
        for i in range(count):
            for lane in range(lanes):
                came = state[i, lane]
                if k == width:
                    came /= max(np.float32(1.0) - left[lane], np.float32(1e-6))
                state[i, lane] = line[i, lane] + own[lane] * (came - line[i, lane])
                if k >= width:
                    line[i, lane] = state[i, lane]
        for lane in range(lanes):
            left[lane] *= own[lane]


@kernel()
def _pass_down(channels, keep, begin, end):  # type: ignore[no-untyped-def]
    """Recursive mean along some columns, both ways; ``keep[r, c]`` couples rows r − 1 and r."""
    height, _, count = channels.shape
    for row in range(1, height):
        _draw_to(channels[row], channels[row - 1], keep[row], begin, end, count)
    for row in range(height - 2, -1, -1):
        _draw_to(channels[row], channels[row + 1], keep[row + 1], begin, end, count)


@inlined()
def _draw_to(line, before, keep, begin, end, count):  # type: ignore[no-untyped-def]
    for col in range(begin, end):
        for i in range(count):
            line[col, i] += keep[col] * (before[col, i] - line[col, i])


def remove_speckles(
    inverse_depth: Float[np.ndarray, "height width"], known: Bool[np.ndarray, "height width"], pixels: int, step: float
) -> Bool[np.ndarray, "height width"]:
    """``known`` without islands of fewer than ``pixels`` whose inverse depth differs from all around.

    Args:
        inverse_depth: any unit.
        known: what to keep.
        pixels: least size of an island.
        step: relative difference that separates neighbours.
    """
    logarithm = np.log2(np.maximum(inverse_depth, 1e-4)) / math.log2(1.0 + step)
    levels = np.where(known, np.clip(logarithm * 16.0 + 16000.0, 0, 32000), -1000).astype(np.int16)

    def without_specks(wide: np.ndarray) -> np.ndarray:
        return np.asarray(cv2.filterSpeckles(wide, -1000, pixels, 16)[0])

    kept = filter_across_seam(without_specks, levels, min(64, levels.shape[1]))
    return np.asarray(known & (kept != -1000))


def median_around(values: Float32[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width"]:
    """Of the square around each pixel, over the seam; at the poles of what there is, the last rows repeated."""
    return filter_across_seam(partial(cv2.medianBlur, ksize=WINDOW), values, WINDOW // 2)


def upsample(
    inverse_depth: Float[np.ndarray, "low_height low_width"],
    low_guide: Float[np.ndarray, "low_height low_width 3"],
    guide: Float[np.ndarray, "height width 3"],
) -> Float[np.ndarray, "height width"]:
    """The map at the size of ``guide``, its discontinuities moved to the edges of the image.

    Every pixel takes the weighted median of the low pixels around it, where those of its own colour weigh most, and
    then the mean of the ones close to that median, so that planes stay smooth.

    Source: Kopf et al., Joint bilateral upsampling, 2007, with a median for the mean.
    """
    ring = 3
    (height, width), (low_height, low_width) = guide.shape[:2], inverse_depth.shape
    out = np.empty((height, width), np.float32)
    bordered = [add_border(each, ring).astype(np.float32) for each in (inverse_depth, low_guide)]
    rows, cols = _places_around(height, low_height, ring), _places_around(width, low_width, ring)
    run_bands(partial(_upsample, *bordered, guide.astype(np.float32), *rows, *cols, out), height)
    return out


def _places_around(
    count: int, of: int, ring: int
) -> tuple[Int64[np.ndarray, " count"], Float32[np.ndarray, "count low"]]:
    """For each of ``count`` pixels the first of the ``of`` low ones around it, counted from the ring; their weights."""
    x = ((np.arange(count) + 0.5) * (of / count) - 0.5 + ring).astype(np.float32)
    first = np.floor(x + np.float32(0.5)).astype(np.int64) - ring + 1
    beside = first[:, None] + np.arange(2 * ring - 1) - x[:, None]
    return first, np.exp(-SPREAD * beside * beside).astype(np.float32)


@fast_kernel()
def _upsample(low, low_guide, guide, rows, near_rows, cols, near_cols, out, begin, end):  # type: ignore[no-untyped-def]
    side = near_rows.shape[1]
    value, weight = np.empty(side * side, np.float32), np.empty(side * side, np.float32)
    for row in range(begin, end):
        r0, near_row = rows[row], near_rows[row]
        for col in range(out.shape[1]):
            c0, near_col = cols[col], near_cols[col]
            least, greatest = np.float32(np.inf), np.float32(-np.inf)
            for i in range(side):
                for j in range(side):
                    found = low[r0 + i, c0 + j]
                    weight[side * i + j], value[side * i + j] = near_row[i] * near_col[j], found
                    least, greatest = min(least, found), max(greatest, found)
            if greatest > np.float32(1.1) * least:
                for k in range(side * side):
                    colour = np.float32(0.0)
                    for i in range(3):
                        colour += abs(low_guide[r0 + k // side, c0 + k % side, i] - guide[row, col, i])
                    weight[k] *= np.exp(np.float32(-12.0) * colour)
            out[row, col] = _mean_near(value, weight, _weighted_median(value, weight, least, greatest))


@inlined()
def _weighted_median(value, weight, low, high):  # type: ignore[no-untyped-def]
    """Between the least and the greatest; any will do when all are alike, else half of the weight is on either side."""
    if high <= np.float32(1.1) * low:
        return high
    half = np.float32(0.0)
    for k in range(value.shape[0]):
        half += np.float32(0.5) * weight[k]
    for _ in range(12):
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
def _mean_near(value, weight, median):  # type: ignore[no-untyped-def]
    total, mean = np.float32(0.0), np.float32(0.0)
    nearest, gap = value[0], np.float32(np.inf)
    for k in range(value.shape[0]):
        distance = abs(value[k] - median)
        if distance < gap:
            nearest, gap = value[k], distance
        if distance <= np.float32(0.1) * median:
            total += weight[k]
            mean += weight[k] * value[k]
    return mean / total if total > 0 else nearest
