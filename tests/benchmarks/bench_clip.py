"""A whole clip against encoding alone: ``python tests/benchmarks/bench_clip.py [A B POSES]``.

Sixty frames of 2048×1024 from two panoramas (by default those of ``examples/street``), in one process and with one
peak of memory; then the very same frames, from memory, through the same encoder with the same settings.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import imageio_ffmpeg
import numpy as np

from omnisyn_cli.io import open_video

SIZE, FRAMES, FPS = (1024, 2048), 60, 30
STREET = Path(__file__).resolve().parents[2] / "examples" / "street"

MEASURED = """
import resource, sys
from omnisyn_cli.cli import main
try:
    main(sys.argv[1:])
finally:
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, file=sys.stderr)
"""


def interpolate(first: Path, second: Path, poses: Path, output: Path) -> tuple[float, float, dict[str, float]]:
    """Wall seconds of the command, its peak memory in GB, and the seconds of its stages."""
    size = f"{SIZE[1]}x{SIZE[0]}"
    command = [sys.executable, "-c", MEASURED, "interpolate", first, second, "--poses", poses, "-o", output]
    begin = time.perf_counter()
    done = subprocess.run(
        [*map(str, command), "--frames", str(FRAMES), "--fps", str(FPS), "--size", size, "--json", "--overwrite"],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    seconds = time.perf_counter() - begin
    return seconds, int(done.stderr.split()[-1]) * 1024 / 1e9, json.loads(done.stdout)["stages"]


def decode(video: Path) -> list[np.ndarray]:
    """All frames of a video."""
    options = ["-v", "error", "-i", str(video), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run([imageio_ffmpeg.get_ffmpeg_exe(), *options], check=True, capture_output=True).stdout
    return list(np.frombuffer(raw, np.uint8).reshape(-1, *SIZE, 3))


def encode(frames: list[np.ndarray], output: Path) -> float:
    """Seconds that the encoder alone takes."""
    begin = time.perf_counter()
    with open_video(output, size=SIZE, fps=FPS, overwrite=True) as sink:
        for frame in frames:
            sink.write(frame)
    return time.perf_counter() - begin


def main() -> None:
    """Print the two times, their ratio and the peak of memory."""
    given = [Path(argument) for argument in sys.argv[1:]]
    first, second, poses = given or (STREET / "first.jpg", STREET / "second.jpg", STREET / "poses.json")
    with tempfile.TemporaryDirectory() as folder:
        video, again = Path(folder) / "clip.mp4", Path(folder) / "again.mp4"
        interpolate(first, second, poses, video)  # kernels are compiled, files are in the cache
        frames = decode(video)
        clips, encodings = [], []
        for _ in range(3):
            encodings.append(encode(frames, again))
            clips.append(interpolate(first, second, poses, video))
    seconds, memory, stages = min(clips)
    print(f"{FRAMES} frames of {SIZE[1]}x{SIZE[0]}, command {seconds:.1f} s, encoder alone {min(encodings):.1f} s")
    print("stages:", ", ".join(f"{stage} {value:.1f} s" for stage, value in stages.items()))
    print(f"ratio {seconds / min(encodings):.2f}, peak memory {memory:.2f} GB")


if __name__ == "__main__":
    main()
