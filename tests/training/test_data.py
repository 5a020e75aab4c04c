import numpy as np
import pytest
import torch
from training_samples import ball_scene, make_pool

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sampling import sample_bilinear
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.geometry.sweep import sweep_directions
from omnisyn_cli.training import data
from omnisyn_cli.training.data import Augmentation, draw_batch, list_scene_files, load_scene, save_scene

ABOVE = Pose(np.eye(3), np.array([0.0, -1.0, 0.0]))
"""The first camera's points seen by one that stands a baseline up the zenith."""


@pytest.mark.parametrize("size", [(64, 128), (32, 64)])
def test_every_pair_is_photoconsistent(tmp_path, size):
    """Whichever end a pair is read from, mirrored or not: the root leads to the same colour in the second image."""
    batch = draw_batch(list_scene_files(make_pool(tmp_path)), np.random.default_rng(0), 16, size)
    assert batch.first.shape == batch.second.shape == (16, 3, *size)
    assert batch.sqrt_inv_depth.shape == (16, 1, *size)
    assert set(np.round(batch.baseline.numpy(), 3)) == {np.float32(0.4), np.float32(0.6), np.float32(1.0)}
    for first, second, sqrt_inv_depth in zip(batch.first, batch.second, batch.sqrt_inv_depth, strict=True):
        moved = sweep_directions(pixel_directions(*size), sqrt_inv_depth[0].double().numpy() ** 2, ABOVE)
        seen = sample_bilinear(second.permute(1, 2, 0).double().numpy(), moved)
        difference = np.abs(seen - first.permute(1, 2, 0).numpy()).mean()
        unmoved = (second - first).abs().mean().item()
        assert difference < 0.02 + 0.02 * (size[0] < 64)
        assert difference < 0.5 * unmoved


@pytest.mark.parametrize("stride", [1, 2, 3, 4])
def test_depth_is_that_of_the_centres_of_the_averaged_blocks(stride):
    """A plane is sampled where the image is; turning the map around turns the result around."""
    size, rng = (6, 12), np.random.default_rng(0)
    row, col = np.mgrid[: 6 * stride, : 12 * stride].astype(np.float32)
    plane = 1.0 + 1e-3 * row + 2e-3 * col
    blocks = plane.reshape(6, stride, 12, stride).mean(axis=(1, 3))
    np.testing.assert_allclose(data.at_block_centres(plane, size), blocks, rtol=1e-6)
    rough = rng.random(plane.shape, dtype=np.float32)
    for turn in (np.s_[::-1], np.s_[:, ::-1]):
        np.testing.assert_allclose(
            data.at_block_centres(rough[turn], size), data.at_block_centres(rough, size)[turn], rtol=1e-6
        )


def test_where_surfaces_meet_depth_is_that_of_the_nearest():
    edge = np.array([[1.0, 0.2], [0.2, 0.0]], dtype=np.float32)
    assert data.at_block_centres(edge, (1, 1)) == 1.0


def test_a_pool_that_is_no_multiple_of_the_size_is_refused(tmp_path):
    pool = list_scene_files(make_pool(tmp_path))
    with pytest.raises(InputError, match="multiple of 48 rows, got 64"):
        draw_batch(pool, np.random.default_rng(0), 1, (48, 96))


def test_equal_seeds_draw_equal_batches(tmp_path):
    pool = list_scene_files(make_pool(tmp_path))
    one, same, other = (
        draw_batch(pool, np.random.default_rng(seed), 2, (64, 128), Augmentation()) for seed in (3, 3, 4)
    )
    assert torch.equal(one.first, same.first)
    assert torch.equal(one.sqrt_inv_depth, same.sqrt_inv_depth)
    assert not torch.equal(one.first, other.first)


def test_varied_colours_stay_colours_of_the_same_picture(tmp_path):
    pool = list_scene_files(make_pool(tmp_path))
    for seed in range(12):
        rng, same = np.random.default_rng(seed), np.random.default_rng(seed)
        varied = draw_batch(pool, rng, 1, (64, 128), Augmentation(jpeg=1.0, blur=1.0))
        plain = draw_batch(pool, same, 1, (64, 128))
        assert varied.first.dtype == torch.float32
        assert 0 <= varied.first.min() <= varied.first.max() <= 1
        assert torch.equal(varied.sqrt_inv_depth, plain.sqrt_inv_depth)
        both = torch.stack([varied.first.mean(1).flatten(), plain.first.mean(1).flatten()])
        assert torch.corrcoef(both)[0, 1] > 0.9


def test_a_scene_survives_the_disk(tmp_path):
    scene = ball_scene()
    save_scene(tmp_path / "a" / "0.npz", scene)
    loaded = load_scene(tmp_path / "a" / "0.npz")
    np.testing.assert_array_equal(loaded.images, scene.images)
    np.testing.assert_allclose(loaded.inverse_depth, scene.inverse_depth, rtol=1e-3)
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["0.npz"]


def test_an_empty_pool_is_an_error_that_says_what_to_do(tmp_path):
    with pytest.raises(InputError, match="omnisyn train pool"):
        list_scene_files(tmp_path)
