"""How many threads the compiled loops of this package and OpenCV may use, and two things done at a time."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import cv2
import numba

__all__ = ["both", "limited_threads"]

T = TypeVar("T")


@contextmanager
def limited_threads(threads: int | None) -> Iterator[None]:
    """At most ``threads`` of numba (of the calling thread) and OpenCV (of the process) inside; None changes nothing.

    Raises:
        ValueError: fewer than one thread.
    """
    if threads is None:
        yield
        return
    if threads < 1:
        raise ValueError(f"expected at least 1 thread, got {threads}")
    before = numba.get_num_threads(), cv2.getNumThreads()
    try:
        numba.set_num_threads(min(threads, before[0]))
        cv2.setNumThreads(min(threads, before[1]))
        yield
    finally:
        numba.set_num_threads(before[0])
        cv2.setNumThreads(before[1])


def both(first: Callable[[], T], second: Callable[[], T]) -> tuple[T, T]:
    """What two functions return, called at the same time where loops may use more than one thread.

    For work that is mostly numpy's, which uses one; loops on all threads wait for each other
    (:func:`omnisyn_cli.runtime.jit.parallel_kernel`).
    """
    threads = numba.get_num_threads()
    if threads == 1:
        return first(), second()

    def aside() -> T:
        numba.set_num_threads(threads)  # every thread has a number of its own
        return second()

    with ThreadPoolExecutor(1, "omnisyn-both") as pool:
        later = pool.submit(aside)
        return first(), later.result()
