# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
"""Both eyes of a panorama whose distances are known (omnidirectional stereo).

The eyes stand on a circle around the camera, each where a head has it that looks along the column. A point at distance
d is seen by the left eye farther to the right by ``asin(half of the eyes' distance / d)``, and by the right eye
farther to the left. Angles are those of the horizon in all rows, so stereo fades towards the poles.

Source: Peleg et al., Omnistereo: panoramic stereo imaging, 2001; Google, "Rendering Omni-directional Stereo Content".
"""

import math
from functools import partial

import numpy as np
from jaxtyping import Float32, Shaped

from omnisyn_cli.compute.arrays import empty
from omnisyn_cli.compute.jit import kernel
from omnisyn_cli.compute.threads import run_ranges

EYE_DISTANCE = 0.064  # metres between the eyes of most people
# Columns that neighbouring columns may come to lie apart; beyond, one of them hides what opens between them.
MAX_STRETCH = 2.0
MAX_SINE = 0.5  # of the shift: nothing is nearer than the eyes' distance


def top_bottom(
    image: Shaped[np.ndarray, "height width 3"], inverse_depth: Float32[np.ndarray, "height width"],
    threads: int | None = None,
) -> Shaped[np.ndarray, "double_height width 3"]:  # fmt: skip
    """The left eye's panorama above the right eye's, each of the size and the type of the equirectangular picture.

    Inverse depth is in 1/metre; negative where it is unknown, which counts as infinitely far.
    """
    height, width, _ = image.shape
    out = np.empty((2 * height, width, 3), image.dtype)
    sine = np.clip(0.5 * EYE_DISTANCE * np.maximum(inverse_depth, 0.0), 0.0, MAX_SINE)
    shift = np.asarray(np.arcsin(sine) * (width / math.radians(360.0)), np.float32)
    rounding = np.float32(0.0 if image.dtype.kind == "f" else 0.5)
    peak = np.float32(np.finfo(np.float32).max if image.dtype.kind == "f" else np.iinfo(image.dtype).max)
    for sign, eye in ((1.0, out[:height]), (-1.0, out[height:])):
        run_ranges(partial(_shift_rows, image, shift, np.float32(sign), rounding, peak, eye), height, threads)
    return out


@kernel()
def _shift_rows(image, shift, sign, rounding, peak, out, begin, end):
    """One eye's rows: what is nearer hides what is farther, and what opens behind it continues the farther side.

    ``shift``: columns by which each pixel moves, >= 0; ``sign``: 1 to the right, −1 to the left. ``rounding`` is added
    before colours are assigned, ``peak`` is the largest.
    """
    width = image.shape[1]
    source, nearest = empty(width, np.float32), empty(width, np.float32)
    for row in range(begin, end):
        nearest[:] = np.float32(-1.0)
        for col in range(width):
            here, beside = shift[row, col], shift[row, (col + 1) % width]
            left, right = np.float32(col) + sign * here, np.float32(col + 1) + sign * beside
            length = right - left
            is_joined = np.float32(0.0) < length <= np.float32(MAX_STRETCH)
            first = math.ceil(left) if is_joined else math.floor(left + np.float32(0.5))
            last = math.ceil(right) - 1 if is_joined else first
            for target in range(first, last + 1):
                share = (np.float32(target) - left) / length if is_joined else np.float32(0.0)
                distance = here + share * (beside - here) if is_joined else here
                at = target % width
                if distance > nearest[at]:
                    nearest[at], source[at] = distance, np.float32(col) + share
        _fill_gaps(source, nearest, width)
        for col in range(width):
            at = math.floor(source[col])
            share = source[col] - np.float32(at)
            a, b = at % width, (at + 1) % width
            for k in range(3):
                value = (np.float32(1.0) - share) * np.float32(image[row, a, k]) + share * np.float32(image[row, b, k])
                out[row, col, k] = min(value + rounding, peak)


@kernel()
def _fill_gaps(source, nearest, width):
    """Give columns without a source that of the farther one of those beside the gap."""
    start = 0
    while start < width and nearest[start] < np.float32(0.0):
        start += 1
    if start == width:
        for col in range(width):
            source[col] = np.float32(col)
        return
    before = start
    for step in range(1, width + 1):
        col = (start + step) % width
        if nearest[col] < np.float32(0.0):
            continue
        gap = (col - before) % width
        if gap > 1:
            far = before if nearest[before] <= nearest[col] else col
            for k in range(1, gap):
                source[(before + k) % width] = source[far]
        before = col
