import numpy as np
import pytest
import torch
from training_samples import ball_scene, make_pool

from omnisyn_cli.errors import InputError
from omnisyn_cli.training import data
from omnisyn_cli.training.data import Augmentation, list_scene_files, load_walk, save_samples
from omnisyn_cli.training.pairs import draw_pairs


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
        draw_pairs(pool, np.random.default_rng(0), 1, (48, 96))


def test_equal_seeds_draw_equal_batches(tmp_path):
    pool = list_scene_files(make_pool(tmp_path))
    one, same, other = (
        draw_pairs(pool, np.random.default_rng(seed), 2, (64, 128), Augmentation()) for seed in (3, 3, 4)
    )
    assert torch.equal(one.first, same.first)
    assert torch.equal(one.sqrt_inv_depth, same.sqrt_inv_depth)
    assert not torch.equal(one.first, other.first)


def test_varied_colours_stay_colours_of_the_same_picture(tmp_path):
    pool = list_scene_files(make_pool(tmp_path))
    for seed in range(12):
        rng, same = np.random.default_rng(seed), np.random.default_rng(seed)
        varied = draw_pairs(pool, rng, 1, (64, 128), Augmentation(jpeg=1.0, blur=1.0))
        plain = draw_pairs(pool, same, 1, (64, 128))
        assert varied.first.dtype == torch.float32
        assert 0 <= varied.first.min() <= varied.first.max() <= 1
        assert torch.equal(varied.sqrt_inv_depth, plain.sqrt_inv_depth)
        both = torch.stack([varied.first.mean(1).flatten(), plain.first.mean(1).flatten()])
        assert torch.corrcoef(both)[0, 1] > 0.9


def test_a_scene_survives_the_disk(tmp_path):
    scene = ball_scene()
    save_samples(tmp_path / "a" / "0.npz", [scene])
    loaded = load_walk(tmp_path / "a" / "0.npz")
    np.testing.assert_array_equal(loaded.images, scene.images)
    np.testing.assert_array_equal(loaded.inverse_depth, scene.inverse_depth)
    assert loaded.inverse_depth.dtype == np.float32
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["0.npz"]


def test_an_empty_pool_is_an_error_that_says_what_to_do(tmp_path):
    with pytest.raises(InputError, match="omnisyn train pool"):
        list_scene_files(tmp_path)
