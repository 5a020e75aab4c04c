import pytest

from omnisyn_cli.training import pool
from omnisyn_cli.training.data import load_scene
from omnisyn_cli.training.pool import PoolConfig, render_pool_scene

SMALL = PoolConfig(size=(16, 32), views=2, supersample=1)


def test_a_kind_that_does_not_exist_is_not_skipped(tmp_path):
    with pytest.raises(ValueError, match="streets"):
        pool.render_to_pool(tmp_path, 0, PoolConfig(kinds=("streets",)))


def test_a_scene_without_room_is_skipped_but_no_other_failure(tmp_path, monkeypatch):
    def no_room(*_, **__):
        raise ValueError("no room")

    with monkeypatch.context() as patch:
        patch.setattr(pool, "render_views", no_room)
        with pytest.raises(ValueError, match="no room"):
            pool.render_to_pool(tmp_path, 0, SMALL)
    monkeypatch.setattr(pool, "sample_path", no_room)
    assert pool.render_to_pool(tmp_path, 0, SMALL) is None
    assert list(tmp_path.iterdir()) == []


def test_the_file_of_a_seed_is_its_scene(tmp_path):
    path = pool.render_to_pool(tmp_path, 4, SMALL)
    assert path == tmp_path / "00000004.npz"
    assert (load_scene(path).images == render_pool_scene(4, SMALL).images).all()
