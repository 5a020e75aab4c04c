import json

import numpy as np
import pytest
from click.testing import CliRunner

from omnisyn_cli.cli.scenes import KINDS, scenes
from omnisyn_cli.errors import InputError, OutputPathError
from omnisyn_cli.io import read_depth, read_panorama
from omnisyn_cli.poses.file import read_poses
from omnisyn_cli.scenes import GENERATORS


def make(*arguments):
    command = ["make", *(str(argument) for argument in arguments), "--size", "64x32", "--threads", "1", "-q"]
    return CliRunner().invoke(scenes, command, catch_exceptions=True)


def test_a_scene_reads_back(tmp_path):
    assert make(tmp_path / "scene", "--kind", "room", "--frames", 2, "--baseline", 0.5).exit_code == 0
    poses = read_poses(tmp_path / "scene" / "poses.json")
    assert list(poses.panoramas) == ["0000.png", "0001.png"]
    ends = [panorama.pose.position for panorama in poses.panoramas.values()]
    assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(0.5)
    assert read_panorama(tmp_path / "scene" / "0000.png").image.shape == (32, 64, 3)
    assert (read_depth(tmp_path / "scene" / "0001_depth.exr") > 0).all()
    assert json.loads((tmp_path / "scene" / "poses.json").read_text())["version"] == 1


def test_many_scenes_get_folders_of_their_own(tmp_path):
    assert make(tmp_path / "set", "--count", 2, "--frames", 1, "--no-depth").exit_code == 0
    names = sorted(str(path.relative_to(tmp_path / "set")) for path in (tmp_path / "set").rglob("*.*"))
    assert names == [f"street_000{k}/{name}" for k in (1, 2) for name in ("0000.png", "poses.json")]


def test_what_exists_is_kept_unless_overwriting_is_allowed(tmp_path):
    make(tmp_path / "scene", "--frames", 1, "--seed", 1)
    before = (tmp_path / "scene" / "0000.png").read_bytes()
    assert isinstance(make(tmp_path / "scene", "--frames", 1, "--seed", 2).exception, OutputPathError)
    assert (tmp_path / "scene" / "0000.png").read_bytes() == before
    assert make(tmp_path / "scene", "--frames", 1, "--seed", 2, "--overwrite").exit_code == 0
    assert (tmp_path / "scene" / "0000.png").read_bytes() != before


def test_overwriting_touches_no_file_of_another_name(tmp_path):
    """A folder of photographs has a poses.json too."""
    scene = tmp_path / "scene"
    (scene / "raw").mkdir(parents=True)
    others = [scene / "holiday.jpg", scene / "raw" / "0000.png", scene / ".hidden"]
    for path in [*others, scene / "poses.json"]:
        path.write_text("mine")
    assert make(scene, "--frames", 1, "--overwrite").exit_code == 0
    assert [path.read_text() for path in others] == ["mine"] * 3
    assert len(read_poses(scene / "poses.json").panoramas) == 1
    names = {"0000.png", "0000_depth.exr", "poses.json", "holiday.jpg", "raw", ".hidden"}
    assert {path.name for path in scene.iterdir()} == names


@pytest.mark.parametrize("taken", ["0000.png", "0000_depth.exr", "poses.json"])
def test_any_file_in_the_way_is_refused_before_anything_is_written(tmp_path, taken):
    (tmp_path / taken).write_text("mine")
    assert isinstance(make(tmp_path, "--frames", 1).exception, OutputPathError)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["mine"]


def test_a_folder_in_the_way_is_never_replaced(tmp_path):
    (tmp_path / "0000.png").mkdir()
    assert isinstance(make(tmp_path, "--frames", 1, "--overwrite").exception, OutputPathError)
    assert [path.name for path in tmp_path.iterdir()] == ["0000.png"]


def test_files_of_other_names_are_no_obstacle(tmp_path):
    (tmp_path / "dear.txt").write_text("Dear")
    assert make(tmp_path, "--frames", 1, "--no-depth").exit_code == 0
    assert {path.name for path in tmp_path.iterdir()} == {"dear.txt", "0000.png", "poses.json"}


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "file").write_text("mine")
    for out in ("file", "file/scene"):
        assert isinstance(make(tmp_path / out, "--overwrite").exception, OutputPathError)


def test_a_failure_keeps_the_scene_that_was_to_be_overwritten(tmp_path, monkeypatch):
    (tmp_path / "0001.png").write_text("mine")

    def fail(*_, **__):
        raise RuntimeError("out of light")

    monkeypatch.setattr("omnisyn_cli.scenes.render_panorama", fail)
    assert isinstance(make(tmp_path, "--overwrite").exception, RuntimeError)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["mine"]


def test_a_failure_leaves_nothing_behind(tmp_path, monkeypatch):
    def fail(*_, **__):
        raise RuntimeError("out of light")

    monkeypatch.setattr("omnisyn_cli.scenes.render_panorama", fail)
    assert isinstance(make(tmp_path / "scene").exception, RuntimeError)
    assert list(tmp_path.iterdir()) == []


def test_a_baseline_without_room_is_an_input_error(tmp_path):
    assert isinstance(make(tmp_path / "scene", "--kind", "room", "--baseline", 900).exception, InputError)
    assert list(tmp_path.iterdir()) == []


def test_names_must_fit_the_frames(tmp_path):
    assert make(tmp_path / "scene", "--frames", 2, "--name", "a.png").exit_code == 2
    twins = make(tmp_path / "scene", "--frames", 2, "--name", "a.png", "--name", "a.jpg")
    assert isinstance(twins.exception, OutputPathError)
    clash = make(tmp_path / "scene", "--frames", 2, "--name", "a.png", "--name", "a_depth.exr")
    assert isinstance(clash.exception, OutputPathError)
    assert list(tmp_path.iterdir()) == []


def test_every_kind_can_be_asked_for():
    assert set(KINDS) == set(GENERATORS)


@pytest.mark.parametrize("options", [["--count", "2", "--frames", "1"], ["--suite"]])
def test_a_folder_that_cannot_be_made_is_refused(tmp_path, monkeypatch, options):
    def refuse(folder, **_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.mkdir", refuse)
    error = CliRunner().invoke(scenes, ["make", str(tmp_path / "new"), "--size", "64x32", *options]).exception
    assert isinstance(error, OutputPathError)
    assert str(error).endswith("new: expected a folder for scenes, got 'No space left on device'; choose another place")


def test_a_name_that_is_too_long_is_refused(tmp_path):
    error = make(tmp_path / ("x" * 300) / "scene", "--frames", 1).exception
    assert isinstance(error, OutputPathError)
    assert "File name too long" in str(error)
