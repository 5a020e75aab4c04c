"""The paper's depth table on scenes that no network was trained on: streets and rooms, two panoramas a metre apart.

Scenes are made as they are needed, with true depth, and never written. Every result is a line of ``results.jsonl`` in
the report's folder as soon as it is there (:mod:`omnisyn_cli.evaluation.results`); an interrupted run goes on from
them. Both panoramas of a pair are scored.
"""

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import count
from pathlib import Path

import numpy as np

import omnisyn_cli
from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.engine import KnownRecords, one_line, recorded
from omnisyn_cli.evaluation.fingerprint import digest_of_sources
from omnisyn_cli.evaluation.grouping import gaps
from omnisyn_cli.evaluation.measure import depth_records
from omnisyn_cli.evaluation.methods import find_method
from omnisyn_cli.evaluation.results import UnitRecord
from omnisyn_cli.evaluation.tables import Row, Table, about_units, depth_table, render_markdown
from omnisyn_cli.io.outputs import replaced_when_complete
from omnisyn_cli.pipeline.config import DepthSource
from omnisyn_cli.pipeline.depth_sources import make_estimator
from omnisyn_cli.pipeline.presets import PRESETS
from omnisyn_cli.runtime.models import find_model, sha256_of
from omnisyn_cli.scenes import Scene, generate_scene, render_views, sample_path
from omnisyn_cli.scenes.suite import STANDARD_KINDS
from omnisyn_cli.types import DepthEstimate, DepthEstimator, View

BASELINE_METRES = 1.0
"""Metres between the two panoramas (the paper's)."""

MIN_SEED = 10_000_000
"""Seeds from here on are never used in training or in the standard scenes."""

FIRST_SEED = 20_000_000
"""Far from the seeds that networks learn from, so that scenes are held out."""

SUPERSAMPLE = 2
"""Colour samples per pixel along each axis."""

TABLE_NAME = "depth-table.md"
"""Of the report."""

RECORD_VERSION = 1
"""Counts up when the same scenes are measured or recorded in another way."""

TABLE_SOURCES: Mapping[str, DepthSource] = {
    "synsin": find_method("monocular").config.depth,
    "matching": find_method("matching").config.depth,
    **{f"omnisyn-{preset.name}": preset.config.depth for preset in PRESETS.values()},
}
"""The rows of the table: SynSin's monocular network, matching alone, and the presets; ``paper`` is a network alone."""

NETWORK_PREFIX = "network:"
"""Before a model's name in the manifest or its ONNX file: that stereo network alone."""


def depth_sources(text: str) -> dict[str, DepthSource]:
    """``all``, or names separated by commas, each once; ``network:FILE.onnx`` is a stereo network in a file.

    InputError: a name that there is no method of, or no name.
    """
    if text == "all":
        return dict(TABLE_SOURCES)
    names = [name.strip() for name in text.split(",") if name.strip()]
    return {name: _source(name) for name in names or [text]}


def _source(name: str) -> DepthSource:
    if name.startswith(NETWORK_PREFIX):
        return DepthSource("network", model=name.removeprefix(NETWORK_PREFIX))
    if name not in TABLE_SOURCES:
        known = ", ".join((*TABLE_SOURCES, f"{NETWORK_PREFIX}FILE.onnx"))
        raise InputError(f"expected one of {known} as method, got {name!r}")
    return TABLE_SOURCES[name]


@dataclass(frozen=True)
class DepthTableJob:
    """What a user asks for.

    Attributes:
        report: folder for results and table; made if it is not there.
        scenes: how many, streets and rooms in equal shares; an odd one is a street.
        seed: of the first scene of each kind; those without room for the way are left out.
        methods: ``all`` or names separated by commas, see :func:`depth_sources`.
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

    ``on_unit`` is called with the number of finished units and the record of the last one.

    Raises:
        InputError: no such method, a seed that networks may have been trained with, a size that is not 2:1, or earlier
            results that cannot be read.
        OutputPathError, WriteError: the folder of the report cannot be written.
    """
    sources = depth_sources(job.methods)
    if job.seed < MIN_SEED:
        raise InputError(f"expected a seed of at least {MIN_SEED:,}, got {job.seed:,}; smaller ones are for training")
    if job.size[1] != 2 * job.size[0]:
        raise InputError(f"expected a size twice as wide as high, got {job.size[1]}x{job.size[0]}; correct it")
    records: list[UnitRecord] = []
    for record in recorded(job.report, _UnitRunner(job, sources).records):
        records.append(record)
        if on_unit:
            on_unit(len(records), record)
    return records


def _scenes(job: DepthTableJob) -> Iterator[tuple[str, int, Scene]]:
    """As many scenes of each kind as there should be, with room for the way, in ascending order of their seeds."""
    for index, kind in enumerate(STANDARD_KINDS):
        wanted = (job.scenes + len(STANDARD_KINDS) - 1 - index) // len(STANDARD_KINDS)
        for seed in count(job.seed):
            if wanted == 0:
                break
            scene = generate_scene(kind, seed)
            if _has_room(scene, seed):
                wanted -= 1
                yield kind, seed, scene


def _has_room(scene: Scene, seed: int) -> bool:
    try:
        sample_path(scene, seed, 2, baseline=BASELINE_METRES, vertical=0.0)
    except ValueError:
        return False
    return True


def make_pair(scene: Scene, seed: int, size: tuple[int, int], threads: int | None = None) -> tuple[View, View]:
    """Two upright panoramas a metre apart on level ground, with their true depth; ValueError: there is no room."""
    path = sample_path(scene, seed, 2, baseline=BASELINE_METRES, vertical=0.0)
    positions = np.stack([pose.position for pose in path])
    images, depths = render_views(
        scene, path[0].rotation, positions, size, supersample=SUPERSAMPLE, threads=threads
    )  # fmt: skip
    first, second = (
        View(image, pose, known_depth=DepthEstimate(1.0 / depth, np.ones_like(depth)))
        for image, pose, depth in zip(images, path, depths, strict=True)
    )
    return first, second


class _UnitRunner:
    """Measures methods on one scene after the other; every network is loaded once."""

    def __init__(self, job: DepthTableJob, sources: Mapping[str, DepthSource]) -> None:
        self._job, self._sources = job, sources
        self._made: dict[str, DepthEstimator] = {}
        self._weights: dict[str | None, str] = {None: ""}
        program = digest_of_sources(Path(omnisyn_cli.__file__).parent)
        self._fixed = [RECORD_VERSION, omnisyn_cli.__version__, program, list(job.size), job.device]

    def records(self, known: KnownRecords) -> Iterator[UnitRecord]:
        """One record for every method on every scene, the known one where nothing has changed."""
        for kind, seed, scene in _scenes(self._job):
            pair = cache(partial(make_pair, scene, seed, self._job.size, self._job.threads))
            for name, source in self._sources.items():
                blank = UnitRecord(
                    "", f"{kind}-{seed}", "first", "second", name, "unavailable", baseline=BASELINE_METRES
                )
                try:
                    blank = replace(blank, key=self._key(name, source, kind, seed))
                    estimator = self._estimator(name, source)
                except InputError as error:
                    yield replace(blank, reason=str(error))
                    continue
                former = known.get(blank.unit)
                is_done = former is not None and former.status == "done" and former.key == blank.key
                yield former if former and is_done else _measured(blank, estimator, pair(), self._job.size)

    def _key(self, name: str, source: DepthSource, kind: str, seed: int) -> str:
        """Hash of everything that a result depends on; InputError where a network is missing."""
        if source.model not in self._weights:
            self._weights[source.model] = sha256_of(find_model(str(source.model)))
        ingredients = [source.kind, str(source.rows), self._weights[source.model]]
        return hashlib.sha256(json.dumps([*self._fixed, name, ingredients, kind, seed]).encode()).hexdigest()

    def _estimator(self, name: str, source: DepthSource) -> DepthEstimator:
        if name not in self._made:
            self._made[name] = make_estimator(source, device=self._job.device, threads=self._job.threads)
        return self._made[name]


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
        return replace(blank, status="failed", reason=one_line(error))
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
    order = sorted(methods, key=lambda name: list(TABLE_SOURCES).index(name) if name in TABLE_SOURCES else -1)
    every = tuple(rows.get(name) or Row(name, (), reasons[name]) for name in order)
    return replace(table, title=f"{kind.capitalize()}s, {BASELINE_METRES:g} m", rows=every)


def write_depth_tables(folder: Path, records: Sequence[UnitRecord]) -> Path:
    """Write the tables as Markdown into a folder that exists; WriteError where that fails."""
    path = folder / TABLE_NAME
    failed = [record for record in records if record.status == "failed"]
    text = render_markdown(depth_tables(records), gaps(failed), about_units(records))
    with replaced_when_complete(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path
