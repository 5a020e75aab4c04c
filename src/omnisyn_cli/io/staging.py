"""Several files that appear in a folder together, or not at all."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from omnisyn_cli.io.paths import check_folder, temporary_name, write_errors

__all__ = ["check_staged_folder", "staged_folder"]


def check_staged_folder(folder: Path) -> None:
    """Refuse a folder that :func:`staged_folder` could not fill, before any work; it need not exist, its parent must.

    Raises:
        OutputPathError: no such parent, not a folder, or not writable.
    """
    check_folder(folder if folder.exists() else folder.parent)


@contextmanager
def staged_folder(folder: Path) -> Iterator[Path]:
    """Give a hidden folder to write into; its files move into ``folder`` at the end, and are gone after any failure.

    Raises:
        WriteError: the disk is full, or the folder went away.
    """
    temporary = temporary_name(folder if folder.is_dir() else folder.parent)
    try:
        with write_errors(folder):
            temporary.mkdir()
        yield temporary
        with write_errors(folder):
            folder.mkdir(exist_ok=True)
            for file in sorted(temporary.iterdir()):
                file.replace(folder / file.name)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
