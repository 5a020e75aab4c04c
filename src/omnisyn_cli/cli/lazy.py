"""Groups of commands: imported when they are called, so that ``--help`` is instant, and listed in whole sentences."""

import importlib
from collections.abc import Mapping
from typing import Any

import click

from omnisyn_cli.cli.failures import EXIT_CODES_LINE
from omnisyn_cli.cli.help import unknown_command


class SuggestingGroup(click.Group):
    """A group that says which command may have been meant by a word that is none, and what exit codes mean."""

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of that name, whose help ends with the exit codes."""
        command = self.find_command(ctx, cmd_name)
        if command is not None:
            command.epilog = EXIT_CODES_LINE
        return command

    def find_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of that name."""
        return super().get_command(ctx, cmd_name)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command that is named."""
        known = self.list_commands(ctx)
        if args[0] not in known and not args[0].startswith("-") and not ctx.resilient_parsing:
            unknown_command(ctx, args[0], known)
        return super().resolve_command(ctx, args)


class LazyGroup(SuggestingGroup):
    """A group whose commands are imported when they are called.

    Args:
        lazy: module and one-line help of every command, in the order in which a newcomer needs them. The command has
            the name of its key, with ``_`` for ``-``, and one more at the end where that is a word of Python's.
    """

    def __init__(self, *arguments: Any, lazy: Mapping[str, tuple[str, str]], **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.lazy = lazy

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of the table."""
        return list(self.lazy)

    def find_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of that name, imported now."""
        if cmd_name not in self.lazy:
            return None
        module = importlib.import_module(self.lazy[cmd_name][0])
        name = cmd_name.replace("-", "_")
        command = getattr(module, name, None) or getattr(module, f"{name}_", None)
        if not isinstance(command, click.Command):
            raise TypeError(f"expected a command {name} in {module.__name__}, got {type(command)}")
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The list of commands, without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in self.lazy.items()])


class PlainGroup(SuggestingGroup):
    """A group that lists what its commands do in whole sentences, where click cuts off what is longer than a line."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Names with the first paragraph of each command's help."""
        with formatter.section("Commands"):
            commands = ((name, self.commands[name].help or "") for name in self.list_commands(ctx))
            formatter.write_dl([(name, " ".join(text.partition("\n\n")[0].split())) for name, text in commands])
