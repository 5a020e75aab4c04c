"""Worker processes run nothing that lies in the current directory; bands of threads cover every row once."""

import ast
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import omnisyn_cli
from omnisyn_cli.compute.threads import available_threads, run_ranges, split_range

PACKAGE = Path(omnisyn_cli.__file__).parent
PROGRAM = """
import os
from concurrent.futures import ProcessPoolExecutor

from omnisyn_cli.compute.processes import spawn_context

if __name__ == "__main__":
    with ProcessPoolExecutor(1, mp_context=spawn_context()) as pool:
        assert pool.submit(os.getpid).result() != os.getpid()
    ours, theirs = spawn_context().Pipe()
    process = spawn_context().Process(target=theirs.send, args=("alive",))
    process.start()
    assert ours.recv() == "alive"
    process.join()
    assert "PYTHONSAFEPATH" not in os.environ
"""

# Modules of the standard library that every worker imports.
SHADOWS = ("pickle", "signal", "struct", "threading", "traceback", "socket")


def test_workers_import_nothing_from_the_current_directory(tmp_path: Path) -> None:
    folder = tmp_path / "downloaded"
    folder.mkdir()
    for name in SHADOWS:
        (folder / f"{name}.py").write_text(f"open('ran', 'a').write('{name} ')\nraise ImportError\n")
    (tmp_path / "program.py").write_text(PROGRAM)
    done = subprocess.run(
        [sys.executable, tmp_path / "program.py"], cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert not (folder / "ran").exists()


def test_interpreters_are_started_with_a_safe_path_only() -> None:
    """Pools and processes are asked of ``spawn_context``; who starts Python itself does so inside ``safe_path``."""
    for path in sorted(PACKAGE.rglob("*.py")):
        if path == PACKAGE / "compute" / "processes.py":
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        contexts = (node for node in ast.walk(tree) if isinstance(node, ast.With))
        safe = [node for node in contexts if "safe_path()" in map(ast.unparse, (i.context_expr for i in node.items))]
        allowed = {id(node) for context in safe for node in ast.walk(context)}
        for node in ast.walk(tree):
            name = node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
            assert name not in ("get_context", "set_start_method"), f"{path}:{node.lineno}"
            assert name != "executable" or id(node) in allowed, f"{path}:{node.lineno}"
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("ProcessPoolExecutor"):
                assert "mp_context=spawn_context()" in ast.unparse(node), f"{path}:{node.lineno}"


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
