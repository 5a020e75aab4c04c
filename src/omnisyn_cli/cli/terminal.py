"""Lines for people on a terminal, which names of files neither break nor command."""

from typing import Any

import click

from omnisyn_cli.errors import WriteError

# Characters that end a line, begin an escape sequence or turn the direction of writing around.
CONTROL_CODES = (
    *range(0x20), *range(0x7F, 0xA0), 0x61C, 0x200E, 0x200F, *range(0x2028, 0x202F), *range(0x2066, 0x206A),
)  # fmt: skip
# For ``str.translate``: control characters become escapes, so that names cannot steer a terminal.
SPELLED_OUT = {code: f"\\u{code:04x}" for code in CONTROL_CODES}


def printable(text: str) -> str:
    """The text with such characters as JSON writes them: a file's name may hold anything."""
    return text.translate(SPELLED_OUT)


def say(line: object, *, err: bool = False) -> None:
    """Print one line on stdout, or on stderr; WriteError: there is no room where it goes."""
    try:
        click.echo(printable(str(line)), err=err)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise WriteError(f"expected to print the result, got '{error.strerror}'; check where it is sent") from error


def print_json(values: Any) -> None:
    """Print plain values on stdout."""
    import json

    for line in json.dumps(values, indent=2, ensure_ascii=False, allow_nan=False).split("\n"):
        say(line)
