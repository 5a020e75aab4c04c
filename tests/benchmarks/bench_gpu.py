"""Frames on a GPU against the processor's: ``python tests/benchmarks/bench_gpu.py [A B POSES] [--sizes 2048x1024]``.

The same frames of two panoramas (by default those of ``examples/street``), their depth found once, in two minutes. By
size and for the settings of two presets: how many of the pixels differ by at most 1/255; milliseconds a frame, in
samples of 8 bits, made as a video makes them; and what the kernels take when each is waited for. The table also goes to
``gpu.md`` in the folder that the environment names as OUT. Where there is no GPU this says so and ends.
"""

import argparse
import os
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from omnisyn_cli.errors import InputError
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.io import read_panorama
from omnisyn_cli.pipeline.config import DepthSource
from omnisyn_cli.pipeline.depth_sources import make_estimator
from omnisyn_cli.pipeline.fusions import FuserSettings, make_fuser
from omnisyn_cli.poses.file import read_poses
from omnisyn_cli.synthesis.device import has_device
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.trajectory import plan_path
from omnisyn_cli.types import KnownDepth, View

STREET = [
    Path(__file__).parents[2] / "examples" / "street" / name for name in ("first.jpg", "second.jpg", "poses.json")
]
SIZES = ["1024x512", "2048x1024", "4096x2048", "8192x4096"]
FRAMES = {"GPU": 24, "processor": 3}  # that are timed, besides one that is not
FUSIONS = {"fast": ("geometric", False), "balanced": ("network", True)}  # and whether edges are supersampled

Size = tuple[int, int]


def with_depth(first: Path, second: Path, poses: Path) -> list[View]:
    entries, views = read_poses(poses), []
    for path in (first, second):
        panorama = read_panorama(path)
        samples = panorama.original if panorama.original is not None and panorama.original.dtype == np.uint8 else None
        views.append(View(panorama.image, entries.of(path).pose, image_uint8=samples))
    depths = make_estimator(DepthSource("matching"), device="cpu")(views[0], views[1])
    return [View(v.image, v.pose, None, d, image_uint8=v.image_uint8) for v, d in zip(views, depths, strict=True)]


def timed_frames(
    method: SurfaceMethod, views: list[View], size: Size, count: int
) -> tuple[list[np.ndarray], float, float]:
    """Frames of the same places, whatever the count; seconds until the first is there, and of each of the others."""
    pair, poses, made = method.prepare(0, views), [view.pose for view in views], []
    path = plan_path(poses, FRAMES["GPU"] + 3)[1 : count + 2]
    begin = time.perf_counter()
    pair.frame(path[0], lambda: np.empty((*size, 3), np.uint8))
    first, begin = time.perf_counter() - begin, time.perf_counter()
    made.extend(frame.image for frame in pair.frames(path[1:], lambda: np.empty((*size, 3), np.uint8)))
    return made, first, (time.perf_counter() - begin) / count


def kernel_times(device: Any, method: SurfaceMethod, views: list[View], size: Size) -> str:
    """Milliseconds of each kernel in a frame, with its launch."""
    from omnisyn_cli.synthesis.device import frames

    spent, launch = Counter(), frames.launch

    def timed(kernel: Any, count: int | None, stream: Any, *arguments: Any) -> None:
        stream.synchronize()
        begin = time.perf_counter()
        launch(kernel, count, stream, *arguments)
        stream.synchronize()
        spent[kernel.__name__] += 1000 * (time.perf_counter() - begin)

    pair, path = method.prepare(0, views), plan_path([view.pose for view in views], 4)[1:-1]
    for measured, waypoint in zip((launch, timed), path, strict=True):
        frames.launch = measured
        pair.frame(waypoint, lambda: np.empty((*size, 3), np.uint8))
    frames.launch = launch
    return ", ".join(f"{name} {took:.2f}" for name, took in spent.most_common())


def compare(views: list[View], size: Size, preset: str) -> str:
    """A row of the table. RuntimeError: the GPU failed."""
    from omnisyn_cli.synthesis.device.frames import DeviceFrames

    (fusion, edges), options = FUSIONS[preset], SynthesisOptions(size)
    fuser = make_fuser(fusion, FuserSettings(size, edges=edges), device="auto")
    assert isinstance(fuser, GeometricFuser)
    device = DeviceFrames(options, fuser)
    on_gpu, on_processor = (SurfaceMethod(KnownDepth(), options, fuser, device=used) for used in (device, None))
    found, first, fast = timed_frames(on_gpu, views, size, FRAMES["GPU"])
    if device.failure is not None:
        raise RuntimeError(device.failure)
    expected, _, slow = timed_frames(on_processor, views, size, FRAMES["processor"])
    pairs = zip(found, expected, strict=False)
    within = min(float((np.abs(one.astype(np.int16) - other) <= 1).all(axis=-1).mean()) for one, other in pairs)
    kernels = kernel_times(device, on_gpu, views, size)
    share = f"{100 * within:.3f} %" + ("" if within >= 0.999 else " **(too few)**")
    times = f"{1000 * fast:.1f} | {1000 * slow:.1f} | {first:.1f} | {kernels}"
    return f"| {size[1]}x{size[0]} | {preset} | {share} | {times} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("inputs", nargs="*", type=Path, default=STREET, help="two panoramas and their poses")
    parser.add_argument("--sizes", nargs="+", default=SIZES)
    parser.add_argument("--presets", nargs="+", default=list(FUSIONS), choices=FUSIONS)
    given = parser.parse_args()
    try:
        has_device("cuda")
    except InputError as error:
        print(f"{error}: nothing to compare")
        return
    lines = [
        "| frame | preset | within 1/255 | GPU, ms | processor, ms | first frame, s | kernels, ms |",
        "|---|---|---|---|---|---|---|",
    ]
    print("\n".join(lines))
    views = with_depth(*given.inputs)
    for size in given.sizes:
        width, height = map(int, size.split("x"))
        for preset in given.presets:
            lines.append(compare(views, (height, width), preset))
            print(lines[-1], flush=True)
    if "OUT" in os.environ:
        (Path(os.environ["OUT"]) / "gpu.md").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
