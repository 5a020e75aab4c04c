"""The command ``omnisyn``: a thin skin over the library.

Every command lives in a module of its own that is imported when the command is named, so that ``omnisyn --help`` is
instant.
"""

import atexit
import gc
import io
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from itertools import takewhile
from pathlib import Path

import click

from omnisyn_cli import __version__
from omnisyn_cli.cli.failures import EXIT_CODES_LINE, EXIT_FAILURE, failure_of
from omnisyn_cli.cli.help import LazyGroup
from omnisyn_cli.cli.signals import signals_raised
from omnisyn_cli.cli.terminal import print_json, say
from omnisyn_cli.errors import WriteError

os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
"""pydantic would look through all that is installed for other people's code, which takes as long as reading poses."""

atexit.register(gc.disable)  # looking for garbage when all is given back anyway takes a twentieth of a dry run

# Module and one-line help of every command; the command has the name of its key.
COMMANDS = {
    "interpolate": ("omnisyn_cli.cli.interpolate", "Make a 360° video between two or more panoramas."),
    "export": ("omnisyn_cli.cli.export", "Write panoramas and depth for other programs: GLB, PLY, COLMAP."),
    "view": ("omnisyn_cli.cli.view", "Make an interactive page to walk through in a browser."),
    "batch": ("omnisyn_cli.cli.batch", "Make all videos of a manifest, on one machine or a Ray cluster."),
    "tag": ("omnisyn_cli.cli.tag", "Write 360° metadata into finished videos and pictures, or check it."),
    "info": ("omnisyn_cli.cli.info", "Show what the program reads in your files."),
    "train": ("omnisyn_cli.cli.train", "Train the networks on generated scenes."),
    "models": ("omnisyn_cli.cli.models", "List the bundled networks."),
    "export-onnx": ("omnisyn_cli.cli.models", "Export a trained network to ONNX."),
    "poses": ("omnisyn_cli.cli.poses", "Import, export, check, refine and estimate poses."),
    "eval": ("omnisyn_cli.cli.evaluate", "Compare methods on scenes with true frames and depth."),
    "bench": ("omnisyn_cli.cli.evaluate", "Measure the cost and gain of settings on this machine."),
    "scenes": ("omnisyn_cli.cli.scenes", "Generate scenes with exact depth and poses."),
}


@click.group(
    cls=LazyGroup, lazy=COMMANDS, epilog=EXIT_CODES_LINE,
    context_settings={"help_option_names": ["-h", "--help"], "show_default": True},
)  # fmt: skip
@click.version_option(__version__, prog_name="omnisyn")
def cli() -> None:
    """Make 360° videos between panoramas.

    \b
    omnisyn interpolate first.jpg second.jpg --poses auto --baseline 1.4
    omnisyn view first.jpg second.jpg --poses auto --baseline 1.4 --open

    Panoramas are equirectangular images. --poses auto estimates where they were taken; --baseline is the distance
    in metres. A pose file can give both instead.
    """  # noqa: D301 - click's \b is a backspace


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and leave with its exit code; errors of this package become one line on stderr."""
    nowhere = Path(os.devnull)  # for a stream that was closed before the program began, which Python leaves out
    sys.stdout, sys.stderr = (each or nowhere.open("w", encoding="utf-8") for each in (sys.stdout, sys.stderr))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a file's name may be what the terminal cannot show
    sys.exit(_run(arguments))


def _run(arguments: Sequence[str] | None) -> int:
    given = sys.argv[1:] if arguments is None else list(arguments)
    try:
        with signals_raised():
            result = cli.main(args=given, prog_name="omnisyn", standalone_mode=False)
    except click.exceptions.Exit as exit_request:
        return exit_request.exit_code
    except click.ClickException as error:
        shown = io.StringIO()
        error.show(shown)
        with suppress(OSError, WriteError):
            for line in shown.getvalue().rstrip("\n").split("\n"):
                say(line, err=True)
        return _failed(error.format_message(), error.exit_code, given, is_said=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # whoever read has gone: flush into nothing
        return EXIT_FAILURE
    except BaseException as error:
        if (failure := failure_of(error)) is None:
            raise
        return _failed(*failure, given)
    return result if isinstance(result, int) else 0


def _failed(message: str, code: int, arguments: Sequence[str], *, is_said: bool = False) -> int:
    """Say why in one line, whatever characters a file's name brought into it, and on stdout to whoever wants JSON."""
    line = " ".join(message.splitlines())
    with suppress(OSError, WriteError):  # there may be nowhere left to say it
        if not is_said:
            say(f"omnisyn: {line}", err=True)
        if "--json" in takewhile(lambda argument: argument != "--", arguments):
            print_json({"error": line, "exit_code": code})
    return code
