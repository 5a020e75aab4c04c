"""What is said where nothing happens for a while."""

from __future__ import annotations

from contextlib import AbstractContextManager

import click

__all__ = ["say_when_compiling"]

COMPILING = "note: compiling the kernels, once per installation: about a minute"

COMPILING_AGAIN = (
    "note: compiling the kernels, about a minute each time: there is no place to keep them; set NUMBA_CACHE_DIR to a "
    "folder that can be written"
)


def say_when_compiling(*, is_quiet: bool) -> AbstractContextManager[None]:
    """Says once that kernels are compiled if any are inside, which only the first run does."""
    from omnisyn_cli.jit import are_kernels_kept, when_compiling

    def say() -> None:
        if not is_quiet:
            click.echo(COMPILING if are_kernels_kept() else COMPILING_AGAIN, err=True)

    return when_compiling(say)
