"""Machine code of kernels on disk: under names that say what is in them, and compiled by one process at a time."""

import hashlib
import os
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

from numba.core import event
from numba.core.caching import FunctionCache, IndexDataCacheFile

COMPILE_EVENT = "numba:compile"  # what numba calls it
OTHER_PROCESS = "elsewhere"  # said of what another process compiles, and long enough to be worth a word
# Seconds that a process waits for another to compile a kernel: it may be one that somebody has stopped.
LONGEST_TURN = 60.0
TURN_POLL_SECONDS = 0.02  # how often it looks


class _KeyedFiles(IndexDataCacheFile):  # type: ignore[misc]
    """Files of machine code whose names say what is in them.

    Numba numbers them: two processes that compile a kernel for different types at once may write both into one file, of
    which the index of one of them says that it is the other's. Here the loser of such a race compiles once more.
    """

    def _load_index(self) -> dict[Any, str]:
        """The files by key; none where the index names types of another version of this program."""
        try:
            found: dict[Any, str] = super()._load_index()
        except (AttributeError, ImportError):
            found = {}
        return found

    def load(self, key: Any) -> Any:
        """The machine code for a key; None if there is none, or only a damaged one or one of modules that are gone."""
        try:
            return super().load(key)
        except (AttributeError, ImportError, EOFError, UnpicklingError):
            return None

    def save(self, key: Any, data: Any) -> None:
        """Keep the machine code of a kernel for types and a processor, which are its key."""
        overloads = self._load_index()
        if key not in overloads:
            digest = hashlib.sha256(repr(key).encode()).digest()
            overloads[key] = self._data_name(int.from_bytes(digest[:8], "big"))
            self._save_index(overloads)
        self._save_data(overloads[key], data)


class _Turn:
    """One process at a time compiles a kernel. Others wait, and find it on disk; a turn ends with its process."""

    def __init__(self, file: Path) -> None:
        self._file, self._descriptor = file, -1

    def take(self) -> None:
        """Wait for the turn, unless it is taken already, takes too long, or there is no way to wait."""
        if self._descriptor >= 0 or sys.platform == "win32":
            return
        with suppress(OSError):  # a file system without locks: both compile
            self._descriptor = os.open(self._file, os.O_RDWR | os.O_CREAT, 0o600)
            if not self._is_mine():
                with event.trigger_event(COMPILE_EVENT, data=OTHER_PROCESS):
                    end = time.monotonic() + LONGEST_TURN
                    while not self._is_mine() and time.monotonic() < end:
                        time.sleep(TURN_POLL_SECONDS)

    def _is_mine(self) -> bool:
        import fcntl

        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def end(self) -> None:
        """Let the next one see what is on disk now."""
        if self._descriptor >= 0:
            with suppress(OSError):  # a folder that can no longer be written
                if self._is_mine():  # not if the wait was too long: it is another's still
                    self._file.unlink(missing_ok=True)
            os.close(self._descriptor)
            self._descriptor = -1


class KernelFiles(FunctionCache):  # type: ignore[misc]
    """The machine code of a kernel on disk, for all types that it was compiled for."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        stamp = self._impl.locator.get_source_stamp()
        self._cache_file = _KeyedFiles(self.cache_path, self._impl.filename_base, stamp)
        self.turn = _Turn(Path(self.cache_path, f"{self._impl.filename_base}.lock"))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The machine code for types; None, and the turn to make it, where there is none yet."""
        target_context.typing_context.refresh()  # before the target's, or containers come before arrays in it
        found = super().load_overload(sig, target_context)
        if found is None:
            self.turn.take()
            found = super().load_overload(sig, target_context)
        if found is not None:
            self.turn.end()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the machine code for types; whoever has waited for it goes on."""
        try:
            super().save_overload(sig, data)
        finally:
            self.turn.end()
