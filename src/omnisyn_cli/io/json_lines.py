"""Files of one JSON object in each line, which runs that may be killed at any moment go on with."""

import json
import os
from pathlib import Path
from typing import Any, BinaryIO

from omnisyn_cli.errors import InputError
from omnisyn_cli.io.outputs import write_errors


def append_line(path: Path, value: Any) -> None:
    """Add a line that has reached the disk when this returns; what a killed run left of one is removed first.

    Raises:
        ValueError: a number is infinite or undefined.
        WriteError: the disk is full, or the folder went away.
    """
    line = json.dumps(value, ensure_ascii=False, allow_nan=False) + "\n"
    with write_errors(path), path.open("a+b") as file:
        _drop_unfinished_line(file)
        file.write(line.encode("utf-8", "backslashreplace"))
        file.flush()
        os.fsync(file.fileno())


def complete_lines(path: Path) -> list[str]:
    """All lines but what a killed run left of one; none where there is no such file.

    InputError: the file cannot be read.
    """
    if not path.exists():
        return []
    try:
        complete, _, _ = path.read_bytes().rpartition(b"\n")  # what was cut short may end inside a character
        return complete.decode("utf-8").split("\n") if complete else []
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: expected results of an earlier run, got '{error}'; name another folder") from error


def _drop_unfinished_line(file: BinaryIO) -> None:
    end = file.seek(0, os.SEEK_END)
    if end == 0:
        return
    file.seek(end - 1)
    if file.read(1) != b"\n":
        file.seek(0)
        file.truncate(file.read().rfind(b"\n") + 1)
        file.seek(0, os.SEEK_END)
