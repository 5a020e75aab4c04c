import numpy as np
import pytest
import torch
from training_samples import TINY, make_pool

from omnisyn_cli.training.loop import train
from omnisyn_cli.training.pictures import SHEET_GAP_PIXELS, contact_sheet, depth_pictures
from omnisyn_cli.training.tasks import TrainConfig


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
    sheet = read_sheet(tmp_path / "run" / "pictures" / names[-1])
    assert sheet.shape == (2 * 64 + SHEET_GAP_PIXELS, 2 * 128 + SHEET_GAP_PIXELS, 3)
    assert sheet[:64, :128].std() > 0.05


def read_sheet(path):
    from omnisyn_cli.io.decode import decode_image

    return decode_image(path)[1]
