"""A batch on several workers against one pair after another: ``python tests/benchmarks/bench_batch.py [OPTIONS]``.

Makes streets, ``--pairs`` pairs of neighbouring panoramas in them (512×256 by default), and one manifest; does the
manifest with one worker and with ``--workers``, one thread each, from start to end of the command, and compares the
bytes. With ``--size 2048x1024 --frames 30 --workers 1`` it prints what docs/batch.md says a pair and a frame cost.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.io import PosedPanorama, write_image, write_poses
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path

STOPS = 5
"""Panoramas of a scene; each pair is two neighbours among them."""


def make_manifest(folder: Path, pairs: int, height: int, frames: int, options: Mapping[str, Any]) -> Path:
    """Panoramas along procedural streets and a job for each two neighbours; lengths differ by a third, as in tours."""
    neighbours = []
    entries = {}
    for seed in range(101, 101 + -(-pairs // (STOPS - 1))):
        scene = generate_scene("street", seed)
        poses: Sequence[Pose] = sample_path(scene, seed, STOPS)
        names = [f"p{seed}-{stop}.jpg" for stop in range(STOPS)]
        for panorama, pose in zip(names, poses, strict=True):
            image, _ = render_panorama(scene, pose, (height, 2 * height))
            write_image(folder / panorama, np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8))
            entries[panorama] = PosedPanorama(pose)
        neighbours += list(pairwise(names))
    write_poses(folder / "poses.json", entries)
    with (folder / "jobs.jsonl").open("w") as file:
        for number, pair in enumerate(neighbours[:pairs]):
            job = {"id": f"job-{number:04d}", "inputs": pair, "poses": "poses.json",
                   "frames": frames + number % (frames // 3 + 1), **options}  # fmt: skip
            file.write(json.dumps(job) + "\n")
    return folder / "jobs.jsonl"


def run(manifest: Path, output: Path, workers: int) -> float:
    """Wall seconds of the command."""
    command = [sys.executable, "-m", "omnisyn_cli", "batch", manifest, "-o", output, "-q",
               "--workers", workers, "--threads", 1]  # fmt: skip
    begin = time.perf_counter()
    subprocess.run([str(word) for word in command], check=True, env=os.environ)
    return time.perf_counter() - begin


def stages(output: Path) -> tuple[Counter[str], int, int]:
    """Seconds by stage, frames and jobs of a batch."""
    seconds: Counter[str] = Counter()
    frames = jobs = 0
    for line in (output / "results.jsonl").read_text().splitlines():
        record = json.loads(line)
        seconds.update(record["summary"]["stages"])
        frames += record["summary"]["frames"]
        jobs += 1
    return seconds, frames, jobs


def print_costs(output: Path, seconds: float) -> None:
    """What a pair and a frame cost one worker: depth and surfaces once a pair, everything else once a frame."""
    by_stage, frames, jobs = stages(output)
    once = by_stage["decode"] + by_stage["depth"] + by_stage["mesh"]
    print(f"one worker: {seconds:.1f} s, {seconds / jobs:.2f} s per pair of {frames / jobs:.0f} frames")
    print(f"  once a pair {once / jobs:.2f} s, each frame {(by_stage['total'] - once) / frames * 1000:.0f} ms")
    print("  " + ", ".join(f"{stage} {value / jobs:.2f} s" for stage, value in by_stage.items()) + " per pair")


def same_bytes(first: Path, second: Path) -> bool:
    """Whether two batches have made the same videos."""
    names = sorted(file.name for file in first.glob("*.mp4"))
    return names == sorted(file.name for file in second.glob("*.mp4")) and all(
        (first / name).read_bytes() == (second / name).read_bytes() for name in names
    )


def main() -> None:
    """Print the costs, and the ratio of the times."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=200)
    parser.add_argument("--size", default="512x256", help="of panoramas and videos")
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    options = {"encoder_preset": "medium"}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        height = int(given.size.partition("x")[2])
        warm = make_manifest(folder, 1, height, 2, options)
        run(warm, folder / "warm", 1)  # kernels are compiled
        manifest = make_manifest(folder, given.pairs, height, given.frames, options)
        alone = run(manifest, folder / "alone", 1)
        print_costs(folder / "alone", alone)
        if given.workers > 1:
            together = run(manifest, folder / "together", given.workers)
            verdict = "same bytes" if same_bytes(folder / "alone", folder / "together") else "DIFFERENT BYTES"
            print(f"{given.workers} workers: {together:.1f} s, {alone / together:.2f} times as fast, {verdict}")


if __name__ == "__main__":
    main()
