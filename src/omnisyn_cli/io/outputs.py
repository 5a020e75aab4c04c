"""Where files go: checks before any work begins, locks while it goes on, writing that is seen whole or not at all."""

import filecmp
import hashlib
import os
import platform
import re
import secrets
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from omnisyn_cli.errors import OutputPathError, WriteError

TEMPORARY_PREFIX = ".omnisyn-"  # of names that are not final yet
# The machine, the process, and chance.
TEMPORARY_NAME = re.compile(re.escape(TEMPORARY_PREFIX) + r"([0-9a-f]{6})-(\d+)-[0-9a-f]{8}(\.\w+)?")
# Of this machine: processes of others, which may see the same folder, are not asked about.
MACHINE_DIGEST = hashlib.sha256(platform.node().encode()).hexdigest()[:6]


def real_path(path: Path) -> Path:
    """The path without links, whether it exists or not; where links go in a circle, what is left of it."""
    return Path(os.path.realpath(path))  # Path.resolve raises RuntimeError there until Python 3.13


def relative_name(path: Path, folder: Path) -> str:
    """A file as it is named from a folder, with slashes; absolute on another drive."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:
        return path.absolute().as_posix()


def make_folder(folder: Path, what: str) -> None:
    """Make a folder for ``what``, and those above it, unless it is there; OutputPathError where it cannot be made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputPathError(
            f"{folder}: expected a folder for {what}, got '{error.strerror}'; choose another place"
        ) from error


def check_kept(outputs: Iterable[Path], inputs: Iterable[Path], *, whole_folders: bool = False) -> None:
    """Refuse (OutputPathError) outputs that would overwrite what they are made of.

    With ``whole_folders`` outputs that are folders are replaced with everything in them, not added to.
    """
    replaced = set(map(real_path, outputs))
    for path in inputs:
        source = real_path(path)
        if source in replaced or (whole_folders and not replaced.isdisjoint(source.parents)):
            raise OutputPathError(f"{path}: expected inputs that are not overwritten, got this one; write elsewhere")


def check_output(path: Path | str, overwrite: bool = False) -> None:
    """Refuse (OutputPathError) a file that could not be written: it exists, is a folder, or its folder is unusable."""
    target = Path(path)
    check_name(target)
    check_folder(target.parent)
    is_folder, exists = target.is_dir(), target.exists() or target.is_symlink()
    if is_folder:
        raise OutputPathError(f"{target}: expected a file name, got a folder; add a file name to it")
    if exists and not overwrite:
        raise OutputPathError(f"{target}: expected a new file, got one that exists; allow overwriting (--overwrite)")


def check_name(path: Path) -> None:
    """Refuse (OutputPathError) a name that the system cannot give to anything: too long, or with unknown characters."""
    try:
        path.is_symlink()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputPathError(f"{path!s:.200}: expected a name for a file, got '{reason}'; choose another") from error


def check_folder(folder: Path) -> None:
    """Refuse (OutputPathError) a folder that new files cannot be put into: missing, no folder, or not writable."""
    if not folder.exists():
        raise OutputPathError(f"{folder}: expected an existing folder to write into, got none; create it first")
    if not folder.is_dir():
        raise OutputPathError(f"{folder}: expected a folder to write into, got a file; choose another output path")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputPathError(f"{folder}: expected a writable folder, got a read-only one; change its permissions")


def temporary_name(folder: Path, suffix: str = "") -> Path:
    """A new hidden name inside ``folder``; nothing is created."""
    return folder / f"{TEMPORARY_PREFIX}{MACHINE_DIGEST}-{os.getpid()}-{secrets.token_hex(4)}{suffix}"


def abandoned(folder: Path) -> list[Path]:
    """What runs that were killed have left in a folder: under names of this machine's processes that have ended."""
    try:
        names = sorted(entry.name for entry in folder.iterdir())
    except OSError:
        return []
    found = ((name, TEMPORARY_NAME.fullmatch(name)) for name in names)
    ours = (name for name, match in found if match and match[1] == MACHINE_DIGEST and _has_ended(int(match[2])))
    return [folder / name for name in ours if os.access(folder / name, os.W_OK)]  # other users' are theirs


def _has_ended(process: int) -> bool:
    if os.name != "posix":
        return False  # asking would be a signal there
    try:
        os.kill(process, 0)
    except (OSError, OverflowError) as error:
        return isinstance(error, ProcessLookupError)
    return False


@contextmanager
def replaced_when_complete(path: Path) -> Iterator[Path]:
    """Give a temporary name beside ``path``; rename it to ``path`` at the end, remove it after any (write) failure."""
    temporary = temporary_name(path.parent, path.suffix)
    try:
        with write_errors(path):
            yield temporary
            temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_parts(path: Path, parts: Iterable[bytes | memoryview]) -> None:
    """Write a file of parts, in place of one of its name; it appears whole, or not at all (WriteError)."""
    with replaced_when_complete(path) as temporary, temporary.open("wb") as file:
        for part in parts:
            file.write(part)


@contextmanager
def write_errors(path: Path) -> Iterator[None]:
    """Turn the system's errors into :class:`WriteError` about ``path``."""
    try:
        yield
    except OSError as error:
        raise WriteError(
            f"{path}: expected to write it, got '{error.strerror or error}'; check free space and permissions"
        ) from error


def check_staged_folder(folder: Path) -> None:
    """Refuse (OutputPathError) what :func:`staged_folder` could not fill, before any work; its parent has to exist."""
    if folder.is_symlink() and not folder.exists():
        raise OutputPathError(f"{folder}: expected a folder, got a link that leads nowhere; remove it")
    check_folder(folder if folder.exists() else folder.parent)


def check_empty_folder(folder: Path, overwrite: bool) -> None:
    """Refuse (OutputPathError) what is no folder of its own for new files, unless others of their names may go."""
    check_staged_folder(folder)
    if not overwrite and folder.is_dir() and set(folder.iterdir()) - set(abandoned(folder)):
        raise OutputPathError(
            f"{folder}: expected a new or empty folder, got files in it; choose another, or replace an earlier output "
            "(--overwrite)"
        )


@contextmanager
def hidden_folder(folder: Path) -> Iterator[Path]:
    """Give a hidden folder on the same disk as ``folder``; it is gone afterwards, whatever happens."""
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
def scratch_folder() -> Iterator[Path]:
    """Give a folder among the system's temporary ones, for this user alone; it is gone afterwards, whatever happens."""
    folder = temporary_name(Path(tempfile.gettempdir()))
    folder.mkdir(mode=0o700)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def staged_folder(folder: Path, *, overwrite: bool = True) -> Iterator[Path]:
    """Give a hidden folder to write into; its content moves into ``folder`` at the end, and is gone after any failure.

    The folder need not exist; its parent must. A new folder appears with all that is in it at once. Folders in it are
    made, or added to. With ``overwrite`` files of the same names are replaced, those included that appeared meanwhile.

    OutputPathError: there is a file of one of the names, and ``overwrite`` is off. WriteError: the disk is full, or the
    folder went away.
    """
    with hidden_folder(folder) as temporary:
        yield temporary
        if not (folder.exists() or folder.is_symlink()):
            with suppress(OSError):  # which the slower way reports
                temporary.rename(folder)
                return
        with write_errors(folder):
            folder.mkdir(exist_ok=True)
            files = sorted(file for file in temporary.rglob("*") if file.is_file())
            targets = [folder / file.relative_to(temporary) for file in files]
            for target in targets:
                target.parent.mkdir(parents=True, exist_ok=True)
                check_output(target, overwrite)
            for file, target in zip(files, targets, strict=True):
                if not (target.is_file() and filecmp.cmp(file, target, shallow=False)):  # else it keeps its date
                    file.replace(target)


def named_in(document: Path, own_file: re.Pattern[str]) -> set[str]:
    """The names that a pattern finds in the text of a file; none where it cannot be read."""
    with suppress(OSError):
        return set(own_file.findall(document.read_text(encoding="utf-8", errors="replace")))
    return set()


def former_files(folder: Path, documents: Iterable[str], own_file: re.Pattern[str]) -> set[str]:
    """Files of a former output in a folder: documents and what they name; one that names none is somebody else's.

    ``own_file`` finds those names in the text of a document.
    """
    former: set[str] = set()
    for document in documents:
        names = named_in(folder / document, own_file)
        former |= {document, *names} if names else set()
    return former


@contextmanager
def replaced_folder(folder: Path, former: Iterable[str], *, overwrite: bool) -> Iterator[Path]:
    """As :func:`staged_folder`; the files of a ``former`` output that the new one has not are removed at the end."""
    with staged_folder(folder, overwrite=overwrite) as staged:
        yield staged
        old = set(former) - {file.relative_to(staged).as_posix() for file in staged.rglob("*")}
    left = [folder / name for name in old]
    with write_errors(folder):
        for file in left:
            if file.is_file():
                file.unlink()
    for place in {file.parent for file in left} - {folder}:
        with suppress(OSError):  # something else is in it
            place.rmdir()


if sys.platform == "win32":  # pragma: no cover

    def lock(descriptor: int) -> None:
        """No lock; two runs with one output are not noticed before the end."""
else:
    import fcntl

    def lock(descriptor: int) -> None:
        """Lock an open file for this process; OSError: another one has it."""
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


@contextmanager
def claimed(place: Path) -> Iterator[None]:
    """Hold the place of an output while work is done for it. OutputPathError: another run on this machine holds it.

    The lock is a file among the system's temporary ones, so that nothing is left beside outputs.
    """
    digest = hashlib.sha256(os.fsencode(real_path(place))).hexdigest()[:24]
    file = Path(tempfile.gettempdir(), f"omnisyn-{digest}.lock")
    try:
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o600)
    except OSError:  # of another user, or there is no room: then it is noticed at the end
        yield
        return
    with os.fdopen(descriptor):
        try:
            lock(descriptor)
        except OSError as error:
            raise OutputPathError(
                f"{place}: expected an output of its own, got one that another run is making; wait for its end, or "
                "choose another"
            ) from error
        try:
            yield
        finally:
            file.unlink(missing_ok=True)
