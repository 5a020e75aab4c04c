"""Make the picture at the top of the README: the first panorama, three frames from in between, the second panorama.

python examples/make_strip.py FOLDER [WIDTH]   writes FOLDER/strip.jpg from FOLDER/first.jpg, second.jpg and poses.json
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from omnisyn_cli.interpolation.job import InterpolationJob
from omnisyn_cli.interpolation.plan import plan_interpolation
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.io import read_panorama, write_image

FRAMES = 5


def make_strip(folder: Path, width: int) -> Path:
    """Five frames, each ``width`` pixels wide and cropped to the middle half of its height, one below the other."""
    with tempfile.TemporaryDirectory() as temporary:
        frames = Path(temporary) / "frames"
        images = (folder / "first.jpg", folder / "second.jpg")
        job = InterpolationJob(images, folder / "poses.json", frames, frames=FRAMES, size=(width // 2, width))
        run_interpolation(plan_interpolation(job))
        rows = [read_panorama(path).image for path in sorted(frames.iterdir())]
    band = slice(width // 8, width * 3 // 8)
    line = np.ones((4, width, 3), np.float32)
    strip = folder / "strip.jpg"
    write_image(strip, np.concatenate([part for row in rows for part in (row[band], line)][:-1]))
    return strip


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    sys.stdout.write(f"{make_strip(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 1024)}\n")
