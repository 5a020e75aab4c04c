"""Kernels are compiled by a second process on the first run, and by nobody afterwards."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from omnisyn_cli.compute.jit import is_on_disk, kernel
from omnisyn_cli.errors import WriteError
from omnisyn_cli.fusion import warp_candidates
from omnisyn_cli.interpolation import kernel_warm_up
from omnisyn_cli.interpolation.kernel_warm_up import compiling_beside
from omnisyn_cli.render import shade


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
    def refuse(folder: Path) -> subprocess.Popen[bytes]:
        raise WriteError(f"{folder}: full")

    monkeypatch.setattr(kernel_warm_up, "_tiny_video", refuse)
    with compiling_beside(None):
        pass
    assert started == []


def test_what_is_not_kept_needs_nobody() -> None:
    """Kernels without a place on disk would be compiled for nothing."""
    assert is_on_disk(kernel(cache=False)(lambda x: x + 1))
