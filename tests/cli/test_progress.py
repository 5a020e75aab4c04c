"""How far a command is: its plan in a sentence, a line or a bar for each stage, and at the end what to think of it."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from cli.cli_samples import Omnisyn, folder_arguments, pair_arguments, write_pair
from interpolation_samples import edit_poses
from omnisyn_cli.cli import progress
from omnisyn_cli.geometry.sphere import angles_to_direction
from omnisyn_cli.interpolation.summary import direction_in_words
from omnisyn_cli.io import write_image


@pytest.fixture
def pair(tmp_path: Path) -> list[Path]:
    return write_pair(tmp_path, size=(64, 128))


def test_without_a_terminal_every_stage_is_a_line_with_the_time(
    tmp_path: Path, pair: list[Path], omnisyn: Omnisyn
) -> None:
    """The plan comes first; nothing of it is on stdout, and nothing at all is said with -q."""
    result = omnisyn.made(*pair_arguments(tmp_path, pair))
    lines = re.findall(r"^\[\d+:\d\d\] (.*)$", result.raw_err, re.MULTILINE)
    assert re.fullmatch(r"0\.1 s of 128x64 H\.264, 3 frames, (about .* s, )?\d\.\d GB of memory", lines[0])
    assert lines[1:] == ["reading panoramas (2)", "finding depth", "making frames (3)"]
    assert omnisyn.made(*folder_arguments(tmp_path, pair, "-q")).raw_err == ""
    walk = omnisyn.made("view", *pair, "-o", tmp_path / "walk.html").raw_err
    assert re.findall(r"^\[\d+:\d\d\] (.*)$", walk, re.MULTILINE)[1:] == [*lines[1:3], "writing"]


def test_on_a_terminal_the_bars_of_all_stages_have_their_totals_from_the_start(
    tmp_path: Path, pair: list[Path], omnisyn: Omnisyn, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "is_watched", lambda **_: True)
    added: list[tuple[str, object]] = []
    done: dict[int, object] = {}
    monkeypatch.setattr("rich.progress.Progress.start_task", lambda *_: None)
    monkeypatch.setattr(
        "rich.progress.Progress.add_task", lambda bars, name, *, total, **_: added.append((name, total)) or len(added)
    )
    monkeypatch.setattr("rich.progress.Progress.update", lambda bars, task, **changes: done.update({task: changes}))
    omnisyn.made(*pair_arguments(tmp_path, pair))
    assert added == [("reading panoramas", 2), ("finding depth", 1), ("making frames", 3)]
    assert done == {1: {"total": 2, "completed": 2}, 2: {"completed": 1}, 3: {"completed": 3}}


def test_a_plan_begins_with_a_sentence(tmp_path: Path, pair: list[Path], omnisyn: Omnisyn) -> None:
    video, images, walk = (
        omnisyn.made(*words, "--dry-run").out.splitlines()[0]
        for words in (
            pair_arguments(tmp_path, pair, "o.mp4", "--fps", 1),
            folder_arguments(tmp_path, pair),
            ["view", *pair, "-o", tmp_path / "walk.html"],
        )
    )
    assert video.startswith("3 s of 128x64 H.264, 3 frames, ")
    assert images.startswith("3 png images of 128x64, ")
    assert walk.startswith("walk.html of 2 panoramas, ")


def test_good_panoramas_are_said_to_be_good(tmp_path: Path, pair: list[Path], omnisyn: Omnisyn) -> None:
    *_, verdict = omnisyn.made(*pair_arguments(tmp_path, pair, "o.mp4", "--fps", 1)).out.splitlines()
    assert re.match(r"confidence: high \((1\.00|0\.[6-9]\d)\), weakest around 1\.0 s, ", verdict)


def test_for_bad_ones_there_is_the_weakest_place_and_what_to_try(
    tmp_path: Path, pair: list[Path], omnisyn: Omnisyn
) -> None:
    """A second picture of noise fits nothing."""
    image = np.random.default_rng(0).integers(0, 255, (64, 128, 3), np.uint8)
    write_image(pair[1], image)
    edit_poses(tmp_path, lambda panoramas: panoramas["b.png"].update(position=[0, 0, -3]))
    *_, verdict, advice, command = omnisyn.made(*pair_arguments(tmp_path, pair, "o.mp4", "--fps", 1)).out.splitlines()
    assert verdict.startswith("confidence: very low (0.")
    spacing = "panoramas at most 2.1 m apart here, not 3 m, as the nearest wall is 2.7 m away"
    words = f"to try: omnisyn poses check, {spacing}, --mask if people or things moved (docs/confidence.md)"
    assert advice == words
    exported = omnisyn.made("export", *pair, "-o", tmp_path / "o.glb")
    assert words in exported.out
    assert "name depth files in the poses" in exported.err  # an export has no fallback
    files = shlex.join(map(str, [*pair, tmp_path / "poses.json"]))
    assert command == f"to see why: omnisyn info {files} --report report.html"


@pytest.mark.parametrize(
    ("azimuth", "elevation", "words"),
    [(0, 0, "ahead"), (90, 10, "to the right"), (-90, -30, "to the left, below the horizon"), (179, 40, "behind, above "
     "the horizon"), (-179, 0, "behind"), (40, 0, "ahead to the right"), (10, -80, "straight down"),
     (0, 90, "straight up")],
)  # fmt: skip
def test_directions_are_those_of_somebody_who_looks_ahead(azimuth: float, elevation: float, words: str) -> None:
    angles = np.radians([azimuth, 90.0 - elevation])
    assert direction_in_words(angles_to_direction(angles[0], angles[1])) == words


@pytest.mark.parametrize(
    ("words", "message"),
    [(["-o", "old.mp4"], "expected a new file, got one that exists"), (["-o", "new.avi"], "expected a name ending in"),
     (["--frames", 2, "--duration", 1], "expected either frames or a duration")],
)  # fmt: skip
def test_nobody_waits_for_poses_to_be_told_of_a_mistake(
    tmp_path: Path, pair: list[Path], omnisyn: Omnisyn, monkeypatch: pytest.MonkeyPatch, words: list[object],
    message: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    (tmp_path / "old.mp4").write_text("mine")
    monkeypatch.setattr("omnisyn_cli.poses.estimation.estimate_poses", None)
    assert message in omnisyn("interpolate", *pair, "--poses", "auto", *words).err
