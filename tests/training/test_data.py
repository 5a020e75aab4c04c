"""Pools, the pairs that are drawn from them, and the pictures that tell how training goes."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from training_samples import TINY, ball_scene, make_pool, make_walks

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.geometry.sampling import sample_bilinear, sample_nearest
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.geometry.sweep import sweep_directions
from omnisyn_cli.io.decode import decode_image
from omnisyn_cli.training import data
from omnisyn_cli.training.data import Augmentation, list_scene_files, load_walk, save_samples
from omnisyn_cli.training.loop import train
from omnisyn_cli.training.pairs import Batch, draw_pairs, turned_depth
from omnisyn_cli.training.pictures import SHEET_GAP_PIXELS, contact_sheet, depth_pictures
from omnisyn_cli.training.tasks import TrainConfig


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
        draw_pairs(Batch, pool, np.random.default_rng(0), 1, (48, 96))


def test_equal_seeds_draw_equal_batches(tmp_path):
    pool = list_scene_files(make_pool(tmp_path))
    one, same, other = (
        draw_pairs(Batch, pool, np.random.default_rng(seed), 2, (64, 128), Augmentation()) for seed in (3, 3, 4)
    )
    assert torch.equal(one.first, same.first)
    assert torch.equal(one.sqrt_inv_depth, same.sqrt_inv_depth)
    assert not torch.equal(one.first, other.first)


def test_varied_colours_stay_colours_of_the_same_picture(tmp_path):
    pool = list_scene_files(make_pool(tmp_path))
    for seed in range(12):
        rng, same = np.random.default_rng(seed), np.random.default_rng(seed)
        varied = draw_pairs(Batch, pool, rng, 1, (64, 128), Augmentation(jpeg=1.0, blur=1.0))
        plain = draw_pairs(Batch, pool, same, 1, (64, 128))
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


def test_arrays_that_samples_no_longer_have_are_passed_over(tmp_path):
    walk, more = ball_scene(), dict.fromkeys(("pairs", "matching", "images_left", "images_right"), np.zeros(1))
    save_samples(tmp_path / "0.npz", [SimpleNamespace(**vars(walk), **more)])
    np.testing.assert_array_equal(load_walk(tmp_path / "0.npz").images, walk.images)


def test_an_empty_pool_is_an_error_that_says_what_to_do(tmp_path):
    with pytest.raises(InputError, match="omnisyn train pool"):
        list_scene_files(tmp_path)


AHEAD = Pose(np.eye(3), np.array([0.0, 0.0, 1.0]))  # second from first camera: a baseline straight ahead


@pytest.mark.parametrize("make", [make_pool, make_walks], ids=["level", "sloped"])
@pytest.mark.parametrize("size", [(64, 128), (64, 64), (32, 64)])
def test_every_pair_is_photoconsistent_straight_ahead(tmp_path, size, make):
    """From either end, mirrored or not: the root, a baseline ahead, leads to the same colour in the second image."""
    batch = draw_pairs(Batch, list_scene_files(make(tmp_path)), np.random.default_rng(0), 12, size)
    assert batch.first.shape == batch.second.shape == (12, 3, *size)
    assert batch.sqrt_inv_depth.shape == (12, 1, *size)
    assert len(set(np.round(batch.baseline.numpy(), 3))) == 3
    for first, second, sqrt_inv_depth in zip(batch.first, batch.second, batch.sqrt_inv_depth, strict=True):
        moved = sweep_directions(pixel_directions(*size), sqrt_inv_depth[0].double().numpy() ** 2, AHEAD)
        seen = sample_bilinear(second.permute(1, 2, 0).double().numpy(), moved)
        difference = np.abs(seen - first.permute(1, 2, 0).numpy()).mean()
        assert difference < 0.02 + 0.02 * (size[0] < 64)
        assert difference < 0.5 * (second - first).abs().mean().item()


def test_at_edges_nothing_is_invented_and_what_is_unknown_stays_unknown():
    sqrt_inv_depth = np.full((32, 64), 0.2, np.float32)
    sqrt_inv_depth[:16], sqrt_inv_depth[20:24, 8:16] = 0.8, np.nan
    rotation = rotation_from_rotation_vector(np.array([0.4, 1.0, -0.3]))
    turned = turned_depth(sqrt_inv_depth, rotation, (32, 64))
    found = turned[np.isfinite(turned)]
    assert np.all(np.isclose(found, 0.2, rtol=0.06) | np.isclose(found, 0.8, rtol=0.06))
    expected = sample_nearest(np.isnan(sqrt_inv_depth).astype(np.float32), pixel_directions(32, 64) @ rotation.T) > 0
    assert (np.isnan(turned) == expected).mean() > 0.995


@pytest.fixture
def config(tmp_path):
    pool = str(make_pool(tmp_path / "pool"))
    return TrainConfig(pool, pool, size=(64, 128), batch=1, validate_every=2, validation_pairs=1)


def test_pictures_show_errors_where_they_are_and_nothing_where_the_truth_is_unknown():
    truth = np.linspace(0.1, 1.0, 32, dtype=np.float32).reshape(4, 8)
    sqrt_inv_depth = truth.copy()
    sqrt_inv_depth[1, 2] += 0.5
    truth[3, 3] = np.nan
    shown = depth_pictures(torch.full((3, 4, 8), 0.5), *map(torch.from_numpy, (sqrt_inv_depth, truth)))
    assert list(shown) == ["input", "prediction", "truth", "error"]
    right = np.ones((4, 8), bool)
    right[1, 2] = right[3, 3] = False
    np.testing.assert_array_equal(shown["prediction"][right], shown["truth"][right])
    assert np.all(shown["truth"][3, 3] == 0)
    brightness = shown["error"].sum(axis=-1)
    assert brightness[1, 2] > 2
    assert np.delete(brightness.ravel(), 8 + 2).max() < 0.1
    far, near = shown["truth"][0, 0], shown["truth"][3, 7]
    assert far[2] > far[0]  # blue
    assert near[0] > near[2]  # red


def test_a_sheet_has_two_pictures_in_a_row():
    pictures = {name: np.full((4, 8, 3), level, np.float32) for name, level in zip("abc", (0.2, 0.5, 0.9), strict=True)}
    sheet = contact_sheet(pictures)
    assert sheet.shape == (2 * 4 + SHEET_GAP_PIXELS, 2 * 8 + SHEET_GAP_PIXELS, 3)
    assert np.all(sheet[:4, :8] == np.float32(0.2))
    assert np.all(sheet[:4, -8:] == np.float32(0.5))
    assert np.all(sheet[-4:, :8] == np.float32(0.9))
    assert np.all(sheet[-4:, -8:] == 0)


def test_every_validation_leaves_a_picture(tmp_path, config):
    train(TINY, config, tmp_path / "run", steps=4)
    names = sorted(path.name for path in (tmp_path / "run" / "pictures").iterdir())
    assert names == ["00000002.png", "00000004.png"]
    _, sheet = decode_image(tmp_path / "run" / "pictures" / names[-1])
    assert sheet.shape == (2 * 64 + SHEET_GAP_PIXELS, 2 * 128 + SHEET_GAP_PIXELS, 3)
    assert sheet[:64, :128].std() > 0.05
