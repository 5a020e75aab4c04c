"""Where files go: checks before any work begins, and writing that is seen whole or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from omnisyn_cli.errors import InputError, OutputPathError, WriteError

__all__ = [
    "check_folder",
    "check_kept",
    "check_name",
    "check_output",
    "make_folder",
    "read_text",
    "replaced_when_complete",
    "temporary_name",
    "write_errors",
]


def read_text(path: Path, what: str, largest: int, error: type[InputError] = InputError) -> str:
    """The text of a file that users write, in UTF-8 with or without a byte order mark.

    Args:
        path: of the file.
        what: it should be, for the message, such as ``a manifest``.
        largest: bytes; more is refused before anything is read.
        error: raised where the file is missing, unreadable, too large, or no UTF-8.
    """
    try:
        size = path.stat().st_size
        if size > largest:
            raise error(f"{path}: expected at most {largest:,} bytes, got {size:,}; split the file")
        return path.read_text(encoding="utf-8-sig")
    except OSError as failure:
        raise error(f"{path}: expected {what}, got '{failure.strerror}'; check the name") from failure
    except ValueError as failure:
        raise error(f"{path}: expected UTF-8 text, got '{failure}'; save the file as UTF-8") from failure


def make_folder(folder: Path, what: str) -> None:
    """Make a folder, and those above it, unless it is there.

    Raises:
        OutputPathError: it cannot be made; the message says that a folder for ``what`` was expected.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputPathError(
            f"{folder}: expected a folder for {what}, got '{error.strerror}'; choose another place"
        ) from error


def check_kept(outputs: Iterable[Path], inputs: Iterable[Path], *, whole_folders: bool = False) -> None:
    """Refuse outputs that would overwrite what they are made of.

    Args:
        outputs: files and folders that will be written.
        inputs: what they are made of.
        whole_folders: outputs that are folders are replaced with everything in them, not added to.

    Raises:
        OutputPathError: one would.
    """
    replaced = {output.resolve() for output in outputs}
    for path in inputs:
        source = path.resolve()
        if source in replaced or (whole_folders and not replaced.isdisjoint(source.parents)):
            raise OutputPathError(f"{path}: expected inputs that are not overwritten, got this one; write elsewhere")


def check_output(path: Path | str, overwrite: bool = False) -> None:
    """Refuse a file that could not be written, before any work is done for it.

    Raises:
        OutputPathError: it exists and ``overwrite`` is off, it is a folder, or its folder is missing or read-only.
    """
    target = Path(path)
    check_name(target)
    check_folder(target.parent)
    is_folder, exists = target.is_dir(), target.exists() or target.is_symlink()
    if is_folder:
        raise OutputPathError(f"{target}: expected a file name, got a folder; add a file name to it")
    if exists and not overwrite:
        raise OutputPathError(
            f"{target}: expected a new file, got one that exists; choose another or allow overwriting (--overwrite)"
        )


def check_name(path: Path) -> None:
    """Refuse names that the system cannot give to anything: too long, or with characters that it does not know.

    Raises:
        OutputPathError: it is one of those.
    """
    try:
        path.is_symlink()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputPathError(f"{path!s:.200}: expected a name for a file, got '{reason}'; choose another") from error


def check_folder(folder: Path) -> None:
    """Refuse a folder that new files cannot be put into.

    Raises:
        OutputPathError: it is missing, not a folder, or not writable.
    """
    if not folder.exists():
        raise OutputPathError(f"{folder}: expected an existing folder to write into, got none; create it first")
    if not folder.is_dir():
        raise OutputPathError(f"{folder}: expected a folder to write into, got a file; choose another output path")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputPathError(
            f"{folder}: expected a writable folder, got a read-only one; choose another or change its permissions"
        )


def temporary_name(folder: Path, suffix: str = "") -> Path:
    """A new hidden name inside ``folder``; nothing is created."""
    return folder / f".omnisyn-{secrets.token_hex(8)}{suffix}"


@contextmanager
def replaced_when_complete(path: Path) -> Iterator[Path]:
    """Give a temporary name beside ``path``; rename it to ``path`` at the end, remove it after any failure.

    Raises:
        WriteError: the disk is full, or the folder went away.
    """
    temporary = temporary_name(path.parent, path.suffix)
    try:
        with write_errors(path):
            yield temporary
            temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def write_errors(path: Path) -> Iterator[None]:
    """Turn the system's errors into :class:`WriteError` about ``path``."""
    try:
        yield
    except OSError as error:
        raise WriteError(
            f"{path}: expected to write it, got '{error.strerror or error}'; check free space and permissions"
        ) from error
