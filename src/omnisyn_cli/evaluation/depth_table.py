"""The paper's depth table on scenes that no network was trained on: streets and rooms, two panoramas a metre apart.

Scenes are made as they are needed, with true depth, and never written. Every result is a line of ``results.jsonl`` in
the report's folder as soon as it is there (:mod:`omnisyn_cli.evaluation.records`); an interrupted run goes on from
them. Both panoramas of a pair are scored.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path

import numpy as np

import omnisyn_cli
from omnisyn_cli.errors import InputError, OmnisynError
from omnisyn_cli.evaluation.depth_methods import METHODS, DepthMethod, find_depth_methods
from omnisyn_cli.evaluation.fingerprint import digest_of_sources
from omnisyn_cli.evaluation.grouping import gaps
from omnisyn_cli.evaluation.markdown import render_markdown
from omnisyn_cli.evaluation.measure import depth_records
from omnisyn_cli.evaluation.records import UnitRecord, append_record, latest_records, read_records
from omnisyn_cli.evaluation.table import Row, Table
from omnisyn_cli.evaluation.tables import depth_table
from omnisyn_cli.io.paths import make_folder, replaced_when_complete
from omnisyn_cli.scenes import GENERATORS, Scene, generate_scene, render_views, sample_path
from omnisyn_cli.types import DepthEstimate, DepthEstimator, View

__all__ = [
    "BASELINE",
    "FIRST_SEED",
    "LEAST_SEED",
    "DepthTableJob",
    "depth_tables",
    "make_pair",
    "run_depth_table",
    "write_depth_tables",
]

BASELINE = 1.0
"""Metres between the two panoramas (the paper's)."""

LEAST_SEED = 10_000_000
"""Seeds from here on are never used in training or in the standard scenes."""

FIRST_SEED = 20_000_000

SUPERSAMPLE = 2
"""Colour samples per pixel along each axis."""

TABLE_NAME = "depth-table.md"

FORM = 1
"""Counts up when the same scenes are measured or recorded in another way."""


@dataclass(frozen=True)
class DepthTableJob:
    """What a user asks for.

    Attributes:
        report: folder for results and table; made if it is not there.
        scenes: how many, streets and rooms in equal shares; an odd one is a street.
        seed: of the first scene of each kind; those without room for the way are left out.
        methods: ``all`` or names separated by commas, see
            :data:`omnisyn_cli.evaluation.depth_methods.METHODS`.
        size: height and width of the panoramas.
        device: where networks run.
        threads: at most this many; None is one per core.
    """

    report: Path
    scenes: int = 200
    seed: int = FIRST_SEED
    methods: str = "all"
    size: tuple[int, int] = (512, 1024)
    device: str = "auto"
    threads: int | None = None


def run_depth_table(job: DepthTableJob, on_unit: Callable[[int, UnitRecord], None] | None = None) -> list[UnitRecord]:
    """Measure what is not measured yet; the records of everything, scene by scene.

    Args:
        job: what was asked for.
        on_unit: called with the number of finished units and the record of the last one.

    Raises:
        InputError: no such method, a seed that networks may have been trained with, a size that is not 2:1, or earlier
            results that cannot be read.
        OutputPathError, WriteError: the folder of the report cannot be written.
    """
    methods = find_depth_methods(job.methods)
    if job.seed < LEAST_SEED:
        raise InputError(f"expected a seed of at least {LEAST_SEED:,}, got {job.seed:,}; smaller ones are for training")
    if job.size[1] != 2 * job.size[0]:
        raise InputError(f"expected a size twice as wide as high, got {job.size[1]}x{job.size[0]}; correct it")
    make_folder(job.report, "the report")
    known = {record.unit: record for record in latest_records(read_records(job.report))}
    worker, records = _Worker(job, methods), list[UnitRecord]()
    for kind, seed, scene in _scenes(job):
        for record in worker.records(kind, seed, scene, known):
            if not _is_same(known.get(record.unit), record):
                append_record(job.report, record)
            records.append(record)
            if on_unit:
                on_unit(len(records), record)
    return records


def _is_same(known: UnitRecord | None, record: UnitRecord) -> bool:
    """Whether a line says the same already."""
    return known is not None and known.to_json() == record.to_json()


def _scenes(job: DepthTableJob) -> Iterator[tuple[str, int, Scene]]:
    """As many scenes of each kind as there should be, with room for the way, in ascending order of their seeds."""
    for index, kind in enumerate(GENERATORS):
        wanted = (job.scenes + len(GENERATORS) - 1 - index) // len(GENERATORS)
        for seed in count(job.seed):
            if wanted == 0:
                break
            scene = generate_scene(kind, seed)
            if _has_room(scene, seed):
                wanted -= 1
                yield kind, seed, scene


def _has_room(scene: Scene, seed: int) -> bool:
    try:
        sample_path(scene, seed, 2, baseline=BASELINE, vertical=0.0)
    except ValueError:
        return False
    return True


def make_pair(scene: Scene, seed: int, size: tuple[int, int], threads: int | None = None) -> tuple[View, View]:
    """Two panoramas a metre apart on level ground, upright, with their true depth.

    Args:
        scene: with room for them.
        seed: of the way through it.
        size: height and width.
        threads: at most this many; the result does not depend on it.

    Raises:
        ValueError: the scene has no room.
    """
    path = sample_path(scene, seed, 2, baseline=BASELINE, vertical=0.0)
    positions = np.stack([pose.position for pose in path])
    images, depths = render_views(
        scene, path[0].rotation, positions, size, supersample=SUPERSAMPLE, threads=threads
    )  # fmt: skip
    first, second = (
        View(image, pose, known_depth=DepthEstimate(1.0 / depth, np.ones_like(depth)))
        for image, pose, depth in zip(images, path, depths, strict=True)
    )
    return first, second


class _Worker:
    """Measures methods on one scene after the other; every network is loaded once."""

    def __init__(self, job: DepthTableJob, methods: Sequence[DepthMethod]) -> None:
        self._job, self._methods = job, methods
        self._made: dict[str, DepthEstimator] = {}
        self._ingredients: dict[str, list[str]] = {}
        program = digest_of_sources(Path(omnisyn_cli.__file__).parent)
        self._fixed = [FORM, omnisyn_cli.__version__, program, list(job.size), job.device]

    def records(
        self, kind: str, seed: int, scene: Scene, known: Mapping[tuple[str, str, str, str], UnitRecord]
    ) -> Iterator[UnitRecord]:
        """One record for every method, the known one where nothing has changed."""
        pair: tuple[View, View] | None = None
        for method in self._methods:
            blank = UnitRecord("", f"{kind}-{seed}", "first", "second", method.name, "unavailable", baseline=BASELINE)
            try:
                blank = replace(blank, key=self._key(method, kind, seed))
                estimator = self._estimator(method)
            except InputError as error:
                yield replace(blank, reason=str(error))
                continue
            earlier = known.get(blank.unit)
            if earlier is not None and earlier.status == "done" and earlier.key == blank.key:
                yield earlier
                continue
            pair = pair or make_pair(scene, seed, self._job.size, self._job.threads)
            yield _measured(blank, estimator, pair, self._job.size)

    def _key(self, method: DepthMethod, kind: str, seed: int) -> str:
        if method.name not in self._ingredients:
            self._ingredients[method.name] = method.ingredients()
        described = [*self._fixed, method.name, self._ingredients[method.name], kind, seed]
        return hashlib.sha256(json.dumps(described).encode()).hexdigest()

    def _estimator(self, method: DepthMethod) -> DepthEstimator:
        if method.name not in self._made:
            self._made[method.name] = method.make(self._job.device, self._job.threads)
        return self._made[method.name]


def _measured(
    blank: UnitRecord, estimator: DepthEstimator, pair: tuple[View, View], size: tuple[int, int]
) -> UnitRecord:
    """Depth that was found without a look at the truth, compared with it; what breaks is written down."""
    first, second = (View(view.image, view.pose) for view in pair)
    begin = time.perf_counter()
    try:
        found = estimator(first, second)
        seconds = time.perf_counter() - begin
        depths = depth_records(found, pair, (blank.first, blank.second))
    except Exception as error:  # noqa: BLE001 - one broken method must not end a comparison of many
        text = " ".join(str(error).split())
        return replace(
            blank,
            status="failed",
            reason=text if isinstance(error, OmnisynError) else f"{type(error).__name__}: {text}",
        )
    return replace(blank, status="done", size=size, depths=depths, seconds={"depth": seconds, "total": seconds})


def depth_tables(records: Sequence[UnitRecord]) -> list[Table]:
    """A table for each kind of scene, with a row for every method in the order of the known methods."""
    kinds = dict.fromkeys(record.scene.partition("-")[0] for record in records)
    return [_table(kind, [record for record in records if record.scene.startswith(f"{kind}-")]) for kind in kinds]


def _table(kind: str, records: Sequence[UnitRecord]) -> Table:
    table = depth_table(records, weighted=False)
    rows = {row.name: row for row in table.rows}
    methods = dict.fromkeys(record.method for record in records)
    reasons = {record.method: record.reason for record in records if record.status != "done"}
    order = sorted(methods, key=lambda name: list(METHODS).index(name) if name in METHODS else -1)
    every = tuple(rows.get(name) or Row(name, (), reasons[name]) for name in order)
    return replace(table, title=f"{kind.capitalize()}s, {BASELINE:g} m", rows=every)


def write_depth_tables(folder: Path, records: Sequence[UnitRecord]) -> Path:
    """Write the tables as Markdown into a folder that exists; WriteError where that fails."""
    path = folder / TABLE_NAME
    failed = [record for record in records if record.status == "failed"]
    text = render_markdown(depth_tables(records), gaps(failed), omnisyn_cli.__version__)
    with replaced_when_complete(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path
