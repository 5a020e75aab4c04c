"""How kernels are compiled: no GIL, no exceptions for division by zero, kept on disk after the first run."""

from __future__ import annotations

from functools import partial

from numba import njit

__all__ = ["fast_kernel", "inlined", "inlined_contracting", "kernel"]

kernel = partial(njit, nogil=True, cache=True, error_model="numpy")
"""Strict floating point: a·b − c·d is the exact negative of c·d − a·b."""

inlined = partial(njit, nogil=True, cache=True, error_model="numpy", forceinline=True)
"""The same, always inlined, so that loops around it can be vectorised."""

inlined_contracting = partial(inlined, fastmath={"contract"})
"""Inlined; a·b + c may be one instruction."""

fast_kernel = partial(njit, nogil=True, cache=True, error_model="numpy", fastmath=True)
"""Reassociation allowed: for colours and boxes, never for tests of visibility."""
