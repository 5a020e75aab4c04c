"""Commands in processes of their own that can be killed, and what they leave behind."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import omnisyn_cli

SOURCES = str(Path(omnisyn_cli.__file__).parents[1])
TESTS = str(Path(__file__).resolve().parents[1])

LONGEST = 300.0
"""Seconds that a small command may take on a busy machine."""


def command_line(*arguments: object) -> list[str]:
    """``omnisyn arguments…`` as this interpreter runs it."""
    return [sys.executable, "-m", "omnisyn_cli", *map(str, arguments)]


def start(command: Sequence[str], folder: Path) -> subprocess.Popen[bytes]:
    """A process in a folder, with the package of this checkout."""
    path = os.pathsep.join([SOURCES, TESTS, str(Path(TESTS) / "training")])
    variables = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(command, cwd=folder, env=variables, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def finish(command: Sequence[str], folder: Path) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command that is left in peace."""
    with start(command, folder) as process:
        out, err = process.communicate(timeout=LONGEST)
        return process.returncode, out.decode(), err.decode()


def kill_after(command: Sequence[str], folder: Path, seconds: float) -> bool:
    """Start a command and ``kill -9`` it; whether it was still at work then."""
    with start(command, folder) as process:
        try:
            process.wait(seconds)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            return True
        process.communicate()
        return False


def duration(command: Sequence[str], folder: Path) -> float:
    """Seconds that a command takes here and now; it has to succeed."""
    begin = time.monotonic()
    code, _, err = finish(command, folder)
    assert code == 0, err
    return time.monotonic() - begin


def visible_files(folder: Path) -> dict[str, bytes]:
    """Every file below a folder that has a final name: neither it nor a folder above it is hidden or partial."""
    found = {}
    for path in sorted(folder.rglob("*")):
        parts = path.relative_to(folder).parts
        if path.is_file() and not any(part.startswith(".") or part.endswith(".partial") for part in parts):
            found["/".join(parts)] = path.read_bytes()
    return found
