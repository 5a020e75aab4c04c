"""Whether the score ranks clips as the truth does: ``python tests/benchmarks/bench_confidence.py [FOLDER ...]``.

Depth, cuts and fusion are those of the default preset. Folders of scenes (a ``poses.json`` with depth, an odd number of
panoramas in walking order) are measured at 512×256. Without folders, streets and rooms are made at short, usual and
long baselines; their depth is true as well, and their poses are right or deliberately wrong. Prints score, expected and
true decibels of every pair and the time a check takes. Then follow Spearman's rank correlation of score and truth, the
error of ``expected``, the calibration error of depth's confidence, and the highest score of bad pairs.
"""

import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from confidence_samples import Judged, generated_views, judged
from omnisyn_cli.evaluation.metrics.depth import rank_correlation
from omnisyn_cli.io import read_inverse_depth, read_panorama
from omnisyn_cli.pipeline.presets import DEFAULT_PRESET, PRESETS
from omnisyn_cli.poses.file import read_poses
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.synthesis.consistency import cross_check
from omnisyn_cli.types import DepthEstimate, KnownDepth, View

SIZE = (256, 512)
CONFIG = PRESETS[DEFAULT_PRESET].config
BAD_DB = 18.0
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


def of_folders(folders: list[Path]) -> Iterator[Judged]:
    """What the default preset says about pairs on disk."""
    for folder in folders:
        yield judged(f"{folder.parent.name}/{folder.name}", scene_views(folder), config=CONFIG)


def of_generated() -> Iterator[Judged]:
    """What it says about generated pairs, with true depth and wrong poses as well."""
    each = [(kind, seed, baseline) for kind in BASELINES for seed in SEEDS[kind] for baseline in BASELINES[kind]]
    for index, (kind, seed, baseline) in enumerate(each):
        name, views = f"{kind} {seed} {baseline:g} m", generated_views(kind, seed, baseline, SIZE)
        yield judged(name, views, config=CONFIG)
        yield judged(f"{name}, true depth", views)
        wrong = judged(f"{name}, wrong poses", views, 0.5 + index % 4, 0.03 * baseline * (index % 3), CONFIG)
        yield replace(wrong, calibration_error=None)


def main() -> None:
    found = list[Judged]()
    print(f"{'':32}{'score':>8}{'expected':>10}{'true dB':>10}{'calibration':>13}")
    folders = [Path(argument) for argument in sys.argv[1:]]
    for case in of_folders(folders) if folders else of_generated():
        calibration = "" if case.calibration_error is None else f"{case.calibration_error:13.3f}"
        print(f"{case.name:32}{case.score:8.2f}{case.expected:10.2f}{case.true:10.2f}{calibration}", flush=True)
        found.append(case)
    views = generated_views("room", 101, 1.0, SIZE)
    depths = KnownDepth()(views[0], views[-1])
    begin = time.perf_counter()
    for _ in range(5):
        cross_check((views[0], views[-1]), depths, Cut())
    print(f"a check takes {(time.perf_counter() - begin) / 5:.2f} s")
    scores, expected, true = np.array([(case.score, case.expected, case.true) for case in found]).T
    correlation = rank_correlation(scores, true, np.ones(len(found)))
    print(f"Spearman over {len(found)} pairs: {correlation or 0.0:.3f}")
    print(f"expected is off by {np.abs(expected - true).mean():.1f} dB, too low by {(true - expected).mean():.1f} dB")
    errors = [case.calibration_error for case in found if case.calibration_error is not None]
    print(f"calibration error of depth: {np.mean(errors):.3f}")
    is_bad = true < BAD_DB
    print(f"below {BAD_DB:g} dB: {is_bad.sum()} pairs, highest score {scores[is_bad].max(initial=0.0):.2f}")


if __name__ == "__main__":
    main()
