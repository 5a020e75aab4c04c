"""What is said where kernels are compiled."""

from pathlib import Path

import pytest

from cli.cli_samples import STAGE_LINE, Omnisyn, write_pair
from omnisyn_cli.cli import progress
from omnisyn_cli.cli.progress import COMPILING_AGAIN, COMPILING_NOTE, say_when_compiling
from omnisyn_cli.compute import jit
from omnisyn_cli.compute.jit import announce_compiling, kernel
from omnisyn_cli.errors import InputError


@pytest.mark.parametrize("is_quiet", [False, True])
def test_compiling_is_said_once_on_standard_error_unless_all_is_quiet(
    is_quiet: bool, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """And unless it is over at once."""
    quick = kernel(cache=False)(lambda x: x * 2)
    with say_when_compiling(is_quiet=is_quiet):
        quick(1)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(progress, "MIN_BAR_SECONDS", 0.0)
    first, second = kernel(cache=False)(lambda x: x + 1), kernel(cache=False)(lambda x: x - 1)
    with say_when_compiling(is_quiet=is_quiet):
        first(1)
        second(1)
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err == ("" if is_quiet else f"{COMPILING_NOTE}\n")


def test_the_bar_says_that_it_waits_for_kernels_and_what_it_said_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "is_watched", lambda **_: True)
    shown: list[str] = []
    monkeypatch.setattr("rich.progress.Progress.update", lambda bar, task, description, **_: shown.append(description))
    first, second = kernel(cache=False)(lambda x: x + 1), kernel(cache=False)(lambda x: x - 1)
    with progress.counted_bar("depth", 3, lambda done: "frames" if done > 1 else "depth", is_quiet=False) as on_frame:
        assert on_frame is not None
        first(1)
        on_frame(1)
        on_frame(2)
        second(1)
    assert shown == ["compiling", "depth", "depth", "frames", "compiling", "frames"]


def test_where_nothing_can_be_kept_it_is_said_what_to_do(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jit._Kept, "everywhere", False)
    with say_when_compiling(is_quiet=False):
        announce_compiling()
    assert capsys.readouterr().err == f"{COMPILING_AGAIN}\n"
    assert "NUMBA_CACHE_DIR" in COMPILING_AGAIN


@pytest.mark.parametrize(
    ("work", "arguments"),
    [("omnisyn_cli.evaluation.engine.plan_evaluation", ("eval", "scenes")),
     ("omnisyn_cli.evaluation.bench_settings.make_scenes", ("bench",)),
     ("omnisyn_cli.evaluation.bench_settings.plan_bench", ("bench", "scenes")),
     ("omnisyn_cli.interpolation.run.run_interpolation", ("interpolate",))],
)  # fmt: skip
def test_commands_that_compile_say_so(
    work: str, arguments: tuple[object, ...], omnisyn: Omnisyn, monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:  # fmt: skip
    def compile_and_fail(*_: object) -> None:
        announce_compiling()
        raise InputError("enough")

    monkeypatch.setattr(work, compile_and_fail)
    if arguments[0] == "interpolate":
        images = write_pair(tmp_path)
        arguments = (*arguments, *images, "--poses", tmp_path / "poses.json", "-o", tmp_path / "out.mp4")
    name, *more = arguments
    for quiet, said in (((), f"{COMPILING_NOTE}\n"), (("-q",), "")):
        assert STAGE_LINE.sub("", omnisyn(name, *quiet, *more).raw_err) == f"{said}omnisyn: enough\n"
