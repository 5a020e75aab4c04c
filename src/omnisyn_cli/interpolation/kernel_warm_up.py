"""On the first run after an installation a second process compiles the kernels that draw, while depth is found.

It makes a video of two tiny panoramas whose depth is known with this very program, so that nothing here has to know
which kernels there are. Machine code is kept on disk; who comes to a kernel later finds it there.
"""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from omnisyn_cli.compute.jit import is_on_disk
from omnisyn_cli.compute.processes import safe_path
from omnisyn_cli.compute.threads import available_threads
from omnisyn_cli.errors import OmnisynError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.io import write_depth, write_image
from omnisyn_cli.io.outputs import scratch_folder
from omnisyn_cli.poses.file import POSES_NAME, PosedPanorama, write_poses
from omnisyn_cli.render.raster_kernels import rasterize_blocks

# Rows and columns of its panoramas: enough for every stage, the fusion network too; next to nothing to compute.
TINY_SIZE = (64, 128)

# The library starts no further process. Two threads have the kernels that one alone can do without. Simplified meshes
# (``adaptive``) are left to the first process, which comes to them early: it would be waited for.
TINY_VIDEO = """
import sys
from pathlib import Path
from omnisyn_cli import interpolate
folder = Path(sys.argv[1])
pictures = [folder / "0.png", folder / "1.png"]
options = {"fusion": "network", "fallback": "none", "adaptive": False, "frames": 3, "threads": 2}
interpolate(pictures, folder / sys.argv[2], folder / "video.mp4", **options)
"""


@contextmanager
def compiling_beside(threads: int | None) -> Iterator[None]:
    """Inside, another process compiles what this one needs later, if nothing is on disk and there is a core for it."""
    if is_on_disk(rasterize_blocks) or min(threads or available_threads(), available_threads()) < 2:
        yield
        return
    with scratch_folder() as folder:
        try:
            process = _tiny_video(folder)
        except (OSError, OmnisynError):  # no memory or no room: this process compiles everything itself
            process = None
        try:
            yield
        finally:
            if process is not None:
                process.kill()
                process.wait()


def _tiny_video(folder: Path) -> subprocess.Popen[bytes]:
    """Start making a video in a folder."""
    rows, columns = np.indices(TINY_SIZE)
    surface = columns // 16
    # A colour for each surface: where these do not match, exposures seem different, and colours are of another type.
    picture = np.stack([100 + 60 * (surface % 2) + (rows + columns) % 8] * 3, axis=-1).astype(np.uint8)
    entries = {}
    for index in range(2):
        write_image(folder / f"{index}.png", picture)
        write_depth(folder / f"{index}.exr", (2.0 + surface).astype(np.float32))
        pose = Pose(np.eye(3), np.array([0.0, 0.0, -0.3 * index]))
        entries[f"{index}.png"] = PosedPanorama(pose, folder / f"{index}.exr")
    write_poses(folder / POSES_NAME, entries)
    with safe_path():
        return subprocess.Popen(  # noqa: S603 - this program
            [sys.executable, "-c", TINY_VIDEO, str(folder), POSES_NAME],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
