"""Several files that appear in a folder together, or not at all."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from omnisyn_cli.errors import WriteError
from omnisyn_cli.io.paths import check_folder, check_output, temporary_name, write_errors

__all__ = ["check_staged_folder", "hidden_folder", "staged_folder"]


def check_staged_folder(folder: Path) -> None:
    """Refuse a folder that :func:`staged_folder` could not fill, before any work; it need not exist, its parent must.

    Raises:
        OutputPathError: no such parent, not a folder, or not writable.
    """
    check_folder(folder if folder.exists() else folder.parent)


@contextmanager
def hidden_folder(folder: Path) -> Iterator[Path]:
    """Give a hidden folder on the same disk as ``folder``; it is gone afterwards, whatever happens.

    Raises:
        WriteError: the disk is full; the message names the file as it would be called in ``folder``.
    """
    temporary = temporary_name(folder if folder.is_dir() else folder.parent)
    try:
        with write_errors(folder):
            temporary.mkdir()
        yield temporary
    except WriteError as error:
        raise WriteError(str(error).replace(str(temporary), str(folder))) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def staged_folder(folder: Path, *, overwrite: bool = True) -> Iterator[Path]:
    """Give a hidden folder to write into; its files move into ``folder`` at the end, and are gone after any failure.

    Args:
        folder: need not exist; its parent must.
        overwrite: replace files of the same names, those included that appeared during the work.

    Raises:
        OutputPathError: there is a file of one of the names, and ``overwrite`` is off.
        WriteError: the disk is full, or the folder went away.
    """
    with hidden_folder(folder) as temporary:
        yield temporary
        with write_errors(folder):
            folder.mkdir(exist_ok=True)
            files = sorted(temporary.iterdir())
            for file in files:
                check_output(folder / file.name, overwrite)
            for file in files:
                file.replace(folder / file.name)
