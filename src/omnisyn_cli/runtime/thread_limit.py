"""How many threads the loops of this package and OpenCV may use."""

from collections.abc import Iterator
from contextlib import contextmanager

import cv2

from omnisyn_cli.runtime.threads import at_most

__all__ = ["limited_threads"]


@contextmanager
def limited_threads(threads: int | None) -> Iterator[None]:
    """At most ``threads`` of this package (:func:`at_most`) and OpenCV (of the process) inside; None changes nothing.

    Raises:
        ValueError: fewer than one thread.
    """
    if threads is None:
        yield
        return
    before = cv2.getNumThreads()
    with at_most(threads):
        try:
            cv2.setNumThreads(min(threads, before))
            yield
        finally:
            cv2.setNumThreads(before)
