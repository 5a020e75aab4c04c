"""The process that reads hostile files: one line on stdout before and after each, so that its death is no loss.

``python fuzz_worker.py SEED TARGET:BEGIN:END …`` says ``> TARGET INDEX`` before and ``accepted``, ``refused`` or
``finding WORDS`` after every file.
"""

import os
import random
import resource
import shutil
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import TextIO

from fuzz_mutations import mutated
from fuzz_targets import MEMORY, Target, targets

from omnisyn_cli.errors import OmnisynError
from process_limits import peak_memory

LONGEST_MESSAGE = 20_000  # Characters; a message is for people.
SLOW = 5.0  # Seconds of the processor for one small file.
HARD_LIMIT = 4 << 30  # Bytes of data segment: what tries to take more fails instead of taking the machine down.


def hostile(name: str, target: Target, seed: int, index: int) -> tuple[str, bytes]:
    """Name and bytes of a broken file; the same for the same arguments."""
    rng = random.Random(f"{seed} {name} {index}")  # noqa: S311 - it shall be repeatable
    file = rng.choice(target.broken)
    return file, mutated(target.files[file], rng)


def outcome(target: Target, folder: Path) -> str:
    """What came of reading: ``accepted``, ``refused``, or ``finding …``."""
    begin, peak = time.process_time(), peak_memory()
    try:
        target.read(folder)
        result = "accepted"
    except OmnisynError as error:
        words = str(error)
        is_clear = "expected" in words and len(words) < LONGEST_MESSAGE
        result = "refused" if is_clear else f"finding message: {words[:200]!r}"
    except Exception as error:  # noqa: BLE001 - whatever it is, it is a finding
        where = traceback.extract_tb(error.__traceback__)[-1]
        words = str(error)[:200]
        result = f"finding {type(error).__name__}: {words!r} at {where.filename}:{where.lineno}"
    if (seconds := time.process_time() - begin) > SLOW:
        result = f"finding {seconds:.1f} s"
    if (more := peak_memory() - peak) > MEMORY:
        result = f"finding {more >> 20} MiB"
    return result


def put(folder: Path, name: str, data: bytes) -> None:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


def run(name: str, seed: int, begin: int, end: int, speaker: TextIO) -> None:
    target = targets()[name]()
    with tempfile.TemporaryDirectory(dir=_fast_folder()) as place:
        folder = Path(place) / "in"
        for index in range(begin, end):
            shutil.rmtree(folder, ignore_errors=True)
            for file, data in target.files.items():
                put(folder, file, data)
            if index == begin:
                target.read(folder)  # the good files are read without complaint, and everything is imported
                for file, data in target.files.items():  # a reader of records has added to them
                    put(folder, file, data)
            put(folder, *hostile(name, target, seed, index))
            print(f"> {name} {index}", file=speaker, flush=True)
            print(outcome(target, folder), file=speaker, flush=True)


def _fast_folder() -> str | None:
    return "/dev/shm" if Path("/dev/shm").is_dir() else None  # noqa: S108 - TemporaryDirectory makes its own inside


def main() -> None:
    resource.setrlimit(resource.RLIMIT_DATA, (HARD_LIMIT, HARD_LIMIT))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    speaker = os.fdopen(os.dup(1), "w", encoding="utf-8", errors="replace")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # libraries of images print what they think
    for work in sys.argv[2:]:
        name, begin, end = work.rsplit(":", 2)
        run(name, int(sys.argv[1]), int(begin), int(end), speaker)


if __name__ == "__main__":
    main()
