"""The sizes that depth is looked for at; nothing heavy is imported for them."""

__all__ = ["coarse_rows", "estimate_sizes"]

REFINED_ROWS = 512
"""Rows of matching up to which the completion network is used: it has been trained at these and half of them."""

ROWS_PER_ROW = 2
"""Rows of an estimate per row of the pictures at most: between their pixels there is a little to be measured."""


def coarse_rows(rows: int) -> int:
    """Rows that matching works towards: a half, a quarter, … of ``rows`` where the network does not know so many."""
    while rows > REFINED_ROWS:
        rows //= 2
    return rows


def estimate_sizes(rows: int, picture_rows: int) -> tuple[tuple[int, int], ...]:
    """Height and width of refined estimates, and of what they are sharpened to, one after the other.

    Args:
        rows: that depth is looked for at.
        picture_rows: those of the larger panorama.
    """
    return doubled_sizes(coarse_rows(rows) // 2, rows // 2, picture_rows)


def doubled_sizes(height: int, most: int, picture_rows: int) -> tuple[tuple[int, int], ...]:
    """Height and width, doubled up to ``most`` rows and :data:`ROWS_PER_ROW` times those of the pictures."""
    sizes = [(height, 2 * height)]
    while 2 * sizes[-1][0] <= min(most, ROWS_PER_ROW * picture_rows):
        sizes.append((2 * sizes[-1][0], 2 * sizes[-1][1]))
    return tuple(sizes)
