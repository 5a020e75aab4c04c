"""How much memory this process has held at most, and how large its files may grow."""

import gc
import resource
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

STATUS = Path("/proc/self/status")

FORGET = Path("/proc/self/clear_refs")

PEAK_ONLY = "5"
"""See proc(5)."""


def peak_memory() -> int:
    """Bytes; Linux is asked directly, because what getrusage says is inherited from the process that started this."""
    if STATUS.exists():
        return next(int(line.split()[1]) for line in STATUS.read_text().splitlines() if line.startswith("VmHWM")) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def renewed_peak_memory() -> int:
    """The same from here on, where the system forgets: what was held before and given back counts no more."""
    gc.collect()  # what other tests left behind would be given back in between
    if FORGET.exists():
        with suppress(OSError):
            FORGET.write_text(PEAK_ONLY)
    return peak_memory()


@contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    """No file can grow beyond ``size`` bytes: the system's answer is that of a full disk."""
    former = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, former[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, former)
