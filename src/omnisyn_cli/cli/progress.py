"""What is said on stderr while a command works: how far it is, and why nothing happens for a while."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omnisyn_cli.cli.terminal import printable, say

if TYPE_CHECKING:
    from rich.progress import Progress, ProgressColumn, TaskID

COMPILING_NOTE = "note: compiling kernels for the first run of this kind: about half a minute"
"""Printed once, before the first run compiles."""

MIN_BAR_SECONDS = 1.5
"""Seconds of compiling that nobody needs to be told about."""

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
def working_folder(report: Path | None, command: str, *, is_quiet: bool) -> Iterator[Path]:
    """The folder of a report, else one that is gone afterwards; inside it is said when kernels are compiled."""
    import tempfile

    with ExitStack() as stack:
        stack.enter_context(say_when_compiling(is_quiet=is_quiet))
        yield report or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix=f"omnisyn-{command}-")))


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
    begins: str, total: int, name: Callable[..., str | None], *, is_quiet: bool, has_lines: bool = False
) -> Iterator[Callable[..., None] | None]:
    """A bar with the time left on stderr; what is yielded takes how many are done, and perhaps what was done last.

    While kernels are compiled, the bar says that instead.

    Args:
        begins: what stands before the bar at first.
        total: how many there are to be done.
        name: what stands before the bar then, of the same arguments; None leaves it as it is.
        is_quiet: there is no bar then, nor where stderr is no terminal, and None is yielded.
        has_lines: where stderr is no terminal, say everything that is done in a line.
    """
    if not is_watched(is_quiet=is_quiet):
        is_said = has_lines and not is_quiet
        yield (lambda done, *what: say(f"{done}/{total} {name(done, *what)}", err=True)) if is_said else None
        return
    from rich import progress

    from omnisyn_cli.compute.jit import while_compiling

    with drawn_bars(progress.MofNCompleteColumn(), progress.TimeRemainingColumn(), transient=True) as bars:
        task, shown = bars.add_task(begins, total=total), [begins]

        def show(done: int, *what: Any) -> None:
            shown[0] = name(done, *what) or shown[0]
            bars.update(task, completed=done, description=shown[0])

        def compile_(is_begun: bool) -> None:
            bars.update(task, description="compiling" if is_begun else shown[0])

        with while_compiling(compile_):
            yield show


STAGES: Mapping[str, str] = {
    "poses": "finding poses",
    "reading": "reading panoramas",
    "depth": "finding depth",
    "frames": "making frames",
    "writing": "writing",
}
"""What is said of each stage, in order."""

UNCOUNTED_STAGES = ("poses", "reading")
"""Stages that are over when the next one begins."""

STAGE_OF_CLOCK: Mapping[str, str] = {
    "decode": "reading", "depth": "depth", "pack": "writing", "write": "writing",
}  # fmt: skip
"""The stage that a time of :class:`omnisyn_cli.compute.stopwatch.Stopwatch` belongs to."""


class Stages:
    """The stages of a command: a bar for each on a terminal; elsewhere a line when one begins.

    Args:
        bars: where bars are drawn; None is no terminal.
        is_quiet: nothing is said at all.
    """

    def __init__(self, bars: Progress | None, *, is_quiet: bool) -> None:
        self._bars, self._is_quiet, self._begin = bars, is_quiet, time.monotonic()
        self._totals: dict[str, int] = {}
        self._tasks: dict[str, TaskID] = {}
        self._begun: list[str] = []
        self._pairs = 0

    @property
    def has_bars(self) -> bool:
        """Whether bars are drawn, among which nobody else may print."""
        return self._bars is not None

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
