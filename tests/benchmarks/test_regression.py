"""No method may become worse unnoticed: the recorded figures, less a tolerance, are the least that is accepted."""

import json
from pathlib import Path

from benchmarks.regression import METHODS, SCENES, SIZE, TABLE, drops, measure

RECORDED = json.loads(TABLE.read_text())


def test_no_figure_has_dropped(tmp_path: Path) -> None:
    """``python tests/benchmarks/regression.py`` writes the table anew where a change is meant."""
    measured = measure(tmp_path)
    assert not drops(RECORDED["ws_psnr"], measured, RECORDED["tolerance_db"])
    for scene in SCENES:
        assert measured[scene]["omnisyn-balanced"] > measured[scene]["crossfade"] + 2.0, measured


def test_the_table_is_that_of_these_scenes_and_methods() -> None:
    assert tuple(RECORDED["ws_psnr"]) == SCENES
    assert all(tuple(methods) == METHODS for methods in RECORDED["ws_psnr"].values())
    assert (tuple(RECORDED["size"]), RECORDED["tolerance_db"]) == (SIZE, 0.3)


def test_a_drop_is_found_and_a_rise_is_none() -> None:
    recorded = {"street": {"a": 30.0, "b": 20.0}}
    assert drops(recorded, {"street": {"a": 29.71, "b": 25.0}}, 0.3) == []
    assert drops(recorded, {"street": {"a": 29.69, "b": 20.0}}, 0.3) == ["street: a had 30.00 dB and has 29.69 dB"]
    assert len(drops(recorded, {"street": {"a": float("nan")}}, 0.3)) == 2
