"""How kernels are compiled: no GIL, no exceptions for division by zero, kept on disk after the first run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from numba import njit
from numba.core import event

__all__ = ["Decorator", "fast_kernel", "inlined", "inlined_contracting", "kernel", "when_compiling"]

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
