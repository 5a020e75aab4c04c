"""The folder of a batch: work in progress in a hidden folder of it, what is finished under its final name.

A worker that cannot see the folder (on another machine) works in a temporary one and sends the files.
"""

import re
import secrets
import shutil
import tempfile
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from omnisyn_cli.batch.manifest import RECORDS, WORKSHOP
from omnisyn_cli.batch.records import recorded_places
from omnisyn_cli.errors import OutputPathError
from omnisyn_cli.io.encode import IMAGE_SUFFIXES
from omnisyn_cli.io.outputs import check_folder, check_kept, temporary_name, write_errors

Files = Mapping[str, bytes]


def prepare_folder(folder: Path, outputs: Iterable[str], inputs: Iterable[Path], *, overwrite: bool) -> None:
    """Refuse a folder in which a batch would destroy something, and make it if there is none.

    What a batch has recorded may be replaced, and, where a run was killed, what it had no time to record.

    Raises:
        OutputPathError: an output would replace an input, or a file that no batch has written.
    """
    if not folder.exists():
        check_folder(folder.parent)
        folder.mkdir()
    check_folder(folder)
    outputs = list(outputs)
    check_kept((folder / place for place in outputs), inputs, whole_folders=True)
    if overwrite or (folder / WORKSHOP).exists():
        return
    recorded = recorded_places(folder / RECORDS)
    if existing := [place for place in outputs if place not in recorded and (folder / place).exists()]:
        raise OutputPathError(
            f"{folder / existing[0]}: expected new outputs, got {len(existing)} that exist and no record of {RECORDS} "
            "names; choose another folder or allow overwriting (--overwrite)"
        )


@contextmanager
def open_workshop(folder: Path) -> Iterator[str]:
    """Make the hidden folder for work in progress, without what a run that was killed left there; remove it again.

    Yields a token by which a worker can tell whether it sees this folder: :func:`workshop_is_seen`.
    """
    workshop, token = folder / WORKSHOP, secrets.token_hex(16)
    shutil.rmtree(workshop, ignore_errors=True)
    try:
        with write_errors(workshop):
            workshop.mkdir()
            (workshop / token).touch()
        yield token
    finally:
        shutil.rmtree(workshop, ignore_errors=True)


def workshop_is_seen(folder: Path, token: str) -> bool:
    """Whether this is the folder in which somebody, maybe on another machine, called :func:`open_workshop`."""
    return (folder / WORKSHOP / token).exists()


@contextmanager
def attempt_folder(folder: Path | None) -> Iterator[Path]:
    """An empty folder for one attempt at a job, gone afterwards; None is the system's place for such folders."""
    if folder is None:
        with tempfile.TemporaryDirectory(prefix="omnisyn-batch-") as name:
            yield Path(name)
        return
    attempt = temporary_name(folder / WORKSHOP)
    try:
        with write_errors(attempt):
            attempt.mkdir()
        yield attempt
    finally:
        shutil.rmtree(attempt, ignore_errors=True)


def measure(folder: Path, places: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Number of files, bytes, and kinds of names of every place below a folder; 0 files where there is nothing."""
    return {place: _measured(_files(folder / place)) for place in places}


def is_as_measured(folder: Path, places: Iterable[str], measured: Mapping[str, Mapping[str, Any]]) -> bool:
    """Whether there is what :func:`measure` found, whatever else there is with names of other kinds."""
    if set(places) != set(measured):
        return False
    for place, figures in measured.items():
        found = _measured(_of_kinds(_files(folder / place), figures.get("names")))
        if any(found.get(name) != figure for name, figure in figures.items()):
            return False
    return True


def publish(attempt: Path, folder: Path, places: Iterable[str]) -> None:
    """Move what an attempt has made to its final name, in folders in place of files with names of the same kinds.

    Raises:
        WriteError: the disk is full, or the folder went away.
    """
    for place in places:
        made, target = attempt / place, folder / place
        with write_errors(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            if not target.is_dir():
                made.replace(target)
                continue
            files = sorted(made.iterdir())
            for former in _of_kinds(list(target.iterdir()), {_kind(file) for file in files}):
                former.unlink()
            for file in files:
                file.replace(target / file.name)


def pack(attempt: Path, places: Iterable[str]) -> dict[str, bytes]:
    """All files that an attempt has made, by their place."""
    return {
        file.relative_to(attempt).as_posix(): file.read_bytes() for place in places for file in _files(attempt / place)
    }


def unpack(files: Files, folder: Path, places: Iterable[str]) -> None:
    """Write what :func:`pack` took, under final names."""
    with attempt_folder(folder) as attempt:
        for name, content in files.items():
            target = attempt / name
            with write_errors(folder / name):
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(content)
        publish(attempt, folder, places)


def _measured(files: Sequence[Path]) -> dict[str, Any]:
    sizes = [file.stat().st_size for file in files]
    return {"files": len(sizes), "bytes": sum(sizes), "names": sorted({_kind(file) for file in files})}


def _of_kinds(files: Iterable[Path], kinds: Collection[str] | None) -> list[Path]:
    """Those with a name of one of the kinds; all where kinds are None, as in records of former versions."""
    return [file for file in files if kinds is None or (_kind(file) in kinds and not file.is_dir())]


def _kind(file: Path) -> str:
    """A name without its numbers and, of an image, without its ending: that of all frames of a job, in any format."""
    suffix = file.suffix.lower()
    return re.sub(r"[0-9]+", "#", file.stem) + ("" if suffix in IMAGE_SUFFIXES else suffix)


def _files(place: Path) -> list[Path]:
    if place.is_dir():
        return sorted(file for file in place.rglob("*") if file.is_file())
    return [place] if place.is_file() else []
