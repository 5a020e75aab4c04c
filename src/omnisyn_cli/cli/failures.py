"""What went wrong in one line, and the exit code that says what kind of thing it was: the same for all commands."""

import errno
from collections.abc import Iterator, Mapping

import click

from omnisyn_cli.cli.signals import Terminated
from omnisyn_cli.errors import OmnisynError

# Exit codes: 1 and 2 are those of click, 130 is a shell's for Ctrl-C, 3 is this program's own.
EXIT_FAILURE, EXIT_USAGE, EXIT_INPUT, EXIT_INTERRUPT = 1, 2, 3, 130
# Meanings, for every command; docs/stability.md says more of each.
EXIT_CODES: Mapping[int, str] = {
    0: "done", EXIT_FAILURE: "failed (or poses do not fit)", EXIT_USAGE: "wrong usage", EXIT_INPUT: "unusable input",
    EXIT_INTERRUPT: "interrupted",
}  # fmt: skip
# Ends the help of all commands.
EXIT_CODES_LINE = f"Exit codes: {', '.join(f'{code} {meaning}' for code, meaning in EXIT_CODES.items())}."
SIGNAL_BASE = 128  # a program that a signal ends has this code plus the number of the signal, as shells count
# What Python, the loader, OpenCV and ONNX Runtime say where memory, or room for threads, has run out.
MEMORY_SIGNS = (
    "can't start new thread", "can't allocate lock", "failed to map segment", "annot allocate memory", "bad_alloc",
    "Insufficient memory", "Failed to allocate memory",
)  # fmt: skip
# Packages that only some commands need, and the extra that brings each.
EXTRAS: Mapping[str, str] = {"torch": "train", "matplotlib": "eval"}

REMEDIES: Mapping[int, str] = {
    errno.EMFILE: "allow more open files (ulimit -n)", errno.ENFILE: "close other programs",
    errno.ENOSPC: "free some space", errno.EDQUOT: "free some space", errno.EIO: "check the disk",
}  # fmt: skip


def failure_of(error: BaseException) -> tuple[str, int] | None:
    """One line and an exit code for what a user can do something about; None for a bug, whose traceback is wanted."""
    match error:
        case OmnisynError():
            return str(error), error.exit_code
        case Terminated():
            return "ended by a signal; nothing was left half written", SIGNAL_BASE + int(error.args[0])
        case KeyboardInterrupt() | click.Abort():
            return "interrupted; nothing was left half written", EXIT_INTERRUPT
    if sign := next(_signs_of_memory(error), ""):
        remedy = "try a smaller --size or fewer --threads (see --dry-run)"
        return f"expected enough memory, got {sign}; {remedy}", EXIT_FAILURE
    match error:
        case ImportError(name=str() as name) if extra := EXTRAS.get(name.split(".")[0]):
            remedy = f"python -m pip install 'omnisyn-cli[{extra}]'"
            return f"expected the package {name}, found none; {remedy}", EXIT_FAILURE
        case OSError(filename=None):
            remedy = REMEDIES.get(error.errno or 0, "check limits and disks")
            reason = f"expected the system to do what the work needs, got '{error.strerror or error}'"
            return f"{reason}; {remedy}", EXIT_FAILURE
        case OSError():
            reason = f"expected a place that can be used, got '{error.strerror or error}'"
            return f"{error.filename}: {reason}; check its name and permissions", EXIT_FAILURE
    return None


def _signs_of_memory(error: BaseException | None) -> Iterator[str]:
    """What says in an error, or in one that led to it, that memory has run out."""
    while error is not None:
        if isinstance(error, MemoryError):
            yield "none"
        elif not isinstance(error, OmnisynError):
            yield from (f"'{sign}'" for sign in MEMORY_SIGNS if sign in str(error))
        error = error.__cause__ or error.__context__
