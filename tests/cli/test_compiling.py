"""What is said where kernels are compiled."""

import pytest

from omnisyn_cli.cli.compiling import COMPILING, say_when_compiling
from omnisyn_cli.jit import kernel


@pytest.mark.parametrize("is_quiet", [False, True])
def test_compiling_is_said_once_on_standard_error_unless_all_is_quiet(
    is_quiet: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = kernel(cache=False)(lambda x: x + 1), kernel(cache=False)(lambda x: x - 1)
    with say_when_compiling(is_quiet=is_quiet):
        first(1)
        second(1)
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err == ("" if is_quiet else f"{COMPILING}\n")
