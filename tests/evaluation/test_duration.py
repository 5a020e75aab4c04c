"""How long a job takes: its work by figures, its pace by former runs; and the preset that a budget takes."""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from interpolation_samples import CHAIN, job_of
from omnisyn_cli.errors import InputError
from omnisyn_cli.interpolation.job import POSES_FROM_PICTURES
from omnisyn_cli.interpolation.plan import InterpolationPlan, plan_interpolation, with_preset
from omnisyn_cli.interpolation.planning import budget, duration
from omnisyn_cli.interpolation.planning.budget import choose_preset
from omnisyn_cli.interpolation.planning.duration import (
    Duration,
    Run,
    Work,
    expected_duration,
    probe,
    range_in_words,
    remember_run,
    remembered_runs,
    work_of,
)
from omnisyn_cli.interpolation.planning.figures import Figures, Setting, gain
from omnisyn_cli.interpolation.summary import Summary
from omnisyn_cli.pipeline.config import RunConfig
from omnisyn_cli.pipeline.presets import PRESETS, SCALE
from synthesis_samples import write_hall

FRAME = {"render": 0.1, "fuse": 0.04, "encode": 0.06}

SECONDS = {"start": 3.0, "decode": 0.2, "depth": 5.0, "check": 0.5, "mesh": 0.3, **FRAME}

SCORES = {"fast": 25.0, "balanced": 27.0}


def figures_of(config: RunConfig, rows: int = 64, **changes: object) -> Figures:
    setting = Setting("a method", (rows, 2 * rows), 1)
    return replace(Figures(setting, config=config, source=(64, 128), seconds=SECONDS, probe=0.01, pairs=2), **changes)


TABLE_NAME = (
    *(
        figures_of(SCALE[name].config, seconds={**SECONDS, "depth": depth}, scores={"a": score, "b": score + 1})
        for (name, score), depth in zip(SCORES.items(), (2.0, 10.0), strict=True)
    ),
    figures_of(RunConfig()),
)
"""The presets, and one that fuses by rules."""


@pytest.fixture(autouse=True)
def memory(tmp_path, monkeypatch):
    """Where runs are remembered; this machine is as fast as that of the table."""
    monkeypatch.setenv("OMNISYN_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(duration, "probe", lambda: 0.01)
    monkeypatch.setattr(duration, "shipped_table", lambda: TABLE_NAME)
    monkeypatch.setattr(budget, "shipped_table", lambda: TABLE_NAME)
    return tmp_path / "cache"


@pytest.fixture
def plan(tmp_path):
    """Ten frames between two panoramas of 128x64."""
    images = write_hall(tmp_path, CHAIN[:2], (64, 128), with_depth=False)
    return plan_interpolation(job_of(tmp_path, images, frames=12, threads=1, output=tmp_path / "out.mp4"))


def work(plan: InterpolationPlan, table: Sequence[Figures] = TABLE_NAME) -> Work:
    """Of a job that was measured."""
    found = work_of(plan, table)
    assert found is not None
    return found


def expected(plan: InterpolationPlan) -> Duration:
    """Of a job that was measured."""
    found = expected_duration(plan, TABLE_NAME)
    assert found is not None
    return found


def chain_of(plan: InterpolationPlan, panoramas: int, frames: int) -> InterpolationPlan:
    path = tuple(plan.path[0] for _ in range(frames))
    return replace(plan, entries=plan.entries[:1] * panoramas, path=path)


def test_work_is_once_plus_pairs_plus_frames(plan):
    once = work(plan)
    assert (once.start, once.pairs, once.frames) == pytest.approx((3.0, 0.2 + 10.0 + 0.5 + 0.3, 10 * 0.2))
    tour = work(chain_of(plan, 4, 104))
    assert (tour.pairs, tour.frames) == pytest.approx((2 * 0.2 + 3 * 10.8, 100 * 0.2))


def test_stages_have_the_figures_of_what_they_depend_on(plan):
    """Depth that of its rows, frames those of their renderer and of their fusion; whatever else there is."""
    base = plan.config
    two_pass = figures_of(replace(base, renderer="two-pass"), seconds={**SECONDS, "render": 1.0})
    closer = figures_of(replace(base, fusion_rows=128), seconds={**SECONDS, "fuse": 3.04})
    both = replace(plan, config=replace(base, renderer="two-pass", fusion_rows=128))
    usual, asked = (work(each, (*TABLE_NAME, two_pass, closer)) for each in (plan, both))
    assert asked.frames - usual.frames == pytest.approx(10 * (0.9 + 3.0))
    assert asked.pairs == usual.pairs
    assert usual.pairs - work(with_preset(plan, "fast")).pairs == pytest.approx(8.0)


def test_frames_of_other_sizes_lie_between_those_that_were_measured(plan):
    """A mesh costs the same in every size, so a frame of four times the pixels does not take four times as long."""
    config = replace(plan.config, adaptive=True, fallback="none")  # as it was measured
    large = figures_of(config, 128, seconds={**SECONDS, "render": 0.16}, pairs=1)
    table = (*TABLE_NAME, large)

    def render(rows: int) -> float:
        whole, without = (
            work(replace(plan, size=(rows, 2 * rows)), [replace(f, seconds={**f.seconds, **zero}) for f in table])
            for zero in ({}, {"render": 0.0})
        )
        return (whole.frames - without.frames) / 10

    assert [render(rows) for rows in (64, 128)] == pytest.approx([0.1, 0.16])
    assert 0.1 < render(96) < 0.16
    assert render(256) == pytest.approx(4 * 0.16)
    assert render(32) == pytest.approx(0.1 / 4)


def test_depth_from_files_takes_no_time_to_find(plan):
    known = replace(plan, config=plan.config.of_known_depth())
    assert work(plan).pairs - work(known).pairs == pytest.approx(10.0)


@pytest.mark.parametrize(
    "config",
    [RunConfig(method="synsin"), PRESETS["paper"].config, replace(SCALE["fast"].config, is_on_gpu=True)],
)
def test_what_was_not_measured_is_not_guessed(plan, config):
    assert expected_duration(replace(plan, config=config), TABLE_NAME) is None


def test_the_first_guess_is_by_the_pace_of_a_small_piece_of_work(plan, monkeypatch):
    once = expected(plan)
    monkeypatch.setattr(duration, "probe", lambda: 0.02)
    twice = expected(plan)
    assert once.seconds == pytest.approx(3.0 + 11.0 + 2.0)
    assert twice.seconds == pytest.approx(2 * once.seconds)
    assert "a guess" in once.source


def summary_of(plan: InterpolationPlan, pairs: float, frames: float) -> Summary:
    return Summary(plan, {"decode": 0.0, "depth": pairs, "render": frames / 2, "total": pairs + frames})


def test_a_run_makes_the_next_expectation_its_own(plan, memory):
    """A machine whose depth is half as fast and whose frames are three times as fast as the table says."""
    plan = chain_of(plan, 2, 92)
    remember_run(summary_of(plan, 22.0, 6.0))
    assert expected(plan).seconds == pytest.approx(3.0 + 22.0 + 6.0)
    assert expected(plan).source == "by the pace of 1 former run on this machine"
    assert remembered_runs() == [Run(1, 64 * 128, pytest.approx(2.0), pytest.approx(1 / 3))]
    assert (memory / "runs.json").exists()


def test_the_pace_is_that_of_runs_with_as_many_threads_and_frames_of_a_similar_size(plan, monkeypatch):
    long = chain_of(plan, 2, 92)
    for pace in (1.0, 2.0, 3.0, 4.0, 5.0):
        remember_run(summary_of(long, 11.0 * pace, 18.0))
        remember_run(summary_of(replace(long, size=(1024, 2048)), 11.0 * 50, 900.0))
    small, large = (expected(replace(long, size=(rows, 2 * rows))) for rows in (64, 1024))
    assert small.seconds == pytest.approx(3.0 + 11.0 * 3.0 + 18.0)
    assert large.seconds > 500
    monkeypatch.setattr(duration, "available_threads", lambda: 8)
    assert "a guess" in expected(replace(long, job=replace(long.job, threads=None))).source


def test_runs_that_were_starved_count_as_if_they_had_not_been(plan):
    """Five on a machine with something else to do take twenty times as long; what they computed is the same."""
    long = chain_of(plan, 2, 92)
    remember_run(summary_of(long, 11.0, 18.0), processor=40.0)
    usual = expected(long)
    for _ in range(5):
        remember_run(summary_of(long, 220.0, 360.0), processor=40.0)
    busy = expected(long)
    assert busy.seconds == pytest.approx(usual.seconds, rel=0.6)
    remember_run(summary_of(long, 11.0, 18.0), processor=40.0)
    assert expected(long).seconds == pytest.approx(usual.seconds, rel=0.05)


def test_runs_of_a_size_that_is_far_off_do_not_count(plan):
    remember_run(summary_of(chain_of(plan, 2, 92), 1100.0, 1800.0))
    assert "a guess" in expected(replace(plan, size=(1024, 2048))).source


def test_the_range_is_wider_the_less_is_known(plan):
    long = chain_of(plan, 2, 92)
    spreads = [expected(long).spread]
    for _ in range(3):
        remember_run(summary_of(long, 11.0, 18.0))
        spreads.append(expected(long).spread)
    assert spreads == sorted(spreads, reverse=True)
    assert spreads[0] > spreads[1] > spreads[3]
    for pace in (0.5, 4.0):
        remember_run(summary_of(long, 11.0 * pace, 18.0 * pace))
    assert expected(long).spread > spreads[3]


@pytest.mark.parametrize(
    ("bounds", "words"),
    [((0.2, 0.4), "1 s"), ((21.3, 38.9), "20 to 40 s"), ((70, 130), "1 to 2 min"), ((90, 99), "90 to 100 s"),
     ((3000, 6300), "1 to 2 hours"), ((400, 410), "7 min")],
)  # fmt: skip
def test_times_are_round_numbers_in_words(bounds, words):
    assert range_in_words(*bounds) == words


def test_the_last_runs_count(plan):
    long = chain_of(plan, 2, 92)
    for pace in [9.0] * 60 + [1.0] * 5:
        remember_run(summary_of(long, 11.0 * pace, 18.0))
    assert expected(long).seconds == pytest.approx(3.0 + 11.0 + 18.0)
    assert len(remembered_runs()) == duration.MAX_RUNS


def test_runs_that_make_other_things_as_well_are_not_remembered(plan, tmp_path):
    for changes in ({"codec": "h265"}, {"save_depth": tmp_path / "d"}, {"output": tmp_path / "frames"}):
        other = replace(plan, job=replace(plan.job, **changes))
        remember_run(summary_of(other, 11.0, 2.0))
        assert expected(other).source.endswith("for an MP4 by the default encoder alone")
    assert remembered_runs() == []


def test_runs_whose_poses_were_found_in_the_pictures_count(plan):
    """Their clock starts when the poses are there."""
    long = chain_of(plan, 2, 92)
    found = replace(long, job=replace(long.job, poses=POSES_FROM_PICTURES))
    remember_run(summary_of(found, 22.0, 6.0))
    assert expected(long) == expected(found)
    assert expected(found).source == "by the pace of 1 former run on this machine"


@pytest.mark.parametrize("text", ["", "{", "[{}]", '[{"threads": "x"}]'])
def test_a_memory_that_is_damaged_is_as_good_as_none(plan, memory, text):
    memory.mkdir()
    (memory / "runs.json").write_text(text)
    assert expected_duration(plan, TABLE_NAME) is not None
    remember_run(summary_of(chain_of(plan, 2, 92), 11.0, 18.0))
    assert len(remembered_runs()) == 1


def test_where_nothing_can_be_kept_nothing_is(plan, memory):
    memory.write_text("a file where the folder would be")
    remember_run(summary_of(plan, 11.0, 2.0))
    assert remembered_runs() == []


def test_the_probe_does_real_work():
    assert 1e-5 < probe() < 10.0


@pytest.mark.parametrize(
    ("seconds", "preset", "fits"),
    [(1.0, "fast", False), (8.0, "fast", True), (15.9, "fast", True), (16.1, "balanced", True)],
)  # fmt: skip
def test_a_budget_takes_the_best_picture_that_fits_and_says_what_more_time_brings(plan, seconds, preset, fits):
    choice = choose_preset(plan, TABLE_NAME, seconds)
    assert (choice.preset, choice.fits) == (preset, fits)
    assert {name: each.seconds for name, each in choice.expected.items()} == pytest.approx(
        {"fast": 8.0, "balanced": 16.0}
    )
    assert ("even the fastest" in str(choice)) == (not fits)
    assert ("balanced would take about 8 to 30 s for +2.00 ± 0.00 dB" in str(choice)) == (preset == "fast")
    assert "a guess" in str(choice)


def test_the_fastest_preset_is_the_first_of_the_scale_whatever_runs_are_remembered(plan, monkeypatch):
    """A run of ``fast`` on a busy machine does not make ``balanced`` the fastest."""
    known = {"fast": replace(expected(plan), seconds=9.0), "balanced": replace(expected(plan), seconds=7.0)}
    monkeypatch.setattr(budget, "expected_duration", lambda other, table: known[other.job.preset])
    assert choose_preset(plan, TABLE_NAME, 1.0).preset == "fast"


def test_a_preset_that_is_slower_and_worse_is_never_chosen(plan):
    choice = choose_preset(plan, [TABLE_NAME[0], replace(TABLE_NAME[1], scores={"a": 24.0})], 1e9)
    assert (choice.preset, choice.more) == ("fast", "")


def test_without_figures_of_a_preset_there_is_no_choice(plan):
    with pytest.raises(InputError, match="omnisyn bench --store"):
        choose_preset(plan, [replace(TABLE_NAME[0], scores={})], 10.0)


def test_the_figures_that_come_with_the_program_are_of_the_whole_scale(plan, monkeypatch):
    monkeypatch.undo()
    table = duration.shipped_table()
    choice = choose_preset(plan, table, 1e9)
    assert set(choice.expected) == set(SCALE)
    assert all(math.isfinite(each.seconds) and each.seconds > 0 for each in choice.expected.values())
    assert all(f.probe > 0 for f in table)
    assert min(choice.expected, key=lambda name: choice.expected[name].seconds) == "fast"
    scored = [f for f in table if f.scores]
    assert all(len(f.scores) >= 12 and np.min(list(f.scores.values())) > 8 for f in scored)
    assert {"crossfade", "flow"} < {f.config.method for f in scored}
    assert json.dumps([f.to_json() for f in table])


def test_a_preset_that_costs_half_as_much_again_is_worth_it(plan, monkeypatch):
    """By 0.3 dB on scenes that nothing was tuned on, for ninety frames of the size of common photographs."""
    monkeypatch.undo()
    table, clip = duration.shipped_table(), replace(chain_of(plan, 2, 92), size=(1024, 2048))
    found = [budget._scored(table, name) for name in SCALE]
    scored = [figures for figures in found if figures is not None]
    assert len(scored) == len(SCALE)
    for cheap, dear in pairwise(scored):
        less, more = (work(replace(clip, config=each.config), table) for each in (cheap, dear))
        assert sum(vars(more).values()) < 1.5 * sum(vars(less).values()) or gain(dear, cheap)[0] >= 0.3
        assert gain(dear, cheap)[0] > 2 * gain(dear, cheap)[1]
