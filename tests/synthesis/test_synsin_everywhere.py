"""SynSin where users meet it, with untrained networks: ``interpolate``, plans, ``eval``, batches."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from interpolation_samples import CHAIN, job_of
from omnisyn_cli.batch.manifest import read_manifest
from omnisyn_cli.cli.interpolate import interpolate
from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.methods import MethodAtWork, find_method
from omnisyn_cli.geometry.pose import interpolate_pose
from omnisyn_cli.interpolation.configs import video_config
from omnisyn_cli.interpolation.plan import plan_interpolation
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.io import read_panorama
from omnisyn_cli.pipeline.methods import SYNSIN_MODELS
from omnisyn_cli.runtime import models
from omnisyn_cli.synthesis.trajectory import Waypoint
from synsin_samples import TINY_SIZE, write_synsin_models
from synthesis_samples import SIZE, hall_view, write_hall


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_synsin_models(tmp_path_factory.mktemp("models"))


@pytest.fixture(autouse=True)
def _installed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(models, "models_folder", lambda: folder)


@pytest.mark.parametrize("method", ["synsin", "synsin-2view"])
def test_a_clip_begins_and_ends_with_the_photographs(tmp_path: Path, method: str) -> None:
    images = write_hall(tmp_path, CHAIN)
    plan = plan_interpolation(job_of(tmp_path, images, method=method, frames=5))
    summary = run_interpolation(plan).describe()
    assert (summary["method"], summary["confidence"], summary["depth"]) == (method, None, "monocular")
    assert summary["model"] == ", ".join(SYNSIN_MODELS)
    assert summary["triangles"] == []
    made = [read_panorama(path).original for path in sorted((tmp_path / "out").iterdir())]
    for frame, photograph in zip(made[::2], images, strict=True):
        np.testing.assert_array_equal(frame, read_panorama(photograph).original)
    assert made[1].shape == (*SIZE, 3)
    assert made[1].std() > 1


def test_pictures_from_one_panorama_and_from_two_differ(tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN[:2])
    shown = []
    for method in ("synsin", "synsin-2view"):
        plan = plan_interpolation(job_of(tmp_path, images, method=method, output=tmp_path / method))
        run_interpolation(plan)
        shown.append(read_panorama(sorted((tmp_path / method).iterdir())[1]).image)
    assert np.abs(shown[0] - shown[1]).mean() > 1e-3


@pytest.mark.parametrize(
    ("changes", "option"),
    [
        ({"preset": "fast"}, "preset"),
        ({"depth": "matching"}, "depth"),
        ({"model": "completion-balanced"}, "model"),
        ({"renderer": "two-pass"}, "renderer"),
        ({"cut": 0.1}, "cut"),
        ({"fusion": "network"}, "fusion"),
        ({"adaptive": True}, "adaptive"),
        ({"fallback": "crossfade"}, "fallback"),
        ({"save_depth": Path("depth")}, "save-depth"),
        ({"save_confidence": Path("confidence.mp4")}, "save-confidence"),
    ],
)
def test_what_means_nothing_to_synsin_is_refused(tmp_path: Path, changes: dict[str, object], option: str) -> None:
    job = job_of(tmp_path, write_hall(tmp_path, CHAIN[:2]), method="synsin", **changes)
    with pytest.raises(InputError, match=f"expected no {option} with the method synsin"):
        plan_interpolation(job)


def test_an_unknown_method_is_refused_and_missing_networks_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = job_of(tmp_path, write_hall(tmp_path, CHAIN[:2]), method="synsin")
    with pytest.raises(InputError, match="as method, got 'magic'"):
        plan_interpolation(replace(job, method="magic"))
    assert video_config(job, ()).networks == SYNSIN_MODELS
    monkeypatch.setattr(models, "models_folder", lambda: tmp_path)
    with pytest.raises(InputError, match="'synsin-depth'"):
        plan_interpolation(job)


def test_a_dry_run_tells_the_plan_and_a_budget_is_refused(tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN[:2])
    arguments = [*map(str, images), "--poses", str(tmp_path / "poses.json"), "-o", str(tmp_path / "a.mp4")]
    result = CliRunner().invoke(interpolate, [*arguments, "--method", "synsin-2view", "--dry-run", "--json"])
    assert result.exit_code == 0, result.output
    plan = json.loads(result.stdout)
    assert (plan["method"], plan["preset"], plan["renderer"]) == ("synsin-2view", "", "soft points")
    assert "enlarges" in plan["notes"][0]
    assert not (tmp_path / "a.mp4").exists()
    result = CliRunner().invoke(interpolate, [*arguments, "--method", "synsin", "--budget", "10"])
    assert result.exit_code == 2
    assert "--budget only with --method omnisyn" in result.output


def test_monocular_depth_is_a_source_like_others(tmp_path: Path) -> None:
    job = job_of(tmp_path, write_hall(tmp_path, CHAIN[:2]), depth="monocular", save_depth=tmp_path / "depth")
    plan = plan_interpolation(job)
    assert (plan.config.depth.kind, plan.config.depth.model) == ("monocular", "synsin-depth")
    run_interpolation(plan)
    assert len(list((tmp_path / "depth").iterdir())) == 2


@pytest.mark.parametrize("name", ["synsin", "synsin-2view", "monocular"])
def test_methods_that_are_compared_make_pictures_and_tell_depth(name: str) -> None:
    views = hall_view(CHAIN[0]), hall_view(CHAIN[1])
    made = MethodAtWork(find_method(name), views, threads=1)(SIZE, Stopwatch())
    picture = made.frame(Waypoint(0, 0.5, interpolate_pose(CHAIN[0], CHAIN[1], 0.5)))
    assert picture.image.shape == (*SIZE, 3)
    assert np.isfinite(picture.image).all()
    assert made.depths is not None
    assert made.depths[0].inverse_depth.shape == TINY_SIZE


@pytest.mark.parametrize("name", ["synsin", "synsin-2view", "monocular"])
def test_results_depend_on_the_networks_that_are_installed(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = find_method(name).ingredients()
    known = models.read_manifest()
    changed = {key: replace(entry, sha256="0") for key, entry in known.items()}
    monkeypatch.setattr("omnisyn_cli.evaluation.methods.read_manifest", lambda: changed)
    assert find_method(name).ingredients() != before


def test_a_line_of_a_batch_can_ask_for_it(tmp_path: Path) -> None:
    write_hall(tmp_path, CHAIN[:2])
    line = {"id": "a", "inputs": ["p0.png", "p1.png"], "poses": "poses.json", "method": "synsin"}
    (tmp_path / "jobs.jsonl").write_text(json.dumps(line) + "\n" + json.dumps({**line, "id": "b", "method": "magic"}))
    manifest = read_manifest(tmp_path / "jobs.jsonl")
    assert ["line 2" in problem and "method" in problem for problem in manifest.problems] == [True]
    (tmp_path / "jobs.jsonl").write_text(json.dumps(line))
    (job,) = read_manifest(tmp_path / "jobs.jsonl").jobs
    assert job.interpolation(tmp_path).method == "synsin"
