"""Bands cover every row once, whatever the number of threads."""

import os
import signal
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from omnisyn_cli.compute.threads import available_threads, run_ranges, split_range


@given(st.integers(0, 300), st.integers(1, 40))
def test_bands_cover_every_row_once_in_order(rows: int, count: int) -> None:
    covered = [row for begin, end in split_range(rows, count) for row in range(begin, end)]
    assert covered == list(range(rows))
    assert len(split_range(rows, count)) <= count
    assert all(end > begin for begin, end in split_range(rows, count))


@pytest.mark.parametrize("threads", [None, 1, 2, 5])
def test_a_kernel_sees_every_row_once(threads: int | None) -> None:
    seen, lock = [], threading.Lock()

    def kernel(begin: int, end: int) -> None:
        with lock:
            seen.extend(range(begin, end))

    run_ranges(kernel, 37, threads)
    assert sorted(seen) == list(range(37))


def test_one_thread_is_a_plain_call() -> None:
    calls: list[tuple[int, int, str]] = []
    run_ranges(lambda begin, end: calls.append((begin, end, threading.current_thread().name)), 9, 1)
    assert calls == [(0, 9, threading.current_thread().name)]


def test_an_error_in_a_band_is_raised() -> None:
    def kernel(begin: int, end: int) -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run_ranges(kernel, 9, 2)


def test_there_is_at_least_one_thread() -> None:
    assert available_threads() >= 1


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork there")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_forked_process_gets_threads_of_its_own() -> None:
    run_ranges(lambda begin, end: None, 64, 2)
    child = os.fork()
    if child == 0:
        signal.alarm(300)  # a pool that came through the fork would wait forever
        run_ranges(lambda begin, end: None, 64, 2)
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
