"""How long a job will take on this machine: a table of measured seconds, and how fast this machine is.

The table (:data:`TABLE_NAME`) has seconds of computing of one core of the machine that it was measured on: once, for
each pair, and for each frame by its size. A small piece of work (:func:`probe`) compares that machine with this one.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from statistics import median

import numpy as np

from omnisyn_cli.compute.threads import available_threads
from omnisyn_cli.interpolation.plan import InterpolationPlan
from omnisyn_cli.interpolation.planning.figures import FRAME_STAGES, Figures, read_table
from omnisyn_cli.pipeline.config import RunConfig

TABLE_NAME = "pareto.json"
"""Figures of speed that come with the program."""

THREAD_SCALING_EXPONENT = 0.75
"""A guess: n threads do as much as n to this power."""

SPREAD = 2.0
"""Factor between what is expected and its bounds. Set by hand."""

PROBE_REPEATS = 4
"""Of the probe of speed; the fastest counts, as others may disturb it. Set by hand."""


@dataclass(frozen=True)
class Duration:
    """What a job is expected to take: seconds on the clock."""

    seconds: float

    @property
    def bounds(self) -> tuple[float, float]:
        """Seconds between which a run usually stays."""
        return self.seconds / SPREAD, self.seconds * SPREAD

    @property
    def words(self) -> str:
        """That for people, such as "about 20 to 40 s"."""
        return f"about {range_in_words(*self.bounds)}"


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

    Numbers are looked up here and there and added one after the other, which no processor has special instructions for.
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
    """What a job will take on this machine; None where its depth, renderer or fusion was never measured.

    InputError: the table that came with the program is missing or damaged.
    """
    table, config = shipped_table() if table is None else table, plan.config
    finder = _figures(table, config, is_of_depth=True)
    sizes = _figures(table, config, is_of_depth=False)
    if not (finder and sizes and config.draws_surfaces):
        return None
    panoramas, found = len(plan.entries), finder[0].seconds
    pair = found["check"] + found["mesh"] + (found["depth"] if config.estimates_depth else 0.0)
    decoding = found["decode"] / 2 * math.prod(max(plan.source_sizes)) / math.prod(finder[0].source)
    frame = _seconds_per_frame(sizes, math.prod(plan.size))
    frames = max(len(plan.path) - panoramas, 0)
    threads = min(plan.job.threads or available_threads(), available_threads())
    work = panoramas * decoding + (panoramas - 1) * pair + frames * frame
    slowness = probe() / median(figures.probe for figures in table)
    return Duration(slowness * (found["start"] + work / threads**THREAD_SCALING_EXPONENT))


def _figures(table: Sequence[Figures], config: RunConfig, *, is_of_depth: bool) -> list[Figures]:
    """Those of settings whose depth is found alike, or whose frames are drawn alike; the most similar rows first."""

    def is_like(other: RunConfig) -> bool:
        if is_of_depth:
            return not config.estimates_depth or (other.depth.kind, other.depth.networks) == (
                config.depth.kind, config.depth.networks
            )  # fmt: skip
        return (other.renderer, other.fusion, other.edges) == (config.renderer, config.fusion, config.edges)

    alike = [f for f in table if f.config.draws_surfaces and is_like(f.config)]
    return sorted(alike, key=lambda f: (abs(math.log2(f.config.depth.rows / config.depth.rows)), -f.pairs))


def _seconds_per_frame(sizes: Sequence[Figures], pixels: int) -> float:
    """A line from size to size of one setting; beyond, in proportion to the pixels."""
    points = sorted(
        (math.prod(f.setting.size), sum(f.seconds[stage] for stage in FRAME_STAGES))
        for f in sizes
        if f.config == sizes[0].config
    )
    places, seconds = zip(*points, strict=True)
    inside = min(max(pixels, places[0]), places[-1])
    return float(np.interp(inside, places, seconds) * pixels / inside)
