"""Who compiles says so, once; who finds machine code does not."""

import numpy as np
import pytest

from omnisyn_cli.runtime import jit
from omnisyn_cli.runtime.jit import announce_compiling, are_kernels_kept, fast_kernel, kernel, when_compiling


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
        announce_compiling()
        announce_compiling()
    assert said == ["compiling"]


@pytest.mark.parametrize("decorator", [kernel, kernel(), fast_kernel()])
def test_kernels_work_without_a_place_for_their_machine_code(
    decorator: jit.Decorator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A read-only installation, and a user without a home."""

    def refuse(_: object) -> None:
        raise RuntimeError("cannot cache function: no locator available")

    monkeypatch.setattr(jit._Kept, "everywhere", True)
    monkeypatch.setattr("numba.core.dispatcher.Dispatcher.enable_caching", refuse)
    assert decorator(lambda x: x + 1)(1) == 2
    assert not are_kernels_kept()
