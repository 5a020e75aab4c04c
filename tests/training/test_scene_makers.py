import errno
import os
import time
from pathlib import Path

import numpy as np
import pytest

from omnisyn_cli.errors import OmnisynError, OutputPathError, WriteError
from omnisyn_cli.training import scene_makers, walks
from omnisyn_cli.training.data import load_walk, save_samples
from omnisyn_cli.training.walks import WalkConfig, make_walk_file

SMALL = WalkConfig(size=(16, 32), kinds=("room",), pose_error_share=0.3, views=2, supersample=1)


def test_a_kind_that_does_not_exist_is_not_skipped(tmp_path):
    with pytest.raises(ValueError, match="streets"):
        make_walk_file(tmp_path, 0, WalkConfig(kinds=("streets",)))


def test_a_scene_without_room_is_skipped_but_no_other_failure(tmp_path, monkeypatch):
    def no_room(*_, **__):
        raise ValueError("no room")

    with monkeypatch.context() as patch:
        patch.setattr(walks, "render_panorama", no_room)
        with pytest.raises(ValueError, match="no room"):
            make_walk_file(tmp_path, 0, SMALL)
    monkeypatch.setattr(scene_makers, "sample_path", no_room)
    assert make_walk_file(tmp_path, 0, SMALL) is None
    assert list(tmp_path.iterdir()) == []


def first_fails(folder: Path, seed: int) -> Path:
    """Work for another process that leaves a trace."""
    (folder / str(seed)).touch()
    time.sleep(0.05)
    if seed == 0:
        raise WriteError("full")
    return folder / str(seed)


def test_after_a_failure_nothing_more_is_begun(tmp_path):
    with pytest.raises(WriteError, match="full"):
        list(scene_makers.make_scene_files(tmp_path, range(500), first_fails))
    assert len(list(tmp_path.iterdir())) < 250


def kills_itself(folder: Path, seed: int) -> Path:
    """Work that ends as it does where memory runs out."""
    if seed == 1:
        os._exit(9)
    (folder / str(seed)).touch()
    return folder / str(seed)


def test_a_worker_that_is_killed_is_an_error_in_one_line(tmp_path):
    with pytest.raises(OmnisynError, match="expected worker processes to live, got one that was killed; start"):
        list(scene_makers.make_scene_files(tmp_path, range(3), kills_itself))
    assert (tmp_path / "0").exists()


def test_a_place_that_cannot_be_written_is_named_before_any_scene_is_rendered(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputPathError, match="file/pool: expected a folder for a pool"):
        list(scene_makers.make_scene_files(tmp_path / "file" / "pool", range(1), first_fails))


def test_a_full_disk_is_a_write_error_and_leaves_no_partial_file(tmp_path, monkeypatch):
    def full(file, **_):
        file.write(b"begun")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("omnisyn_cli.training.data.np.savez", full)
    with pytest.raises(WriteError, match=r"a\.npz: expected to write it, got 'No space left on device'"):
        save_samples(tmp_path / "a.npz", [])
    assert list(tmp_path.iterdir()) == []


def test_the_file_of_a_seed_is_its_scene(tmp_path):
    path = make_walk_file(tmp_path, 4, SMALL)
    assert path == tmp_path / "00000004.npz"
    scene = load_walk(path)
    again, other = (load_walk(make_walk_file(tmp_path / "again", seed, SMALL)) for seed in (4, 6))
    np.testing.assert_array_equal(again.images, scene.images)
    np.testing.assert_array_equal(again.inverse_depth, scene.inverse_depth)
    assert (other.images != scene.images).any()
