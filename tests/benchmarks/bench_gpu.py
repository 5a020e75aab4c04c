"""Frames on a GPU against the processor's: ``python tests/benchmarks/bench_gpu.py [A B POSES] [--sizes 2048x1024]``.

The same frames of the same two panoramas (by default those of ``examples/street``), their depth found once, made by
either in turn: milliseconds per frame without the first one, copied to the host and rounded to 8 bits; how many of the
pixels differ by at most 1/255; and the most memory that torch took on the GPU. Where torch sees no GPU this says so and
ends. ``--device cpu`` shows what the code for devices does on a processor, which it was not written for.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

from omnisyn_cli.compute.threads import run_ranges
from omnisyn_cli.fusion.blend_kernels import quantize_rows
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.io import read_panorama
from omnisyn_cli.pipeline.config import DepthSource
from omnisyn_cli.pipeline.depth_sources import make_estimator
from omnisyn_cli.poses.file import read_poses
from omnisyn_cli.synthesis.device.pair import GpuFrames
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.trajectory import plan_path
from omnisyn_cli.types import KnownDepth, View

STREET = Path(__file__).resolve().parents[2] / "examples" / "street"
SIZES = ["1024x512", "2048x1024", "4096x2048", "8192x4096"]
ROUNDS = 2

Size = tuple[int, int]


def with_depth(first: Path, second: Path, poses: Path) -> tuple[View, View]:
    """Both panoramas, with depth by matching."""
    entries = read_poses(poses)
    views = []
    for path in (first, second):
        panorama = read_panorama(path)
        samples = panorama.original if panorama.original is not None and panorama.original.dtype == np.uint8 else None
        views.append(View(panorama.image, entries.of(path).pose, image_uint8=samples))
    depths = make_estimator(DepthSource("matching"), device="cpu")(*views)
    known = [View(v.image, v.pose, None, d, image_uint8=v.image_uint8) for v, d in zip(views, depths, strict=True)]
    return known[0], known[1]


def frames(
    views: tuple[View, View], size: Size, count: int, device: GpuFrames | None
) -> Iterator[tuple[float, np.ndarray]]:
    """Seconds that each frame between the panoramas took, and its samples."""
    memory = np.empty((*size, 3), np.uint8)
    path = plan_path([view.pose for view in views], count + 2)[1:-1]
    fuser = GeometricFuser(size, edges=False)  # which a GPU does not sample more than once
    pair = SurfaceMethod(KnownDepth(), SynthesisOptions(size), fuser, device=device).prepare(0, views)
    for waypoint in path:
        begin = time.perf_counter()
        image = pair.frame(waypoint, lambda: memory).image
        samples = image if image.dtype == np.uint8 else rounded(image)
        yield time.perf_counter() - begin, samples


def rounded(image: np.ndarray) -> np.ndarray:
    """Small frames of the processor are numbers."""
    samples = np.empty(image.shape, np.uint8)
    run_ranges(lambda begin, end: quantize_rows(image, np.float32(255), samples, begin, end), len(samples))
    return samples


def compare(views: tuple[View, View], size: Size, count: int, device: str) -> str:
    """A row of the table."""
    seconds: dict[str, list[float]] = {"processor": [], device: []}
    shares = []
    for _ in range(ROUNDS):
        expected = frames(views, size, count, None)
        found = frames(views, size, count, GpuFrames(size, device))
        for number, ((one, slow), (other, fast)) in enumerate(zip(expected, found, strict=True)):
            shares.append((np.abs(slow.astype(np.int16) - fast) <= 1).all(axis=-1).mean())
            if number > 0:
                seconds["processor"].append(one)
                seconds[device].append(other)
    one, other = (1000 * float(np.median(found)) for found in seconds.values())
    memory = f"{torch.cuda.max_memory_allocated() / 1e9:.2f} GB" if device == "cuda" else "-"
    share = 100 * float(np.min(shares))
    return f"{size[1]}x{size[0]:<6} {one:9.1f} ms {other:9.1f} ms {one / other:7.2f} {share:10.3f} % {memory:>9}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("inputs", nargs="*", type=Path, metavar="A B POSES")
    parser.add_argument("--sizes", nargs="+", default=SIZES)
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--device", choices=["cuda", "cpu"], default="cuda")
    given = parser.parse_args()
    if given.device == "cuda" and not torch.cuda.is_available():
        print(f"torch {torch.__version__} sees no GPU: nothing to compare")
        return
    views = with_depth(*(given.inputs or [STREET / name for name in ("first.jpg", "second.jpg", "poses.json")]))
    print(torch.cuda.get_device_name() if given.device == "cuda" else "the processor as the device")
    print("size          processor       device   ratio  within 1/255   memory")
    for size in given.sizes:
        width, height = map(int, size.split("x"))
        print(compare(views, (height, width), given.frames, given.device), flush=True)


if __name__ == "__main__":
    main()
