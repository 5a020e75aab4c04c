"""Help is short, in sections, true and quick; a word that is no command is answered with one."""

import os
import re
import subprocess
import sys
from pathlib import Path

import click
import pytest

from cli.cli_samples import Omnisyn, write_pair
from omnisyn_cli.cli import cli
from omnisyn_cli.cli.help import RARE_OPTIONS, SECTIONS, by_section
from omnisyn_cli.interpolation.planning.duration import shipped_table
from omnisyn_cli.interpolation.planning.figures import standard_seconds
from omnisyn_cli.pipeline.presets import PRESETS

COMMANDS = ("interpolate", "view", "export")
every_command = pytest.mark.parametrize("name", COMMANDS)


def options_of(name: str) -> list[click.Option]:
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    return [param for param in command.params if isinstance(param, click.Option)]


@every_command
def test_every_option_has_a_section(name: str) -> None:
    """A new one is put into SECTIONS, and into RARE if few people need it."""
    named = " ".join(SECTIONS.values()).split()
    assert {option.name for option in options_of(name)} - {*named} == set()


def test_no_section_names_what_is_no_option() -> None:
    known = {option.name for name in COMMANDS for option in options_of(name)} | {"help"}
    assert set(" ".join(SECTIONS.values()).split()) == known
    assert known >= {*RARE_OPTIONS}


@every_command
def test_rare_options_are_listed_on_demand(name: str, omnisyn: Omnisyn) -> None:
    usual, every = (omnisyn.quiet(name, option).out for option in ("--help", "--help-all"))
    sections = [section for section, shown in by_section(options_of(name)).items() if shown]
    assert re.findall(r"^(\w[\w ]*):$", every, re.MULTILINE) == sections
    for option in options_of(name):
        line = re.compile(rf"^  (-\w, )?{option.opts[-1]}\b", re.MULTILINE)
        assert line.search(every)
        assert bool(line.search(usual)) is (option.name not in RARE_OPTIONS)
    assert usual.count("\n") <= 100


def test_presets_promise_what_was_measured(omnisyn: Omnisyn) -> None:
    shown = omnisyn("interpolate", "--help").out
    for figures in shipped_table():
        name = figures.setting.method.removeprefix("omnisyn-")
        if name in PRESETS and figures.ws_psnr is not None:
            words = f"{name:9} {standard_seconds(figures):.0f} s, {figures.ws_psnr:.1f} dB"
            assert words in shown


@pytest.mark.parametrize(
    ("words", "meant"),
    [(["interpolte"], "did you mean interpolate"), (["poses", "chek"], "did you mean check?"),
     (["a.png", "b.png"], "did you mean interpolate a.png?"), (["zzz"], "known are interpolate, export")],
)  # fmt: skip
def test_a_word_that_is_no_command_is_answered_with_one(
    tmp_path: Path, omnisyn: Omnisyn, monkeypatch: pytest.MonkeyPatch, words: list[str], meant: str
) -> None:
    write_pair(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert meant in omnisyn.misused(*words)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shells_complete_commands(shell: str) -> None:
    environment = {**os.environ, "_OMNISYN_COMPLETE": f"{shell}_complete", "COMP_WORDS": "omnisyn inter",
                   "COMP_CWORD": "inter" if shell == "fish" else "1"}  # fmt: skip
    done = subprocess.run([sys.executable, "-m", "omnisyn_cli"], env=environment, capture_output=True, text=True)
    assert "interpolate" in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize(("words", "seconds"), [(["--help"], 0.15), (["interpolate", "--dry-run"], 0.6)])
def test_help_and_plans_take_little_computing(tmp_path: Path, words: list[str], seconds: float) -> None:
    """The least of some runs: a busy machine makes every one of them slower."""
    images = write_pair(tmp_path) if len(words) > 1 else []
    command = [sys.executable, "-m", "omnisyn_cli", *words, *map(str, images)]

    def computing() -> float:
        before = os.times()
        subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
        after = os.times()
        return sum(after[2:4]) - sum(before[2:4])

    assert min(computing() for _ in range(5)) < seconds
