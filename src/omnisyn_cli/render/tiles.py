"""What a target sees of the tiles of a simplified mesh: :mod:`omnisyn_cli.render.rasterize` without face numbers."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import direction_tables, pixel_scale
from omnisyn_cli.render.rasterize import tables_for_vectors
from omnisyn_cli.render.simplify import Tiles
from omnisyn_cli.render.tile_kernels import find_tile_rows, rasterize_tiles
from omnisyn_cli.threads import run_bands

__all__ = ["TileRasterizer"]


class TileRasterizer:
    """Tables for one target size, and the image it writes; reused from frame to frame. Not shared between threads."""

    def __init__(self, size: tuple[int, int], threads: int | None = None) -> None:
        self.size, self.threads = size, threads
        self._exact_tables = direction_tables(*size)
        self._tables = tables_for_vectors(size)
        self._scale = np.array(pixel_scale(size), np.float32)
        self._inverse_depth = np.empty(size, np.float32)

    def __call__(self, tiles: Tiles, target_from_source: Pose) -> Float32[np.ndarray, "height width"]:
        """Inverse depth from the target's centre, negative where nothing is seen; the next call overwrites it."""
        rotation = np.ascontiguousarray(target_from_source.rotation, np.float32)
        translation = np.ascontiguousarray(target_from_source.position, np.float32)
        rows = self._rows(tiles, rotation, translation)

        def fill(begin: int, end: int) -> None:
            self._inverse_depth[begin:end] = -1.0
            rasterize_tiles(
                tiles.points, tiles.codes, tiles.gaps, rows, rotation, translation, self._scale,
                self._tables, self._exact_tables, self._inverse_depth, begin, end,
            )  # fmt: skip

        run_bands(fill, self.size[0], self.threads)
        return self._inverse_depth

    def _rows(self, tiles: Tiles, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
        """First and last row that each block can touch; all where one band takes everything."""
        rows = np.empty((len(tiles.points), 2), np.int32)
        rows[:] = 0, self.size[0]
        if self.threads != 1:
            run_bands(
                lambda begin, end: find_tile_rows(
                    tiles.points, tiles.gaps, rotation, translation, self._scale, self._tables[0], *self.size,
                    rows, begin, end,
                ),
                len(rows),
                self.threads,
            )  # fmt: skip
        return rows
