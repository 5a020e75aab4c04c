"""Data sets of the hall with exact depth, seen along a bent path by turned cameras."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from omnisyn_cli.evaluation.datasets import find_scenes
from omnisyn_cli.evaluation.datasets.sources import Pair, choose_pairs
from omnisyn_cli.evaluation.engine import EvaluationJob, evaluate, plan_evaluation
from omnisyn_cli.evaluation.results import UnitRecord
from omnisyn_cli.evaluation.views import LoadedPair, load_pair
from omnisyn_cli.io import write_image
from synthesis_samples import as_bytes, hall_image, posed, write_hall

SIZE = (64, 128)

# The second and third pose are not on the line between the first and the last.
PATH = (
    posed((0, 0, 0.6)),
    posed((0.25, 0.1, 0.3), 0.4, 0.1),
    posed((-0.2, -0.1, -0.2), -0.3, 0.0, 0.2),
    posed((0, 0, -0.6), 0.5),
)


def write_halls(folder: Path, *names: str, frames: int = 4, with_depth: bool = True) -> Path:
    for name in names:
        (folder / name).mkdir(parents=True)
        write_hall(folder / name, [*PATH[: frames - 1], PATH[-1]], SIZE, with_depth=with_depth)
    return folder


def hall_pair(folder: Path) -> Pair:
    write_halls(folder, "hall")
    (pair,) = choose_pairs(None)(find_scenes(folder)[0].read())
    return pair


def loaded_hall(folder: Path) -> LoadedPair:
    return load_pair(hall_pair(folder), None, 1)


def damage(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:200])


def repaint(path: Path) -> None:
    write_image(path, as_bytes(1 - hall_image(PATH[1], SIZE)))


def run(
    folder: Path, methods: str, on_unit: Callable[[int, UnitRecord], None] | None = None, **options: object
) -> list[UnitRecord]:
    job = EvaluationJob(folder, folder.parent / "report", methods, **{"pictures": False, "threads": 1, **options})
    return evaluate(plan_evaluation(job), on_unit, has_report=False)


def scores_of(records: list[UnitRecord], method: str) -> np.ndarray:
    (record,) = [record for record in records if record.method == method]
    return np.array([frame.scores["ws_psnr"] for frame in record.frames])
