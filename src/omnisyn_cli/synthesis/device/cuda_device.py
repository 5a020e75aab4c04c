"""Memory, functions and launches of a CUDA device.

Formulas are the scalar ones of the processor's kernels, which numba-cuda compiles again. In its simulator (the tests
have no GPU) kernels are plain Python, and the functions that they call are compiled for the processor.
"""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import config, cuda, njit

IS_SIMULATED = bool(config.ENABLE_CUDASIM)
BLOCK_THREADS = 128  # threads of a block. Set by hand.
MAX_BLOCKS = 1 << 16  # of a launch; threads of a longer job do several things
LISTED_BLOCKS = 1024  # for jobs whose length only the device knows. Set by hand.

_launching = threading.Lock()  # of launches by the threads that make frames at once


def device_function(function: Callable[..., Any] | None = None, *, fastmath: bool = False) -> Any:
    """A function that kernels call."""
    if function is None:
        return lambda function: device_function(function, fastmath=fastmath)
    if IS_SIMULATED:
        return njit(error_model="numpy", fastmath=fastmath)(function)
    return cuda.jit(device=True, fastmath=fastmath)(function)


def kernel(function: Callable[..., Any] | None = None, *, fastmath: bool = False) -> Any:
    """A kernel, whose machine code is kept on disk where that is possible."""
    if function is None:
        return lambda function: kernel(function, fastmath=fastmath)
    try:
        return cuda.jit(cache=True, fastmath=fastmath)(function)
    except RuntimeError:  # no folder that numba knows can be written
        return cuda.jit(fastmath=fastmath)(function)


def launch(made: Any, count: int | None, stream: Any, *arguments: Any) -> None:
    """Start a kernel with a thread for each of ``count``; None for :data:`LISTED_BLOCKS` blocks."""
    blocks = LISTED_BLOCKS if count is None else min(-(-count // BLOCK_THREADS), MAX_BLOCKS)
    with _launching:
        made[(1, 1) if IS_SIMULATED else (max(blocks, 1), BLOCK_THREADS, stream)](*arguments)


def allocate(shape: Any, dtype: Any) -> Any:
    """Memory on the device."""
    return np.empty(shape, dtype) if IS_SIMULATED else cuda.device_array(shape, dtype)


def upload(array: np.ndarray, stream: Any = 0, to: Any = None) -> Any:
    """A copy on the device, in memory that is there if it is given."""
    if IS_SIMULATED:
        if to is None:
            return np.array(array)
        to[...] = array
        return to
    return cuda.to_device(np.ascontiguousarray(array), stream, to=to)


def to_host(array: Any) -> np.ndarray:
    """A copy for the processor, of what the device has finished."""
    return np.array(array if IS_SIMULATED else array.copy_to_host())


def download(array: Any, stream: Any, out: np.ndarray) -> None:
    """Begin to copy from the device; ``out`` is there when the stream has been waited for."""
    if IS_SIMULATED:
        out[...] = array
    else:
        array.copy_to_host(out, stream)
