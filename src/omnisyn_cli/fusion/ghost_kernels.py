"""The pixel loops of ghost removal, in numba; twins of the array code in :mod:`omnisyn_cli.fusion.ghosts`."""

import math

import numpy as np

from omnisyn_cli.compute.jit import fast_kernel, inlined
from omnisyn_cli.types import MIN_VISIBLE_WEIGHT


@fast_kernel()
def accumulate_cells(first, first_rho, second, second_rho, cell_size, sums, begin, end):
    """Sums over the pixels of each cell, for rows of cells ``begin`` to ``end``.

    Layers are ``(height, width, 4)`` RGB and weight, with inverse depths; ``cell_size`` is in pixels. ``sums``,
    ``(rows, cols, 13)``, are written: [0] how many pixels both see; of these [1–4] RGB and weight of the first, [5–8]
    of the second, [9, 10] inverse depth of both; [11] how many only the first sees, [12] only the second.
    """
    height, width = first_rho.shape
    for i in range(begin, end):
        for j in range(sums.shape[1]):
            for k in range(sums.shape[2]):
                sums[i, j, k] = np.float32(0.0)
            for row in range(i * cell_size, min((i + 1) * cell_size, height)):
                for col in range(j * cell_size, min((j + 1) * cell_size, width)):
                    if not first[row, col, 3] > MIN_VISIBLE_WEIGHT:
                        sums[i, j, 12] += np.float32(second[row, col, 3] > MIN_VISIBLE_WEIGHT)
                    elif not second[row, col, 3] > MIN_VISIBLE_WEIGHT:
                        sums[i, j, 11] += np.float32(1.0)
                    else:
                        sums[i, j, 0] += np.float32(1.0)
                        for k in range(4):
                            sums[i, j, 1 + k] += first[row, col, k]
                            sums[i, j, 5 + k] += second[row, col, k]
                        sums[i, j, 9] += max(first_rho[row, col], np.float32(0.0))
                        sums[i, j, 10] += max(second_rho[row, col], np.float32(0.0))


@fast_kernel()
def suppress_rows(first, second, signed_strength, cell_size, top):
    """Take weight from the suppressed layer where both see something; the strength is bilinear between cells.

    Layers, ``(rows, width, 4)`` from row ``top`` of the frame on, change in place. ``signed_strength``, by cell of
    ``cell_size`` pixels, is from −1 (the first loses all weight) to 1 (the second).
    """
    width = first.shape[1]
    for row in range(len(first)):
        upper, lower, down = neighbour_cell_rows(signed_strength, cell_size, top + row)
        for cell_col in range(-(-width // cell_size)):
            # Nearly all cells of nearly all frames: no interpolation where nothing is suppressed.
            if _is_unsuppressed(signed_strength, upper, lower, cell_col):
                continue
            for col in range(cell_col * cell_size, min((cell_col + 1) * cell_size, width)):
                strength = interpolate_strength(signed_strength, cell_size, upper, lower, down, col)
                _reduce_weight(first, second, row, col, strength)


@fast_kernel()
def suppress_edge_samples(first, second, signed_strength, cell_size, edge_pixels):
    """The same for the samples of edge pixels, ``(2, samples, 4)`` of either layer; one strength for each pixel."""
    for row in range(len(edge_pixels.tile_begins)):
        upper, lower, down = neighbour_cell_rows(signed_strength, cell_size, edge_pixels.top + row)
        for at in range(edge_pixels.tile_begins[row, 0], edge_pixels.tile_begins[row, -1]):
            col = edge_pixels.cols[at]
            if col < 0 or _is_unsuppressed(signed_strength, upper, lower, col // cell_size):
                continue
            value = interpolate_strength(signed_strength, cell_size, upper, lower, down, col)
            for half in range(2):
                _reduce_weight(first, second, half, 2 * at, value)
                _reduce_weight(first, second, half, 2 * at + 1, value)


@inlined()
def neighbour_cell_rows(signed_strength, cell_size, row):
    """The two rows of cells between whose centres a row lies, and its fraction of the way between them."""
    y = (np.float32(row) + np.float32(0.5)) / np.float32(cell_size) - np.float32(0.5)
    i = int(math.floor(y))  # noqa: RUF046 - in CUDA kernels it is a float
    last = len(signed_strength) - 1
    return min(max(i, 0), last), min(max(i + 1, 0), last), y - np.float32(i)


@inlined()
def interpolate_strength(signed_strength, cell_size, upper, lower, down, col):
    """The strength at a column, bilinear between four cells; columns wrap."""
    x = (np.float32(col) + np.float32(0.5)) / np.float32(cell_size) - np.float32(0.5)
    j, cols = int(math.floor(x)), signed_strength.shape[1]  # noqa: RUF046
    across = x - np.float32(j)
    left, right = j % cols, (j + 1) % cols
    above = signed_strength[upper, left] + across * (signed_strength[upper, right] - signed_strength[upper, left])
    below = signed_strength[lower, left] + across * (signed_strength[lower, right] - signed_strength[lower, left])
    return above + down * (below - above)


@inlined()
def _reduce_weight(first, second, row, col, strength):
    """Take weight from the suppressed layer, if both see something: where one sees nothing, the other has to stay."""
    if first[row, col, 3] > MIN_VISIBLE_WEIGHT and second[row, col, 3] > MIN_VISIBLE_WEIGHT:
        if strength > np.float32(0.0):
            second[row, col, 3] *= np.float32(1.0) - strength
        else:
            first[row, col, 3] *= np.float32(1.0) + strength


@inlined()
def _is_unsuppressed(signed_strength, upper, lower, cell_col):
    """Whether the strength is 0 in a cell column and beside it, in two rows of cells."""
    cols = signed_strength.shape[1]
    for j in range(cell_col - 1, cell_col + 2):
        if signed_strength[upper, j % cols] != np.float32(0.0) or signed_strength[lower, j % cols] != np.float32(0.0):
            return False
    return True
