"""How soon a long tour shows, and the memory of a walk through it: ``python tests/benchmarks/bench_walk.py FOLDER``.

``FOLDER/walk`` is made once: panoramas of 4096×2048 along a snake with two short cuts, with known depth (``--count``,
100). A browser with WebGL in software opens it over 127.0.0.1 and visits every panorama. Printed are the milliseconds
until the first picture, of three openings, and megabytes: of graphics memory as the page counts it, of JavaScript, and
resident ones of the browser's processes. The renderer's grow by the answers that a browser keeps for whoever drives it.
"""

import argparse
import os
import re
import sys
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from playwright.sync_api import sync_playwright

sys.path.insert(0, str(Path(__file__).parents[1]))

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.interpolation.viewer.run import ViewJob, plan_view, run_view
from omnisyn_cli.io import write_depth
from omnisyn_cli.poses.file import PosedPanorama, write_poses
from viewer.browser import SOFTWARE_GL, WalkPage, launcher, serving

SIZE, DEPTH_SIZE, STEP_METRES = (2048, 4096), (512, 1024), 2.0
PICTURE = Path(__file__).parents[2] / "examples" / "street" / "first.jpg"
SIDE = 10
NO_CACHE = ("--disk-cache-size=1",)  # files that browsers keep are not memory of the walk
MEMORY = "[omnisyn.page.graphicsBytes, performance.memory.usedJSHeapSize].map((bytes) => Math.round(bytes / 1e6))"


def write_tour(folder: Path, count: int) -> Path:
    """The walk as a folder, made unless it is there."""
    if (folder / "walk").exists():
        return folder / "walk"
    folder.mkdir(parents=True, exist_ok=True)
    picture = cv2.resize(cv2.imread(str(PICTURE)), SIZE[::-1], interpolation=cv2.INTER_CUBIC)
    noise = np.random.default_rng(0).integers(-6, 7, picture.shape)
    picture = np.clip(picture + noise, 0, 255).astype(np.uint8)
    around, down = np.meshgrid(np.linspace(0, 2 * np.pi, DEPTH_SIZE[1]), np.linspace(0, np.pi, DEPTH_SIZE[0]))
    entries = {}
    for k in range(count):
        row, col = divmod(k, SIDE)
        col = col if row % 2 == 0 else SIDE - 1 - col
        name, depth = f"p{k:03d}.jpg", folder / f"p{k:03d}.exr"
        cv2.imwrite(str(folder / name), np.roll(picture, 41 * k, axis=1), [cv2.IMWRITE_JPEG_QUALITY, 92])
        write_depth(depth, (4 + np.sin(5 * around + k) * np.sin(down) + 0.8 * (around % 1 > 0.5)).astype(np.float32))
        position = np.array([STEP_METRES * col, 0.0, STEP_METRES * row])
        entries[name] = PosedPanorama(Pose(np.eye(3), position), depth)
    names = [*entries]
    links = [*pairwise(names), *((names[k], names[k + 11]) for k in (4, 24) if k + 11 < count)]
    write_poses(folder / "poses.json", entries, links=links)
    images = tuple(folder / name for name in names)
    run_view(
        plan_view(ViewJob(images, folder / "poses.json", folder / "walk", is_chain=False, is_folder=True, nadir=0.0))
    )
    return folder / "walk"


def resident() -> dict[str, int]:
    """Megabytes of the processes below this one, by their kind."""
    parents, found = {}, {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            after_name = (entry / "stat").read_text().rpartition(")")[2].split()
            parents[int(entry.name)] = int(after_name[1])
            command = (entry / "cmdline").read_bytes()
        except OSError:
            continue
        kind = "".join(re.findall(r"--type=([\w-]+)", command.decode(errors="replace"))[:1])
        found[int(entry.name)] = (kind, int(after_name[21]) * os.sysconf("SC_PAGE_SIZE") / 1e6)

    def is_below(process: int) -> bool:
        while process in parents:
            process = parents[process]
            if process == os.getpid():
                return True
        return False

    sums: dict[str, float] = {}
    for process, (kind, megabytes) in found.items():
        if is_below(process) and kind in ("renderer", "gpu-process"):
            sums[kind] = sums.get(kind, 0.0) + megabytes
    return {kind: round(megabytes) for kind, megabytes in sums.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition(":")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=100)
    options = parser.parse_args()
    walk = write_tour(options.folder, options.count)
    with sync_playwright() as driver, launcher(driver)(*SOFTWARE_GL, *NO_CACHE) as opened, serving(walk) as address:
        for _ in range(3):
            page = WalkPage(opened, address, viewport={"width": 960, "height": 540})
            page.until("globalThis.omnisyn?.page?.firstPicture !== undefined")
            print(f"first picture after {page.page.evaluate('omnisyn.page.firstPicture'):.0f} ms", flush=True)
            page.wait().page.context.close()
        page = WalkPage(opened, address, viewport={"width": 960, "height": 540}).wait()
        for k in range(options.count):
            page.page.evaluate(f"omnisyn.page.goTo({k}, {{ isSudden: true }})")
            page.until("omnisyn.page.world.isReady(omnisyn.page.walker.link) && omnisyn.page.world.pending.size === 0")
            if k % 10 in (0, 9):
                graphics, scripts = page.page.evaluate(MEMORY)
                print(f"panorama {k}: {graphics} MB graphics, {scripts} MB scripts, resident {resident()}", flush=True)
        print(f"errors: {page.errors}")


if __name__ == "__main__":
    main()
