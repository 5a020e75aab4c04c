"""Settings that are measured: figures that agree with the evaluation, failures that are written down, nothing twice."""

import math
import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hall_samples import damage, hall_pair, run, write_halls

from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation import bench, bench_run
from omnisyn_cli.evaluation.bench import BenchJob, make_scenes, plan_bench, run_bench
from omnisyn_cli.evaluation.bench_report import bench_tables, write_bench_report
from omnisyn_cli.evaluation.bench_run import BenchRun, measure_setting
from omnisyn_cli.evaluation.budget import calibrate
from omnisyn_cli.evaluation.datasets import choose_pairs, find_scenes
from omnisyn_cli.evaluation.pareto import FRAME_STAGES, Figures, Setting
from omnisyn_cli.interpolation.job import InterpolationJob
from omnisyn_cli.interpolation.plan import plan_interpolation
from omnisyn_cli.runtime.jit import kernel, when_compiling
from omnisyn_cli.synthesis.presets import PRESETS
from omnisyn_cli.types import KnownDepth

ROWS = 64


def job(tmp_path: Path, **options: object) -> BenchJob:
    fixed = {"presets": ("fast",), "depth_rows": (ROWS,), "sizes": ((64, 128),), "threads": (1,), "frames": 2}
    return BenchJob(tmp_path / "data", tmp_path / "report", **{**fixed, **options})


def figures_of(setting: Setting) -> Figures:
    stages = ("start", "decode", "depth", "mesh", *FRAME_STAGES)
    return Figures(setting, seconds=dict.fromkeys(stages, 0.5), calibration=1.0, source=(64, 128), ws_psnr=30.0)


def test_accuracy_is_what_the_evaluation_measures(tmp_path: Path) -> None:
    """Two ways through the program: files to a video with its depth remembered, and a method on loaded views."""
    pair = hall_pair(tmp_path / "data")
    (tmp_path / "clips").mkdir()
    setting = Setting("fast", PRESETS["fast"].recipe.depth.rows, (64, 128), 1)
    figures = measure_setting(BenchRun(setting, (pair,), 1), tmp_path / "clips", launched=0.0)
    (record,) = run(tmp_path / "data", "omnisyn-fast")
    assert figures.ws_psnr == pytest.approx(record.mean("ws_psnr"), abs=0.01)
    assert (figures.source, figures.pairs, figures.status) == ((64, 128), 1, "done")
    assert figures.seconds is not None
    assert all(math.isfinite(seconds) and seconds >= 0 for seconds in figures.seconds.values())
    assert {"start", "decode", "depth", "mesh", *FRAME_STAGES} <= set(figures.seconds)
    assert figures.seconds["depth"] > figures.seconds["mesh"] > 0


def test_frames_of_another_size_are_compared_at_the_size_of_the_truth(tmp_path: Path) -> None:
    """A quarter of the pixels costs accuracy, and the true frame itself scores the best at its own size."""
    pair = hall_pair(tmp_path)
    depths = KnownDepth()(*bench_run.load_pair(pair).views)
    folder, ends = tmp_path / "hall", (pair.first.image, pair.second.image)
    clip = InterpolationJob(ends, folder / "poses.json", tmp_path / "frames", frames=3, threads=1)
    small, same, large = (
        np.mean(bench_run._scores(pair, depths, plan_interpolation(replace(clip, size=(rows, 2 * rows)))))
        for rows in (32, 64, 128)
    )
    assert small < same - 1.0
    assert large > small + 1.0


def test_every_combination_is_a_setting_in_a_process_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_halls(tmp_path / "data", "hall", "yard")
    runs: list[BenchRun] = []

    def pretend(asked: BenchRun) -> Figures:
        runs.append(asked)
        return figures_of(asked.setting)

    monkeypatch.setattr(bench, "_in_child", pretend)
    sizes = ((32, 64), (64, 128))
    wanted = job(tmp_path, presets=("fast", "balanced"), depth_rows=(64, 128), sizes=sizes, threads=(1, 2))
    run_bench(plan_bench(wanted))
    assert len({each.setting for each in runs}) == len(runs) == 2 * 2 * 2 * 2
    assert all([pair.scene for pair in each.pairs] == ["hall", "yard"] for each in runs)
    own_rows = plan_bench(job(tmp_path, presets=tuple(PRESETS), depth_rows=())).settings
    assert [each.depth_rows for each in own_rows] == [preset.recipe.depth.rows for preset in PRESETS.values()]


def test_what_is_measured_is_not_measured_again_and_failures_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_halls(tmp_path / "data", "hall")
    asked: list[Setting] = []

    def pretend(each: BenchRun) -> Figures:
        asked.append(each.setting)
        done = Figures(**{**vars(figures_of(each.setting)), "key": each.key})
        return done if each.setting.preset == "fast" else Figures(each.setting, "failed", "no memory", each.key)

    monkeypatch.setattr(bench, "_in_child", pretend)
    plan = plan_bench(job(tmp_path, presets=("fast", "balanced")))
    first = run_bench(plan)
    with (tmp_path / "report" / "bench.jsonl").open("a") as file:
        file.write('{"setting": {"pre')  # an interruption in the middle of a line
    assert run_bench(plan) == first
    assert [setting.preset for setting in asked] == ["fast", "balanced", "balanced"]
    damage(tmp_path / "data" / "hall" / "p1.png")
    run_bench(plan)
    assert [setting.preset for setting in asked[3:]] == ["fast", "balanced"]


def test_a_setting_that_fails_says_why_and_so_does_one_that_dies(tmp_path: Path) -> None:
    pair = hall_pair(tmp_path / "data")
    damage(tmp_path / "data" / "hall" / "p0.png")
    setting = Setting("fast", ROWS, (64, 128), 1)
    failed = bench._in_child(BenchRun(setting, (pair,), 1, key="key"))
    assert (failed.status, failed.key) == ("failed", "key")
    assert "first.png" in failed.reason
    died = bench._in_child(BenchRun(setting, (Deadly(),), 1))  # type: ignore[arg-type]
    assert (died.status, died.reason) == ("failed", "the process ended with exit code 3")


class Compiling:
    """A pair whose first panorama cannot be read before a kernel is compiled."""

    @property
    def first(self) -> None:
        kernel(cache=False)(lambda x: x)(1)
        raise InputError("no panorama")


def test_a_process_that_compiles_says_so(tmp_path: Path) -> None:
    said: list[str] = []
    with when_compiling(lambda: said.append("compiling")):
        failed = bench._in_child(BenchRun(Setting("fast", ROWS, (64, 128), 1), (Compiling(),), 1))  # type: ignore[arg-type]
    assert (failed.status, failed.reason) == ("failed", "InputError: no panorama")
    assert said == ["compiling"]


@pytest.mark.parametrize("has_compiled", [False, True])
def test_a_setting_that_had_to_compile_is_measured_again(has_compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiling takes a minute once, which is not what a clip takes."""
    answers = [(figures_of(Setting("fast", rows, (64, 128), 1)), has_compiled) for rows in (64, 128)]
    monkeypatch.setattr(bench, "_measured_once", lambda run: answers.pop(0))
    figures = bench._in_child(BenchRun(Setting("fast", ROWS, (64, 128), 1), (), 1))
    assert figures.setting.depth_rows == (128 if has_compiled else 64)


class Deadly:
    """Ends the process that it is sent to."""

    def __reduce__(self) -> tuple[object, tuple[int]]:
        return os._exit, (3,)


def test_time_and_memory_are_those_of_the_process() -> None:
    held = np.ones(32 << 20, np.uint8)
    peak = bench_run._peak_memory()
    assert peak is None or peak > held.nbytes


def test_other_stages_belong_to_the_pair_and_the_rest_to_the_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair = hall_pair(tmp_path / "data")

    seconds = {"decode": 1.0, "depth": 4.0, "check": 2.0, "mesh": 1.0, "render": 6.0, "fuse": 2.0, "total": 20.0}
    monkeypatch.setattr(bench_run, "run_interpolation", lambda plan, estimator: SimpleNamespace(seconds=seconds))
    ends = (pair.first.image, pair.second.image)
    plan = plan_interpolation(InterpolationJob(ends, ends[0].parent / "poses.json", tmp_path / "clip.mp4"))
    of_pair = {"decode": 1.0, "depth": 4.0, "check": 2.0, "mesh": 1.0}
    of_frame = {"render": 1.5, "fuse": 0.5, "encode": 0.0, "convert": 1.0}
    assert bench_run._per_pair_and_frame(bench_run._clip(plan, KnownDepth()), 4) == of_pair | of_frame


def test_calibration_is_the_median_of_three_steps_or_more(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    monkeypatch.setattr("omnisyn_cli.evaluation.budget._step", lambda _: lambda: calls.append(1))
    marks = iter([0.0, 1.0, 9.0, 11.0])
    monkeypatch.setattr("omnisyn_cli.evaluation.budget.time.perf_counter", lambda: next(marks))
    assert calibrate(1, seconds=0.0) == 2.0
    assert len(calls) == 1 + 3


def test_calibration_does_real_work() -> None:
    assert 1e-5 < calibrate(1, seconds=0.0) < 10.0


def test_scenes_are_made_once(tmp_path: Path) -> None:
    make_scenes(tmp_path / "scenes", (16, 32))
    pairs = [pair for source in find_scenes(tmp_path / "scenes") for pair in choose_pairs(None)(source.read())]
    assert [pair.scene for pair in pairs] == ["room-9000001-1m", "street-9000001-2m"]
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "scenes").rglob("*.png")}
    make_scenes(tmp_path / "scenes", (16, 32))
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "scenes").rglob("*.png")} == before


@pytest.mark.parametrize(("options", "message"), [({"presets": ("nosuch",)}, "nosuch"), ({"pairs": "x"}, "pairs")])
def test_wrong_wishes_are_refused(tmp_path: Path, options: dict[str, object], message: str) -> None:
    write_halls(tmp_path / "data", "hall")
    with pytest.raises(InputError, match=message):
        plan_bench(job(tmp_path, **options))


def test_the_report_names_failures_and_draws_what_is_rated(tmp_path: Path) -> None:
    good, bad = (Setting(preset, 256, (64, 128), 1) for preset in ("fast", "accurate"))
    measured = [figures_of(good), Figures(bad, "failed", "<no memory>")]
    write_bench_report(tmp_path, measured)
    page = (tmp_path / "bench.html").read_text()
    assert "&lt;no memory&gt;" in page
    assert good.name in page
    assert (tmp_path / "bench.png").read_bytes().startswith(b"\x89PNG")
    choice, stages = bench_tables(measured)
    assert [row.name.partition(": ")[2] for row in choice.rows] == [good.name]
    assert [row.reason for row in stages.rows] == ["", "<no memory>"]
