"""The paper's depth table: means over scenes that training never sees, resumed, with reasons for what is missing."""

import math

import numpy as np
import pytest
from click.testing import CliRunner

from omnisyn_cli.cli.depth_table import depth_table as command
from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation import depth_benchmark
from omnisyn_cli.evaluation.depth_benchmark import (
    FIRST_SEED,
    MIN_SEED,
    DepthTableJob,
    depth_sources,
    depth_tables,
    make_pair,
    run_depth_table,
    write_depth_tables,
)
from omnisyn_cli.pipeline.config import DepthSource
from omnisyn_cli.pipeline.presets import PRESETS
from omnisyn_cli.scenes import generate_scene
from omnisyn_cli.scenes.suite import SUITE_SEEDS
from omnisyn_cli.types import DepthEstimate

SIZE = (16, 32)


class Guess:
    """Says that near the horizon everything is so many metres away, and infinitely far elsewhere."""

    def __init__(self, metres):
        self.inverse_depth = np.zeros(SIZE)
        self.inverse_depth[4:14] = 1.0 / metres

    def __call__(self, first, second):
        assert first.known_depth is None
        assert second.known_depth is None
        estimate = DepthEstimate(self.inverse_depth, np.ones(SIZE))
        return estimate, estimate


@pytest.fixture
def guesses(monkeypatch):
    guesses = {f"guess-{metres:.1f}": DepthSource("guess", metres) for metres in (3, 8)}
    make = depth_benchmark.make_estimator
    monkeypatch.setattr(depth_benchmark, "TABLE_SOURCES", guesses | depth_benchmark.TABLE_SOURCES)
    monkeypatch.setattr(
        depth_benchmark, "make_estimator", lambda source, **more: (
            Guess(source.rows) if source.kind == "guess" else make(source, **more)
        ),
    )  # fmt: skip
    return guesses


def job(folder, **changes):
    options = {"scenes": 2, "methods": "guess-3.0,guess-8.0", "size": SIZE, "threads": 1} | changes
    return DepthTableJob(folder, **options)


def by_brute_force(kind, seed, guess):
    """All figures of both panoramas of a scene, pixel by pixel."""
    made = []
    for view in make_pair(generate_scene(kind, seed), seed, SIZE, 1):
        errors, inverse_errors, ratios = [], [], []
        for estimate, true in zip(guess.ravel(), view.known_depth.inverse_depth.ravel(), strict=True):
            if not 1.0 < 1.0 / max(float(true), 1e-9) < 50.0:
                continue
            metres = min(1.0 / estimate, 100.0) if estimate > 0 else 100.0
            errors.append(abs(metres - 1.0 / true))
            inverse_errors.append(abs(estimate - true))
            ratios.append(max(estimate / true, true / estimate) if estimate > 0 else math.inf)
        mean = {
            "IMAE, 1/m": np.mean(inverse_errors), "IRMSE, 1/m": np.mean(np.square(inverse_errors)) ** 0.5,
            "MAE, m": np.mean(errors), "RMSE, m": np.mean(np.square(errors)) ** 0.5,
        }  # fmt: skip
        for name, threshold in (("1.05", 1.05), ("1.10", 1.1), ("1.25", 1.25), ("1.25²", 1.25**2), ("1.25³", 1.25**3)):
            mean[f"δ < {name}"] = np.mean([ratio < threshold for ratio in ratios])
        made.append(mean)
    return made


def test_the_means_are_those_of_brute_force_streets_and_rooms_apart(tmp_path, guesses):
    records = run_depth_table(job(tmp_path / "report"))
    tables = depth_tables(records)
    assert [table.title for table in tables] == ["Streets, 1 m", "Rooms, 1 m"]
    for table, kind in zip(tables, ("street", "room"), strict=True):
        seed = next(int(record.scene.split("-")[1]) for record in records if record.scene.startswith(kind))
        assert [row.name for row in table.rows] == list(guesses)
        for row, metres in zip(table.rows, (3.0, 8.0), strict=True):
            expected = by_brute_force(kind, seed, Guess(metres).inverse_depth)
            found = {column.title: cell.value for column, cell in zip(table.columns, row.cells, strict=True)}
            assert found.pop("Panoramas") == 2
            assert {"AbsRel", *expected[0]} == set(found)
            for name in expected[0]:
                assert found[name] == pytest.approx(np.mean([one[name] for one in expected]), rel=1e-4), name
    text = write_depth_tables(tmp_path / "report", records).read_text(encoding="utf-8")
    assert "## Streets, 1 m" in text
    assert f"{tables[1].rows[0].cells[0].value:.4f}" in text


def test_a_second_run_measures_nothing_again_unless_something_changed(tmp_path, guesses, monkeypatch):
    first = run_depth_table(job(tmp_path / "report"))
    lines = (tmp_path / "report" / "results.jsonl").read_text().splitlines()
    made = []
    monkeypatch.setattr(
        depth_benchmark, "make_pair", lambda *arguments: made.append(arguments) or make_pair(*arguments)
    )
    assert run_depth_table(job(tmp_path / "report")) == first
    assert made == []
    assert (tmp_path / "report" / "results.jsonl").read_text().splitlines() == lines
    more = run_depth_table(job(tmp_path / "report", scenes=4))
    assert len(made) == 2
    assert [record for record in more if record in first] == first
    run_depth_table(job(tmp_path / "report", size=(8, 16)))
    assert len(made) == 4


def test_an_interrupted_run_keeps_what_it_has(tmp_path, guesses):
    def interrupt(done, _):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_depth_table(job(tmp_path / "report"), interrupt)
    assert len((tmp_path / "report" / "results.jsonl").read_text().splitlines()) == 3
    assert len(run_depth_table(job(tmp_path / "report"))) == 4


def test_what_is_not_there_is_a_row_with_its_reason(tmp_path, guesses):
    absent = f"guess-3.0,network:depth-gone,network:{tmp_path / 'missing.onnx'}"
    records = run_depth_table(job(tmp_path / "report", methods=absent))
    for table in depth_tables(records):
        rows = {row.name: row for row in table.rows}
        assert rows["guess-3.0"].cells
        assert "'depth-gone'" in rows["network:depth-gone"].reason
        assert "expected an ONNX file" in rows[f"network:{tmp_path / 'missing.onnx'}"].reason


def test_a_method_that_breaks_does_not_end_the_others(tmp_path, guesses, monkeypatch):
    def broken(self, first, second):
        if self.inverse_depth[5, 0] < 0.2:
            raise ZeroDivisionError("of all things")
        return sound(self, first, second)

    sound = Guess.__call__
    monkeypatch.setattr(Guess, "__call__", broken)
    records = run_depth_table(job(tmp_path / "report"))
    assert [record.status for record in records] == ["done", "failed"] * 2
    assert records[1].reason == "ZeroDivisionError: of all things"


def test_seeds_of_training_are_refused_and_the_standard_scenes_are_others(tmp_path):
    assert max(SUITE_SEEDS) < MIN_SEED <= FIRST_SEED
    with pytest.raises(InputError, match="10,000,000"):
        run_depth_table(job(tmp_path / "report", methods="synsin", seed=MIN_SEED - 1))
    with pytest.raises(InputError, match="twice as wide as high, got 16x16"):
        run_depth_table(job(tmp_path / "report", methods="synsin", size=(16, 16)))
    assert not (tmp_path / "report").exists()


def test_every_row_of_the_papers_table_and_every_preset_is_there():
    names = depth_sources("all")
    assert set(names) == {"synsin", "matching", *(f"omnisyn-{preset}" for preset in PRESETS)}
    with pytest.raises(InputError, match="one of synsin"):
        depth_sources("guesswork")
    with pytest.raises(InputError, match="one of synsin"):
        depth_sources(" , ")


def test_panoramas_are_a_metre_apart_and_show_one_scene():
    first, second = make_pair(generate_scene("room", FIRST_SEED), FIRST_SEED, SIZE, 1)
    assert np.linalg.norm(second.pose.position - first.pose.position) == pytest.approx(1.0)
    assert np.array_equal(first.pose.rotation, second.pose.rotation)
    assert first.image.shape == (*SIZE, 3)
    assert not np.array_equal(first.image, second.image)


def test_the_command_prints_both_tables(tmp_path):
    arguments = [
        "--scenes", "2", "--size", "32x16", "--methods", "synsin,network:depth-gone", "--report", str(tmp_path / "r"),
    ]  # fmt: skip
    result = CliRunner().invoke(command, arguments, standalone_mode=False)
    assert result.return_value == 0, result.output
    assert "Streets, 1 m" in result.output
    assert "Rooms, 1 m" in result.output
    assert result.output.count("network:depth-gone: expected a model of the manifest") == 2
    assert (tmp_path / "r" / "depth-table.md").exists()
