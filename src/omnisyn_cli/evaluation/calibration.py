"""How fast this machine is, by one fixed piece of the program's own work.

One step sees two surfaces with a texture from in between and fuses them: the kernels that most of a video's time goes
to, on as many threads as the job has. What is compiled or loaded at the first call is not timed.
"""

import statistics
import time
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.render.renderer import MeshRenderer

SECONDS = 0.8
"""How long steps are repeated; with the last one that is below two seconds on any machine worth using."""

SIZE = (256, 512)
"""Of the surfaces and of the picture."""

BASELINE = 1.0


def calibrate(threads: int | None = None, seconds: float = SECONDS) -> float:
    """Seconds of one step: the median over as many as fit into ``seconds``, three at least.

    Args:
        threads: at most this many; None is one per core.
        seconds: how long to go on.
    """
    step = _step(threads)
    step()
    begin = time.perf_counter()
    marks = [begin]
    while len(marks) < 4 or marks[-1] - begin < seconds:
        step()
        marks.append(time.perf_counter())
    return statistics.median(after - before for before, after in pairwise(marks))


def _step(threads: int | None) -> Callable[[], None]:
    """The work: a ball of a room with a bump, seen from both ends of a way."""
    directions = pixel_directions(*SIZE)
    inverse_depth = np.asarray(0.3 + 0.2 * (directions[..., 1] < 0) + 0.3 * (directions[..., 0] > 0.8), np.float32)
    image = np.asarray(0.5 + 0.5 * np.sin(40 * directions), np.float32)
    renderers = [MeshRenderer(image, None, inverse_depth, None, SIZE, None, threads) for _ in range(2)]
    fuser = GeometricFuser(SIZE, threads=threads)
    poses = [Pose(np.eye(3), np.array([0.0, 0.0, side * BASELINE / 2])) for side in (-1, 1)]

    def work() -> None:
        first, second = (render(pose) for render, pose in zip(renderers, poses, strict=True))
        fuser(first, second, 0.5)

    return work
