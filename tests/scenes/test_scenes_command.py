import json

import numpy as np
import pytest
from click.testing import CliRunner

from omnisyn_cli.cli.scenes import scenes
from omnisyn_cli.errors import InputError, OutputPathError
from omnisyn_cli.io import read_depth, read_panorama, read_poses


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


def test_a_folder_of_something_else_is_never_replaced(tmp_path):
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "dear.txt").write_text("Dear")
    assert isinstance(make(tmp_path / "letters", "--overwrite").exception, OutputPathError)
    assert (tmp_path / "letters" / "dear.txt").read_text() == "Dear"


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
