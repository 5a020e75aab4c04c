"""``omnisyn bench`` from the command line, and ``interpolate --budget``, which chooses by its figures."""

import json
from dataclasses import asdict
from pathlib import Path

import pytest

from cli.cli_samples import Omnisyn, listing, write_pair
from omnisyn_cli.cli.evaluate import LAYOUTS
from omnisyn_cli.evaluation import bench_settings
from omnisyn_cli.evaluation.bench_settings import DEFAULT_BENCH_METHODS, GENERATED_PAIRS, BenchJob, BenchRun
from omnisyn_cli.evaluation.datasets import FORMATS
from omnisyn_cli.interpolation.planning.figures import FIGURES, FRAME_STAGES, Figures, read_table
from omnisyn_cli.pipeline.presets import SCALE
from synthesis_samples import posed, write_hall

POSES = [posed((0, 0, 0.6)), posed((0.2, 0.1, 0.1), 0.3), posed((0, 0, -0.6), 0.5)]
SCORES = {"fast": 25.0, "balanced": 27.0}


@pytest.fixture
def scenes(tmp_path: Path) -> Path:
    folder = tmp_path / "scenes" / "hall"
    folder.mkdir(parents=True)
    write_hall(folder, POSES, (32, 64))
    return tmp_path / "scenes"


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[BenchRun]:
    """Every run that is asked for; none is made."""
    asked: list[BenchRun] = []

    def pretend(run: BenchRun) -> Figures:
        asked.append(run)
        score = SCORES.get(run.setting.method.removeprefix("omnisyn-"), 20.0)
        seconds = dict.fromkeys(("start", "decode", "depth", "mesh", *FRAME_STAGES), score - 19.0)
        scores = {pair.scene: score for pair in run.pairs if run.is_scored}
        return Figures(run.setting, key=run.key, source=(32, 64), seconds=seconds, probe=1.0, scores=scores, pairs=1)

    monkeypatch.setattr(bench_settings, "_measure_in_child", pretend)
    return asked


def test_a_setting_is_measured_and_stored(omnisyn: Omnisyn, scenes: Path, tmp_path: Path) -> None:
    result = omnisyn("bench", scenes, "--methods", "omnisyn-fast:rows=64", "--sizes", "64x32", "--frames", 1,
        "--threads", 1, "--report", tmp_path / "report", "--store", tmp_path / "table.json", "--json",
    )  # fmt: skip
    assert (result.code, result.err) == (0, "1/1 omnisyn-fast:rows=64, 64x32, 1 thread\n")
    (figures,) = json.loads(result.out)["settings"]
    assert figures["setting"] == {"method": "omnisyn-fast:rows=64", "size": [32, 64], "threads": 1}
    assert (figures["status"], figures["source"], figures["pairs"]) == ("done", [32, 64], 1)
    assert all(score > 10 for score in figures["scores"].values())
    (stored,) = read_table(tmp_path / "table.json")
    assert asdict(stored) == asdict(FIGURES.validate_python(figures))
    assert {"bench.jsonl", "bench.html", "bench.png", "bench.json"} <= set(listing(tmp_path / "report"))


def test_tables_say_what_to_take(omnisyn: Omnisyn, scenes: Path, runs: list[BenchRun]) -> None:
    result = omnisyn.made("bench", scenes, "--sizes", "64x32,128x64", "--threads", "1,2")
    assert len(runs) == (len(DEFAULT_BENCH_METHODS) + len(SCALE)) * 2
    assert result.out.count("What settings cost and are worth") == 1
    assert "● omnisyn-balanced, 64x32, 1 thread" in result.out
    assert "○ omnisyn-balanced:rows=512, 64x32, 2 threads" in result.out
    assert "27.00" in result.out


def test_scenes_are_made_where_none_are_given(omnisyn: Omnisyn, runs: list[BenchRun], tmp_path: Path) -> None:
    options = ("--scene-size", "32x16", "--sizes", "32x16", "--methods", "omnisyn-fast", "-q")
    assert omnisyn("bench", *options, "--report", tmp_path / "report").out == ""
    assert len({pair.scene for run in runs for pair in run.pairs}) == len(GENERATED_PAIRS)


def test_a_failure_is_named_and_the_exit_code_is_1(
    omnisyn: Omnisyn, scenes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench_settings, "_measure_in_child", lambda run: Figures(run.setting, "failed", "no memory"))
    result = omnisyn.ended(1, "bench", scenes, "--methods", "omnisyn-fast", "--sizes", "64x32", "--threads", 1)
    assert "omnisyn-fast, 64x32, 1 thread: no memory" in result.out


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [(["nosuch"], 3, "expected a folder of scenes"), (["--sizes", "64x64"], 2, "twice as wide"),
     (["--threads", "0"], 2, "--threads"), (["--threads", "64,abc"], 2, "'--threads': 'abc' is not a valid integer."),
     (["--store", "nosuch/table.json"], 3, "expected an existing folder")],
)  # fmt: skip
def test_wrong_options_are_explained(omnisyn: Omnisyn, options: list[str], code: int, message: str) -> None:
    result = omnisyn.ended(code, "bench", *options)
    assert result.out == ""
    assert message in result.err


def test_defaults_and_choices_are_those_of_the_library() -> None:
    from omnisyn_cli.cli.evaluate import bench as command

    assert ("auto", *FORMATS) == LAYOUTS
    values = command.make_context("bench", []).params
    for name, field in BenchJob.__dataclass_fields__.items():
        assert name == "dataset" or values[name] in {None, field.default}, name


@pytest.fixture
def images(tmp_path: Path) -> list[Path]:
    return write_pair(tmp_path)


def job_of(images: list[Path], *more: object) -> list[object]:
    poses, output = images[0].parent / "poses.json", images[0].parent / "out.mp4"
    return ["interpolate", *images, "--poses", poses, "-o", output, "--frames", 9, *more]


def budget_of(seconds: float, images: list[Path], *more: object) -> list[object]:
    return job_of(images, "--budget", seconds, *more)


@pytest.mark.parametrize(
    ("seconds", "words"), [(1e6, "preset {best} for a budget"), (1e-4, "even the fastest preset, fast")]
)
def test_a_budget_chooses_the_preset_and_says_so(
    omnisyn: Omnisyn, images: list[Path], seconds: float, words: str
) -> None:
    result = omnisyn(*budget_of(seconds, images, "--depth", "refined", "--dry-run", "--json"))
    plan = json.loads(result.out)
    best = plan["preset"]
    assert result.code == 0
    assert words.format(best=best) in plan["notes"][-1]
    assert plan["notes"][-1] in result.err
    assert best == "fast" if seconds < 1 else best != "fast"


def test_depth_from_files_leaves_nothing_to_choose(omnisyn: Omnisyn, images: list[Path]) -> None:
    plan = omnisyn.json(*budget_of(60, images, "--dry-run"))
    assert (plan["depth"], plan["preset"]) == ("file", "balanced")
    assert "presets make no difference" in plan["notes"][-1]


@pytest.mark.parametrize(
    ("more", "code", "message"),
    [(["--preset", "fast"], 2, "expected --preset or --budget"),
     (["--renderer", "two-pass"], 3, "expected the renderer 'mesh' with a budget"),
     (["--depth", "matching"], 3, "expected the depth 'auto' with a budget, got 'matching'"),
     (["--depth", "refined", "--model", "completion-balanced"], 3, "expected no model with a budget"),
     (["--fusion", "network"], 3, "expected the fusion 'auto' with a budget, got 'network'")],
)  # fmt: skip
def test_what_a_budget_does_not_go_with(
    omnisyn: Omnisyn, images: list[Path], more: list[str], code: int, message: str
) -> None:
    result = omnisyn(*budget_of(60, images, "--dry-run", *more))
    assert (result.code, result.out) == (code, "")
    assert message in result.err


def test_a_dry_run_says_how_long_it_will_take(omnisyn: Omnisyn, images: list[Path]) -> None:
    plan = omnisyn.json(*job_of(images, "--dry-run"))
    assert plan["expected_seconds"] > 0
