"""Seconds by stage."""

import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import copy

_listeners: list[Callable[[str], None]] = []


@contextmanager
def while_timing(listen: Callable[[str], None]) -> Iterator[None]:
    """Inside, whatever stage any stopwatch begins is told to ``listen``."""
    _listeners.append(listen)
    try:
        yield
    finally:
        _listeners.remove(listen)


class Stopwatch:
    """Seconds by stage, of a clock; by default of that on the wall."""

    def __init__(self, now: Callable[[], float] = time.perf_counter) -> None:
        self.now = now
        self.seconds: dict[str, float] = defaultdict(float)
        self._begin, self._lock, self._workers = now(), threading.Lock(), 1

    def of_one_of(self, workers: int) -> "Stopwatch":
        """One for a thread of several that work at once: what it times counts as that share of the time."""
        shared = copy(self)
        shared._workers = workers
        return shared

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Time what happens inside."""
        for listen in _listeners:
            listen(stage)
        begin = self.now()
        try:
            yield
        finally:
            with self._lock:
                self.seconds[stage] += (self.now() - begin) / self._workers

    def with_total(self) -> dict[str, float]:
        """Seconds by stage, and as ``total`` all since it was made."""
        return {**self.seconds, "total": self.now() - self._begin}
