"""Put the presets side by side: a column for each, the frame halfway between two panoramas, and a part of it enlarged.

python examples/make_contact_sheet.py SHEET.jpg FOLDER[:COL,ROW] …

Every FOLDER has poses.json and the two panoramas that it names; COL and ROW, in shares of the width and the height, say
which part is enlarged (the middle unless given). What lies within 25° of straight down is left out.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
from pathlib import Path

import numpy as np

from omnisyn_cli.interpolation.job import InterpolationJob
from omnisyn_cli.interpolation.plan import plan_interpolation
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.io import read_panorama, write_image
from omnisyn_cli.pipeline.presets import PRESETS

WIDTH = 1792
"""Of the frames that parts are taken from; a multiple of :data:`CELL`."""

CELL = 448
"""Width of a cell; it is half as high."""

LINE = 4


def middle_frame(folder: Path, preset: str) -> np.ndarray:
    """``(WIDTH / 2, WIDTH, 3)`` the second of three frames."""
    names = list(json.loads((folder / "poses.json").read_text())["panoramas"])
    with tempfile.TemporaryDirectory() as temporary:
        frames = Path(temporary) / "frames"
        images = (folder / names[0], folder / names[-1])
        size = (WIDTH // 2, WIDTH)
        job = InterpolationJob(
            images, folder / "poses.json", frames, frames=3, size=size, preset=preset, nadir=math.radians(25)
        )
        run_interpolation(plan_interpolation(job))
        return read_panorama(sorted(frames.iterdir())[1]).image


def cells(frame: np.ndarray, col: float, row: float) -> list[np.ndarray]:
    """The whole frame made small, and a part of it as it is."""
    step, height = WIDTH // CELL, CELL // 2
    small = frame[: step * height, : step * CELL].reshape(height, step, CELL, step, 3).mean(axis=(1, 3))
    top = min(max(int(row * frame.shape[0]) - height // 2, 0), frame.shape[0] - height)
    left = min(max(int(col * WIDTH) - CELL // 2, 0), WIDTH - CELL)
    return [small, frame[top : top + height, left : left + CELL]]


def make_sheet(sheet: Path, pairs: list[str]) -> None:
    """Two rows for each pair, a column for each preset."""
    rows = []
    for pair in pairs:
        folder, _, place = pair.partition(":")
        col, row = (float(share) for share in place.split(",")) if place else (0.5, 0.5)
        columns = [cells(middle_frame(Path(folder), preset), col, row) for preset in PRESETS]
        for parts in zip(*columns, strict=True):
            line = np.ones((CELL // 2, LINE, 3), np.float32)
            rows.append(np.concatenate([cell for part in parts for cell in (part, line)][:-1], axis=1))
            rows.append(np.ones((LINE, rows[-1].shape[1], 3), np.float32))
    write_image(sheet, np.concatenate(rows[:-1]))


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    make_sheet(Path(sys.argv[1]), sys.argv[2:])
