"""The last words of C++ libraries: where memory runs out in a thread of theirs, nobody can catch it.

What C++ calls then is machine code. Python code would wait for Python's lock, perhaps for ever: its owner may itself be
waiting for that thread.
"""

import sys
from contextlib import suppress
from typing import Any

from omnisyn_cli.cli.failures import EXIT_FAILURE, memory_failure

CXX_LIBRARY = "libstdc++.so.6"  # the C++ runtime of GCC, whose handler is replaced
SET_TERMINATE = "_ZSt13set_terminatePFvvE"  # the mangled name of ``std::set_terminate``
# What the handler calls, by the names that it has for them, and their mangled names; the last compares two types.
CXX_FUNCTIONS = {
    "omnisyn_former_handler": "_ZN9__gnu_cxx27__verbose_terminate_handlerEv",
    "omnisyn_thrown_type": "__cxa_current_exception_type",
    "omnisyn_is_type": "_ZNKSt9type_info10__do_catchEPKS_PPvj",
}
# Mangled names of the types of exceptions that mean: no more memory, and no more threads.
MEMORY_TYPES = ("_ZTISt9bad_alloc", "_ZTISt12system_error")
# In the assembly language of LLVM, of any version: addresses are whole numbers here. 2 is standard error.
HANDLER = """
declare i64 @omnisyn_thrown_type()
declare zeroext i1 @omnisyn_is_type(i64, i64, i64, i32)
declare void @omnisyn_former_handler()
declare i64 @write(i32, i64, i64)
declare void @_exit(i32)

define void @omnisyn_say_memory_failure() {{
  %thrown = call i64 @omnisyn_thrown_type()
  %is_any = icmp ne i64 %thrown, 0
  br i1 %is_any, label %known, label %other
known:
  %is_memory = call zeroext i1 @omnisyn_is_type(i64 {memory}, i64 %thrown, i64 0, i32 0)
  %is_threads = call zeroext i1 @omnisyn_is_type(i64 {threads}, i64 %thrown, i64 0, i32 0)
  %is_ours = or i1 %is_memory, %is_threads
  br i1 %is_ours, label %ours, label %other
ours:
  call i64 @write(i32 2, i64 {text}, i64 {length})
  call void @_exit(i32 {code})
  unreachable
other:
  call void @omnisyn_former_handler()
  unreachable
}}
"""

_kept: list[Any] = []  # the text and the machine code, which must not be collected


def explain_memory_aborts() -> None:
    """From now on say in this program's words that memory has run out in a thread of a library, before it ends.

    Where the system's C++ is another one, its own words are all there is.
    """
    if sys.platform != "linux" or _kept:
        return
    import ctypes

    with suppress(OSError, AttributeError, ValueError):
        library = ctypes.CDLL(CXX_LIBRARY)
        functions = {
            name: ctypes.cast(library[mangled], ctypes.c_void_p).value for name, mangled in CXX_FUNCTIONS.items()
        }
        memory, threads = (ctypes.addressof(ctypes.c_char.in_dll(library, mangled)) for mangled in MEMORY_TYPES)
        line = f"omnisyn: {memory_failure('no more memory or threads')}\n".encode()
        text = ctypes.create_string_buffer(line)
        assembly = HANDLER.format(
            memory=memory, threads=threads, text=ctypes.addressof(text), length=len(line), code=EXIT_FAILURE
        )
        engine = _compiled(assembly, functions)
        _kept.extend((text, engine))
        library[SET_TERMINATE](ctypes.c_void_p(engine.get_function_address("omnisyn_say_memory_failure")))


def _compiled(assembly: str, functions: dict[str, int | None]) -> Any:
    """Machine code, with the addresses of functions that it calls."""
    from llvmlite import binding  # type: ignore[import-untyped]

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    for name, address in functions.items():
        binding.add_symbol(name, address)
    machine = binding.Target.from_default_triple().create_target_machine()
    engine = binding.create_mcjit_compiler(binding.parse_assembly(assembly), machine)
    engine.finalize_object()
    return engine
