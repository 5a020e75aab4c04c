"""The last words of C++ libraries: where memory runs out in a thread of theirs, nobody can catch it."""

import os
import sys
from collections.abc import Callable
from contextlib import suppress

from omnisyn_cli.cli.failures import EXIT_FAILURE, memory_failure

CXX_LIBRARY = "libstdc++.so.6"
"""The C++ runtime of GCC, whose handler is replaced."""

SET_TERMINATE = "_ZSt13set_terminatePFvvE"
"""The mangled name of ``std::set_terminate``."""

MEMORY_EXCEPTIONS = {b"St9bad_alloc": "no more memory", b"St12system_error": "no more threads"}
"""Mangled names of exceptions, and what they mean."""

STDERR = 2
"""The file descriptor of POSIX."""

TYPE_NAME = 1
"""Which word of ``std::type_info`` leads to the name."""

_kept: list[Callable[[], None]] = []
"""What C++ calls, which must not be collected, and what it called before."""


def explain_memory_aborts() -> None:
    """From now on say in this program's words that memory has run out in a thread of a library, before it ends.

    Where the system's C++ is another one, its own words are all there is.
    """
    if sys.platform != "linux" or _kept:
        return
    import ctypes

    called = ctypes.CFUNCTYPE(None)
    with suppress(OSError, AttributeError):
        library = ctypes.CDLL(CXX_LIBRARY)
        library.__cxa_current_exception_type.restype = ctypes.POINTER(ctypes.c_void_p)
        set_terminate = library[SET_TERMINATE]
        set_terminate.argtypes, set_terminate.restype = [called], called

        def end() -> None:
            found = library.__cxa_current_exception_type()
            meaning = MEMORY_EXCEPTIONS.get(ctypes.string_at(found[TYPE_NAME])) if found else None
            if meaning is not None:
                os.write(STDERR, f"omnisyn: {memory_failure(meaning)}\n".encode())
                os._exit(EXIT_FAILURE)
            _kept[1]()

        _kept.append(called(end))
        _kept.append(set_terminate(_kept[0]))
