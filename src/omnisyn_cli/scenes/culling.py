"""Which shapes can matter where: tiles of the picture for eye rays, cells of a grid across the light for shadow rays.

Both answers are conservative: a shape may be listed in vain but is never missed.
"""

import math

import numpy as np
from jaxtyping import Float, Int

from omnisyn_cli.scenes.kernel_decorators import kernel

LIGHT_GRID_CELLS = 96
"""Cells of the light grid along each axis."""


@kernel
def _support(shape, axes, k, x, y, z):  # type: ignore[no-untyped-def]
    """Support function: how far a shape extends from its centre along (x, y, z); rows of ``axes`` are scaled axes."""
    a = abs(axes[k, 0, 0] * x + axes[k, 0, 1] * y + axes[k, 0, 2] * z)
    b = abs(axes[k, 1, 0] * x + axes[k, 1, 1] * y + axes[k, 1, 2] * z)
    c = abs(axes[k, 2, 0] * x + axes[k, 2, 1] * y + axes[k, 2, 2] * z)
    if shape == 0:
        return a + b + c
    if shape == 1:
        return math.sqrt(a * a + b * b + c * c)
    return b + math.sqrt(a * a + c * c)


@kernel
def tile_planes(sin_polar, cos_polar, horizon, up, rows, columns, planes):  # type: ignore[no-untyped-def]
    """Fill ``planes`` (4, 3) with inward normals of half spaces through the eye that hold all rays of a tile.

    Sides are meridians, which are planes. The parallels above and below are cones: where the cone bulges out of the
    tile the plane touches it, elsewhere the plane passes through the corners. A tile half around the sphere or more
    gets no planes (zeros).

    ``sin_polar``, ``cos_polar`` (per row of samples) and ``horizon`` (per column) are the tables of the rays; ``rows``
    and ``columns`` hold the first and the last of the tile.
    """
    for p in range(4):
        planes[p, 0], planes[p, 1], planes[p, 2] = 0.0, 0.0, 0.0
    first, last = columns
    x, y = horizon[first, 0] + horizon[last, 0], horizon[first, 1] + horizon[last, 1]
    z = horizon[first, 2] + horizon[last, 2]
    length = math.sqrt(x * x + y * y + z * z)
    if length < 0.5 or last - first > 0.4 * len(horizon):
        return
    x, y, z, cos_half = x / length, y / length, z / length, 0.5 * length
    for side in range(2):
        h = columns[side]
        nx = up[1] * horizon[h, 2] - up[2] * horizon[h, 1]
        ny = up[2] * horizon[h, 0] - up[0] * horizon[h, 2]
        nz = up[0] * horizon[h, 1] - up[1] * horizon[h, 0]
        sign = -1.0 if nx * x + ny * y + nz * z < 0.0 else 1.0
        planes[side, 0], planes[side, 1], planes[side, 2] = sign * nx, sign * ny, sign * nz
    for side in range(2):
        cosine, sine = cos_polar[rows[side]], sin_polar[rows[side]]
        sign = 1.0 if side == 0 else -1.0
        a, b = sign * cosine, -sign * sine * (cos_half if sign * cosine > 0.0 else 1.0)
        p = 2 + side
        planes[p, 0], planes[p, 1], planes[p, 2] = a * x + b * up[0], a * y + b * up[1], a * z + b * up[2]


@kernel
def cull_tile(bounds, candidates, candidate_count, planes, visible):  # type: ignore[no-untyped-def]
    """Copy those of the first ``candidate_count`` candidates that may show in a tile to ``visible`` and count them.

    ``bounds`` is a :class:`omnisyn_cli.scenes.world.Bounds`, ``planes`` come from :func:`tile_planes`; the order stays.
    """
    count = 0
    shape, offset, axes = bounds.shape, bounds.offset, bounds.axes
    for i in range(candidate_count):
        k = candidates[i]
        is_visible = True
        for p in range(4):
            x, y, z = planes[p, 0], planes[p, 1], planes[p, 2]
            height = offset[k, 0] * x + offset[k, 1] * y + offset[k, 2] * z
            if height < -1e-7 and height < -_support(shape[k], axes, k, x, y, z) - 1e-7:
                is_visible = False
                break
        if is_visible:
            visible[count] = k
            count += 1
    return count


@kernel
def _fill_grid(low: np.ndarray, high: np.ndarray, casters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    start = np.zeros(LIGHT_GRID_CELLS * LIGHT_GRID_CELLS + 1, dtype=np.int64)
    for k in casters:
        for i in range(low[k, 0], high[k, 0] + 1):
            for j in range(low[k, 1], high[k, 1] + 1):
                start[i * LIGHT_GRID_CELLS + j + 1] += 1
    for cell in range(LIGHT_GRID_CELLS * LIGHT_GRID_CELLS):
        start[cell + 1] += start[cell]
    items = np.empty(start[-1], dtype=np.int64)
    filled = start[:-1].copy()
    for k in casters:
        for i in range(low[k, 0], high[k, 0] + 1):
            for j in range(low[k, 1], high[k, 1] + 1):
                items[filled[i * LIGHT_GRID_CELLS + j]] = k
                filled[i * LIGHT_GRID_CELLS + j] += 1
    return start, items


def light_grid(
    centre: Float[np.ndarray, "n 3"], axes: Float[np.ndarray, "n 3 3"], casters: Int[np.ndarray, " k"],
    across: Float[np.ndarray, "2 3"], margin: float,
) -> tuple[Int[np.ndarray, " c1"], Int[np.ndarray, " i"], Float[np.ndarray, "2 2"]]:  # fmt: skip
    """List for each cell of a grid across the light the shapes whose shadows pass through it.

    Args:
        centre: of each shape, metres.
        axes: scaled axes as rows.
        casters: shapes that cast shadows.
        across: two unit vectors orthogonal to the light.
        margin: by which shadows are wider than their shapes, metres.

    Returns:
        ``(start, items, frame)``: the shapes of cell ``c = i·GRID + j`` are ``items[start[c]:start[c + 1]]``;
        ``frame`` holds for each axis of the grid its origin in metres and the number of cells per metre.
    """
    if len(casters) == 0:
        start = np.zeros(LIGHT_GRID_CELLS**2 + 1, np.int64)
        return start, np.zeros(0, np.int64), np.array([[0.0, 1.0], [0.0, 1.0]])
    middle = centre @ across.T
    reach = np.abs(axes @ across.T).sum(axis=1) + margin
    low, high = middle - reach, middle + reach
    origin, end = low[casters].min(axis=0), high[casters].max(axis=0)
    scale = (LIGHT_GRID_CELLS - 1e-6) / (end - origin)
    cells = [np.clip((edge - origin) * scale, 0, LIGHT_GRID_CELLS - 1).astype(np.int64) for edge in (low, high)]
    start, items = _fill_grid(cells[0], cells[1], casters)
    return start, items, np.stack([origin, scale], axis=1)
