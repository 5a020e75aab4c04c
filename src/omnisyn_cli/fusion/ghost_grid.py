"""The coarse grid of cells in which ghosts are looked for, and which pixels of a frame it samples."""

# Rows of cells in a frame: a cell is 1.4° high, wider than a pixel of displacement by wrong depth. Set by hand.
GRID_ROWS = 128
MIN_CELL_PIXELS = 4  # side of a cell in pixels at least: wrong depth displaces by pixels, not by angles. Set by hand.
# Pixels that are sampled along the side of a large cell: 16 are enough for its mean. Set by hand.
SAMPLES_PER_CELL_SIDE = 4


def ghost_cell_size(size: tuple[int, int]) -> int:
    """Pixels along the side of a cell of a frame of ``size = (height, width)``."""
    return max(MIN_CELL_PIXELS, -(-size[0] // GRID_ROWS))


def ghost_sample_step(size: tuple[int, int]) -> int:
    """Every how many-th pixel of a row and of a column is sampled; 1 where cells are small."""
    return max(1, ghost_cell_size(size) // SAMPLES_PER_CELL_SIDE)
