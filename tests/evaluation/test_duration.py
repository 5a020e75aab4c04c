"""How long a job takes: by a table; and the preset that a budget takes."""

import json
import math
from dataclasses import asdict, replace
from itertools import pairwise

import numpy as np
import pytest

from interpolation_samples import CHAIN, job_of
from omnisyn_cli.errors import InputError
from omnisyn_cli.interpolation.plan import InterpolationPlan, plan_interpolation, with_preset
from omnisyn_cli.interpolation.planning import duration
from omnisyn_cli.interpolation.planning.duration import (
    Duration,
    choose_preset,
    expected_duration,
    probe,
    range_in_words,
)
from omnisyn_cli.interpolation.planning.figures import Figures, Setting, gain
from omnisyn_cli.pipeline.config import RunConfig
from omnisyn_cli.pipeline.presets import PRESETS, SCALE
from synthesis_samples import write_hall

FRAME = {"render": 0.1, "fuse": 0.04, "encode": 0.06}
SECONDS = {"start": 3.0, "decode": 0.2, "depth": 5.0, "check": 0.5, "mesh": 0.3, **FRAME}
SCORES = {"fast": 25.0, "balanced": 27.0}


def figures_of(config: RunConfig, rows: int = 64, **changes: object) -> Figures:
    setting = Setting("a method", (rows, 2 * rows), 1)
    return replace(Figures(setting, config=config, source=(64, 128), seconds=SECONDS, probe=0.01, pairs=2), **changes)


# The presets, and one that fuses by rules.
TABLE_NAME = (
    *(
        figures_of(SCALE[name].config, seconds={**SECONDS, "depth": depth}, scores={"a": score, "b": score + 1})
        for (name, score), depth in zip(SCORES.items(), (2.0, 10.0), strict=True)
    ),
    figures_of(RunConfig()),
)


@pytest.fixture(autouse=True)
def same_machine(monkeypatch):
    """This machine is as fast as that of the table."""
    monkeypatch.setattr(duration, "probe", lambda: 0.01)
    monkeypatch.setattr(duration, "shipped_table", lambda: TABLE_NAME)


@pytest.fixture
def plan(tmp_path):
    """Ten frames between two panoramas of 128x64."""
    images = write_hall(tmp_path, CHAIN[:2], (64, 128), with_depth=False)
    return plan_interpolation(job_of(tmp_path, images, frames=12, threads=1, output=tmp_path / "out.mp4"))


def expected(plan: InterpolationPlan) -> Duration:
    """Of a job that was measured."""
    found = expected_duration(plan, TABLE_NAME)
    assert found is not None
    return found


def chain_of(plan: InterpolationPlan, panoramas: int, frames: int) -> InterpolationPlan:
    path = tuple(plan.path[0] for _ in range(frames))
    return replace(plan, entries=plan.entries[:1] * panoramas, path=path)


def test_the_time_is_once_plus_pairs_plus_frames(plan):
    assert expected(plan).seconds == pytest.approx(3.0 + 0.2 + 10.0 + 0.5 + 0.3 + 10 * 0.2)
    assert expected(chain_of(plan, 4, 104)).seconds == pytest.approx(3.0 + 2 * 0.2 + 3 * 10.8 + 100 * 0.2)
    known = replace(plan, config=plan.config.of_known_depth())
    assert expected(plan).seconds - expected(known).seconds == pytest.approx(10.0)
    assert expected(plan).seconds - expected(with_preset(plan, "fast")).seconds == pytest.approx(8.0)


def test_frames_have_the_figures_of_their_renderer_and_fusion(plan):
    other = replace(plan.config, renderer="two-pass", fusion="geometric")
    slower = figures_of(other, seconds={**SECONDS, "render": 1.0})
    usual, asked = (
        expected_duration(replace(plan, config=config), (*TABLE_NAME, slower)) for config in (plan.config, other)
    )
    assert asked.seconds - usual.seconds == pytest.approx(10 * 0.9)


def test_frames_of_other_sizes_lie_between_those_that_were_measured(plan):
    """A mesh costs the same in every size, so a frame of four times the pixels does not take four times as long."""
    config = replace(plan.config, adaptive=True, fallback="none")  # as it was measured
    table = (*TABLE_NAME, figures_of(config, 128, seconds={**SECONDS, "render": 0.16}, pairs=1))

    def frame(rows: int) -> float:
        found = [expected_duration(chain_of(replace(plan, size=(rows, 2 * rows)), 2, n), table) for n in (2, 12)]
        return (found[1].seconds - found[0].seconds) / 10

    assert [frame(rows) for rows in (64, 128)] == pytest.approx([0.2, 0.26])
    assert 0.2 < frame(96) < 0.26
    assert (frame(256), frame(32)) == pytest.approx((4 * 0.26, 0.2 / 4))


@pytest.mark.parametrize("config", [RunConfig(method="synsin"), PRESETS["paper"].config])
def test_what_was_not_measured_is_not_guessed(plan, config):
    assert expected_duration(replace(plan, config=config), TABLE_NAME) is None


def test_the_first_guess_is_by_the_pace_of_a_small_piece_of_work(plan, monkeypatch):
    once = expected(plan)
    monkeypatch.setattr(duration, "probe", lambda: 0.02)
    twice = expected(plan)
    assert twice.seconds == pytest.approx(2 * once.seconds)


@pytest.mark.parametrize(
    ("bounds", "words"),
    [((0.2, 0.4), "1 s"), ((21.3, 38.9), "20 to 40 s"), ((70, 130), "1 to 2 min"), ((90, 99), "90 to 100 s"),
     ((3000, 6300), "1 to 2 hours"), ((400, 410), "7 min")],
)  # fmt: skip
def test_times_are_round_numbers_in_words(bounds, words):
    assert range_in_words(*bounds) == words


def test_the_probe_does_real_work():
    assert 1e-5 < probe() < 10.0


@pytest.mark.parametrize(
    ("seconds", "preset", "fits"),
    [(1.0, "fast", False), (8.0, "fast", True), (15.9, "fast", True), (16.1, "balanced", True)],
)  # fmt: skip
def test_a_budget_takes_the_best_picture_that_fits_and_says_what_more_time_brings(plan, seconds, preset, fits):
    chosen, note = choose_preset(plan, TABLE_NAME, seconds)
    assert chosen == preset
    assert f"expected to take about {'4 to 15' if preset == 'fast' else '8 to 30'} s" in note
    assert ("even the fastest" in note) == (not fits)
    assert ("balanced would take about 8 to 30 s for +2.00 ± 0.00 dB" in note) == (preset == "fast")


def test_the_fastest_preset_is_the_first_of_the_scale(plan, monkeypatch):
    known = {"fast": replace(expected(plan), seconds=9.0), "balanced": replace(expected(plan), seconds=7.0)}
    monkeypatch.setattr(duration, "expected_duration", lambda other, table: known[other.job.preset])
    assert choose_preset(plan, TABLE_NAME, 1.0)[0] == "fast"


def test_a_preset_that_is_slower_and_worse_is_never_chosen(plan):
    chosen, note = choose_preset(plan, [TABLE_NAME[0], replace(TABLE_NAME[1], scores={"a": 24.0})], 1e9)
    assert (chosen, "balanced" in note) == ("fast", False)


def test_without_figures_of_a_preset_there_is_no_choice(plan):
    with pytest.raises(InputError, match="omnisyn bench --store"):
        choose_preset(plan, [replace(TABLE_NAME[0], scores={})], 10.0)


def test_the_figures_that_come_with_the_program_are_of_the_whole_scale(plan, monkeypatch):
    monkeypatch.undo()
    table = duration.shipped_table()
    seconds = {name: expected_duration(with_preset(plan, name), table).seconds for name in SCALE}
    assert all(math.isfinite(each) and each > 0 for each in seconds.values())
    assert all(f.probe > 0 for f in table)
    assert min(seconds, key=seconds.__getitem__) == "fast"
    scored = [f for f in table if f.scores]
    assert all(len(f.scores) >= 12 and np.min(list(f.scores.values())) > 8 for f in scored)
    assert {"crossfade", "flow"} < {f.config.method for f in scored}
    assert json.dumps([asdict(f) for f in table])


def test_a_preset_that_costs_half_as_much_again_is_worth_it(plan, monkeypatch):
    """By 0.3 dB on scenes that nothing was tuned on, for ninety frames of the size of common photographs."""
    monkeypatch.undo()
    table, clip = duration.shipped_table(), replace(chain_of(plan, 2, 92), size=(1024, 2048))
    found = [duration._scored(table, name) for name in SCALE]
    scored = [figures for figures in found if figures is not None]
    assert len(scored) == len(SCALE)
    for cheap, dear in pairwise(scored):
        less, more = (expected_duration(replace(clip, config=each.config), table) for each in (cheap, dear))
        assert more.seconds < 1.5 * less.seconds or gain(dear, cheap)[0] >= 0.3
        assert gain(dear, cheap)[0] > 2 * gain(dear, cheap)[1]
