"""What is said where nothing happens for a while."""

from __future__ import annotations

from contextlib import AbstractContextManager

import click

__all__ = ["say_when_compiling"]

COMPILING = "note: compiling the kernels, once per installation: about a minute"


def say_when_compiling(*, is_quiet: bool) -> AbstractContextManager[None]:
    """Says once that kernels are compiled if any are inside, which only the first run does."""
    from omnisyn_cli.jit import when_compiling

    return when_compiling(lambda: None if is_quiet else click.echo(COMPILING, err=True))
