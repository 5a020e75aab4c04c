"""A signal is a signal wherever it arrives: its exit code, one line, all outputs or none, no process left behind."""

import ctypes
import gc
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import suppress
from itertools import count
from pathlib import Path
from types import FunctionType
from typing import Any

import pytest

from cli.cli_samples import Omnisyn, listing, pair_arguments, write_pair
from omnisyn_cli.cli import signals
from omnisyn_cli.cli.signals import Terminated, signals_raised
from omnisyn_cli.errors import WriteError
from omnisyn_cli.io.ffmpeg_process import EncoderProcess
from omnisyn_cli.io.video import BackgroundSink

pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="no such signals there"),
    pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning"),  # torn out between `open` and its `with`
]

LONG = 60.0  # Seconds that something waits which a signal shall break off.


@pytest.fixture(autouse=True)
def _heeded() -> Iterator[None]:
    """Whatever the shell that runs the tests, or a test before, ignores."""
    own = {signal.SIGTERM: signal.SIG_DFL, signal.SIGINT: signal.default_int_handler}
    former = {number: signal.signal(number, handler) for number, handler in own.items()}
    yield
    for number, handler in former.items():
        signal.signal(number, handler)


def end() -> None:
    signal.raise_signal(signal.SIGTERM)


@signals_raised()
def after_signal(wait: Callable[..., object], *arguments: object) -> None:
    """Wait, while the signal comes from outside."""
    threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGTERM)).start()
    wait(*arguments)


def check_broken_off(work: Callable[[], None]) -> None:
    begin = time.monotonic()
    with pytest.raises(Terminated):
        work()
    assert time.monotonic() - begin < LONG / 2


class Destroyed:
    def __del__(self) -> None:
        end()


def at_call(number: int, original: Callable[..., Any], then: Callable[[], object]) -> Callable[..., Any]:
    """A function that calls ``then`` after its ``number``-th call on the main thread."""
    calls = count(1)

    def wrapped(*arguments: Any, **options: Any) -> Any:
        result = original(*arguments, **options)
        if threading.get_ident() == threading.main_thread().ident and next(calls) == number:
            then()
        return result

    return wrapped


MOMENTS = {
    "a lock is given back to wait": (threading.Condition, "_release_save", 1, end),
    "a thread is started": (threading.Event, "wait", 1, end),
    "ffmpeg is started": (EncoderProcess, "_started", 1, end),
    "frames are made": (BackgroundSink, "write", 5, end),
    "something is destroyed": (BackgroundSink, "write", 5, Destroyed),
    "frames get their names": (Path, "replace", 3, end),
}


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_signal_leaves_all_or_nothing(
    tmp_path: Path, omnisyn: Omnisyn, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    owner, name, number, then = MOMENTS[moment]
    (tmp_path / "frames").mkdir()  # a new one would get its name with all frames in it
    more = ("--save-frames", tmp_path / "frames", "--frames", 9, "-q")
    arguments = pair_arguments(tmp_path, write_pair(tmp_path), "out.mp4", *more)
    before = {*listing(tmp_path)}
    all_there = before | {"out.mp4", "frames/", *(f"frames/00000{index}.png" for index in range(9))}
    processes: list[subprocess.Popen[bytes]] = []
    original = subprocess.Popen.__init__

    def started(process: subprocess.Popen[bytes], *arguments: Any, **options: Any) -> None:
        original(process, *arguments, **options)
        processes.append(process)

    monkeypatch.setattr(subprocess.Popen, "__init__", started)
    monkeypatch.setattr(owner, name, at_call(number, getattr(owner, name), then))
    result = omnisyn(*arguments)
    assert (result.code, result.out) == (143, "")
    assert result.err == "omnisyn: ended by a signal; nothing was left half written\n"
    assert {*listing(tmp_path)} in (before, all_there)
    assert all(process.returncode is not None for process in processes)


def test_whatever_else_fails_on_the_way_out_the_signal_is_what_is_told() -> None:
    @signals_raised()
    def fail() -> None:
        with suppress(Terminated):
            end()
        raise WriteError("expected a pipe, got a broken one")

    with pytest.raises(Terminated):
        fail()


def test_a_signal_that_somebody_swallows_is_told_in_the_end() -> None:
    with pytest.raises(KeyboardInterrupt), signals_raised(), suppress(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_a_signal_while_kernels_are_compiled_is_not_lost() -> None:
    """LLVM calls back through C, where an exception would be printed and forgotten."""
    there = {"__name__": "llvmlite.binding.executionengine", "signal": signal}
    callback = ctypes.CFUNCTYPE(None)(FunctionType(end.__code__, there))

    @signals_raised()
    def compile_and_go_on() -> None:
        callback()
        time.sleep(LONG)

    check_broken_off(compile_and_go_on)


def test_a_signal_while_garbage_is_collected_is_not_lost() -> None:
    """Python prints what such a callback raises, and goes on."""

    def collected(phase: str, info: dict[str, int]) -> None:
        end()
        gc.callbacks.remove(collected)

    @signals_raised()
    def collect_and_go_on() -> None:
        gc.callbacks.append(collected)
        gc.collect()
        time.sleep(LONG)

    check_broken_off(collect_and_go_on)


def test_a_wait_is_broken_off() -> None:
    with pytest.raises(Terminated):
        after_signal(Future[None]().result, LONG)


def test_tidying_up_that_hangs_is_broken_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """Joining a thread is not broken off otherwise: it would be no longer known that it runs."""
    monkeypatch.setattr(signals, "SIGNAL_PATIENCE_SECONDS", 0.2)
    hanging, ended = threading.Event(), list[bool]()
    thread = threading.Thread(target=lambda: ended.append(hanging.wait(LONG)))
    thread.start()
    with pytest.raises(Terminated):
        after_signal(thread.join)
    assert not ended
    hanging.set()


def test_handlers_of_others_are_left_alone_and_ours_are_gone_afterwards() -> None:
    ours = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)}
    with signals_raised():
        assert ours[signal.SIGTERM] is not signal.getsignal(signal.SIGTERM)
    assert {number: signal.getsignal(number) for number in ours} == ours
    heard = []
    signal.signal(signal.SIGTERM, lambda number, frame: heard.append(number))
    with signals_raised():
        end()
    assert heard == [signal.SIGTERM]
