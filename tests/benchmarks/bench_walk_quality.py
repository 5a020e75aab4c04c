"""How far a walk is from the truth half way, and the video: ``python tests/benchmarks/bench_walk_quality.py FOLDER``.

Generated scenes with three panoramas are made in ``FOLDER``. A video and a page are made of the outer two, from one
depth; a browser captures six faces of the page at the place of the middle one. Printed are decibels (WS-PSNR) against
the middle panorama: of a page by rules alone, of the page, then of a video by these rules, with edges, and as usual.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from playwright.sync_api import sync_playwright

sys.path.insert(0, str(Path(__file__).parents[1]))

from omnisyn_cli.evaluation.scene_files import write_scene
from omnisyn_cli.interpolation.job import InterpolationJob
from omnisyn_cli.interpolation.plan import plan_interpolation
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.io import read_panorama
from omnisyn_cli.scenes import generate_scene, sample_path
from synthesis_samples import ws_psnr
from viewer.browser import SOFTWARE_GL, Launch, WalkPage, launcher

SIZE = (512, 1024)
NAMES = ("0000.png", "0001.png", "0002.png")
# Changes of the config.
STEPS = {"rules": {"fusion": "geometric", "edges": False}, "edges": {"fusion": "geometric"}, "video": {}}


def made(folder: Path, preset: str) -> dict[str, np.ndarray]:
    """The middle frame of every video; beside the first and the last one a page."""
    ends = (folder / NAMES[0], folder / NAMES[2])
    frames = {}
    for step, changes in STEPS.items():
        frame = folder / preset / step
        frame.mkdir(parents=True, exist_ok=True)
        view = None if step == "edges" else frame / "walk.html"
        job = InterpolationJob(ends, folder / "poses.json", frame, preset=preset, frames=3, overwrite=True, view=view)
        plan = plan_interpolation(job)
        run_interpolation(replace(plan, config=replace(plan.config, **changes)))
        frames[step] = read_panorama(frame / "000001.png").image
    return frames


def judged(folder: Path, preset: str, launch: Launch) -> list[float]:
    """Decibels of both pages and of every video."""
    frames, truth = made(folder, preset), read_panorama(folder / NAMES[1]).image
    pose = plan_interpolation(
        InterpolationJob((folder / NAMES[0], folder / NAMES[1]), folder / "poses.json", folder / "unused", frames=2)
    ).entries[1].pose  # fmt: skip
    with launch(*SOFTWARE_GL) as opened:
        pages = [
            WalkPage(opened, folder / preset / step / "walk.html").wait().unfolded(pose, SIZE)
            for step in ("rules", "video")
        ]
    return [ws_psnr(picture, truth) for picture in (*pages, *frames.values())]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition(":")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--preset", default="balanced")
    parser.add_argument("--kinds", nargs="+", default=["street", "room", "home"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[902])
    options = parser.parse_args()
    print("dB: page by rules, page, " + ", ".join(STEPS))
    found = []
    with sync_playwright() as driver:
        launch = launcher(driver)
        for kind in options.kinds:
            for seed in options.seeds:
                folder = options.folder / f"{kind}-{seed}"
                if not folder.exists():
                    folder.mkdir(parents=True)
                    scene = generate_scene(kind, seed)
                    write_scene(folder, scene, sample_path(scene, seed, 3), NAMES, SIZE, 3, with_depth=False)
                found.append(judged(folder, options.preset, launch))
                print(f"{folder.name}: " + ", ".join(f"{decibels:.2f}" for decibels in found[-1]), flush=True)
    print("mean: " + ", ".join(f"{decibels:.2f}" for decibels in np.mean(found, axis=0)))


if __name__ == "__main__":
    main()
