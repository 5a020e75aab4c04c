"""How many threads the compiled loops of this package and OpenCV may use."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numba

__all__ = ["limited_threads"]


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
