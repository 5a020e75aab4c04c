"""Who compiles says so, once, in a second process on the first run; afterwards nobody compiles."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numba
import numpy as np
import pytest

from omnisyn_cli.compute import jit, kernel_files
from omnisyn_cli.compute.arrays import empty, zeros
from omnisyn_cli.compute.jit import kernel, when_compiling
from omnisyn_cli.errors import WriteError
from omnisyn_cli.fusion import warp_candidates
from omnisyn_cli.interpolation import kernel_warm_up
from omnisyn_cli.interpolation.kernel_warm_up import compiling_beside
from omnisyn_cli.render import shade


def test_the_first_compilation_is_said_and_no_other_one() -> None:
    first, second = kernel(cache=False)(lambda x: x + 1), kernel(cache=False)(lambda x: x - 1)
    said: list[str] = []
    with when_compiling(lambda: said.append("compiling")):
        assert said == []
        first(1)
        second(1)
        assert said == ["compiling"]
    with when_compiling(lambda: said.append("again")):
        first(2)
        assert said == ["compiling"]
        first(np.float32(2))
        assert said == ["compiling", "again"]
    second(np.float32(2))
    assert said == ["compiling", "again"]


def test_what_another_process_compiles_is_said_as_well() -> None:
    said: list[str] = []
    with when_compiling(lambda: said.append("compiling")):
        jit.announce_compiling()
        jit.announce_compiling()
    assert said == ["compiling"]


@pytest.mark.parametrize("decorator", [kernel, kernel(), jit.fast_kernel()])
def test_kernels_work_without_a_place_for_their_machine_code(
    decorator: jit.Decorator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A read-only installation, and a user without a home."""

    monkeypatch.setattr(jit._Kept, "everywhere", True)
    refusal = Mock(side_effect=RuntimeError("cannot cache function: no locator available"))
    monkeypatch.setattr("numba.core.caching.FunctionCache.__init__", refusal)
    assert decorator(lambda x: x + 1)(1) == 2
    assert not jit.are_kernels_kept()


def test_what_is_compiled_quickly_is_not_worth_a_word() -> None:
    quick, said = kernel(cache=False)(lambda x: x + 1), []
    with when_compiling(lambda: said.append("compiling"), patience=60.0):
        quick(1)
        assert said == []
        jit.announce_compiling()  # by somebody who knows that it takes long
        assert said == ["compiling"]
    with when_compiling(lambda: said.append("again"), patience=1e-9):
        quick(1.0)
    deadline = time.monotonic() + 60
    while said == ["compiling"] and time.monotonic() < deadline:
        time.sleep(0.01)
    assert said == ["compiling", "again"]


def test_compiling_begins_and_ends_once_for_a_kernel_and_those_in_it() -> None:
    inner = kernel(cache=False)(lambda x: x + 1)
    outer, said = kernel(cache=False)(lambda x: inner(x) * 2), []
    with jit.while_compiling(said.append):
        assert outer(1) == 4
        assert said == [True, False]
        outer(1)
    assert said == [True, False]


KERNEL = """
from omnisyn_cli.compute.jit import kernel

@kernel
def double(x):
    return x + x
"""


def loaded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> numba.core.dispatcher.Dispatcher:
    """A kernel of a file, as a process of its own would have it, with a place on disk."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(folder / "kept"))
    (folder / "doubling.py").write_text(KERNEL) if not (folder / "doubling.py").exists() else None
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(__import__("sys").modules, "doubling", raising=False)
    return __import__("doubling").double


def test_two_processes_that_compile_one_kernel_for_two_types_do_not_mix_them_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both find nothing on disk, both write; who reads then gets what belongs to the types, or nothing."""
    first, second = loaded(tmp_path, monkeypatch), loaded(tmp_path, monkeypatch)
    empty = first._cache._cache_file._load_index()
    assert empty == {}
    monkeypatch.setattr(type(first._cache._cache_file), "_load_index", lambda file: {})  # as of before the other wrote
    assert (first(3), second(1.5)) == (6, 3.0)
    monkeypatch.undo()
    again = loaded(tmp_path, monkeypatch)
    assert again(1.5) == 3.0
    assert again(3) == 6
    assert len(list((tmp_path / "kept").rglob("*.nbc"))) == 2


@pytest.mark.parametrize("content", [b"", b"no pickle", b"cno.such.module\nthing\n."], ids=["empty", "other", "gone"])
def test_machine_code_that_cannot_be_read_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: bytes
) -> None:
    """The last one needs a module that this version of the program no longer has."""
    assert loaded(tmp_path, monkeypatch)(3) == 6
    (file,) = (tmp_path / "kept").rglob("*.nbc")
    file.write_bytes(content)
    again = loaded(tmp_path, monkeypatch)
    assert (again(3), sum(again.stats.cache_misses.values())) == (6, 1)
    assert loaded(tmp_path, monkeypatch)(3) == 6


COMPILES_WHEN_TOLD = """
from doubling import double
input()
double(3)
print(sum(double.stats.cache_misses.values()))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no locks there")
def test_of_two_processes_one_compiles_and_the_other_finds_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded(tmp_path, monkeypatch)
    paths = os.pathsep.join([str(tmp_path), *sys.path])
    variables = {**os.environ, "PYTHONPATH": paths, "NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    command, pipe = [sys.executable, "-c", COMPILES_WHEN_TOLD], subprocess.PIPE
    both = [subprocess.Popen(command, env=variables, stdin=pipe, stdout=pipe, text=True) for _ in range(2)]
    for process in both:
        process.stdin.write("\n")
        process.stdin.flush()
    assert sum(int(process.communicate()[0]) for process in both) == 1
    assert not list((tmp_path / "kept").rglob("*.lock"))


@pytest.mark.skipif(sys.platform == "win32", reason="no locks there")
def test_nobody_waits_for_ever_and_a_kernel_that_cannot_be_compiled_holds_nobody_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other process may be one that somebody has stopped."""
    monkeypatch.setattr(kernel_files, "LONGEST_TURN", 0.05)
    stopped, patient = loaded(tmp_path, monkeypatch), loaded(tmp_path, monkeypatch)
    stopped._cache.turn.take()
    said: list[str] = []
    with when_compiling(lambda: said.append("compiling"), patience=60.0):
        assert patient(3) == 6
    assert said == ["compiling"]
    stopped._cache.turn.end()
    with pytest.raises(numba.TypingError):
        patient(None)
    assert not list((tmp_path / "kept").rglob("*.lock"))


def test_new_arrays_in_kernels_are_numpys() -> None:
    @kernel(cache=False)
    def new(count: int, like: np.ndarray) -> tuple[np.ndarray, ...]:
        return empty(count, np.bool_), zeros((count, 3), like.dtype), zeros((2, count, 2), np.float64)

    found = new(5, np.ones(1, np.uint16))
    plain = np.empty(5, bool), np.zeros((5, 3), np.uint16), np.zeros((2, 5, 2))
    for array, expected in zip(found, plain, strict=True):
        assert (array.shape, array.strides, array.dtype) == (expected.shape, expected.strides, expected.dtype)
    assert not found[1].any()
    assert not found[2].any()
    with pytest.raises(ValueError, match="negative"):
        new(-1, np.ones(1))


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Processes that were started, on a machine of two cores that has never compiled a kernel."""
    found: list[subprocess.Popen[bytes]] = []
    start = kernel_warm_up._tiny_video
    monkeypatch.setattr(kernel_warm_up, "is_on_disk", lambda kernel: False)
    monkeypatch.setattr(kernel_warm_up, "available_threads", lambda: 2)
    monkeypatch.setattr(kernel_warm_up, "_tiny_video", lambda folder: found.append(start(folder)) or found[-1])
    yield found
    assert all(process.poll() is not None for process in found)


def test_the_second_process_makes_its_video(started: list[subprocess.Popen[bytes]]) -> None:
    with compiling_beside(None):
        assert started[0].wait(timeout=300) == 0
    assert not Path(str(started[0].args[3])).exists()  # type: ignore[index]


def test_its_video_has_what_costs_most_to_compile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Edge pixels, the fusion network, and colours of the one type that equally exposed photographs have."""
    seen: set[tuple[str, str]] = set()

    def watch(module: Any, name: str) -> None:
        kernel = getattr(module, name)

        def watched(*arguments: Any) -> None:
            seen.update((name, str(each.texels.dtype)) for each in arguments if hasattr(each, "texels"))
            seen.add((name, "called"))
            kernel(*arguments)

        monkeypatch.setattr(module, name, watched)

    for module, name in ((shade, "shade_rows"), (shade, "shade_edge_pixels"), (warp_candidates, "mix_rows")):
        watch(module, name)
    with monkeypatch.context() as context:
        context.setattr(subprocess, "Popen", lambda command, **options: command)
        _, _, program, *arguments = kernel_warm_up._tiny_video(tmp_path)  # type: ignore[misc]
    monkeypatch.setattr(sys, "argv", ["-c", *arguments])
    exec(program, {})  # noqa: S102 - as the second process does
    assert seen == {(name, "called") for name in ("shade_rows", "shade_edge_pixels", "mix_rows")} | {
        (name, "uint8") for name in ("shade_rows", "shade_edge_pixels")
    }


def test_it_ends_with_the_first_one(started: list[subprocess.Popen[bytes]]) -> None:
    with pytest.raises(KeyboardInterrupt), compiling_beside(2):
        raise KeyboardInterrupt
    assert len(started) == 1


@pytest.mark.parametrize(("threads", "is_kept"), [(1, False), (None, True)])
def test_without_a_core_or_a_need_there_is_none(started, monkeypatch, threads, is_kept) -> None:
    monkeypatch.setattr(kernel_warm_up, "is_on_disk", lambda kernel: is_kept)
    with compiling_beside(threads):
        pass
    assert started == []


def test_where_it_cannot_be_started_everything_is_as_before(started, monkeypatch) -> None:
    monkeypatch.setattr(kernel_warm_up, "_tiny_video", Mock(side_effect=WriteError("folder: full")))
    with compiling_beside(None):
        pass
    assert started == []


def test_what_is_not_kept_needs_nobody() -> None:
    """Kernels without a place on disk would be compiled for nothing."""
    assert jit.is_on_disk(kernel(cache=False)(lambda x: x + 1))
