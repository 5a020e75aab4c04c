"""Who compiles says so, once; who finds machine code does not."""

import numpy as np

from omnisyn_cli.jit import kernel, when_compiling


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
