"""How kernels are compiled: no GIL, no exceptions for division by zero, kept on disk after the first run.

Where no folder can be written (a read-only installation without a home), they are compiled by every process.
"""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial, wraps
from typing import Any

from numba import njit
from numba.core import event

__all__ = [
    "Decorator",
    "announce_compiling",
    "are_kernels_kept",
    "compiled_kernel",
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


class _Kept:
    """Whether machine code has a place on disk."""

    everywhere = True


def are_kernels_kept() -> bool:
    """Whether there was a place on disk for the machine code of all kernels of the modules loaded by now."""
    return _Kept.everywhere


def compiled_kernel(function: Callable[..., Any] | None = None, *, cache: bool = True, **options: Any) -> Any:
    """:func:`numba.njit`, but that a place for machine code is a wish: without one, numba would refuse the function.

    Args:
        function: to be compiled; None makes a decorator.
        cache: keep the machine code on disk where that is possible.
        options: of :func:`numba.njit`.
    """
    if function is None:
        return partial(compiled_kernel, cache=cache, **options)
    compiled = njit(function, **options)
    if cache:
        try:
            compiled.enable_caching()
        except RuntimeError:  # no folder that numba knows can be written
            _Kept.everywhere = False
    return compiled


kernel: Decorator = partial(compiled_kernel, nogil=True, error_model="numpy")
"""Strict floating point: a·b − c·d is the exact negative of c·d − a·b."""

inlined: Decorator = partial(compiled_kernel, nogil=True, error_model="numpy", forceinline=True)
"""The same, always inlined, so that loops around it can be vectorised."""

inlined_contracting: Decorator = partial(inlined, fastmath={"contract"})
"""Inlined; a·b + c may be one instruction."""

fast_kernel: Decorator = partial(compiled_kernel, nogil=True, error_model="numpy", fastmath=True)
"""Reassociation allowed: for colours and boxes, never for tests of visibility."""

COMPILATION = "numba:compile"
"""What numba calls it."""

_PARALLEL = threading.Lock()


def parallel_kernel(**options: Any) -> Decorator:
    """Decorates a kernel whose ``prange`` loops numba spreads over threads, to be called from Python.

    Args:
        options: of :func:`numba.njit`.
    """
    compile_it = compiled_kernel(nogil=True, parallel=True, **options)
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
    with event.install_listener(COMPILATION, _FirstCompilation(say)):
        yield


def announce_compiling() -> None:
    """Let those who wait in :func:`when_compiling` know that another process, started by this one, compiles."""
    event.start_event(COMPILATION)
    event.end_event(COMPILATION)
