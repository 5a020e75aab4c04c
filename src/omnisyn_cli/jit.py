"""How kernels are compiled: no GIL, no exceptions for division by zero, kept on disk after the first run."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from numba import njit

__all__ = ["Decorator", "fast_kernel", "inlined", "inlined_contracting", "kernel"]

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
