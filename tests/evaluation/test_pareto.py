"""What settings cost and are worth: the gain of one against another, and the settings that are worth choosing."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from omnisyn_cli.errors import InputError
from omnisyn_cli.interpolation.planning.figures import (
    STANDARD_FRAMES,
    Figures,
    Setting,
    gain,
    pareto_front,
    read_table,
    standard_seconds,
    write_table,
)

SECONDS = {
    "start": 3.0, "decode": 0.2, "depth": 5.0, "check": 0.5, "mesh": 0.3,
    "render": 0.1, "fuse": 0.04, "encode": 0.06,
}  # fmt: skip

MEASURED = Figures(
    Setting("omnisyn-fast", (512, 1024), 2), source=(512, 1024), seconds=SECONDS, probe=0.02, scores={"hall": 27.0},
    pairs=2,
)  # fmt: skip


def figures(seconds: float, ws_psnr: float | None) -> Figures:
    """Figures of a setting whose clips take so long and are so good."""
    stages = dict.fromkeys(SECONDS, 0.0) | {"depth": seconds}
    return replace(MEASURED, seconds=stages, scores={} if ws_psnr is None else {"hall": ws_psnr})


def test_a_standard_clip_is_once_plus_a_pair_plus_its_frames():
    assert standard_seconds(MEASURED) == pytest.approx(3.0 + 0.2 + 5.0 + 0.5 + 0.3 + STANDARD_FRAMES * 0.2)


def test_a_gain_is_the_mean_of_paired_differences_and_its_error_shrinks_with_agreement():
    """Scenes that are hard for both do not count as a spread of the difference."""
    base = replace(MEASURED, scores={"a": 20.0, "b": 30.0, "c": 25.0})
    better = replace(MEASURED, scores={"c": 25.5, "a": 20.5, "b": 30.5, "only here": 99.0})
    assert gain(better, base) == pytest.approx((0.5, 0.0))
    assert gain(base, better)[0] == pytest.approx(-0.5)
    mixed = replace(MEASURED, scores={"a": 21.0, "b": 30.0})
    assert gain(mixed, base) == pytest.approx((0.5, 0.5))
    assert all(map(math.isnan, gain(replace(MEASURED, scores={}), base)))


@pytest.mark.parametrize("seed", range(20))
def test_the_front_is_what_nothing_else_beats(seed):
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


def test_what_failed_or_has_no_accuracy_is_not_in_the_front():
    broken = Figures(MEASURED.setting, "failed", "no memory")
    assert pareto_front([broken, figures(1.0, None), figures(2.0, 20.0)]) == [figures(2.0, 20.0)]


def test_a_table_reads_back(tmp_path):
    other = replace(MEASURED, scores={}, memory=123)
    write_table(tmp_path / "table.json", "a machine", [MEASURED, other, Figures(MEASURED.setting, "failed", "why")])
    assert read_table(tmp_path / "table.json") == (MEASURED, other)
    assert json.loads((tmp_path / "table.json").read_text())["machine"] == "a machine"


@pytest.mark.parametrize("text", ["", "[]", "{", '{"version": 1, "figures": []}', '{"version": 2, "figures": [{}]}'])
def test_what_is_no_table_is_refused(tmp_path, text):
    (tmp_path / "table.json").write_text(text)
    with pytest.raises(InputError, match=r"table\.json: expected a table"):
        read_table(tmp_path / "table.json")
