"""Pairs of a data set and generated scenes become a pool: what is known about them survives the turn."""

import errno
import os
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from training_samples import make_walks

from ball_samples import FIRST, SECOND, SIZE, ball
from omnisyn_cli.errors import InputError, OmnisynError, OutputPathError, WriteError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.io import write_depth, write_image
from omnisyn_cli.networks.paper import PaperPrediction
from omnisyn_cli.poses.file import PosedPanorama, write_poses
from omnisyn_cli.training import scene_makers, walks
from omnisyn_cli.training.data import list_scene_files, load_walk, save_samples
from omnisyn_cli.training.losses import depth_scores, paper_loss
from omnisyn_cli.training.pairs import Batch, draw_pairs
from omnisyn_cli.training.scene_makers import pair_path, walk_of_views
from omnisyn_cli.training.walks import WalkConfig, make_walk_file
from omnisyn_cli.types import DepthEstimate, View


def view(pose, size, *, hole=False, mask=None):
    inverse_depth, image = ball(pose, size)
    known = np.ones(size, np.float32)
    if hole:
        known[size[0] // 4 : size[0] // 2, : size[1] // 4] = 0
    return View(image, pose, mask, DepthEstimate(np.where(known > 0, inverse_depth, 0.0), known))


@pytest.mark.parametrize("size", [SIZE, (128, 256)])
def test_a_pair_is_held_as_pools_are(size):
    walk = walk_of_views((view(FIRST, size), view(SECOND, size)), SIZE)
    np.testing.assert_allclose(walk.positions, [np.zeros(3), SECOND.position - FIRST.position], rtol=1e-6)
    upright = [Pose(np.eye(3), pose.position) for pose in (FIRST, SECOND)]
    for pose, image, inverse_depth in zip(upright, walk.images, walk.inverse_depth, strict=True):
        np.testing.assert_allclose(inverse_depth, ball(pose, SIZE)[0], rtol=0.05)
        np.testing.assert_allclose(image / 255.0, ball(pose, SIZE)[1], atol=0.02)


def test_holes_and_masks_are_unknown_and_teach_nothing(tmp_path):
    mask = np.ones(SIZE, bool)
    mask[:, 64:] = False
    folder = tmp_path / "pool"
    save_samples(folder / "a.npz", [walk_of_views((view(FIRST, SIZE, hole=True), view(SECOND, SIZE, mask=mask)), SIZE)])
    stored = load_walk(folder / "a.npz")
    shares = np.isnan(stored.inverse_depth).mean(axis=(1, 2))
    assert 0.03 < shares[0] < 0.2
    assert 0.4 < shares[1] < 0.6
    batch = draw_pairs(Batch, list_scene_files(folder), np.random.default_rng(0), 4, SIZE)
    unknown = torch.isnan(batch.sqrt_inv_depth)
    assert unknown.any()
    heads = torch.rand(2, 4, 1, *SIZE)
    changed = torch.where(unknown, torch.rand(2, 4, 1, *SIZE), heads)
    one, other = (figures(each, batch) for each in (heads, changed))
    assert one == pytest.approx(other)
    assert all(np.isfinite(one))


def figures(heads, batch):
    """Loss and scores of a low and a high head; gradients are finite, and nothing where the truth is unknown."""
    leaves = [head.clone().requires_grad_() for head in heads]
    prediction = PaperPrediction(*leaves)
    loss = paper_loss(prediction, batch.sqrt_inv_depth)
    loss.backward()
    unknown = torch.isnan(batch.sqrt_inv_depth)
    for leaf in leaves:
        assert torch.all(torch.isfinite(leaf.grad))
        assert torch.all(leaf.grad[unknown] == 0)
    scores = depth_scores(prediction, batch.sqrt_inv_depth, batch.baseline)
    return loss.item(), scores["imae"], scores["delta_25"], scores["confidence_error"]


def test_pairs_without_depth_or_without_a_baseline_are_refused():
    plain = View(ball(FIRST, SIZE)[1], FIRST)
    with pytest.raises(InputError, match="true depth"):
        walk_of_views((plain, view(SECOND, SIZE)), SIZE)
    with pytest.raises(InputError, match="different places"):
        walk_of_views((view(FIRST, SIZE), view(FIRST, SIZE)), SIZE)


def test_names_of_files_are_plain(tmp_path):
    assert pair_path(tmp_path, "a b/c", "0.png", "ü?.png").name == "a_b_c-0.png-ü_.png.npz"


def write_walk(folder, *, with_depth=True):
    folder.mkdir(parents=True)
    entries = {}
    for index in range(3):
        pose = Pose(FIRST.rotation, FIRST.position + 0.4 * index * np.array([1.0, 0.0, 0.2]))
        inverse_depth, image = ball(pose, SIZE)
        write_image(folder / f"{index}.png", image)
        if with_depth:
            write_depth(folder / f"{index}.exr", (1.0 / inverse_depth).astype(np.float32))
        entries[f"{index}.png"] = PosedPanorama(pose, depth=folder / f"{index}.exr" if with_depth else None)
    write_poses(folder / "poses.json", entries)


def test_a_folder_of_scenes_becomes_a_pool_once(tmp_path, omnisyn):
    write_walk(tmp_path / "data" / "walk")
    write_walk(tmp_path / "data" / "blind", with_depth=False)
    (tmp_path / "data" / "broken").mkdir()
    (tmp_path / "data" / "broken" / "poses.json").write_text("{")
    arguments = ("train", "convert", tmp_path / "data", tmp_path / "pool", "--height", 64)
    said = omnisyn.made(*arguments).raw_err
    names = [path.name for path in list_scene_files(tmp_path / "pool")]
    assert names == ["walk-0.png-1.png.npz", "walk-1.png-2.png.npz"]
    assert said.count("expected true depth of both panoramas") == 2
    assert "broken: " in said
    scene = load_walk(tmp_path / "pool" / names[0])
    assert scene.images.shape == (2, 64, 128, 3)
    np.testing.assert_allclose(scene.positions[1], [0.4, 0.0, 0.08], atol=1e-4)
    again = omnisyn(*arguments)
    assert ".npz" not in again.out + again.raw_err


def test_walks_of_a_recipe_become_a_pool(tmp_path, omnisyn):
    """All views of a walk are one scene, and show what they showed."""
    positions = ((0, 0, 0), (0.2, 0, -0.4), (0.5, 0, -1.0))
    make_walks(tmp_path / "walks", 2, size=(128, 256), radius=3.0, positions=positions)
    arguments = ("train", "convert", tmp_path / "walks", tmp_path / "pool", "--height", 64)
    omnisyn.made(*arguments)
    paths = list_scene_files(tmp_path / "pool")
    assert [path.name for path in paths] == ["00000000.npz", "00000001.npz"]
    small, walk = load_walk(paths[1]), load_walk(tmp_path / "walks" / paths[1].name)
    np.testing.assert_allclose(small.positions, positions, rtol=1e-5)
    for k in range(3):
        np.testing.assert_allclose(small.inverse_depth[k], walk.inverse_depth[k][::2, ::2], rtol=0.05)
    omnisyn.made(*arguments, "--pairs", "1:2")
    pair = load_walk(tmp_path / "pool" / "00000001-1-2.npz")
    np.testing.assert_allclose(pair.positions[1], np.subtract(positions[2], positions[1]), rtol=1e-3)
    np.testing.assert_array_equal(pair.images, small.images[1:])


SMALL = WalkConfig(size=(16, 32), kinds=("room",), pose_error_share=0.3, views=2, supersample=1)


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
