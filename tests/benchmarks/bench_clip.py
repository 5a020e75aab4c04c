"""A whole clip against encoding alone: ``python tests/benchmarks/bench_clip.py [A B POSES] [--size 4096x2048]``.

Ninety frames from two panoramas (by default those of ``examples/street``) by x264 veryfast, in one process and with one
peak of memory; then the very same frames, from memory, through the same encoder with the same settings; in turn, for
each preset. Two ratios: of the time on the clock, for a quiet machine, and of computing time, ffmpeg's included, which
other work on the machine changes less.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from omnisyn_cli.evaluation.bench_settings import computing
from omnisyn_cli.io import open_video
from omnisyn_cli.io.ffmpeg_process import read_frames

T = TypeVar("T")
FPS = 30
ENCODER = "veryfast"
ROUNDS = 2
STREET = [
    Path(__file__).parents[2] / "examples" / "street" / name for name in ("first.jpg", "second.jpg", "poses.json")
]
MEASURED = """
import resource, sys
from pathlib import Path
from omnisyn_cli.cli import main
try:
    main(sys.argv[1:])
finally:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    peak = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
    print(sum(u.ru_utime + u.ru_stime for u in used), int(peak.split()[1]) * 1024, file=sys.stderr)
"""
Size = tuple[int, int]


def interpolate(inputs: list[Path], output: Path, size: Size, frames: int, *options: str) -> tuple[float, int, str]:
    """Computing seconds and peak memory of the command, and what it says about itself in JSON."""
    first, second, poses = inputs
    command = [sys.executable, "-c", MEASURED, "interpolate", first, second, "--poses", poses, "-o", output]
    settings = ["--frames", frames, "--size", f"{size[1]}x{size[0]}", "--encoder-preset", ENCODER, *options]
    words = [str(word) for word in (*command, *settings, "--json", "--overwrite")]
    done = subprocess.run(words, check=True, capture_output=True, text=True)
    seconds, memory = done.stderr.split()[-2:]
    return float(seconds), int(memory), done.stdout


def encode(frames: list[np.ndarray], output: Path, size: Size) -> None:
    """The same frames, from memory."""
    with open_video(output, size=size, fps=FPS, preset=ENCODER, overwrite=True) as sink:
        for frame in frames:
            sink.write(frame)


def timed(work: Callable[[], T]) -> tuple[float, float, T]:
    """Seconds on the clock, seconds of computing in this process and those that ended meanwhile, and the result."""
    clock, before = time.perf_counter(), computing()
    result = work()
    return time.perf_counter() - clock, computing() - before, result


def compare(inputs: list[Path], size: Size, count: int, preset: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        video, again = Path(folder) / "clip.mp4", Path(folder) / "again.mp4"
        options = ("--fps", str(FPS), "--preset", preset)
        interpolate(inputs, video, size, count, *options)  # kernels are compiled, files are in the cache
        frames = list(read_frames(video, size, count))
        clips, encodings = [], []
        for _ in range(ROUNDS):
            encodings.append(timed(lambda: encode(frames, again, size)))
            clips.append(timed(lambda: interpolate(inputs, video, size, count, *options)))
    wall, own = (min(clip[k] for clip in clips) / min(encoding[k] for encoding in encodings) for k in (0, 1))
    _, memory, said = clips[0][2]
    print(f"{preset}: {count} frames of {size[1]}x{size[0]}, {wall:.2f} times the encoder's time, {own:.2f} times")
    print(f"  its computing; command {min(c[0] for c in clips):.1f} s, encoder {min(e[0] for e in encodings):.1f} s,")
    print(f"  peak memory {memory / 1e9:.2f} GB; stages:", json.loads(said)["stages"], flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("inputs", type=Path, nargs="*", default=STREET, help="two panoramas and their poses")
    parser.add_argument("--size", default="4096x2048")
    parser.add_argument("--frames", type=int, default=90)
    parser.add_argument("--presets", nargs="*", default=["balanced", "fast"])
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    for preset in options.presets:
        compare(options.inputs, (height, width), options.frames, preset)


if __name__ == "__main__":
    main()
