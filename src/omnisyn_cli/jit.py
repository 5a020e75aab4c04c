"""How kernels are compiled: no GIL, no exceptions for division by zero, kept on disk after the first run."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial, wraps
from typing import Any

from numba import njit
from numba.core import event

__all__ = [
    "Decorator",
    "fast_kernel",
    "inlined",
    "inlined_contracting",
    "kernel",
    "one_at_a_time",
    "parallel_kernel",
    "when_compiling",
]

Decorator = Callable[..., Any]
"""Numba's decorators say nothing about the types of what they make."""

kernel: Decorator = partial(njit, nogil=True, cache=True, error_model="numpy")
"""Strict floating point: a·b − c·d is the exact negative of c·d − a·b."""

inlined: Decorator = partial(njit, nogil=True, cache=True, error_model="numpy", forceinline=True)
"""The same, always inlined, so that loops around it can be vectorised."""

inlined_contracting: Decorator = partial(inlined, fastmath={"contract"})
"""Inlined; a·b + c may be one instruction."""

fast_kernel: Decorator = partial(njit, nogil=True, cache=True, error_model="numpy", fastmath=True)
"""Reassociation allowed: for colours and boxes, never for tests of visibility."""


_PARALLEL = threading.Lock()


def parallel_kernel(**options: Any) -> Decorator:
    """Decorates a kernel whose ``prange`` loops numba spreads over threads, to be called from Python.

    Args:
        options: of :func:`numba.njit`.
    """
    compile_it = njit(nogil=True, cache=True, parallel=True, **options)
    return lambda function: one_at_a_time(compile_it(function))


def one_at_a_time(compiled: Callable[..., Any]) -> Callable[..., Any]:
    """A compiled kernel with ``prange`` loops, for which calls from several threads wait for each other.

    Where neither OpenMP nor TBB is installed, numba's own threads must not be asked by two at a time.
    """

    @wraps(compiled)
    def call(*arguments: Any) -> Any:
        with _PARALLEL:
            return compiled(*arguments)

    return call


class _FirstCompilation(event.Listener):  # type: ignore[misc]
    """Says once that something is compiled."""

    def __init__(self, say: Callable[[], None]) -> None:
        self._say: Callable[[], None] | None = say

    def on_start(self, event: Any) -> None:
        say, self._say = self._say, None
        if say is not None:
            say()

    def on_end(self, event: Any) -> None:
        pass


@contextmanager
def when_compiling(say: Callable[[], None]) -> Iterator[None]:
    """Call ``say`` when the first kernel is compiled in between; those that are found on disk are not compiled."""
    with event.install_listener("numba:compile", _FirstCompilation(say)):
        yield
