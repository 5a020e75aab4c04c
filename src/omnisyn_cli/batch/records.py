"""``results.jsonl``: what became of every job, one line each, the last line of a job counts.

A line is on the disk before the next job is recorded. What a power cut left of a line is cut off when the file is
opened again.
"""

import json
import os
import sys
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from omnisyn_cli.errors import OutputPathError
from omnisyn_cli.io.outputs import write_errors

if sys.platform == "win32":  # pragma: no cover

    def _lock(descriptor: int) -> None:
        """No lock; two runs in one folder are not noticed."""
else:
    import fcntl

    def _lock(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def recorded_places(path: Path) -> set[str]:
    """Files and folders that any record of a file names as made by a batch; none where there is no such file.

    Lines that are no records are passed over: :class:`Records` refuses them.
    """
    places: set[str] = set()
    if not path.is_file():
        return places
    with path.open("rb") as lines:
        for line in lines:
            try:
                places.update(json.loads(line)["outputs"])
            except (ValueError, KeyError, TypeError, RecursionError):
                continue
    return places


class Records:
    """The records of a batch, open for one run; a second run at the same time is refused.

    Args:
        path: the file; it is made if it does not exist.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._places: dict[str, int] = {}

    def __enter__(self) -> Self:
        with write_errors(self._path):
            self._file = self._path.open("ab+")
        try:
            self._claim()
            self._read()
        except BaseException:
            self._file.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with write_errors(self._path):  # what did not get through is tried once more
            self._file.close()

    def last(self, key: str) -> dict[str, Any] | None:
        """The last record of a job when the file was opened, read again: a city of jobs does not fit into memory."""
        if key not in self._places:
            return None
        self._file.seek(self._places[key])
        record: dict[str, Any] = json.loads(self._file.readline())
        return record

    def append(self, record: dict[str, Any]) -> None:
        """Add the line of a job and wait until it is on the disk.

        Raises:
            WriteError: the disk is full.
        """
        with write_errors(self._path):
            self._file.write((json.dumps(record, ensure_ascii=False) + "\n").encode())
            self._file.flush()
            os.fsync(self._file.fileno())

    def _claim(self) -> None:
        try:
            _lock(self._file.fileno())
        except OSError as error:
            raise OutputPathError(
                f"{self._path}: expected a folder that no other batch works in, got one in use; wait for its end"
            ) from error

    def _read(self) -> None:
        self._file.seek(0)
        whole = 0
        for line in self._file:
            if not line.endswith(b"\n"):
                break
            try:
                self._places[json.loads(line)["id"]] = whole
            except (ValueError, KeyError, TypeError, RecursionError) as error:
                raise OutputPathError(
                    f"{self._path}: expected records of a batch, got '{error!s:.200}' at byte {whole}; "
                    "move the file away"
                ) from error
            whole += len(line)
        if self._path.stat().st_size > whole:
            self._file.truncate(whole)
