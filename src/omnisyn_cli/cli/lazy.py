"""Groups of commands: imported when they are called, so that ``--help`` is instant, and listed in whole sentences."""

import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from omnisyn_cli.cli.failures import EXIT_CODES_LINE
from omnisyn_cli.cli.terminal import printable


class PlainGroup(click.Group):
    """A group that lists what its commands do in whole sentences, where click cuts off what is longer than a line.

    It says which command may have been meant by a word that is none, and what exit codes mean.
    """

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of that name, whose help ends with the exit codes."""
        command = super().get_command(ctx, cmd_name)
        if command is not None:
            command.epilog = EXIT_CODES_LINE
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command that is named; UsageError: a word that is none, with those that may have been meant."""
        known = self.list_commands(ctx)
        if args[0] not in known and not args[0].startswith("-") and not ctx.resilient_parsing:
            import difflib

            near = difflib.get_close_matches(args[0], known, n=2, cutoff=0.5)
            if not near and "interpolate" in known and Path(args[0]).exists():
                near = [f"interpolate {args[0]}"]
            advice = f"did you mean {' or '.join(near)}?" if near else f"known are {', '.join(known)}"
            ctx.fail(f"expected a command, got '{printable(args[0])}'; {advice}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Names with the first paragraph of each command's help."""
        with formatter.section("Commands"):
            commands = ((name, self.commands[name].help or "") for name in self.list_commands(ctx))
            formatter.write_dl([(name, " ".join(text.partition("\n\n")[0].split())) for name, text in commands])


class LazyGroup(PlainGroup):
    """A group whose commands are imported when they are called.

    Args:
        lazy: module and one-line help of every command, in the order in which a newcomer needs them. The command has
            the name of its key, with ``_`` for ``-``, and one more at the end where that is a word of Python's.
    """

    def __init__(self, *, lazy: Mapping[str, tuple[str, str]], **options: Any) -> None:
        stubs = {name: click.Command(name, help=text) for name, (_, text) in lazy.items()}
        super().__init__(commands=stubs, **options)
        self.modules = {name: module for name, (module, _) in lazy.items()}

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of the table."""
        return list(self.modules)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of that name, imported now."""
        if cmd_name not in self.modules:
            return None
        module, name = importlib.import_module(self.modules[cmd_name]), cmd_name.replace("-", "_")
        command: click.Command = getattr(module, name, None) or getattr(module, f"{name}_")
        command.epilog = EXIT_CODES_LINE
        return command
