"""The standard evaluation set: the same for everybody, and what its names say."""

import hashlib

import numpy as np
import pytest
from click.testing import CliRunner
from scene_samples import clearance

from omnisyn_cli.cli.scenes import scenes
from omnisyn_cli.errors import OutputPathError
from omnisyn_cli.evaluation import scene_files as suite_module
from omnisyn_cli.evaluation.datasets import find_scenes
from omnisyn_cli.evaluation.datasets.sources import choose_pairs
from omnisyn_cli.evaluation.scene_files import write_suite_scene
from omnisyn_cli.io import read_depth
from omnisyn_cli.poses.file import read_poses
from omnisyn_cli.scenes import generate_scene
from omnisyn_cli.scenes.paths import BASELINES, FRAMES_PER_WALK, SUITE_SEEDS, longest_path, suite_scenes

POSES_SHA256 = "c13f327442a7aa68c9116086252862149caf00cf1960164983f519322565bc01"

DEPTH_SHA256 = "d3da740d656c8ef23bbe62af4b745c809d98520f1e375f4e1a4f114643cbe270"
"""Of millimetres, because machines may differ in the last digits."""


@pytest.fixture(scope="module")
def walks():
    return list(suite_scenes())


def test_every_kind_has_every_baseline_that_it_has_room_for(walks):
    assert [walk.name for walk in walks] == [
        f"{kind}-{seed}-{baseline:g}m" for kind in ("street", "room") for seed in SUITE_SEEDS for baseline in BASELINES
    ]
    assert [walk.name for walk in walks if not walk.path] == ["room-9000002-6m"]


def test_a_walk_is_straight_even_free_and_as_long_as_its_name_says(walks):
    for walk in walks:
        if walk.path:
            positions = np.stack([pose.position for pose in walk.path])
            assert len(positions) == FRAMES_PER_WALK
            steps = np.diff(positions, axis=0)
            assert np.linalg.norm(steps, axis=1) == pytest.approx(walk.baseline / (FRAMES_PER_WALK - 1), abs=3e-6)
            np.testing.assert_allclose(steps, np.broadcast_to(steps[0], steps.shape), atol=3e-6)
            assert clearance(generate_scene(walk.kind, walk.seed), positions).min() > 0.05
            assert all(np.array_equal(pose.rotation, walk.path[0].rotation) for pose in walk.path)


def test_all_baselines_of_a_scene_begin_at_one_place_and_go_one_way(walks):
    for kind in ("street", "room"):
        for seed in SUITE_SEEDS:
            ways = [walk.path for walk in walks if (walk.kind, walk.seed) == (kind, seed) and walk.path]
            assert len({way[0].position.tobytes() for way in ways}) == 1
            directions = np.stack([way[-1].position - way[0].position for way in ways])
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
            np.testing.assert_allclose(directions @ directions[0], 1.0, atol=1e-9)


def test_a_scene_without_room_has_no_way():
    narrow = generate_scene("room", 3)
    narrow.shapes["half"] = 1e3
    assert longest_path(narrow, 3) == ()


def test_the_bytes_are_those_that_were_recorded(tmp_path, walks):
    """If this fails after a change of the scenes, figures of earlier versions can no longer be compared."""
    (walk,) = [walk for walk in walks if walk.name == "room-9000001-2m"]
    write_suite_scene(tmp_path, walk, (16, 32), threads=2)
    assert hashlib.sha256((tmp_path / "poses.json").read_bytes()).hexdigest() == POSES_SHA256
    depths = [
        np.rint(1000 * np.nan_to_num(read_depth(tmp_path / f"{k:04d}_depth.exr"), posinf=0.0))
        for k in range(FRAMES_PER_WALK)
    ]
    assert hashlib.sha256(np.stack(depths).astype("<i8").tobytes()).hexdigest() == DEPTH_SHA256
    assert len(read_poses(tmp_path / "poses.json").panoramas) == FRAMES_PER_WALK


@pytest.fixture
def one_seed(monkeypatch):
    monkeypatch.setattr(suite_module, "SUPERSAMPLE", 1)
    monkeypatch.setattr(suite_scenes, "__defaults__", (("room",), SUITE_SEEDS[1:]))


def make(*arguments):
    return CliRunner().invoke(scenes, ["make", *map(str, arguments)], catch_exceptions=True)


@pytest.mark.usefixtures("one_seed")
def test_the_command_writes_it_and_eval_reads_it(tmp_path):
    done = make(tmp_path / "suite", "--suite", "--size", "32x16", "--threads", 2)
    assert done.exit_code == 0
    assert "room-9000002-6m: not made, the scene has no room for 6 m" in done.output
    pairs = [pair for source in find_scenes(tmp_path / "suite") for pair in choose_pairs(None)(source.read())]
    assert [pair.scene for pair in pairs] == [f"room-9000002-{b}m" for b in (1, 2, 4)]
    assert all(len(pair.between) == 3 and pair.first.depth is not None for pair in pairs)
    assert isinstance(make(tmp_path / "suite", "--suite", "--size", "32x16").exception, OutputPathError)


@pytest.mark.parametrize("options", [["--seed", 1], ["--frames", 3], ["--baseline", 2], ["--no-depth"]])
def test_what_is_fixed_cannot_be_changed(tmp_path, options):
    refused = make(tmp_path / "suite", "--suite", *options)
    assert refused.exit_code == 2
    assert str(options[0]) in refused.output
    assert not list(tmp_path.iterdir())
