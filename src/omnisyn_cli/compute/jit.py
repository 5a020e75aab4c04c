"""How kernels are compiled: no GIL, no exceptions for division by zero, kept on disk after the first run.

Where no folder can be written (a read-only installation without a home), they are compiled by every process.
"""

import gc
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from omnisyn_cli.errors import InputError

try:
    from numba import njit
    from numba.core import event
    from numba.core.codegen import JITCodeLibrary
    from numba.core.compiler import CompilerBase, DefaultPassBuilder
except ValueError as error:
    raise InputError(f"expected settings that numba takes in NUMBA_… of the environment, got '{error}'") from error

from omnisyn_cli.compute.kernel_files import COMPILE_EVENT, OTHER_PROCESS, KernelFiles

Decorator = Callable[..., Any]  # Numba's decorators say nothing about the types of what they make.


class _Kept:
    """Whether machine code has a place on disk."""

    everywhere = True


class _Code(JITCodeLibrary):  # type: ignore[misc]
    """Code of a kernel. Its functions are not optimised one by one, as numba does, before all are at once."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout


class _Ingredient(_Code):
    """Code of a subkernel. It is made machine code with kernels that it is part of; numba would do so twice.

    It is optimised by itself all the same: of loops that are not, many do not vectorise within a kernel any more.
    """

    @property
    def codegen(self) -> "_Ingredient":
        return self

    def set_env(self, name: str, env: Any) -> None:
        """Numba's place for an environment is in machine code, which there is none of."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _Compiler(CompilerBase):  # type: ignore[misc]
    """Numba's way to compile a function, but for the kind of code that comes out."""

    kind: type[_Code] = _Code

    def define_pipelines(self) -> list[Any]:
        code = self.kind(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        code.enable_object_caching()
        self.state.library = code
        return [DefaultPassBuilder.define_nopython_pipeline(self.state)]


class _SubkernelCompiler(_Compiler):
    kind = _Ingredient


def are_kernels_kept() -> bool:
    """Whether there was a place on disk for the machine code of all kernels of the modules loaded by now."""
    return _Kept.everywhere


def is_on_disk(compiled: Any) -> bool:
    """Whether machine code of a kernel is kept for any types; also where there is no place for it."""
    files = getattr(compiled._cache, "_cache_file", None)
    return files is None or bool(files._load_index())


def compiled_kernel(function: Callable[..., Any] | None = None, *, cache: bool = True, **options: Any) -> Any:
    """:func:`numba.njit`, but that a place for machine code is a wish: without one, numba would refuse the function.

    It makes a decorator without a function. With ``cache`` the machine code is kept on disk where that is possible.
    """
    if function is None:
        return partial(compiled_kernel, cache=cache, **options)
    compiler = _SubkernelCompiler if options.get("no_cpython_wrapper") else _Compiler
    compiled = njit(function, pipeline_class=compiler, no_cfunc_wrapper=True, **options)  # nobody calls them from C
    if compiled is function:
        raise InputError("expected kernels that can be compiled, got NUMBA_DISABLE_JIT in the environment; unset it")
    if cache:
        try:
            compiled._cache = KernelFiles(compiled.py_func)
        except RuntimeError:  # no folder that numba knows can be written
            _Kept.everywhere = False
    return compiled


# Strict floating point: a·b − c·d is the exact negative of c·d − a·b.
kernel: Decorator = partial(compiled_kernel, nogil=True, error_model="numpy")
# Reassociation allowed: for colours and boxes, never for tests of visibility.
fast_kernel: Decorator = partial(kernel, fastmath=True)
# Only other kernels can call it, and its machine code is kept with theirs: that compiles faster.
subkernel: Decorator = partial(kernel, cache=False, no_cpython_wrapper=True)
fast_subkernel: Decorator = partial(subkernel, fastmath=True)  # The same with reassociation.
inlined: Decorator = partial(subkernel, forceinline=True)  # Always inlined, so that loops around it can be vectorised.
inlined_contracting: Decorator = partial(inlined, fastmath={"contract"})  # Inlined; a·b + c may be one instruction.


class _Change(event.Listener):  # type: ignore[misc]
    """Says when compiling begins and ends; a kernel inside of another changes nothing."""

    def __init__(self, say: Callable[[bool], None]) -> None:
        self._say, self._depth = say, 0

    def on_start(self, event: Any) -> None:
        self._depth += 1
        if self._depth == 1:
            self._say(True)

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if self._depth == 0:
            self._say(False)


class _WithoutCollections(_Change):
    """Stops the garbage collector while a kernel is compiled, which makes many objects that live on: a tenth faster."""

    def __init__(self) -> None:
        super().__init__(self._switch)

    def _switch(self, is_begun: bool) -> None:
        if is_begun:
            self._was_enabled = gc.isenabled()
            gc.disable()
        elif self._was_enabled:
            gc.enable()


event.register(COMPILE_EVENT, _WithoutCollections())


class _WithoutTurns(event.Listener):  # type: ignore[misc]
    """Ends the turn of a kernel that could not be compiled, for want of memory for example."""

    def on_start(self, event: Any) -> None:
        pass

    def on_end(self, event: Any) -> None:
        if event.data == OTHER_PROCESS:
            return
        compiled, types = event.data["dispatcher"], tuple(event.data["args"])
        if types not in compiled.overloads and isinstance(compiled._cache, KernelFiles):
            compiled._cache.turn.end()


event.register(COMPILE_EVENT, _WithoutTurns())


class _Compilation(event.Listener):  # type: ignore[misc]
    """Says once that kernels are compiled, when that has taken a while; a kernel inside of another counts once."""

    def __init__(self, say: Callable[[], None], patience: float) -> None:
        self._say: Callable[[], None] | None = say
        self._left, self._depth, self._begun = patience, 0, 0.0
        self._timer: threading.Timer | None = None
        self._lock = threading.Lock()

    def on_start(self, event: Any) -> None:
        self._depth += 1
        if self._depth > 1 or self._say is None:
            return
        if self._left <= 0.0 or event.data == OTHER_PROCESS:
            self._tell()
            return
        self._begun = time.perf_counter()
        self._timer = threading.Timer(self._left, self._tell)
        self._timer.daemon = True
        self._timer.start()

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if self._depth == 0:
            self.rest()
            self._left -= time.perf_counter() - self._begun

    def rest(self) -> None:
        """Say nothing until something is compiled again."""
        if self._timer is not None:
            self._timer.cancel()

    def _tell(self) -> None:
        with self._lock:
            say, self._say = self._say, None
        if say is not None:
            say()


@contextmanager
def when_compiling(say: Callable[[], None], patience: float = 0.0) -> Iterator[None]:
    """Call ``say`` once if kernels are compiled in between for longer than so many seconds; others are on disk."""
    listener = _Compilation(say, patience)
    try:
        with event.install_listener(COMPILE_EVENT, listener):
            yield
    finally:
        listener.rest()


@contextmanager
def while_compiling(say: Callable[[bool], None]) -> Iterator[None]:
    """Call ``say`` with True whenever a kernel is compiled in between, and with False afterwards."""
    with event.install_listener(COMPILE_EVENT, _Change(say)):
        yield


def announce_compiling() -> None:
    """Let those who wait in :func:`when_compiling` know that another process, started by this one, compiles."""
    event.start_event(COMPILE_EVENT, data=OTHER_PROCESS)
    event.end_event(COMPILE_EVENT, data=OTHER_PROCESS)
