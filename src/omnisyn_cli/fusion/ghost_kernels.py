"""The loops over pixels that find and remove ghosts, in numba: twins of those of :mod:`omnisyn_cli.fusion.ghosts`."""

import numpy as np

from omnisyn_cli.compute.jit import fast_kernel, inlined
from omnisyn_cli.types import MIN_VISIBLE_WEIGHT


@fast_kernel()
def accumulate_cells(first, first_rho, second, second_rho, cell, sums, begin, end):
    """Sums over the pixels of each cell, for rows of cells ``begin`` to ``end``.

    Args:
        first: ``(height, width, 4)`` RGB and weight.
        first_rho: its inverse depth.
        second: as ``first``.
        second_rho: as ``first_rho``.
        cell: pixels along the side of a cell.
        sums: ``(rows, cols, 13)``: how many both views see; of these, RGB and weight of the first, of the second;
            inverse depth of both; how many only the first sees, and only the second.
        begin: first row of cells.
        end: the row after the last.
    """
    height, width = first_rho.shape
    for i in range(begin, end):
        for j in range(sums.shape[1]):
            for k in range(sums.shape[2]):
                sums[i, j, k] = np.float32(0.0)
            for row in range(i * cell, min((i + 1) * cell, height)):
                for col in range(j * cell, min((j + 1) * cell, width)):
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
def suppress_rows(first, second, suppressed, cell, top):
    """Take weight away from the suppressed view where both see something, gradually at the border of a region.

    Args:
        first: ``(rows, width, 4)`` RGB and weight; the weight is changed in place.
        second: likewise.
        suppressed: ``(rows, cols)`` by cell: from −1 (the first loses all of its weight) to 1 (the second does).
        cell: pixels along the side of a cell.
        top: row of the picture that the first row of both is.
    """
    width = first.shape[1]
    for row in range(len(first)):
        upper, lower, down = _rows_of_cells(suppressed, cell, top + row)
        for block in range(-(-width // cell)):
            if _is_free(suppressed, upper, lower, block):
                continue
            for col in range(block * cell, min((block + 1) * cell, width)):
                _lessen(first, second, row, col, _between(suppressed, cell, upper, lower, down, col))


@fast_kernel()
def suppress_edge_samples(first, second, suppressed, cell, edge_pixels):
    """The same for the samples of spots, ``(2, samples, 4)`` of either view: each by where its spot is."""
    for row in range(len(edge_pixels.begins)):
        upper, lower, down = _rows_of_cells(suppressed, cell, edge_pixels.top + row)
        for at in range(edge_pixels.begins[row, 0], edge_pixels.begins[row, -1]):
            col = edge_pixels.cols[at]
            if col < 0 or _is_free(suppressed, upper, lower, col // cell):
                continue
            value = _between(suppressed, cell, upper, lower, down, col)
            for half in range(2):
                _lessen(first, second, half, 2 * at, value)
                _lessen(first, second, half, 2 * at + 1, value)


@inlined()
def _rows_of_cells(suppressed, cell, row):
    """The rows of cells between whose centres a row lies, and how far it is from the first of them."""
    y = (np.float32(row) + np.float32(0.5)) / np.float32(cell) - np.float32(0.5)
    i = int(np.floor(y))
    last = len(suppressed) - 1
    return min(max(i, 0), last), min(max(i + 1, 0), last), y - np.float32(i)


@inlined()
def _between(suppressed, cell, upper, lower, down, col):
    """What is said of a column between four cells."""
    x = (np.float32(col) + np.float32(0.5)) / np.float32(cell) - np.float32(0.5)
    j, cols = int(np.floor(x)), suppressed.shape[1]
    right = x - np.float32(j)
    left, beyond = j % cols, (j + 1) % cols
    above = suppressed[upper, left] + right * (suppressed[upper, beyond] - suppressed[upper, left])
    below = suppressed[lower, left] + right * (suppressed[lower, beyond] - suppressed[lower, left])
    return above + down * (below - above)


@inlined()
def _lessen(first, second, row, col, value):
    """Take weight from one view where both see something."""
    if first[row, col, 3] > MIN_VISIBLE_WEIGHT and second[row, col, 3] > MIN_VISIBLE_WEIGHT:
        if value > np.float32(0.0):
            second[row, col, 3] *= np.float32(1.0) - value
        else:
            first[row, col, 3] *= np.float32(1.0) + value


@inlined()
def _is_free(suppressed, upper, lower, block):
    """Whether nothing is to be suppressed between the rows of cells ``upper`` and ``lower`` in and beside a cell."""
    cols = suppressed.shape[1]
    for j in range(block - 1, block + 2):
        if suppressed[upper, j % cols] != np.float32(0.0) or suppressed[lower, j % cols] != np.float32(0.0):
            return False
    return True
