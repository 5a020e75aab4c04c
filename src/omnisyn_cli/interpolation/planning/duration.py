"""How long a job will take on this machine: its work by what was measured elsewhere, its pace by former runs here.

Work is computing, in seconds of one core of the machine of :data:`TABLE_NAME`: once, for each pair, and for each frame.
Every stage has the figures of a setting that agrees in what this stage depends on. Pace is the time on the clock for a
second of work: that of the most similar former runs here. A run that had fewer cores than others, because something
else was running, counts as if it had had them. Before there is a run, :func:`probe` guesses. Nothing heavy is loaded
for any of it.
"""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

import numpy as np
from pydantic import TypeAdapter

from omnisyn_cli.compute.threads import available_threads
from omnisyn_cli.errors import OmnisynError
from omnisyn_cli.interpolation.plan import InterpolationPlan
from omnisyn_cli.interpolation.planning.figures import Figures, read_table
from omnisyn_cli.io.outputs import write_parts
from omnisyn_cli.pipeline.config import RunConfig
from omnisyn_cli.pipeline.presets import DEFAULT_PRESET, PRESETS

if TYPE_CHECKING:
    from omnisyn_cli.interpolation.summary import Summary

__all__ = ["Duration", "expected_duration", "probe", "remember_run", "shipped_table"]

TABLE_NAME = "pareto.json"
"""Figures of speed that come with the program."""

RUNS_NAME = "runs.json"
"""Earlier runs on this machine, in the cache folder."""

MAX_RUNS = 40
"""That are remembered."""

SIMILAR_RUNS = 5
"""Of which the median is the pace."""

MAX_OCTAVES = 4.0
"""Frames of a sixteenth of the pixels, or of sixteen times as many, say nothing about the pace any more."""

THREAD_SCALING_EXPONENT = 0.75
"""A guess: n threads do as much as n to this power."""

MIN_WORK_SECONDS = 0.5
"""Of work, below which a run says nothing about the pace."""

PROBE_REPEATS = 4
"""Of the probe of speed; the fastest counts, as others may disturb it. Set by hand."""

MIN_CORES = 0.9
"""A run that nothing disturbs keeps at least about one core busy."""

STARVED_SHARE = 0.5
"""Of the cores that the best of the similar runs had; a run with less of them was starved. Set by hand."""

GUESS_SPREAD, FEW_SPREAD, MIN_SPREAD, MAX_SPREAD = 2.0, 1.5, 1.25, 3.0
"""Factors between what is expected and its bounds: of a guess, of one or two runs, at least, and at most."""


@dataclass(frozen=True)
class Work:
    """Seconds of computing on the machine of the table."""

    start: float
    pairs: float
    frames: float


@dataclass(frozen=True)
class Run:
    """What is remembered of a run.

    Attributes:
        threads: it used at most this many.
        pixels: of a frame.
        pairs, frames: seconds on the clock for a second of work; None where there was too little of it.
        cores: seconds of processors for a second on the clock; None where nobody knows.
    """

    threads: int
    pixels: int
    pairs: float | None
    frames: float | None
    cores: float | None = None


RUNS = TypeAdapter(list[Run])
"""Reads and checks them."""


@dataclass(frozen=True)
class Duration:
    """What a job is expected to take.

    Attributes:
        seconds: on the clock.
        source: how that is known, in words.
        spread: factor to the bounds, within which a run usually stays.
    """

    seconds: float
    source: str
    spread: float = GUESS_SPREAD

    @property
    def bounds(self) -> tuple[float, float]:
        """Seconds between which a run usually stays."""
        return self.seconds / self.spread, self.seconds * self.spread

    @property
    def words(self) -> str:
        """That for people, such as "about 20 to 40 s"."""
        return f"about {range_in_words(*self.bounds)}"

    def __str__(self) -> str:
        return f"{self.words} ({self.source})"


def range_in_words(low: float, high: float) -> str:
    """A range of seconds in round numbers of seconds, minutes or hours."""
    unit, name = next((each for each in ((1, "s"), (60, "min")) if high < 100 * each[0]), (3600, "hours"))
    bounds = [_rounded(seconds / unit) for seconds in (low, high)]
    return f"{bounds[0]} to {bounds[1]} {name}" if bounds[0] < bounds[1] else f"{bounds[1]} {name}"


def _rounded(number: float) -> int:
    step = 1 if number < 10 else 5 if number < 40 else 10
    return max(1, step * round(number / step))


def probe() -> float:
    """Seconds of computing, on one core, of a fixed piece of work with arrays: the least of some tries.

    Numbers are looked up here and there and added one after the other, which no processor has special instructions for:
    sorting, which some do in a tenth of the time, said little about anything else, and so does asking for memory.
    """
    values, index = np.linspace(0.0, 1.0, 1 << 18), np.arange(1 << 18)
    places, found = index * (2 * index + 1) % len(values), np.empty_like(values)  # each place once, in no order
    least = math.inf
    for _ in range(PROBE_REPEATS):
        begin = time.process_time()
        np.take(values, places, out=found, mode="clip")
        np.cumsum(found, out=found)
        least = min(least, time.process_time() - begin)
    return max(least, 1e-6)


def shipped_table() -> tuple[Figures, ...]:
    """The figures that came with the program; InputError: they are missing or damaged."""
    return read_table(Path(str(files("omnisyn_cli"))) / "interpolation" / "planning" / TABLE_NAME)


def expected_duration(plan: InterpolationPlan, table: Sequence[Figures] | None = None) -> Duration | None:
    """What a job will take on this machine; None where its depth, method or device was never measured.

    InputError: the table that came with the program is missing or damaged.
    """
    table = shipped_table() if table is None else table
    work = work_of(plan, table)
    if work is None:
        return None
    slowness = probe() / median(figures.probe for figures in table)
    threads = _threads(plan)
    guess = slowness / threads**THREAD_SCALING_EXPONENT
    runs = _similar(remembered_runs(), threads, math.prod(plan.size))
    cores = max([MIN_CORES, *(run.cores for run in runs if run.cores is not None)])
    known = [[_undisturbed(run, part, cores) for run in runs] for part in ("pairs", "frames")]
    pairs, frames = (_pace(paces, guess) for paces in known)
    source = (
        f"by the pace of {len(runs)} former run{'s' * (len(runs) > 1)} on this machine"
        if runs
        else "a guess from the speed of another machine, until this one has made videos"
    )
    besides = "" if _is_standard(plan) else "; for an MP4 by the default encoder alone"
    seconds = work.start * slowness + work.pairs * pairs + work.frames * frames
    return Duration(seconds, source + besides, max(map(_spread, known)))


def remember_run(summary: Summary, processor: float | None = None) -> None:
    """Keep how long a run took, for :func:`expected_duration`; where that cannot be done it is not.

    Args:
        summary: of the run.
        processor: seconds of processors that it took, those of the encoder included; None where nobody knows.
    """
    plan, seconds = summary.plan, summary.seconds
    try:
        work = work_of(plan, shipped_table())
        if work is None or not _is_standard(plan):
            return
        pairs = sum(seconds.get(stage, 0.0) for stage in ("decode", "depth", "check", "mesh"))
        pair_pace, frame_pace = (
            took / planned if planned >= MIN_WORK_SECONDS else None
            for took, planned in ((pairs, work.pairs), (seconds["total"] - pairs, work.frames))
        )
        cores = None if processor is None else processor / seconds["total"]
        run = Run(_threads(plan), math.prod(plan.size), pair_pace, frame_pace, cores)
        runs = [run, *remembered_runs()][:MAX_RUNS]
        folder = cache_folder()
        folder.mkdir(parents=True, exist_ok=True)
        write_parts(folder / RUNS_NAME, [json.dumps([asdict(each) for each in runs]).encode()])
    except (OSError, OmnisynError):
        return


def _is_standard(plan: InterpolationPlan) -> bool:
    """Whether nothing is made besides the frames, and those are encoded as in the table.

    Poses are found before the clock of a run starts.
    """
    job = plan.job
    besides = (job.view, job.save_depth, job.save_confidence, job.save_frames, job.codec, job.encoder_preset)
    return all(each is None for each in besides) and job.output.suffix == ".mp4"


def remembered_runs() -> list[Run]:
    """Those that this machine remembers, the last one first; none where they cannot be read."""
    try:
        return RUNS.validate_json((cache_folder() / RUNS_NAME).read_bytes())
    except (OSError, ValueError):
        return []


def cache_folder() -> Path:
    """Where this program keeps what it may lose: ``OMNISYN_CACHE_DIR``, else what the system has for such things."""
    if named := os.environ.get("OMNISYN_CACHE_DIR"):
        return Path(named)
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "omnisyn"


def _similar(runs: Iterable[Run], threads: int, pixels: int) -> list[Run]:
    """Those with as many threads whose frames are the nearest in size, the last ones first."""

    def octaves(run: Run) -> float:
        return abs(math.log2(run.pixels / pixels))

    alike = (run for run in runs if run.threads == threads and octaves(run) <= MAX_OCTAVES)
    return sorted(alike, key=octaves)[:SIMILAR_RUNS]


def _undisturbed(run: Run, part: str, cores: float) -> float | None:
    """The pace of a part of a run; that which it would have had with so many cores if it was starved."""
    pace: float | None = getattr(run, part)
    is_starved = run.cores is not None and run.cores < STARVED_SHARE * cores
    return pace if pace is None or run.cores is None or not is_starved else pace * run.cores / cores


def _pace(known: Iterable[float | None], guess: float) -> float:
    paces = [pace for pace in known if pace is not None]
    return median(paces) if paces else guess


def _spread(known: Iterable[float | None]) -> float:
    """How far runs were from each other, as a factor from the middle; more where there are few."""
    paces = [pace for pace in known if pace]
    least = MIN_SPREAD if len(paces) > 2 else FEW_SPREAD if paces else GUESS_SPREAD
    return min(MAX_SPREAD, max(least, math.sqrt(max(paces) / min(paces)) if paces else least))


def _threads(plan: InterpolationPlan) -> int:
    return min(plan.job.threads or available_threads(), available_threads())


def work_of(plan: InterpolationPlan, table: Sequence[Figures]) -> Work | None:
    """What a job is in computing, None where the table does not say."""
    config = plan.config
    finders = (
        _like(table, config, "depth.kind", "depth.networks") if config.estimates_depth else _standard_figures(table)
    )
    renderers, fusers = _like(table, config, "renderer"), _like(table, config, "fusion", "edges")
    if not config.draws_surfaces or config.is_on_gpu or not (finders and renderers and fusers):
        return None
    finder, renderer = (_nearest(each, config) for each in (finders, renderers))
    standard = _nearest(_standard_figures(table), PRESETS[DEFAULT_PRESET].config)
    source = math.prod(max(plan.source_sizes)) / math.prod(standard.source)
    found = sum(finder.seconds[stage] for stage in ("depth",) if config.estimates_depth)
    surfaces = finder.seconds["check"] + renderer.seconds["mesh"]
    panoramas = len(plan.entries)
    frame = _at(table, renderer, "render", plan.size) + _at(table, _nearest(fusers, config), "fuse", plan.size)
    frame += _at(table, standard, "encode", plan.size)
    return Work(
        standard.seconds["start"],
        standard.seconds["decode"] * source * panoramas / 2 + (panoramas - 1) * (found + surfaces),
        max(len(plan.path) - panoramas, 0) * frame,
    )


def _standard_figures(table: Sequence[Figures]) -> list[Figures]:
    return _like(table, PRESETS[DEFAULT_PRESET].config, *STAGE_SETTINGS)


STAGE_SETTINGS: dict[str, Callable[[RunConfig], object]] = {
    "depth.kind": lambda config: config.depth.kind,
    "depth.networks": lambda config: config.depth.networks,
    "renderer": lambda config: config.renderer,
    "fusion": lambda config: (config.fusion, config.fusion_rows if config.fusion_strategy.is_residual else 0),
    "edges": lambda config: config.edges,
}
"""What a stage may depend on."""


def _like(table: Sequence[Figures], config: RunConfig, *aspects: str) -> list[Figures]:
    """Figures of settings that agree with a config."""
    return [
        f
        for f in table
        if all(STAGE_SETTINGS[aspect](f.config) == STAGE_SETTINGS[aspect](config) for aspect in aspects)
    ]


def _nearest(measured: Sequence[Figures], config: RunConfig) -> Figures:
    """Those with the most similar density of depth, then those with the most pairs."""
    return min(measured, key=lambda f: (abs(math.log2(f.config.depth.rows / config.depth.rows)), -f.pairs))


def _at(table: Sequence[Figures], figures: Figures, stage: str, size: tuple[int, int]) -> float:
    """Seconds of a stage for a frame of a size: between the sizes of a method, else as much more than the default's."""
    sizes = [f for f in table if f.config == figures.config]
    if len(sizes) > 1:
        return _between(sizes, stage, math.prod(size))
    standard = [
        f for f in table if f.config == _nearest(_standard_figures(table), PRESETS[DEFAULT_PRESET].config).config
    ]
    here, there = (_between(standard, stage, math.prod(each)) for each in (size, figures.setting.size))
    return max(0.0, here + figures.seconds[stage] - there)


def _between(sizes: Sequence[Figures], stage: str, pixels: int) -> float:
    """A line from size to size; beyond, in proportion to the pixels."""
    points = sorted((math.prod(f.setting.size), f.seconds[stage]) for f in sizes)
    places, seconds = zip(*points, strict=True)
    inside = min(max(pixels, places[0]), places[-1])
    return float(np.interp(inside, places, seconds) * pixels / inside)
