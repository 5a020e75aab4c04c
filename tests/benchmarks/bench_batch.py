"""A batch on several workers against one pair after another: ``python tests/benchmarks/bench_batch.py [OPTIONS]``.

Makes streets, ``--pairs`` pairs of neighbouring panoramas in them (512×256 by default), and one manifest; does the
manifest with one worker and with ``--workers``, one thread each, from start to end of the command, and compares the
bytes. With ``--size 2048x1024 --frames 30 --workers 1`` it prints what docs/batch.md says a pair and a frame cost.
With ``--kills 3`` the manifest is done a last time while workers are killed at random moments, and the command once,
after which it is started again (Linux).
"""

import argparse
import json
import os
import signal
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
from omnisyn_cli.io import write_image
from omnisyn_cli.poses.file import PosedPanorama, write_poses
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path

STOPS = 5  # Panoramas of a scene; each pair is two neighbours among them.


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


def command(manifest: Path, output: Path, workers: int) -> list[str]:
    words = [sys.executable, "-m", "omnisyn_cli", "batch", manifest, "-o", output, "-q",
             "--workers", workers, "--threads", 1]  # fmt: skip
    return [str(word) for word in words]


def run(manifest: Path, output: Path, workers: int) -> float:
    begin = time.perf_counter()
    subprocess.run(command(manifest, output, workers), check=True)
    return time.perf_counter() - begin


def recorded(output: Path) -> list[str]:
    """Jobs that have a whole line in the records."""
    path = output / "results.jsonl"
    lines = path.read_text().split("\n")[:-1] if path.exists() else []
    return [json.loads(line)["id"] for line in lines]


def workers_of(pid: int) -> list[int]:
    tasks = Path(f"/proc/{pid}/task").iterdir()
    children = [int(child) for task in tasks for child in (task / "children").read_text().split()]
    return [child for child in children if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()]


def run_killing(
    manifest: Path, output: Path, workers: int, jobs: int, kills: int, chance: np.random.Generator
) -> list[str]:
    """Do a batch whose workers are killed ``kills`` times (-9), and the command once; what was killed when."""
    moments = np.sort(chance.uniform(0.05, 0.9, kills + 1)) * jobs
    last = chance.integers(kills + 1)
    process = subprocess.Popen(command(manifest, output, workers))
    story = []
    for number, moment in enumerate(moments):
        while process.poll() is None and (len(recorded(output)) < moment or not workers_of(process.pid)):
            time.sleep(0.05)
        time.sleep(chance.uniform(0, 2))
        done = len(recorded(output))
        if number == last:
            process.kill()
            process.wait()
            process = subprocess.Popen(command(manifest, output, workers))
            story.append(f"the command after {done} jobs")
        else:
            os.kill(chance.choice(workers_of(process.pid)), signal.SIGKILL)
            story.append(f"a worker after {done} jobs")
    if process.wait() != 0:
        raise SystemExit(f"the batch ended with exit code {process.returncode}")
    return story


def stages(output: Path) -> tuple[Counter[str], int, int]:
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


def compare(first: Path, second: Path) -> str:
    """Whether two batches have made the same videos, and left nothing else."""
    made = [{file.name: file for file in folder.iterdir() if file.suffix != ".jsonl"} for folder in (first, second)]
    same = made[0].keys() == made[1].keys() and all(
        file.read_bytes() == made[1][name].read_bytes() for name, file in made[0].items()
    )
    return f"{len(made[1])} files, {'same' if same else 'DIFFERENT'} bytes"


def main() -> None:
    """Print the costs, the ratio of the times, and what became of the batch whose processes were killed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=200)
    parser.add_argument("--size", default="512x256", help="of panoramas and videos")
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--kills", type=int, default=0, help="how often a worker is killed; the command is killed once")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    given = parser.parse_args()
    options = {"encoder_preset": "medium"}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        height = int(given.size.partition("x")[2])
        warm = make_manifest(folder, 1, height, 2, options)
        run(warm, folder / "warm", 1)  # kernels are compiled
        manifest = make_manifest(folder, given.pairs, height, given.frames, options)
        calm = folder / "alone"
        alone = run(manifest, calm, 1)
        print_costs(calm, alone)
        if given.workers > 1:
            together = run(manifest, folder / "together", given.workers)
            verdict = compare(calm, folder / "together")
            print(f"{given.workers} workers: {together:.1f} s, {alone / together:.2f} times as fast, {verdict}")
        if given.kills:
            wild, chance = folder / "wild", np.random.default_rng(given.seed)
            story = run_killing(manifest, wild, given.workers, given.pairs, given.kills, chance)
            print(f"killed: {', '.join(story)}; {compare(calm, wild)}")
            print(f"{len(recorded(wild))} jobs done, {len(set(recorded(wild)))} different ones")


if __name__ == "__main__":
    main()
