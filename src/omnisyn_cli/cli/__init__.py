"""The command ``omnisyn``: a thin skin over the library.

Every command lives in a module of its own that is imported when the command is named, so that ``omnisyn --help`` is
instant.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

import click

from omnisyn_cli import __version__
from omnisyn_cli.errors import OmnisynError

__all__ = ["cli", "main"]

COMMANDS = {
    "interpolate": ("omnisyn_cli.cli.interpolate", "Make the 360° video between two or more posed panoramas."),
    "info": ("omnisyn_cli.cli.info", "Show what the program sees in panoramas, depth, pose files and videos."),
    "scenes": ("omnisyn_cli.cli.scenes", "Make procedural scenes with exact depth and poses."),
}
"""Module and one-line help of every command; the command has the name of its key."""

INTERRUPTED = 130


class LazyGroup(click.Group):
    """A group whose commands are imported when they are called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order in which a newcomer needs them."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of that name, imported now."""
        if cmd_name not in COMMANDS:
            return None
        command = getattr(importlib.import_module(COMMANDS[cmd_name][0]), cmd_name.replace("-", "_"))
        if not isinstance(command, click.Command):
            raise TypeError(f"expected a command in {COMMANDS[cmd_name][0]}, got {type(command)}")
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The list of commands, without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="omnisyn")
def cli() -> None:
    """The 360° video between two panoramas.

    \b
    omnisyn interpolate first.jpg second.jpg --poses poses.json -o video.mp4

    Panoramas are equirectangular images; a pose file says where each was taken.

    Exit codes: 0 done, 1 failed, 2 wrong usage, 3 unusable input, 130 interrupted.
    """


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and leave with its exit code; errors of this package become one line on stderr."""
    sys.exit(_run(arguments))


def _run(arguments: Sequence[str] | None) -> int:
    try:
        result = cli.main(args=list(arguments) if arguments is not None else None, prog_name="omnisyn", standalone_mode=False)
    except click.exceptions.Exit as exit_request:
        return exit_request.exit_code
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except OmnisynError as error:
        click.echo(f"omnisyn: {error}", err=True)
        return error.exit_code
    except (KeyboardInterrupt, click.Abort):
        click.echo("omnisyn: interrupted; nothing was left half written", err=True)
        return INTERRUPTED
    except MemoryError:
        click.echo("omnisyn: expected enough memory, got none; try a smaller --size (see --dry-run)", err=True)
        return 1
    return result if isinstance(result, int) else 0
