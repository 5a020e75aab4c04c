"""A whole clip against encoding alone: ``python tests/benchmarks/bench_clip.py [A B POSES] [--size 4096x2048]``.

Ninety frames from two panoramas (by default those of ``examples/street``) by x264 veryfast, in one process and with one
peak of memory; then the very same frames, from memory, through the same encoder with the same settings; in turn, for
each preset. Two ratios: of the time on the clock, for a quiet machine, and of computing time, ffmpeg's included, which
other work on the machine changes less.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from omnisyn_cli.io import open_video
from omnisyn_cli.io.ffmpeg_process import read_frames

T = TypeVar("T")

FPS = 30
ENCODER = "veryfast"
ROUNDS = 2
STREET = Path(__file__).resolve().parents[2] / "examples" / "street"

MEASURED = """
import sys
from pathlib import Path
from omnisyn_cli.cli import main
try:
    main(sys.argv[1:])
finally:
    status = Path("/proc/self/status").read_text().splitlines()
    print(next(line for line in status if line.startswith("VmHWM")).split()[1], file=sys.stderr)
"""


Size = tuple[int, int]


def interpolate(inputs: list[Path], output: Path, size: Size, frames: int, preset: str) -> tuple[float, str]:
    """Peak memory of the command in GB, and what it says about itself in JSON."""
    first, second, poses = inputs
    command = [sys.executable, "-c", MEASURED, "interpolate", first, second, "--poses", poses, "-o", output]
    settings = ["--frames", frames, "--fps", FPS, "--size", f"{size[1]}x{size[0]}", "--preset", preset]
    done = subprocess.run(
        [*map(str, [*command, *settings, "--encoder-preset", ENCODER]), "--json", "--overwrite"],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    return int(done.stderr.split()[-1]) * 1024 / 1e9, done.stdout


def encode(frames: list[np.ndarray], output: Path, size: Size) -> None:
    """The same frames, from memory."""
    with open_video(output, size=size, fps=FPS, preset=ENCODER, overwrite=True) as sink:
        for frame in frames:
            sink.write(frame)


def timed(work: Callable[[], T]) -> tuple[float, float, T]:
    """Seconds on the clock, seconds of computing in this process and those that ended meanwhile, and the result."""
    clock, computing = time.perf_counter(), computed()
    result = work()
    return time.perf_counter() - clock, computed() - computing, result


def computed() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def compare(inputs: list[Path], size: Size, count: int, preset: str) -> None:
    """Print times, ratios and the peak of memory of one preset."""
    with tempfile.TemporaryDirectory() as folder:
        video, again = Path(folder) / "clip.mp4", Path(folder) / "again.mp4"
        interpolate(inputs, video, size, count, preset)  # kernels are compiled, files are in the cache
        frames = list(read_frames(video, size, count))
        clips, encodings = [], []
        for _ in range(ROUNDS):
            encodings.append(timed(lambda: encode(frames, again, size)))
            clips.append(timed(lambda: interpolate(inputs, video, size, count, preset)))
    wall, computing = (min(clip[k] for clip in clips) / min(encoding[k] for encoding in encodings) for k in (0, 1))
    memory, said = clips[0][2]
    print(
        f"{preset}: {count} frames of {size[1]}x{size[0]}, {wall:.2f} times the encoder's time, {computing:.2f} times"
    )
    print(f"  its computing; command {min(c[0] for c in clips):.1f} s, encoder {min(e[0] for e in encodings):.1f} s,")
    print(f"  peak memory {memory:.2f} GB; stages:", json.loads(said)["stages"], flush=True)


def main() -> None:
    """One comparison for each preset."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("inputs", type=Path, nargs="*", help="two panoramas and their poses")
    parser.add_argument("--size", default="4096x2048")
    parser.add_argument("--frames", type=int, default=90)
    parser.add_argument("--presets", nargs="*", default=["balanced", "fast"])
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    inputs = options.inputs or [STREET / name for name in ("first.jpg", "second.jpg", "poses.json")]
    for preset in options.presets:
        compare(inputs, (height, width), options.frames, preset)


if __name__ == "__main__":
    main()
