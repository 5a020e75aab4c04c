"""How close the frames come to the truth: ``python tests/benchmarks/bench_quality.py [FOLDER ...]``.

Every scene folder has a ``poses.json`` with five or so panoramas in walking order and their depth; the first and the
last are the inputs, those between are the truth. Without folders, streets and rooms are made (seeds 101 to 104).
Prints the mean WS-PSNR of the frames between for a cross-fade, for depth by matching and for the true depth.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from omnisyn_cli.evaluation.metrics import ws_psnr
from omnisyn_cli.interpolation.job import InterpolationJob
from omnisyn_cli.interpolation.plan import plan_interpolation
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.io import read_panorama
from omnisyn_cli.poses.file import read_poses

SEEDS = range(101, 105)
BASELINES = {"street": 3.0, "room": 1.0}
SIZE = "1024x512"


def make_scenes(folder: Path) -> list[Path]:
    """Streets and rooms of five frames each."""
    scenes = []
    for kind, baseline in BASELINES.items():
        for seed in SEEDS:
            scene = folder / f"{kind}_{seed}"
            options = ["--kind", kind, "--seed", seed, "--frames", 5, "--baseline", baseline, "--size", SIZE, "-q"]
            subprocess.run(
                [sys.executable, "-m", "omnisyn_cli", "scenes", "make", scene, *map(str, options)], check=True
            )
            scenes.append(scene)
    return scenes


def scores(scene: Path) -> dict[str, float]:
    """Mean WS-PSNR in dB of the frames between, by method."""
    names = list(read_poses(scene / "poses.json").panoramas)
    truths = [read_panorama(scene / name).image for name in names]
    shares = np.linspace(0, 1, len(names))
    fades = [(1 - t) * truths[0] + t * truths[-1] for t in shares]
    return {
        "cross-fade": mean_score(fades, truths),
        "matching": mean_score(interpolated(scene, names, "matching"), truths),
        "true depth": mean_score(interpolated(scene, names, "file"), truths),
    }


def interpolated(scene: Path, names: list[str], depth: str) -> list[np.ndarray]:
    """What ``omnisyn interpolate`` makes of the first and the last panorama at the places of all."""
    with tempfile.TemporaryDirectory() as temporary:
        frames = Path(temporary) / "frames"
        ends = (scene / names[0], scene / names[-1])
        job = InterpolationJob(ends, scene / "poses.json", frames, frames=len(names), depth=depth)
        run_interpolation(plan_interpolation(job))
        return [read_panorama(path).image for path in sorted(frames.iterdir())]


def mean_score(frames: list[np.ndarray], truths: list[np.ndarray]) -> float:
    """Mean WS-PSNR of all frames but the first and the last."""
    return float(np.mean([ws_psnr(a, b) for a, b in zip(frames[1:-1], truths[1:-1], strict=True)]))


def main() -> None:
    """Print a table."""
    with tempfile.TemporaryDirectory() as temporary:
        scenes = [Path(argument) for argument in sys.argv[1:]] or make_scenes(Path(temporary))
        table = {scene.name: scores(scene) for scene in scenes}
    methods = list(next(iter(table.values())))
    print(f"{'WS-PSNR in dB':16}" + "".join(f"{method:>12}" for method in methods))
    for name, row in table.items():
        print(f"{name:16}" + "".join(f"{row[method]:12.2f}" for method in methods), flush=True)
    print(f"{'mean':16}" + "".join(f"{np.mean([row[m] for row in table.values()]):12.2f}" for m in methods))


if __name__ == "__main__":
    main()
