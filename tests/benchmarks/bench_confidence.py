"""Whether the score ranks clips as the truth does: ``python tests/benchmarks/bench_confidence.py [FOLDER ...]``.

Streets and rooms are made at short, usual and long baselines; depth comes from matching and from the truth, poses are
right or deliberately wrong. Folders of scenes (a ``poses.json`` with depth, an odd number of panoramas in walking
order) are added, at 512×256. Prints score, expected and true decibels of every pair, the time a check takes, and
Spearman's rank correlation between score and truth.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from confidence_samples import Judged, generated_views, judged, rank_correlation
from omnisyn_cli.io import read_inverse_depth, read_panorama
from omnisyn_cli.poses.file import read_poses
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.stereo.matching_estimator import MatchingDepthEstimator, MatchingOptions
from omnisyn_cli.synthesis.consistency import cross_check
from omnisyn_cli.types import DepthEstimate, KnownDepth, View

SIZE = (256, 512)
BASELINES = {"street": (1.0, 3.0, 7.0), "room": (0.4, 1.0, 2.0)}
SEEDS = {"street": (101, 103, 105), "room": (101, 104, 106)}


def scene_views(folder: Path) -> list[View]:
    """First, middle and last panorama of a folder, reduced."""
    entries = list(read_poses(folder / "poses.json").panoramas.items())
    views = []
    for name, entry in (entries[0], entries[len(entries) // 2], entries[-1]):
        image = cv2.resize(read_panorama(folder / name).image, SIZE[::-1], interpolation=cv2.INTER_AREA)
        known = None
        if entry.depth is not None:
            rho = cv2.resize(read_inverse_depth(entry.depth), SIZE[::-1], interpolation=cv2.INTER_NEAREST)
            known = DepthEstimate(rho, np.ones_like(rho))
        views.append(View(image, entry.pose, None, known))
    if views[0].known_depth is None or views[-1].known_depth is None:
        raise SystemExit(f"{folder}: expected depth of the first and last panorama, got none; name it in poses.json")
    return views


def pairs(folders: list[Path]) -> Iterator[tuple[str, list[View], float]]:
    """Name, views and length of the way in metres."""
    for folder in folders:
        views = scene_views(folder)
        yield folder.name, views, float(np.linalg.norm(views[-1].pose.position - views[0].pose.position))
    for kind, baselines in BASELINES.items():
        for seed in SEEDS[kind]:
            for baseline in baselines:
                yield f"{kind} {seed} {baseline:g} m", generated_views(kind, seed, baseline, SIZE), baseline


def main() -> None:
    """Print the table and the correlation."""
    matching, found = MatchingDepthEstimator(MatchingOptions(size=SIZE)), list[Judged]()
    print(f"{'':32}{'score':>8}{'expected':>10}{'true dB':>10}")
    for index, (name, views, baseline) in enumerate(pairs([Path(argument) for argument in sys.argv[1:]])):
        cases = [
            judged(f"{name}, matching", views, matching),
            judged(f"{name}, true depth", views, KnownDepth()),
            judged(f"{name}, wrong poses", views, matching, 0.5 + index % 4, 0.03 * baseline * (index % 3)),
        ]
        for case in cases:
            print(f"{case.name:32}{case.score:8.2f}{case.expected:10.2f}{case.true:10.2f}", flush=True)
        found += cases
    views = generated_views("room", 101, 1.0, SIZE)
    depths = KnownDepth()(views[0], views[-1])
    begin = time.perf_counter()
    for _ in range(5):
        cross_check((views[0], views[-1]), depths, Cut())
    print(f"a check takes {(time.perf_counter() - begin) / 5:.2f} s")
    correlation = rank_correlation([case.expected for case in found], [case.true for case in found])
    print(f"Spearman over {len(found)} pairs: {correlation:.3f}")


if __name__ == "__main__":
    main()
