"""What settings cost: the model of time, the settings that are worth choosing, and the choice for a budget."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.budget import choose_preset, shipped_table
from omnisyn_cli.evaluation.pareto import (
    STANDARD_FRAMES,
    Figures,
    Setting,
    Workload,
    expected_seconds,
    nearest_figures,
    pareto_front,
    read_table,
    standard_seconds,
    write_table,
)
from omnisyn_cli.synthesis.presets import PRESETS, SCALE

SECONDS = {
    "start": 3.0, "decode": 0.2, "depth": 5.0, "check": 0.5, "mesh": 0.3,
    "render": 0.1, "fuse": 0.04, "encode": 0.05, "convert": 0.01,
}  # fmt: skip

MEASURED = Figures(
    Setting("fast", 256, (512, 1024), 2), source=(512, 1024), seconds=SECONDS, calibration=0.02, ws_psnr=27.0, pairs=2
)

WORK = Workload(2, 90, (512, 1024), (512, 1024), 0.02)


def figures(seconds: float, ws_psnr: float | None, preset: str = "fast") -> Figures:
    """Figures of a setting whose clips take so long and are so good."""
    setting = replace(MEASURED.setting, preset=preset, depth_rows=PRESETS[preset].recipe.depth.rows)
    stages = dict.fromkeys(SECONDS, 0.0) | {"depth": seconds}
    return replace(MEASURED, setting=setting, seconds=stages, ws_psnr=ws_psnr)


def test_expected_time_is_once_plus_pairs_plus_frames() -> None:
    once, pair, frame = 3.0, 5.0 + 0.5 + 0.3, 0.2
    assert expected_seconds(MEASURED, WORK) == pytest.approx(once + 0.2 + pair + 90 * frame)
    assert expected_seconds(MEASURED, WORK) == pytest.approx(standard_seconds(MEASURED))
    assert WORK.frames == STANDARD_FRAMES
    tour = replace(WORK, panoramas=4, frames=200, size=(1024, 2048), source=(2048, 4096), calibration=0.03)
    expected = 1.5 * (once + 4 * 0.1 * 16 + 3 * pair + 200 * frame * 4)
    assert expected_seconds(MEASURED, tour) == pytest.approx(expected)


def test_depth_from_files_takes_no_time_to_find() -> None:
    saved = expected_seconds(MEASURED, WORK) - expected_seconds(MEASURED, replace(WORK, finds_depth=False))
    assert saved == pytest.approx(5.0)


@pytest.mark.parametrize("seed", range(20))
def test_the_front_is_what_nothing_else_beats(seed: int) -> None:
    rng = np.random.default_rng(seed)
    drawn = rng.integers(1, 8, (12, 2))  # few values, so that there are ties
    settings = [figures(float(seconds), float(score)) for seconds, score in drawn]
    front = {(standard_seconds(f), f.ws_psnr) for f in pareto_front(settings)}
    brute = {
        (float(s), float(q))
        for s, q in drawn
        if not any((t <= s and r >= q) and (t, r) != (s, q) for t, r in drawn)
    }  # fmt: skip
    assert front == brute
    found = pareto_front(settings)
    assert found == sorted(found, key=standard_seconds)


def test_what_failed_or_has_no_accuracy_is_not_in_the_front() -> None:
    broken = Figures(MEASURED.setting, "failed", "no memory")
    assert pareto_front([broken, figures(1.0, None), figures(2.0, 20.0)]) == [figures(2.0, 20.0)]


def test_a_table_reads_back(tmp_path: Path) -> None:
    other = replace(MEASURED, ws_psnr=None, memory=123)
    write_table(tmp_path / "table.json", "a machine", [MEASURED, other, Figures(MEASURED.setting, "failed", "why")])
    assert read_table(tmp_path / "table.json") == (MEASURED, other)
    assert json.loads((tmp_path / "table.json").read_text())["machine"] == "a machine"


@pytest.mark.parametrize("text", ["", "[]", "{", '{"version": 2, "figures": []}', '{"version": 1, "figures": [{}]}'])
def test_what_is_no_table_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "table.json").write_text(text)
    with pytest.raises(InputError, match=r"table\.json: expected a table"):
        read_table(tmp_path / "table.json")


def test_figures_are_those_of_the_nearest_threads_then_of_the_nearest_size() -> None:
    settings = [Setting("fast", 256, (rows, 2 * rows), threads) for rows in (256, 1024) for threads in (1, 4)]
    table = [replace(MEASURED, setting=setting) for setting in settings]

    def nearest(rows: int, threads: int) -> tuple[int, int]:
        found = nearest_figures(table, "fast", 256, (rows, 2 * rows), threads)
        assert found is not None
        return found.setting.size[0], found.setting.threads

    assert nearest(2048, 16) == (1024, 4)
    assert nearest(300, 1) == (256, 1)
    assert nearest(500, 3) == (256, 4)
    assert nearest_figures(table, "fast", 512, (256, 512), 1) is None


def table_of(**presets: tuple[float, float]) -> list[Figures]:
    return [figures(*values, preset) for preset, values in presets.items()]


THREE = table_of(fast=(2.0, 25.0), balanced=(10.0, 27.0), accurate=(40.0, 28.0))


@pytest.mark.parametrize(
    ("budget", "preset", "fits"),
    [(1.0, "fast", False), (2.0, "fast", True), (9.9, "fast", True), (10.0, "balanced", True), (1e9, "accurate", True)],
)
def test_the_most_accurate_that_fits_is_chosen_and_the_fastest_if_none_does(
    budget: float, preset: str, fits: bool
) -> None:
    choice = choose_preset(THREE, WORK, 2, budget)
    assert (choice.preset, choice.fits) == (preset, fits)
    assert choice.expected == {"fast": 2.0, "balanced": 10.0, "accurate": 40.0}
    assert ("even the fastest" in str(choice)) == (not fits)
    assert f"{choice.expected[preset]:.1f} s" in str(choice)


def test_a_preset_that_is_slower_and_worse_is_never_chosen() -> None:
    table = table_of(fast=(2.0, 25.0), balanced=(10.0, 27.0), accurate=(40.0, 26.0))
    assert choose_preset(table, WORK, 2, 1e9).preset == "balanced"


def test_a_machine_of_half_the_speed_needs_twice_the_budget() -> None:
    slow = replace(WORK, calibration=2 * WORK.calibration)
    assert choose_preset(THREE, slow, 2, 19.9).preset == "fast"
    assert choose_preset(THREE, slow, 2, 20.1).preset == "balanced"


def test_without_figures_of_a_preset_there_is_no_choice() -> None:
    with pytest.raises(InputError, match="omnisyn bench --store"):
        choose_preset([], WORK, 2, 10.0)


def test_the_figures_that_come_with_the_program_are_of_the_whole_scale() -> None:
    table = shipped_table()
    choice = choose_preset(table, WORK, 2, 1e9)
    assert set(choice.expected) == set(SCALE)
    assert all(math.isfinite(seconds) and seconds > 0 for seconds in choice.expected.values())
    assert all(f.calibration > 0 and f.ws_psnr is not None and f.ws_psnr > 15 for f in table)
    assert min(choice.expected, key=choice.expected.__getitem__) == "fast"
    assert json.dumps(choice.expected)
