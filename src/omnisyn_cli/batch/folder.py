"""The folder of a batch: work in progress in a hidden folder of it, what is finished under its final name.

A worker that cannot see the folder (on another machine) works in a temporary one and sends the files.
"""

import json
import re
import shutil
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Self

from omnisyn_cli.batch.manifest import RECORDS
from omnisyn_cli.errors import OutputPathError
from omnisyn_cli.io import outputs
from omnisyn_cli.io.documents import append_line
from omnisyn_cli.io.encode import IMAGE_SUFFIXES
from omnisyn_cli.io.outputs import hidden_folder, write_errors

STAGING_SUFFIX = ".batch"  # of the hidden folder in which a batch works; its whole name is that of no other run


def recorded_outputs(path: Path) -> set[str]:
    """Places that the records of a file name, if there is one; :class:`Records` refuses other lines."""
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
    """The records of a batch in a file, which is made if needed; a second run at the same time is refused."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._places: dict[str, int] = {}

    def __enter__(self) -> Self:
        with write_errors(self._path):
            self._file = self._path.open("ab+")
        try:
            self._read()
        except BaseException:
            self._file.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def last(self, key: str) -> dict[str, Any] | None:
        """The last record of a job when the file was opened, read again: a city of jobs does not fit into memory."""
        if key not in self._places:
            return None
        self._file.seek(self._places[key])
        return dict(json.loads(self._file.readline()))

    def append(self, record: dict[str, Any]) -> None:
        """Add the line of a job and wait until it is on the disk; WriteError: the disk is full."""
        append_line(self._path, record)

    def _read(self) -> None:
        try:
            outputs.lock(self._file.fileno())
        except OSError as error:
            raise OutputPathError(
                f"{self._path}: expected a folder that no other batch works in, got one in use; wait for its end"
            ) from error
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


def prepare_folder(folder: Path, places: Sequence[str], inputs: Iterable[Path], *, overwrite: bool) -> None:
    """Make a folder, or refuse one in which a batch would replace what none has made (OutputPathError)."""
    if not folder.exists():
        outputs.check_folder(folder.parent)
        folder.mkdir()
    outputs.check_folder(folder)
    outputs.check_kept((folder / place for place in places), inputs, whole_folders=True)
    if overwrite or _staging_dirs(folder):
        return
    recorded = recorded_outputs(folder / RECORDS)
    if existing := [place for place in places if place not in recorded and (folder / place).exists()]:
        raise OutputPathError(
            f"{folder / existing[0]}: expected new outputs, got {len(existing)} that exist and no record of {RECORDS} "
            "names; choose another folder or allow overwriting (--overwrite)"
        )


@contextmanager
def open_staging_dir(folder: Path) -> Iterator[str]:
    """Make and remove the hidden folder for work in progress, whose name tells workers whether they see this folder."""
    staging = outputs.temporary_name(folder, STAGING_SUFFIX)
    try:
        with write_errors(staging):
            staging.mkdir()
        yield staging.name
    finally:
        _remove(staging)


def remove_leftovers(folder: Path, staging: str) -> list[Path]:
    """Remove hidden folders of runs that were killed, and name them; ``staging`` is that of the only run at work."""
    found = [place for place in _staging_dirs(folder) if place.name != staging]
    for place in found:
        _remove(place)
    return found


def _staging_dirs(folder: Path) -> list[Path]:
    return sorted(folder.glob(f"{outputs.TEMPORARY_PREFIX}*{STAGING_SUFFIX}"))


def _remove(staging: Path) -> None:
    """Under another name first: a worker that has outlived its batch by a moment finds no place to write to."""
    removed = outputs.temporary_name(staging.parent, STAGING_SUFFIX)
    with suppress(OSError):
        staging = staging.rename(removed)
    shutil.rmtree(staging, ignore_errors=True)


@contextmanager
def attempt_folder(staging: Path) -> Iterator[tuple[Path, bool]]:
    """An empty folder for one attempt, and whether it is in the hidden one, which another machine may not see."""
    is_shared = staging.is_dir()
    with hidden_folder(staging) if is_shared else outputs.scratch_folder() as folder:
        yield folder, is_shared


def output_stats(folder: Path, places: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Number of files, bytes, and kinds of names of every place below a folder; 0 files where there is nothing."""
    return {place: _file_stats(_files(folder / place)) for place in places}


def is_unchanged(folder: Path, places: Iterable[str], measured: Mapping[str, Mapping[str, Any]]) -> bool:
    """Whether there is what :func:`output_stats` found, whatever else there is with names of other kinds."""
    if set(places) != set(measured):
        return False
    for place, figures in measured.items():
        found = _file_stats(_of_name_kinds(_files(folder / place), figures.get("names")))
        if any(found.get(name) != figure for name, figure in figures.items()):
            return False
    return True


def publish(attempt: Path, folder: Path, places: Iterable[str]) -> None:
    """Move an attempt's outputs to their names, in folders in place of names of their kinds; WriteError: no space."""
    for place in places:
        produced, target = attempt / place, folder / place
        with write_errors(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            if not target.is_dir():
                produced.replace(target)
                continue
            files = sorted(produced.iterdir())
            for former in _of_name_kinds(list(target.iterdir()), {_name_kind(file) for file in files}):
                former.unlink()
            for file in files:
                file.replace(target / file.name)


def read_outputs(attempt: Path, places: Iterable[str]) -> dict[str, bytes]:
    """All files that an attempt has made, by their place."""
    return {
        file.relative_to(attempt).as_posix(): file.read_bytes() for place in places for file in _files(attempt / place)
    }


def write_outputs(files: Mapping[str, bytes], folder: Path, places: Iterable[str]) -> None:
    """Write what :func:`read_outputs` took, under final names."""
    with hidden_folder(folder) as attempt:
        for name, content in files.items():
            target = attempt / name
            with write_errors(folder / name):
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(content)
        publish(attempt, folder, places)


def _file_stats(files: Sequence[Path]) -> dict[str, Any]:
    sizes = [file.stat().st_size for file in files]
    return {"files": len(sizes), "bytes": sum(sizes), "names": sorted({_name_kind(file) for file in files})}


def _of_name_kinds(files: Iterable[Path], kinds: Collection[str] | None) -> list[Path]:
    """Those with a name of one of the kinds; all where kinds are None, as in records of former versions."""
    return [file for file in files if kinds is None or (_name_kind(file) in kinds and not file.is_dir())]


def _name_kind(file: Path) -> str:
    """A name without its numbers and, of an image, without its ending: that of all frames of a job, in any format."""
    suffix = file.suffix.lower()
    return re.sub(r"[0-9]+", "#", file.stem) + ("" if suffix in IMAGE_SUFFIXES else suffix)


def _files(place: Path) -> list[Path]:
    if place.is_dir():
        return sorted(file for file in place.rglob("*") if file.is_file())
    return [place] if place.is_file() else []
