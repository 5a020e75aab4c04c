"""Settings that are measured: figures that agree with the evaluation, failures that are written down, nothing twice."""

import math
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from types import SimpleNamespace

import numpy as np
import pytest
from hall_samples import damage, hall_pair, run, write_halls

from omnisyn_cli.compute.jit import kernel, when_compiling
from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation import bench_settings
from omnisyn_cli.evaluation.bench_settings import (
    BenchJob,
    BenchRun,
    make_scenes,
    measure_setting,
    plan_bench,
    run_bench,
)
from omnisyn_cli.evaluation.datasets import find_scenes
from omnisyn_cli.evaluation.datasets.sources import choose_pairs
from omnisyn_cli.evaluation.methods import find_method
from omnisyn_cli.evaluation.report import bench_tables, write_bench_report
from omnisyn_cli.interpolation.job import InterpolationJob
from omnisyn_cli.interpolation.plan import plan_interpolation
from omnisyn_cli.interpolation.planning.figures import FRAME_STAGES, Figures, Setting
from omnisyn_cli.pipeline.methods import OMNISYN
from omnisyn_cli.pipeline.presets import DEFAULT_PRESET, SCALE
from omnisyn_cli.types import KnownDepth

FAST = "omnisyn-fast"


def job(tmp_path: Path, **options: object) -> BenchJob:
    fixed = {"methods": FAST, "sizes": ((64, 128),), "threads": (1,), "frames": 2}
    return BenchJob(tmp_path / "data", **{**fixed, **options})


def figures_of(setting: Setting) -> Figures:
    stages = ("start", "decode", "depth", "mesh", *FRAME_STAGES)
    scores = {"hall": 30.0, "yard": 28.0}
    return Figures(setting, seconds=dict.fromkeys(stages, 0.5), probe=1.0, source=(64, 128), scores=scores)


@pytest.mark.parametrize("method", [FAST, "crossfade"])
def test_accuracy_is_what_the_evaluation_measures(tmp_path, method):
    """Two ways through the program: files to a video with its depth remembered, and a method on loaded views."""
    pair = hall_pair(tmp_path / "data")
    (tmp_path / "clips").mkdir()
    figures = measure_setting(BenchRun(Setting(method, (64, 128), 1), (pair,), 1), tmp_path / "clips")
    (record,) = run(tmp_path / "data", method)
    assert figures.ws_psnr == pytest.approx(fmean(frame.scores["ws_psnr"] for frame in record.frames), abs=0.01)
    assert len(figures.scores) == 1
    assert (figures.source, figures.pairs, figures.status) == ((64, 128), 1, "done")
    assert all(math.isfinite(seconds) and seconds >= 0 for seconds in figures.seconds.values())
    assert {"start", "decode", *FRAME_STAGES} <= set(figures.seconds)
    assert figures.seconds["encode"] > 0
    assert figures.config == find_method(method).config
    if method == FAST:
        assert figures.seconds["depth"] > figures.seconds["mesh"] > 0


def test_frames_of_another_size_are_compared_at_the_size_of_the_truth(tmp_path):
    """A quarter of the pixels costs accuracy, and the true frame itself scores the best at its own size."""
    pair = hall_pair(tmp_path)
    depths = KnownDepth()(*bench_settings.load_pair(pair).views)
    folder, ends = tmp_path / "hall", (pair.first.image, pair.second.image)
    clip = InterpolationJob(ends, folder / "poses.json", tmp_path / "frames", frames=3, threads=1)
    small, same, large = (
        np.mean(bench_settings._scores(pair, depths, plan_interpolation(replace(clip, size=(rows, 2 * rows)))))
        for rows in (32, 64, 128)
    )
    assert small < same - 1.0
    assert large > small + 1.0


def test_every_combination_is_a_setting_in_a_process_of_its_own(tmp_path, monkeypatch):
    write_halls(tmp_path / "data", "hall", "yard")
    runs: list[BenchRun] = []

    def pretend(asked: BenchRun) -> Figures:
        runs.append(asked)
        return figures_of(asked.setting)

    monkeypatch.setattr(bench_settings, "_measure_in_child", pretend)
    sizes = ((32, 64), (64, 128))
    wanted = job(tmp_path, methods=f"{FAST},omnisyn-balanced,matching", sizes=sizes, threads=(1, 2))
    run_bench(tmp_path / "report", plan_bench(wanted))
    assert len({each.setting for each in runs}) == len(runs) == 3 * 2 + 2 * 2
    assert all([pair.scene for pair in each.pairs] == ["hall", "yard"] and each.is_scored for each in runs)
    assert {each.setting.method for each in runs if each.setting.size == (64, 128)} == {FAST, "omnisyn-balanced"}


def test_frames_that_are_larger_than_the_truth_are_timed_and_not_compared(tmp_path, monkeypatch):
    write_halls(tmp_path / "data", "hall", "nave", "yard")
    runs: list[BenchRun] = []
    monkeypatch.setattr(bench_settings, "_measure_in_child", lambda run: runs.append(run) or figures_of(run.setting))
    run_bench(tmp_path / "report", plan_bench(job(tmp_path, sizes=((64, 128), (128, 256)))))
    assert [(run.is_scored, len(run.pairs)) for run in runs] == [(True, 3), (False, 2)]
    figures = measure_setting(BenchRun(runs[1].setting, runs[1].pairs[:1], 1, is_scored=False), tmp_path)
    assert (figures.scores, figures.ws_psnr) == ({}, None)


def test_what_is_measured_is_what_users_may_choose():
    chosen = [find_method(name).config for name in bench_settings.DEFAULT_BENCH_METHODS]
    assert {config.method for config in chosen} == {"crossfade", "flow", OMNISYN}
    assert {preset.config for preset in SCALE.values()} <= set(chosen)
    usual = SCALE[DEFAULT_PRESET].config
    for aspect in ("renderer", "fusion", "edges"):
        assert any(getattr(config, aspect) != getattr(usual, aspect) for config in chosen), aspect
    assert len(bench_settings.GENERATED_PAIRS) >= 12
    assert len({kind for kind, _, _ in bench_settings.GENERATED_PAIRS}) == 3
    assert all(5_000_000 <= seed < 6_000_000 for _, seed, _ in bench_settings.GENERATED_PAIRS)


def test_what_is_measured_is_not_measured_again_and_failures_are(tmp_path, monkeypatch):
    write_halls(tmp_path / "data", "hall")
    asked: list[Setting] = []

    def pretend(each: BenchRun) -> Figures:
        asked.append(each.setting)
        done = Figures(**{**vars(figures_of(each.setting)), "key": each.key})
        return done if each.setting.method == FAST else Figures(each.setting, "failed", "no memory", key=each.key)

    monkeypatch.setattr(bench_settings, "_measure_in_child", pretend)
    plan = plan_bench(job(tmp_path, methods=f"{FAST},matching"))
    first = run_bench(tmp_path / "report", plan)
    with (tmp_path / "report" / "bench.jsonl").open("a") as file:
        file.write('{"setting": {"pre')  # an interruption in the middle of a line
    assert run_bench(tmp_path / "report", plan) == first
    assert [setting.method for setting in asked] == [FAST, "matching", "matching"]
    damage(tmp_path / "data" / "hall" / "p1.png")
    run_bench(tmp_path / "report", plan)
    assert [setting.method for setting in asked[3:]] == [FAST, "matching"]


def test_a_setting_that_fails_says_why_and_so_does_one_that_dies(tmp_path):
    pair = hall_pair(tmp_path / "data")
    damage(tmp_path / "data" / "hall" / "p0.png")
    setting = Setting(FAST, (64, 128), 1)
    failed = bench_settings._measure_in_child(BenchRun(setting, (pair,), 1, key="key"))
    assert (failed.status, failed.key) == ("failed", "key")
    assert "first.png" in failed.reason
    died = bench_settings._measure_in_child(BenchRun(setting, (Deadly(),), 1))  # type: ignore[arg-type]
    assert (died.status, died.reason) == ("failed", "the process ended with exit code 3")


class Compiling:
    """A pair whose first panorama cannot be read before a kernel is compiled."""

    @property
    def first(self) -> None:
        kernel(cache=False)(lambda x: x)(1)
        raise InputError("no panorama")


def test_a_process_that_compiles_says_so(tmp_path):
    said: list[str] = []
    with when_compiling(lambda: said.append("compiling")):
        failed = bench_settings._measure_in_child(BenchRun(Setting(FAST, (64, 128), 1), (Compiling(),), 1))  # type: ignore[arg-type]
    assert (failed.status, failed.reason) == ("failed", "InputError: no panorama")
    assert said == ["compiling"]


def test_a_process_that_compiled_ends_before_it_measures(tmp_path, monkeypatch):
    sent: list[object] = []

    def measure(run: BenchRun, folder: Path, on_warm: Callable[[], None]) -> str:
        if run.frames == 2:
            kernel(cache=False)(lambda x: x)(1)
        on_warm()
        return "figures"

    monkeypatch.setattr(bench_settings, "measure_setting", measure)
    monkeypatch.setattr(bench_settings, "end_with_parent", lambda: None)
    for frames, is_patient in ((1, False), (2, False), (2, True)):
        setting = Setting(FAST, (64, 128), 1)
        bench_settings._serve(SimpleNamespace(send=sent.append), BenchRun(setting, (), frames), tmp_path, is_patient)  # type: ignore[arg-type]
    assert sent == ["figures", "compiling", None, "compiling", "figures"]


@pytest.mark.parametrize("has_compiled", [False, True])
def test_a_setting_that_had_to_compile_is_measured_again(has_compiled, monkeypatch):
    """Compiling takes a minute once, which is not what a clip takes."""
    first, second = (figures_of(Setting(FAST, (64, 128), threads)) for threads in (1, 2))
    answers = [None, second] if has_compiled else [first]
    monkeypatch.setattr(bench_settings, "_measured_once", lambda run, is_patient=False: answers.pop(0))
    assert bench_settings._measure_in_child(BenchRun(first.setting, (), 1)) is (second if has_compiled else first)


class Deadly:
    """Ends the process that it is sent to."""

    def __reduce__(self) -> tuple[object, tuple[int]]:
        return os._exit, (3,)


def test_time_and_memory_are_those_of_the_process():
    held = np.ones(32 << 20, np.uint8)
    peak = bench_settings.peak_memory()
    assert peak is None or peak > held.nbytes


def test_other_stages_belong_to_the_pair_and_the_rest_to_the_frames(tmp_path, monkeypatch):
    pair = hall_pair(tmp_path / "data")
    seconds = {"decode": 1.0, "depth": 4.0, "check": 2.0, "mesh": 1.0, "render": 6.0, "fuse": 2.0, "total": 20.0}
    monkeypatch.setattr(
        bench_settings, "run_interpolation", lambda plan, estimator, now: SimpleNamespace(seconds=seconds)
    )
    ends = (pair.first.image, pair.second.image)
    plan = plan_interpolation(InterpolationJob(ends, ends[0].parent / "poses.json", tmp_path / "clip.mp4"))
    of_pair = {"decode": 1.0, "depth": 4.0, "check": 2.0, "mesh": 1.0}
    of_frame = {"render": 1.5, "fuse": 0.5, "encode": 1.0}
    assert bench_settings._clip(plan, KnownDepth(), 4) == of_pair | of_frame


def test_computing_counts_what_is_computed_here_and_by_processes_that_have_ended():
    begin = bench_settings.computing()
    subprocess.run([sys.executable, "-c", "sum(range(3_000_000))"], check=True)
    after = bench_settings.computing()
    assert after > begin + 0.01
    time.sleep(0.2)
    assert bench_settings.computing() < after + 0.1


def test_scenes_are_made_once(tmp_path):
    make_scenes(tmp_path / "scenes", (16, 32))
    pairs = [pair for source in find_scenes(tmp_path / "scenes") for pair in choose_pairs(None)(source.read())]
    assert sorted(pair.scene for pair in pairs) == sorted(
        f"{k}-{s}-{b:g}m" for k, s, b in bench_settings.GENERATED_PAIRS
    )
    walked = [float(np.linalg.norm(pair.second.pose.position - pair.first.pose.position)) for pair in pairs]
    assert walked == pytest.approx([float(pair.scene.split("-")[2][:-1]) for pair in pairs])
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "scenes").rglob("*.png")}
    make_scenes(tmp_path / "scenes", (16, 32))
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "scenes").rglob("*.png")} == before


@pytest.mark.parametrize(
    ("options", "message"),
    [({"methods": "nosuch"}, "nosuch"), ({"pairs": "x"}, "pairs"),
     ({"methods": "oracle-depth"}, "expected methods that `omnisyn interpolate` has"),
     ({"methods": "matching:depth=64x32"}, "expected methods that `omnisyn interpolate` has")],
)  # fmt: skip
def test_wrong_wishes_are_refused(tmp_path, options, message):
    write_halls(tmp_path / "data", "hall")
    with pytest.raises(InputError, match=message):
        plan_bench(job(tmp_path, **options))


def test_the_report_names_failures_and_draws_what_is_rated(tmp_path):
    good, bad = (Setting(method, (64, 128), 1) for method in (FAST, "matching"))
    measured = [figures_of(good), Figures(bad, "failed", "<no memory>")]
    write_bench_report(tmp_path, measured)
    page = (tmp_path / "bench.html").read_text()
    assert "&lt;no memory&gt;" in page
    assert good.name in page
    assert (tmp_path / "bench.png").read_bytes().startswith(b"\x89PNG")
    choice, stages = bench_tables(measured)
    assert [row.name for row in choice.rows] == [f"● {good.name}"]
    assert [row.reason for row in stages.rows] == ["", "<no memory>"]
