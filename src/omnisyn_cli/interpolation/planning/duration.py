"""How long a job takes on this machine, and which preset shows the best picture within a number of seconds.

The table (:data:`TABLE_NAME`) has seconds of computing of one core of the machine that it was measured on: once, for
each pair, and for each frame by its size. A small piece of work (:func:`probe`) compares that machine with this one.
Only presets of the scale from fast to balanced are chosen: what is there to compare with is neither.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from omnisyn_cli.compute.threads import available_threads
from omnisyn_cli.errors import InputError
from omnisyn_cli.interpolation.plan import InterpolationPlan, with_preset
from omnisyn_cli.interpolation.planning.figures import FRAME_STAGES, Figures, gain, quality, read_table
from omnisyn_cli.pipeline.config import RunConfig
from omnisyn_cli.pipeline.presets import SCALE

TABLE_NAME = "pareto.json"  # figures of speed that come with the program

# Set by hand: n threads do as much as n to this power; factor between what is expected and its bounds; tries of the
# probe, the fastest of which counts, as others may disturb it.
THREAD_SCALING_EXPONENT, SPREAD, PROBE_REPEATS = 0.75, 2.0, 4


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
    numbers = low / unit, high / unit
    steps = [1 if number < 10 else 5 if number < 40 else 10 for number in numbers]
    first, last = (max(1, step * round(number / step)) for number, step in zip(numbers, steps, strict=True))
    return f"{first} to {last} {name}" if first < last else f"{last} {name}"


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
    """What a job will take on this machine; None where its depth, renderer or fusion was never measured."""
    table, config = shipped_table() if table is None else table, plan.config
    is_found = config.estimates_depth
    # the answers of a network of the user's are counted besides
    finders = _alike(
        table, config, lambda other: is_found and (other.depth.kind, other.depth.model, other.depth.prior is None)
    )
    sizes = _alike(table, config, lambda other: (other.renderer, other.fusion, other.edges))
    prior_seconds = plan.prior_cost.seconds
    if not (finders and sizes and config.draws_surfaces) or prior_seconds is None:
        return None
    panoramas, found = len(plan.entries), finders[0].seconds
    pair = found["check"] + found["mesh"] + (found["depth"] if is_found else 0.0)
    decoding = found["decode"] / 2 * math.prod(max(plan.source_sizes)) / math.prod(finders[0].source)
    frames = max(len(plan.path) - panoramas, 0) * _seconds_per_frame(sizes, math.prod(plan.size))
    threads = min(plan.job.threads or available_threads(), available_threads())
    work = panoramas * decoding + (panoramas - 1) * pair + frames
    slowness = probe() / median(figures.probe for figures in table)
    return Duration(slowness * (found["start"] + work / threads**THREAD_SCALING_EXPONENT) + prior_seconds)


def _alike(table: Sequence[Figures], config: RunConfig, trait: Callable[[RunConfig], Any]) -> list[Figures]:
    """Those of settings that share a trait with a config; the most similar rows first."""
    alike = [f for f in table if f.config.draws_surfaces and trait(f.config) == trait(config)]
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


def apply_budget(plan: InterpolationPlan, budget: float) -> InterpolationPlan:
    """The plan with the preset of :func:`choose_preset` and a note. InputError: it asks for what was not measured."""
    _check_measured(plan)
    table = shipped_table()
    if plan.config.estimates_depth:
        preset, note = choose_preset(plan, table, budget)
        plan = with_preset(plan, preset)
    else:
        expected = expected_duration(plan, table)
        if expected is None:
            raise InputError(
                "expected a renderer and a fusion that were measured with a budget, got others; leave it out"
            )
        note = (
            f"depth comes from files, so presets make no difference: expected to take {expected.words}, "
            f"{'within' if expected.seconds <= budget else 'more than'} the budget of {budget:g} s"
        )
    return replace(plan, notes=(*plan.notes, note))


def _check_measured(plan: InterpolationPlan) -> None:
    """Pictures were compared with presets as they are; depth from files takes no time."""
    job = plan.job
    asked = {
        "renderer": (plan.config.renderer, ("mesh",)),
        "depth": (job.depth, ("auto", "file", "refined")),
        "model": (job.model, (None,)),
        "depth_prior": (job.depth_prior, (None,)),
        "fusion": (job.fusion, ("auto",)),
    }
    for name, (given, measured) in asked.items():
        if given not in measured:
            default = f"the {name} {measured[0]!r}" if measured[0] else f"no {name}"
            raise InputError(
                f"expected {default} with a budget, got {given!r}, with which presets were not compared; leave one of "
                "them out"
            )


def choose_preset(plan: InterpolationPlan, table: Sequence[Figures], budget: float) -> tuple[str, str]:
    """The preset of the best picture within ``budget`` seconds, else the fastest; and a note about it.

    InputError: none was measured.
    """
    measured = {name: found for name in SCALE if (found := _scored(table, name)) is not None}
    durations = {name: expected_duration(with_preset(plan, name), table) for name in measured}
    expected = {name: duration for name, duration in durations.items() if duration is not None}
    if not expected:
        raise InputError(f"expected figures of {', '.join(SCALE)} in the table, got none; run omnisyn bench --store")
    fitting = [name for name, duration in expected.items() if duration.seconds <= budget]
    fastest = next(iter(expected))  # by the scale: runs that are remembered may be of one preset, on a busy machine
    chosen = max(fitting, key=lambda name: quality(measured[name]), default=fastest)
    note = f"preset {chosen} for a budget of {budget:g} s: expected to take {expected[chosen].words}"
    if not fitting:
        note = (
            f"even the fastest preset, {chosen}, is expected to take {expected[chosen].words}, more than the budget of "
            f"{budget:g} s; it is taken (fewer frames or a smaller --size help)"
        )
    best = max(expected, key=lambda name: quality(measured[name]))
    if best != chosen:
        gained, error = gain(measured[best], measured[chosen])
        note += (
            f"; {best} would take {expected[best].words} for {gained:+.2f} ± {error:.2f} dB "
            f"(the mean of {len(measured[best].scores)} scenes of omnisyn bench)"
        )
    return chosen, note


def _scored(table: Sequence[Figures], preset: str) -> Figures | None:
    """Figures of a preset in the size with the most pixels that it has scores in."""
    rated = [f for f in table if f.scores and f.config == SCALE[preset].config]
    return max(rated, key=lambda f: math.prod(f.setting.size), default=None)
