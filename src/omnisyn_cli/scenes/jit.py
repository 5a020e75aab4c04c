"""How the kernels of this package are compiled."""

from functools import partial
from typing import Any

import numba

__all__ = ["inlined", "kernel"]

_FAST = {"nsz", "arcp", "contract", "afn", "reassoc"}  # all of fastmath but the promise that nothing is infinite

kernel: Any = partial(numba.njit, cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
"""Compile a function; the machine code is kept on disk, the GIL is released, a division by zero gives inf."""

inlined: Any = partial(kernel, forceinline=True)
"""The same for small functions that are copied into their callers."""
