"""How much memory this process has held at most, and how large its files may grow."""

import resource
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import Any

STATUS = Path("/proc/self/status")


def peak_memory() -> int:
    """Bytes; Linux is asked directly, because what getrusage says is inherited from the process that started this."""
    if STATUS.exists():
        return next(int(line.split()[1]) for line in STATUS.read_text().splitlines() if line.startswith("VmHWM")) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def memory_taken(call: Callable[..., Any], *arguments: Any) -> int:
    """Bytes by which a call raises the peak of a new process, which can import it: no other test hides them."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        return process.submit(_rise_of_peak, call, *arguments).result()


def _rise_of_peak(call: Callable[..., Any], *arguments: Any) -> int:
    before = peak_memory()
    call(*arguments)
    return peak_memory() - before


@contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    """No file can grow beyond ``size`` bytes: the system's answer is that of a full disk."""
    former = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, former[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, former)
