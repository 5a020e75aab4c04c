"""The sizes at which depth is estimated; importing this loads nothing heavy."""

# Rows of matching up to which the completion network works: it was trained at these and half of them.
MAX_COMPLETION_ROWS = 512
# Rows of an estimate per row of the pictures: sub-pixel matching measures a little between pixels.
MAX_ROWS_PER_IMAGE_ROW = 2


def matching_rows(rows: int) -> int:
    """Rows that matching works towards: ``rows``, or a half, a quarter, … where the network does not know so many."""
    while rows > MAX_COMPLETION_ROWS:
        rows //= 2
    return rows


def refinement_sizes(rows: int, image_rows: int) -> tuple[tuple[int, int], ...]:
    """Height and width of completed depth, and of each refinement after it.

    Depth is looked for at ``rows``; the larger panorama has ``image_rows``.
    """
    return doubled_sizes(matching_rows(rows) // 2, rows // 2, image_rows)


def doubled_sizes(height: int, max_height: int, image_rows: int) -> tuple[tuple[int, int], ...]:
    """Height and width, doubled up to ``max_height`` and :data:`MAX_ROWS_PER_IMAGE_ROW` times the pictures' rows."""
    sizes = [(height, 2 * height)]
    while 2 * sizes[-1][0] <= min(max_height, MAX_ROWS_PER_IMAGE_ROW * image_rows):
        sizes.append((2 * sizes[-1][0], 2 * sizes[-1][1]))
    return tuple(sizes)
