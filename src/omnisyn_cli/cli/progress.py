"""What is said on stderr while a command works: how far it is, and why nothing happens for a while."""

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Any

from omnisyn_cli.cli.terminal import say

COMPILING = "note: compiling the kernels, once per installation: about half a minute"

MIN_BAR_SECONDS = 1.5
"""Seconds of compiling that nobody needs to be told about."""

COMPILING_AGAIN = (
    "note: compiling the kernels, about a minute each time: there is no place to keep them; set NUMBA_CACHE_DIR to a "
    "folder that can be written"
)


def say_when_compiling(
    *, is_quiet: bool, listen: Callable[[str], None] = lambda note: None
) -> AbstractContextManager[None]:
    """Says once that kernels are compiled if that takes a while inside, which only the first run does.

    Args:
        is_quiet: nothing is printed then.
        listen: called with what is, or would have been, said.
    """
    from omnisyn_cli.compute.jit import are_kernels_kept, when_compiling

    def tell() -> None:
        note = COMPILING if are_kernels_kept() else COMPILING_AGAIN
        listen(note)
        if not is_quiet:
            say(note, err=True)

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
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from omnisyn_cli.compute.jit import while_compiling

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task, shown = progress.add_task(begins, total=total), [begins]

        def show(done: int, *what: Any) -> None:
            shown[0] = name(done, *what) or shown[0]
            progress.update(task, completed=done, description=shown[0])

        def compile_(is_begun: bool) -> None:
            progress.update(task, description="compiling" if is_begun else shown[0])

        with while_compiling(compile_):
            yield show
