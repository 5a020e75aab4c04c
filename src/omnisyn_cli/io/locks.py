"""Locks that end with their process: who holds the place of an output, or a folder of records."""

import hashlib
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from omnisyn_cli.errors import OutputPathError
from omnisyn_cli.io.outputs import real_path

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
