"""``omnisyn eval``: tables, JSON, exit codes, and a report that an interrupted run can go on from."""

import json
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from cli.cli_samples import Omnisyn, listing
from interpolation_samples import edit_poses
from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation import engine
from omnisyn_cli.evaluation.methods import MethodUnavailableError
from omnisyn_cli.evaluation.results import read_records
from omnisyn_cli.runtime import session
from synthesis_samples import posed, write_hall

POSES = [posed((0, 0, 0.6)), posed((0.2, 0.1, 0.1), 0.3), posed((0, 0, -0.6), 0.5)]
METHODS = ("crossfade", "oracle-depth", "omnisyn-paper")


@pytest.fixture
def scenes(tmp_path: Path) -> Path:
    """One scene with a true frame, one without."""
    for name, poses in (("hall", POSES), ("pair", POSES[::2])):
        folder = tmp_path / "scenes" / name
        folder.mkdir(parents=True)
        write_hall(folder, poses, (32, 64))
    return tmp_path / "scenes"


@pytest.fixture(autouse=True)
def no_networks(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that a method cannot run."""

    monkeypatch.setattr(session, "open_model", Mock(side_effect=InputError("expected the network, got none")))


def arguments(scenes: Path, *more: object) -> list[object]:
    return ["eval", scenes, "--methods", ",".join(METHODS), "--threads", 1, *more]


def test_the_table_has_the_means_and_every_reason(omnisyn: Omnisyn, scenes: Path) -> None:
    before = listing(scenes)
    result = omnisyn.made(*arguments(scenes))
    titles = ("WS-PSNR", "Some pairs have no true frames", "Shards")
    for expected in ("crossfade", "oracle-depth (upper bound)", *titles, "omnisyn-paper: unavailable: "):
        assert expected in result.out
    assert "Shards" not in omnisyn.made(*arguments(scenes / "hall")).out
    alone = omnisyn.made(*arguments(scenes / "pair")).out
    assert "WS-PSNR" not in alone
    assert "crossfade: no frame between the panoramas" in alone
    assert listing(scenes) == before


def test_json_is_everything_that_was_measured(omnisyn: Omnisyn, scenes: Path, tmp_path: Path) -> None:
    values = json.loads(omnisyn.quiet(*arguments(scenes, "--json", "--quiet", "--report", tmp_path / "report")).out)
    assert [(unit["scene"], unit["method"], unit["status"]) for unit in values["units"]] == [
        (scene, method, status) for scene in ("hall", "pair")
        for method, status in (("crossfade", "done"), ("oracle-depth", "done"), ("omnisyn-paper", "unavailable"))
    ]  # fmt: skip
    assert values["units"] == [record.to_json() for record in read_records(tmp_path / "report")]


def test_what_is_done_is_said_in_lines_where_nobody_sees_a_bar(omnisyn: Omnisyn, scenes: Path, tmp_path: Path) -> None:
    """With where the results are; nothing of it on standard output, and none of it if all shall be quiet."""
    result = omnisyn(*arguments(scenes, "--report", tmp_path / "report"))
    first, *lines = result.err.splitlines()
    assert first.startswith(f"note: results are kept in {tmp_path / 'report'} as they come; started again, the command")
    units = [f"{scene} {method}" for scene in ("hall", "pair") for method in METHODS]
    assert lines == [f"{number}/6 {unit}" for number, unit in enumerate(units, start=1)]
    unkept = omnisyn(*arguments(scenes))
    assert unkept.err.splitlines()[0].startswith("note: results are printed at the end and kept nowhere; --report DIR")
    assert "hall crossfade" not in unkept.out
    assert omnisyn(*arguments(scenes, "-q")).err == ""


def test_the_usual_methods_are_compared_unless_others_are_named(omnisyn, scenes: Path, monkeypatch) -> None:
    """The true depth only where there is some; the help says which. What they would be worth is not measured."""
    monkeypatch.setattr(engine, "measure", Mock(side_effect=MethodUnavailableError("not measured")))

    def methods(*more: object) -> list[str]:
        units = omnisyn.json("eval", scenes / "hall", "--threads", 1, "--no-pictures", *more)["units"]
        return [unit["method"] for unit in units]

    presets = ["omnisyn-fast", "omnisyn-balanced"]
    assert methods() == ["crossfade", "matching", *presets, "oracle-depth"]
    assert methods("--methods", "usual") == methods()
    edit_poses(scenes / "hall", lambda panoramas: panoramas["p2.png"].pop("depth"))
    assert methods() == ["crossfade", "matching", *presets]
    assert methods("--methods", "crossfade,oracle-depth") == ["crossfade", "oracle-depth"]
    words = " ".join(omnisyn("eval", "--help").out.split())
    assert "usual: crossfade, matching, the presets from fast to balanced, and the true depth" in words


def test_the_report_and_its_pictures_are_kept(omnisyn: Omnisyn, scenes: Path, tmp_path: Path) -> None:
    result = omnisyn(*arguments(scenes, "--report", tmp_path / "report"))
    assert "report.html" in result.out
    kept = listing(tmp_path / "report")
    assert {"results.jsonl", "report.html", "report.md", "report.csv", "report.json"} <= set(kept)
    assert any(name.startswith("pictures/") and name.endswith(".jpg") for name in kept)
    assert omnisyn.made(*arguments(scenes, "--report", tmp_path / "bare", "--no-pictures", "-q")).out == ""
    assert not any(name.startswith("pictures/") for name in listing(tmp_path / "bare"))


def test_what_is_broken_is_named_and_the_exit_code_is_1(omnisyn: Omnisyn, scenes: Path) -> None:
    (scenes / "pair" / "poses.json").write_text("{")
    result = omnisyn.ended(1, *arguments(scenes))
    assert "pair: failed: " in result.out
    assert "crossfade" in result.out


def test_depth_outside_of_a_scene_is_read_only_if_allowed(omnisyn: Omnisyn, scenes: Path) -> None:
    hall = scenes / "hall"
    elsewhere = scenes.parent / "depth"
    elsewhere.mkdir()

    def move(panoramas: dict[str, Any]) -> None:
        for entry in panoramas.values():
            (hall / entry["depth"]).rename(elsewhere / entry["depth"])
            entry["depth"] = f"../../depth/{entry['depth']}"

    edit_poses(hall, move)
    assert "commands with --allow-outside accept it" in omnisyn.ended(1, *arguments(hall)).out
    allowed = omnisyn.json(*arguments(hall, "--allow-outside"))
    done = {unit["method"]: unit for unit in allowed["units"] if unit["status"] == "done"}
    assert len(done["oracle-depth"]["depths"]) == 2


def test_pairs_can_be_chosen(omnisyn: Omnisyn, scenes: Path) -> None:
    unit, *_ = omnisyn.json(*arguments(scenes / "hall", "--pairs", "0:1"))["units"]
    assert (unit["first"], unit["second"], unit["frames"][0]["name"]) == ("p0.png", "p1.png", "half way")


@pytest.mark.parametrize(
    ("more", "code", "message"),
    [
        (["--methods", "nosuch"], 3, "expected one of crossfade"), (["--format", "zind"], 3, "the layout 'zind'"),
        (["--format", "nosuch"], 2, "nosuch"), (["--pairs", "x"], 3, "expected pairs"),
        (["--size", "64x64"], 2, "twice as wide"),
        (["--report", "/dev/null/report"], 3, "expected a folder for the report"),
    ],
)  # fmt: skip
def test_wrong_options_are_explained(omnisyn: Omnisyn, scenes: Path, more: list[str], code: int, message: str) -> None:
    result = omnisyn("eval", scenes, "--threads", 1, *more)
    assert (result.code, result.out) == (code, "")
    assert message in result.err


def test_methods_are_listed_without_a_data_set(omnisyn: Omnisyn) -> None:
    result = omnisyn.made("eval", "--list-methods")
    for name in ("crossfade", "flow", "matching", "omnisyn-balanced", "synsin-2view", "oracle-depth"):
        assert f"{name} " in result.out
