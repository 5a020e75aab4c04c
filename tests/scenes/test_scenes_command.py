"""Scenes as files; and the standard evaluation set: the same for everybody, and what its names say."""

import hashlib
import json
from unittest.mock import Mock

import numpy as np
import pytest
from scene_samples import clearance, make

from omnisyn_cli.cli.scenes import KINDS
from omnisyn_cli.evaluation import scene_files as suite_module
from omnisyn_cli.evaluation.datasets import find_scenes
from omnisyn_cli.evaluation.datasets.sources import choose_pairs
from omnisyn_cli.evaluation.scene_files import PANORAMA_NAMES, SUPERSAMPLE, write_scene
from omnisyn_cli.io import read_depth, read_panorama
from omnisyn_cli.poses.file import read_poses
from omnisyn_cli.scenes import GENERATORS, generate_scene, paths
from omnisyn_cli.scenes.paths import BASELINES, FRAMES_PER_WALK, SUITE_SEEDS, longest_path, suite_scenes


def test_a_scene_reads_back(tmp_path, omnisyn):
    omnisyn.made(*make(tmp_path / "scene", "--kind", "room", "--frames", 2, "--baseline", 0.5))
    poses = read_poses(tmp_path / "scene" / "poses.json")
    assert list(poses.panoramas) == ["0000.png", "0001.png"]
    ends = [panorama.pose.position for panorama in poses.panoramas.values()]
    assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(0.5)
    assert read_panorama(tmp_path / "scene" / "0000.png").image.shape == (32, 64, 3)
    assert (read_depth(tmp_path / "scene" / "0001_depth.exr") > 0).all()
    assert json.loads((tmp_path / "scene" / "poses.json").read_text())["version"] == 1


def test_many_scenes_get_folders_of_their_own(tmp_path, omnisyn):
    omnisyn.made(*make(tmp_path / "set", "--count", 2, "--frames", 1, "--no-depth"))
    names = sorted(str(path.relative_to(tmp_path / "set")) for path in (tmp_path / "set").rglob("*.*"))
    assert names == [f"street_000{k}/{name}" for k in (1, 2) for name in ("0000.png", "poses.json")]


def test_what_exists_is_kept_unless_overwriting_is_allowed(tmp_path, omnisyn):
    omnisyn.made(*make(tmp_path / "scene", "--frames", 1, "--seed", 1))
    before = (tmp_path / "scene" / "0000.png").read_bytes()
    omnisyn.refused(*make(tmp_path / "scene", "--frames", 1, "--seed", 2))
    assert (tmp_path / "scene" / "0000.png").read_bytes() == before
    omnisyn.made(*make(tmp_path / "scene", "--frames", 1, "--seed", 2, "--overwrite"))
    assert (tmp_path / "scene" / "0000.png").read_bytes() != before


def test_overwriting_touches_no_file_of_another_name(tmp_path, omnisyn):
    """A folder of photographs has a poses.json too."""
    scene = tmp_path / "scene"
    (scene / "raw").mkdir(parents=True)
    others = [scene / "holiday.jpg", scene / "raw" / "0000.png", scene / ".hidden"]
    for path in [*others, scene / "poses.json"]:
        path.write_text("mine")
    omnisyn.made(*make(scene, "--frames", 1, "--overwrite"))
    assert [path.read_text() for path in others] == ["mine"] * 3
    assert len(read_poses(scene / "poses.json").panoramas) == 1
    names = {"0000.png", "0000_depth.exr", "poses.json", "holiday.jpg", "raw", ".hidden"}
    assert {path.name for path in scene.iterdir()} == names


@pytest.mark.parametrize("taken", ["0000.png", "0000_depth.exr", "poses.json"])
def test_any_file_in_the_way_is_refused_before_anything_is_written(tmp_path, taken, omnisyn):
    (tmp_path / taken).write_text("mine")
    omnisyn.refused(*make(tmp_path, "--frames", 1))
    assert [path.read_text() for path in tmp_path.iterdir()] == ["mine"]


def test_a_folder_in_the_way_is_never_replaced(tmp_path, omnisyn):
    (tmp_path / "0000.png").mkdir()
    omnisyn.refused(*make(tmp_path, "--frames", 1, "--overwrite"))


def test_files_of_other_names_are_no_obstacle(tmp_path, omnisyn):
    (tmp_path / "dear.txt").write_text("Dear")
    omnisyn.made(*make(tmp_path, "--frames", 1, "--no-depth"))
    assert {path.name for path in tmp_path.iterdir()} == {"dear.txt", "0000.png", "poses.json"}


def test_a_file_is_no_folder(tmp_path, omnisyn):
    (tmp_path / "file").write_text("mine")
    for out in ("file", "file/scene"):
        omnisyn.refused(*make(tmp_path / out, "--overwrite"))


@pytest.mark.parametrize("out", ["old", "new"])
def test_a_failure_keeps_what_was_to_be_overwritten_and_leaves_nothing_behind(tmp_path, monkeypatch, out, omnisyn):
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "0001.png").write_text("mine")
    monkeypatch.setattr("omnisyn_cli.scenes.render_panorama", Mock(side_effect=RuntimeError("out of light")))
    with pytest.raises(RuntimeError):
        omnisyn(*make(tmp_path / out, "--overwrite"))
    assert [path.name for path in sorted(tmp_path.rglob("*"))] == ["old", "0001.png"]
    assert (tmp_path / "old" / "0001.png").read_text() == "mine"


def test_a_baseline_without_room_is_an_input_error(tmp_path, omnisyn):
    omnisyn.refused(*make(tmp_path / "scene", "--kind", "room", "--baseline", 900))


def test_names_must_fit_the_frames(tmp_path, omnisyn):
    named = make(tmp_path / "scene", "--frames", 2, "--name", "a.png")
    omnisyn.misused(*named)
    for twin in ("a.jpg", "a_depth.exr"):
        omnisyn.refused(*named, "--name", twin)


def test_every_kind_can_be_asked_for():
    assert set(KINDS) == set(GENERATORS)


@pytest.mark.parametrize("options", [["--count", "2", "--frames", "1"], ["--suite"]])
def test_a_folder_that_cannot_be_made_is_refused(tmp_path, monkeypatch, options, omnisyn):
    monkeypatch.setattr("pathlib.Path.mkdir", Mock(side_effect=OSError(28, "No space left on device")))
    said = omnisyn.refused(*make(tmp_path / "new", *options))
    assert "new: expected a folder for scenes, got 'No space left on device'; choose another place" in said


def test_a_name_that_is_too_long_is_refused(tmp_path, omnisyn):
    assert "File name too long" in omnisyn.refused(*make(tmp_path / ("x" * 300) / "scene", "--frames", 1))


POSES_SHA256 = "c13f327442a7aa68c9116086252862149caf00cf1960164983f519322565bc01"

# Of millimetres, because machines may differ in the last digits.
DEPTH_SHA256 = "d3da740d656c8ef23bbe62af4b745c809d98520f1e375f4e1a4f114643cbe270"


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
    scene = generate_scene(walk.kind, walk.seed)
    write_scene(tmp_path, scene, walk.path, PANORAMA_NAMES, (16, 32), SUPERSAMPLE, threads=2)
    assert hashlib.sha256((tmp_path / "poses.json").read_bytes()).hexdigest() == POSES_SHA256
    depths = [
        np.rint(1000 * np.nan_to_num(read_depth(tmp_path / f"{k:04d}_depth.exr"), posinf=0.0))
        for k in range(FRAMES_PER_WALK)
    ]
    assert hashlib.sha256(np.stack(depths).astype("<i8").tobytes()).hexdigest() == DEPTH_SHA256
    assert len(read_poses(tmp_path / "poses.json").panoramas) == FRAMES_PER_WALK


def test_the_command_writes_it_and_eval_reads_it(tmp_path, omnisyn, monkeypatch):
    monkeypatch.setattr(suite_module, "SUPERSAMPLE", 1)
    monkeypatch.setattr(paths, "STANDARD_KINDS", ("room",))
    monkeypatch.setattr(paths, "SUITE_SEEDS", SUITE_SEEDS[1:])
    words = ("scenes", "make", tmp_path / "suite", "--suite", "--size", "32x16", "--threads", 2)
    assert "room-9000002-6m: not made, the scene has no room for 6 m" in omnisyn.made(*words).err
    pairs = [pair for source in find_scenes(tmp_path / "suite") for pair in choose_pairs(None)(source.read())]
    assert [pair.scene for pair in pairs] == [f"room-9000002-{b}m" for b in (1, 2, 4)]
    assert all(len(pair.between) == 3 and pair.first.depth is not None for pair in pairs)
    omnisyn.refused(*words)


@pytest.mark.parametrize("options", [["--seed", 1], ["--frames", 3], ["--baseline", 2], ["--no-depth"]])
def test_what_is_fixed_cannot_be_changed(tmp_path, options, omnisyn):
    assert options[0] in omnisyn.misused("scenes", "make", tmp_path / "suite", "--suite", *options)
