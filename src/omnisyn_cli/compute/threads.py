"""Kernels on ranges of rows, each range in a thread of its own.

The kernels release the GIL and write only their own rows, so the result does not depend on the number of threads.
"""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from functools import lru_cache
from itertools import pairwise
from typing import TypeVar

T = TypeVar("T")

_limit: ContextVar[int | None] = ContextVar("most threads", default=None)
_lane: ContextVar[int] = ContextVar("whose threads", default=0)

RANGES_PER_THREAD = 4  # more ranges than threads, because some rows are more work than others
# Memory for frames that are made at once, and what each takes: 6 of 4096×2048, 1 of 8192×4096. Set by hand.
MAX_BYTES_AT_ONCE, BYTES_PER_PIXEL_AT_ONCE = 2 * 2**30, 38


def available_threads() -> int:
    """The number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def allowed_threads() -> int:
    """How many :func:`run_ranges` uses if its caller does not say: a core each, or what :func:`at_most` allows."""
    return min(available_threads(), _limit.get() or available_threads())


def frames_at_once(size: tuple[int, int], threads: int | None) -> int:
    """How many frames of a size are made at once: a thread each, while all together take little memory."""
    affordable = MAX_BYTES_AT_ONCE // (BYTES_PER_PIXEL_AT_ONCE * size[0] * size[1])
    return max(1, min(threads or allowed_threads(), affordable))


@contextmanager
def at_most(threads: int) -> Iterator[None]:
    """Inside, here and in what :func:`both` starts, loops use no more threads than that. ValueError: fewer than 1."""
    if threads < 1:
        raise ValueError(f"expected at least 1 thread, got {threads}")
    former = _limit.set(min(threads, _limit.get() or threads))
    try:
        yield
    finally:
        _limit.reset(former)


@contextmanager
def limited_threads(threads: int | None) -> Iterator[None]:
    """:func:`at_most` so many, and OpenCV's (of the process); None changes nothing. ValueError: fewer than 1."""
    if threads is None:
        yield
        return
    import cv2  # slow to import, and only work with pictures needs it

    before = cv2.getNumThreads()
    with at_most(threads):
        try:
            cv2.setNumThreads(min(threads, before))
            yield
        finally:
            cv2.setNumThreads(before)


def both(first: Callable[[], T], second: Callable[[], T]) -> tuple[T, T]:
    """What two functions return, at once if loops may use two threads: for numpy's work, which uses one."""
    if allowed_threads() == 1:
        return first(), second()
    with ThreadPoolExecutor(1, "omnisyn-both") as pool:
        later = pool.submit(copy_context().run, second)
        return first(), later.result()


def split_range(rows: int, count: int) -> list[tuple[int, int]]:
    """``count`` (or fewer) contiguous ranges that cover ``range(rows)``."""
    edges = [rows * k // count for k in range(count + 1)]
    return [(begin, end) for begin, end in pairwise(edges) if end > begin]


def run_ranges(kernel: Callable[[int, int], None], rows: int, threads: int | None = None) -> None:
    """Call ``kernel(row_begin, row_end)`` for ranges that cover ``rows``; on one thread that is a single plain call."""
    threads = threads or allowed_threads()
    if threads == 1:
        kernel(0, rows)
        return
    ranges = split_range(rows, threads * RANGES_PER_THREAD)
    pending = [_pool(threads, _lane.get()).submit(kernel, begin, end) for begin, end in ranges]
    for future in pending:
        future.result()


def in_lane(lane: int, work: Callable[[], T]) -> T:
    """What ``work`` returns; its loops have threads of their own and do not wait for those of other lanes."""
    former = _lane.set(lane)
    try:
        return work()
    finally:
        _lane.reset(former)


@lru_cache(maxsize=16)
def _pool(threads: int, lane: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=threads, thread_name_prefix="omnisyn")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        after_in_child=_pool.cache_clear
    )  # threads do not survive a fork, their pools would wait forever
