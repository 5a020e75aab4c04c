"""What is said on stderr before and while a command works.

Memory that is short, what killed runs have left, how far it is, and why nothing happens for a while.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omnisyn_cli.cli.terminal import printable, say

if TYPE_CHECKING:
    from rich.progress import Progress, ProgressColumn, TaskID

# Printed once, before the first run compiles.
COMPILING_NOTE = "note: compiling kernels for the first run of this kind: about half a minute"
MIN_BAR_SECONDS = 1.5  # seconds of compiling that nobody needs to be told about

COMPILING_AGAIN = (
    "note: compiling the kernels, about a minute each time: there is no place to keep them; set NUMBA_CACHE_DIR to a "
    "folder that can be written"
)


def say_when_compiling(*, is_quiet: bool) -> AbstractContextManager[None]:
    """Says once that kernels are compiled if that takes a while inside, which only the first run does."""
    from omnisyn_cli.compute.jit import are_kernels_kept, when_compiling

    def tell() -> None:
        if not is_quiet:
            say(COMPILING_NOTE if are_kernels_kept() else COMPILING_AGAIN, err=True)

    return when_compiling(tell, MIN_BAR_SECONDS)


@contextmanager
def working_folder(report: Path | None, *, is_quiet: bool) -> Iterator[Path]:
    """The folder of a report, else one that is gone afterwards; inside it is said when kernels are compiled."""
    from omnisyn_cli.io.outputs import scratch_folder

    with ExitStack() as stack:
        stack.enter_context(say_when_compiling(is_quiet=is_quiet))
        folder = report or stack.enter_context(scratch_folder())
        for note in leftover_notes(folder) if report is None and not is_quiet else ():
            say(f"note: {note}", err=True)
        yield folder


def is_watched(*, is_quiet: bool) -> bool:
    """Whether somebody sees a bar."""
    return not is_quiet and sys.stderr.isatty()


def drawn_bars(*columns: ProgressColumn, **options: Any) -> Progress:
    """Bars on stderr with a name before each, and more columns after it."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    return Progress(TextColumn("{task.description}"), BarColumn(), *columns, console=Console(stderr=True), **options)


@contextmanager
def counted_bar(
    begins: str, total: int, name: Callable[..., str], *, is_quiet: bool
) -> Iterator[Callable[..., None] | None]:
    """A bar with the time left on stderr, a line for everything that is done where that is no terminal, None if quiet.

    What is yielded takes how many of ``total`` are done, and what was done last; ``name`` makes of these what stands
    before the bar, as ``begins`` does at first. While kernels are compiled, the bar says that instead.
    """
    if not is_watched(is_quiet=is_quiet):
        yield None if is_quiet else (lambda done, *what: say(f"{done}/{total} {name(done, *what)}", err=True))
        return
    from rich import progress

    from omnisyn_cli.compute.jit import while_compiling

    with drawn_bars(progress.MofNCompleteColumn(), progress.TimeRemainingColumn(), transient=True) as bars:
        task, shown = bars.add_task(begins, total=total), [begins]

        def show(done: int, *what: Any) -> None:
            shown[0] = name(done, *what)
            bars.update(task, completed=done, description=shown[0])

        with while_compiling(lambda begun: bars.update(task, description="compiling" if begun else shown[0])):
            yield show


# What is said of each stage, in order.
STAGES: Mapping[str, str] = {
    "poses": "finding poses", "reading": "reading panoramas", "depth": "finding depth", "frames": "making frames",
    "writing": "writing",
}  # fmt: skip
UNCOUNTED_STAGES = ("poses", "reading")  # stages that are over when the next one begins
# The stage that a time of :class:`omnisyn_cli.compute.stopwatch.Stopwatch` belongs to.
STAGE_OF_CLOCK: Mapping[str, str] = {"decode": "reading", "depth": "depth", "pack": "writing", "write": "writing"}


class Stages:
    """The stages of a command: a bar for each on a terminal; else, without ``bars``, a line when one begins."""

    def __init__(self, bars: Progress | None, *, is_quiet: bool) -> None:
        self._bars, self._is_quiet, self._begin = bars, is_quiet, time.monotonic()
        self._totals: dict[str, int] = {}
        self._tasks: dict[str, TaskID] = {}
        self._begun: list[str] = []
        self._pairs = 0
        self.has_bars = bars is not None  # among which nobody else may print

    def note(self, line: str) -> None:
        """Print a line on stderr, above bars if there are any."""
        if self._bars is not None:
            self._bars.console.print(printable(line), markup=False, highlight=False, soft_wrap=True)
        elif not self._is_quiet:
            say(line, err=True)

    def log(self, line: str) -> None:
        """The same with the time since the beginning."""
        seconds = int(time.monotonic() - self._begin)
        self.note(f"[{seconds // 60}:{seconds % 60:02}] {line}")

    def expect(self, **totals: int) -> None:
        """Show bars of stages that are to come, with how much there is to do."""
        self._totals |= totals
        for stage in totals if self._bars is not None else ():
            self._add(stage)

    def show(self, stage: str, done: int | None = None) -> None:
        """Say that a stage goes on, and how much of it is done."""
        if stage not in self._begun:
            self._begun.append(stage)
            self._start(stage)
        if self._bars is not None and done is not None:
            self._bars.update(self._tasks[stage], completed=done)

    def time(self, clocked: str) -> None:
        """The same by what a stopwatch times; depth of a pair is done when it is checked.

        What is written before all panoramas are read and all depth is found is not worth a word.
        """
        if clocked == "check":
            self._pairs += 1
            self.show("depth", self._pairs)
        elif clocked in STAGE_OF_CLOCK:
            stage = STAGE_OF_CLOCK[clocked]
            has_depth = "depth" not in self._begun or self._pairs >= self._totals.get("depth", 0)
            if stage != "writing" or ("reading" in self._begun and has_depth):
                self.show(stage)

    def compile(self, is_begun: bool) -> None:
        """Say that kernels are compiled, or what went on before."""
        if self._bars is not None and self._begun:
            stage = self._begun[-1]
            self._bars.update(self._tasks[stage], description="compiling" if is_begun else STAGES[stage])

    def _add(self, stage: str) -> None:
        if self._bars is not None and stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(STAGES[stage], start=False, total=self._totals.get(stage))

    def _start(self, stage: str) -> None:
        if self._bars is None:
            count = self._totals.get(stage, 0)
            self.log(f"{STAGES[stage]} ({count})" if count > 1 else STAGES[stage])
            return
        for before in self._begun[:-1]:
            if before in UNCOUNTED_STAGES:
                total = self._totals.get(before, 1)
                self._bars.update(self._tasks[before], total=total, completed=total)
        self._add(stage)
        self._bars.start_task(self._tasks[stage])


@contextmanager
def shown_stages(*, is_quiet: bool) -> Iterator[Stages]:
    """Stages from the first second on; what is timed inside tells its own."""
    with ExitStack() as stack:
        bars = None
        if is_watched(is_quiet=is_quiet):
            from rich import progress

            times = (progress.TimeElapsedColumn(), progress.TimeRemainingColumn(compact=True))
            bars = stack.enter_context(drawn_bars(progress.MofNCompleteColumn(), *times, transient=True))
        yield Stages(bars, is_quiet=is_quiet)


CGROUP_LIMIT = Path("/sys/fs/cgroup/memory.max")  # where Linux says what a container may have: bytes, or ``max``


def memory_notes(expected: float) -> Iterator[str]:
    """What there is to say if ``expected`` bytes are more than this process may have."""
    limit = memory_limit()
    if limit is None or expected <= limit:
        return
    yield (
        f"expected {expected / 1e9:.1f} GB of memory, got a limit of {limit / 1e9:.1f}; the system "
        "may end this program: take a smaller --size or fewer --threads"
    )


def memory_limit() -> int | None:
    """The least of the memory, its container's limit and its user's limits, in bytes; None where nobody says."""
    limits = []
    with suppress(ImportError, OSError):
        import resource

        soft = (resource.getrlimit(limit)[0] for limit in (resource.RLIMIT_AS, resource.RLIMIT_DATA))
        limits += [limit for limit in soft if limit != resource.RLIM_INFINITY]
    with suppress(OSError, ValueError):
        limits.append(int(CGROUP_LIMIT.read_text(encoding="ascii")))
    with suppress(AttributeError, OSError, ValueError):
        limits.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    return min(limits, default=None)


def leftover_notes(*outputs: Path, pictures: Path | None = None) -> Iterator[str]:
    """What runs that were killed have left where outputs go and anywhere in ``pictures``, and how to remove it."""
    import shlex

    from omnisyn_cli.io.outputs import abandoned

    deeper = sorted(pictures.glob("**/")) if pictures else []
    folders = dict.fromkeys((*(folder for output in outputs for folder in (output.parent, output)), *deeper))
    found = [left for folder in folders for left in abandoned(folder)]
    if found:
        names = " ".join(shlex.quote(str(path)) for path in found)
        yield f"runs that were killed have left hidden files; nothing needs them, remove them with: rm -r {names}"
