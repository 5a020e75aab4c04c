"""Bars on stderr that say how far a command is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

__all__ = ["counted_bar"]


@contextmanager
def counted_bar(
    begins: str, total: int, name: Callable[..., str | None], *, is_shown: bool
) -> Iterator[Callable[..., None] | None]:
    """A bar with the time left on stderr; what is yielded takes how many are done, and perhaps what was done last.

    Args:
        begins: what stands before the bar at first.
        total: how many there are to be done.
        name: what stands before the bar then, of the same arguments; None leaves it as it is.
        is_shown: otherwise there is no bar, and None is yielded.
    """
    if not is_shown:
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(begins, total=total)
        yield lambda done, *what: progress.update(task, completed=done, description=name(done, *what))
