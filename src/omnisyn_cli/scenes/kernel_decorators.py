"""How the kernels of this package are compiled."""

from functools import partial

from omnisyn_cli.compute import jit
from omnisyn_cli.compute.jit import Decorator

_FAST_MATH_FLAGS = {
    "nsz",
    "arcp",
    "contract",
    "afn",
    "reassoc",
}  # all of fastmath but the promise that nothing is infinite

kernel: Decorator = partial(jit.kernel, fastmath=_FAST_MATH_FLAGS)
"""Compile a function; the machine code is kept on disk, the GIL is released, a division by zero gives inf."""

inlined: Decorator = partial(jit.inlined, fastmath=_FAST_MATH_FLAGS)
"""The same for small functions that are copied into their callers."""
