"""How time and memory grow with the frames: ``python tests/benchmarks/bench_scaling.py [A B POSES] [--plot FILE]``.

Clips of 1024×512 to 8192×4096 from two panoramas (by default those of ``examples/street``), each made twice, with a few
and with some more frames: the difference is what a frame takes, start and depth left out. Computing time of program and
encoder together, so that other work on the machine counts little; peak memory of the program, and what ``--dry-run``
says about it. Then the time that frames take on one and on two threads, both views rendered and fused as the program
does it, and that of arithmetic without memory, in turn, on the clock: no program scales better than the second.
"""

import argparse
import json
import math
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from bench_clip import STREET, interpolate

from omnisyn_cli.compute.jit import kernel
from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.trajectory import plan_path
from omnisyn_cli.types import DepthEstimate, KnownDepth, View

WIDTHS = (1024, 2048, 4096, 8192)
FEW = 4  # Frames; two of them are the photographs.
# By so many pixels the second clip of a size is longer: frames of the smallest size are few milliseconds each.
MORE_PIXELS = 2**27
LEAST_MORE = 12  # Frames by which it is longer at least.
ROOTS = 100_000  # Numbers summed for each of the thousand rows of arithmetic.


@dataclass(frozen=True)
class Scale:
    width: int
    seconds: float
    memory: tuple[int, int]
    planned: int
    more: int

    @property
    def megapixels(self) -> float:
        return self.width * self.width / 2e6


def clip(inputs: list[Path], width: int, frames: int, *options: str) -> tuple[float, int, str]:
    """Computing seconds, peak memory and what was printed."""
    with tempfile.TemporaryDirectory() as folder:
        return interpolate(inputs, Path(folder) / "clip.mp4", (width // 2, width), frames, *options)


def scale_of(inputs: list[Path], width: int) -> Scale:
    longer = max(LEAST_MORE, MORE_PIXELS // (width * width // 2))
    few, more = (clip(inputs, width, frames) for frames in (FEW, FEW + longer))
    plan = json.loads(clip(inputs, width, FEW, "--dry-run")[2])
    seconds = (more[0] - few[0]) / longer
    return Scale(width, seconds, (few[1], more[1]), plan["memory_mib"] * 2**20, FEW + longer)


def frames(threads: int, width: int = 4096) -> Callable[[], object]:
    """Makes four frames between two panoramas of a room with a bump, as a video does: a thread for each."""
    directions, size = pixel_directions(256, 512), (width // 2, width)
    inverse_depth = np.asarray(0.3 + 0.2 * (directions[..., 1] < 0) + 0.3 * (directions[..., 0] > 0.8), np.float32)
    samples = np.random.default_rng(0).integers(0, 256, (*size, 3), np.uint8)
    depth, image = DepthEstimate(inverse_depth, np.ones_like(inverse_depth)), samples.astype(np.float32) / 255.0
    poses = [Pose(np.eye(3), np.array([side * 0.1, 0.0, side * 0.4])) for side in (1.0, -1.0)]
    views = [View(image, pose, known_depth=depth, image_uint8=samples) for pose in poses]
    pair = SurfaceMethod(KnownDepth(), SynthesisOptions(size, threads=threads)).prepare(0, views)
    path = plan_path(poses, 6)[1:-1]
    return lambda: list(pair.frames(path, lambda: np.empty((*size, 3), np.uint8)))


@kernel()  # type: ignore[untyped-decorator]
def sum_of_roots(begin: int, end: int) -> float:
    """Takes a while, and no memory."""
    total = 0.0
    for number in range(ROOTS * begin, ROOTS * end):
        total += math.sqrt(number)
    return total


def speed_up(rounds: int = 7) -> tuple[float, float]:
    """Wall time on one thread divided by that on two: of a frame, and of arithmetic; in turn, the best of each."""
    works = [frames(1), frames(2), *(partial(run_ranges, sum_of_roots, 1000, threads) for threads in (1, 2))]
    best = [float("inf")] * len(works)
    for number in range(rounds + 1):
        for index, work in enumerate(works):
            begin = time.perf_counter()
            work()
            if number:
                best[index] = min(best[index], time.perf_counter() - begin)
    return best[0] / best[1], best[2] / best[3]


def plot(scales: Sequence[Scale], path: Path) -> None:
    """Seconds and memory against pixels, both axes logarithmic, with the line of proportion."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.6), dpi=110, layout="constrained")
    time_axes, memory_axes = figure.subplots(1, 2)
    pixels = np.array([scale.megapixels for scale in scales])
    seconds = np.array([scale.seconds for scale in scales])
    time_axes.plot(pixels, seconds[-1] * pixels / pixels[-1], color="0.7", linestyle="--", label="in proportion")
    time_axes.plot(pixels, seconds, marker="o", color="#0072b2", label="measured")
    time_axes.set_ylabel("Seconds of computing for each frame")
    for k, (frames, marker) in enumerate(((f"{FEW} frames", "o"), ("more frames", "x"))):
        memory = [scale.memory[k] / 1e9 for scale in scales]
        memory_axes.plot(pixels, memory, marker=marker, label=f"{frames}, measured")
    memory_axes.plot(pixels, [scale.planned / 1e9 for scale in scales], color="0.7", linestyle="--", label="--dry-run")
    memory_axes.set_ylabel("Peak memory, GB")
    time_axes.set_yscale("log")
    for axes in (time_axes, memory_axes):
        axes.set_xscale("log")
        axes.set_xticks(pixels, [f"{scale.width}×{scale.width // 2}" for scale in scales], fontsize="small")
        axes.minorticks_off()
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False)
    figure.savefig(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("inputs", type=Path, nargs="*", default=STREET, help="two panoramas and their poses")
    parser.add_argument("--widths", type=int, nargs="*", default=WIDTHS)
    parser.add_argument("--plot", type=Path, help="write the diagram, such as docs/scaling.png")
    options = parser.parse_args()
    print(f"{'size':>12}{'s/frame':>10}{'s/Mpixel':>10}{'GB, few':>9}{'frames':>8}{'GB, more':>10}{'planned':>9}")
    scales = []
    for width in options.widths:
        scale = scale_of(options.inputs, width)
        scales.append(scale)
        few, more, planned = (value / 1e9 for value in (*scale.memory, scale.planned))
        name, per_pixel = f"{width}x{width // 2}", scale.seconds / scale.megapixels
        print(f"{name:>12}{scale.seconds:10.2f}{per_pixel:10.3f}{few:9.2f}", end="")
        print(f"{scale.more:8}{more:10.2f}{planned:9.2f}", flush=True)
    if options.plot is not None:
        plot(scales, options.plot)
    frame, arithmetic = speed_up()
    print(f"frames of 4096x2048 on two threads: {frame:.2f} times as fast as on one; arithmetic: {arithmetic:.2f}")


if __name__ == "__main__":
    main()
