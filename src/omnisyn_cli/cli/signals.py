"""Signals that ask the program to end become exceptions, so that half-written files are removed on the way out."""

import gc
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

# What ending signals do unless they are ignored (nohup) or somebody else's.
FORMER_HANDLERS: dict[str, Callable[[int, FrameType | None], Any] | signal.Handlers] = {
    "SIGINT": signal.default_int_handler,
    "SIGTERM": signal.SIG_DFL,
    "SIGHUP": signal.SIG_DFL,
}
# Whether the system wakes a program to look again; Windows does not, so exceptions are raised at once there.
HAS_ALARM = hasattr(signal, "setitimer")
SIGNAL_RETRY_SECONDS = 0.02  # seconds until it is looked again whether an exception may be raised
SIGNAL_PATIENCE_SECONDS = 10.0  # seconds after which it is raised wherever the program is: something hangs

# Where an exception is lost, leaves a lock taken or gives it back twice, or breaks off what tidies up or publishes.
FRAGILE_MODULES = {
    "_weakrefset", "concurrent.futures._base", "concurrent.futures.process", "concurrent.futures.thread", "contextlib",
    "llvmlite.binding.executionengine", "threading", "weakref",
}  # fmt: skip
FRAGILE_FUNCTIONS = {"__del__", "__enter__", "__exit__"}
# Functions of fragile modules that may wait for ever and, while they do, bear an exception.
WAITING_FUNCTIONS = {"as_completed", "result", "wait"}
# Of contextlib: calls a function that is decorated with a context, which may be the whole work.
CONTEXT_FUNCTION = "inner"


class Terminated(BaseException):
    """Another process, or the terminal that was closed, asked the program to end; ``args[0]`` is the signal."""


@contextmanager
def signals_raised() -> Iterator[None]:
    """Raise KeyboardInterrupt at Ctrl-C and :class:`Terminated` at other ending signals, where it does no harm.

    That a signal came is raised at the end in any case, whatever else failed, or was still done, after it.
    """
    is_main = threading.current_thread() is threading.main_thread()
    known = {getattr(signal, name): former for name, former in FORMER_HANDLERS.items() if hasattr(signal, name)}
    ours = [number for number, former in known.items() if is_main and signal.getsignal(number) is former]
    arrived: list[tuple[int, float]] = []
    seen = 0, -1

    def look(number: int, frame: FrameType | None) -> None:
        nonlocal seen
        if not arrived:
            arrived.append((number, time.monotonic()))
        before, seen = seen, (id(frame), frame.f_lasti if frame else -1)
        is_late = time.monotonic() > arrived[0][1] + SIGNAL_PATIENCE_SECONDS
        if is_late or not HAS_ALARM or not _is_fragile(frame, is_waiting=seen == before):
            raise _ending(arrived[0][0])
        signal.setitimer(signal.ITIMER_REAL, SIGNAL_RETRY_SECONDS)

    for number in ours:
        signal.signal(number, look)
    if ours and HAS_ALARM:
        signal.signal(signal.SIGALRM, look)
    try:
        yield
    finally:
        if ours and HAS_ALARM:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
        for number in ours:
            signal.signal(number, known[number])
        if arrived:
            raise _ending(arrived[0][0]) from None


def _ending(number: int) -> BaseException:
    return KeyboardInterrupt() if number == signal.SIGINT else Terminated(number)


def _is_fragile(frame: FrameType | None, *, is_waiting: bool) -> bool:
    """Whether the main thread is where it must not be torn out of; ``is_waiting`` if it is where it was before."""
    collectors = {getattr(callback, "__code__", None) for callback in gc.callbacks}  # what they raise is lost
    while frame is not None:
        name, module = frame.f_code.co_name, frame.f_globals.get("__name__")
        is_borne = name == CONTEXT_FUNCTION or (is_waiting and name in WAITING_FUNCTIONS)
        is_tidying = name in FRAGILE_FUNCTIONS or frame.f_code in collectors
        if is_tidying or (module in FRAGILE_MODULES and not is_borne):
            return True
        frame = frame.f_back
    return False
