"""The error tree is what its docstring draws, and every leaf leaves with the right exit code."""

import inspect

import pytest

from omnisyn_cli import errors
from omnisyn_cli.errors import InputError, OmnisynError

CLASSES = {name: value for name, value in vars(errors).items() if inspect.isclass(value)}


def test_everything_is_drawn() -> None:
    for name in CLASSES:
        assert name in (errors.__doc__ or "")


@pytest.mark.parametrize("name", CLASSES)
def test_exit_codes_tell_unusable_input_from_failure(name: str) -> None:
    kind = CLASSES[name]
    assert issubclass(kind, OmnisynError)
    assert kind.exit_code == (3 if issubclass(kind, InputError) else 1)
    assert str(kind("expected this, got that")) == "expected this, got that"


def test_the_drawing_shows_who_descends_from_whom() -> None:
    """A line that is indented deeper descends from the last line above that is less indented."""
    lines = [line for line in (errors.__doc__ or "").splitlines() if "Error" in line]
    above: list[tuple[int, str]] = []
    for line in lines:
        name = next(word for word in line.split() if word.endswith("Error"))
        indent = line.index(name)
        while above and above[-1][0] >= indent:
            above.pop()
        assert CLASSES[name].__base__ is (CLASSES[above[-1][1]] if above else Exception)
        above.append((indent, name))
