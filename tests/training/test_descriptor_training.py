"""The descriptor network, what it is shown, and what it is taught."""

from functools import partial

import numpy as np
import pytest
import torch
from training_samples import make_walks

from omnisyn_cli.networks.descriptors import DESCRIPTOR_VARIANTS, DescriptorNetwork
from omnisyn_cli.training.data import Augmentation, list_scene_files
from omnisyn_cli.training.descriptor_pairs import DescriptorBatch, descriptor_loss, descriptor_scores, draw_descriptors


def test_a_rolled_picture_has_rolled_descriptors():
    network = DescriptorNetwork(DESCRIPTOR_VARIANTS["lite0"]).eval()
    picture = torch.rand(1, 3, 32, 64)
    with torch.inference_mode():
        rolled = network(picture.roll(8, -1)).roll(-4, -1)
        torch.testing.assert_close(rolled, network(picture), atol=1e-4, rtol=1e-4)
    with pytest.raises(ValueError, match="multiples of 8"):
        network(picture[..., :30])


def test_drawn_targets_show_the_same_spot(tmp_path):
    """Colours of smooth balls: those at the targets are those of the pixels, those at other rows are not."""
    pool = list_scene_files(make_walks(tmp_path, 4))
    draw = partial(draw_descriptors, pool, pairs=6, size=(64, 128))
    batch = draw(np.random.default_rng(0), augmentation=None)
    first, second = (torch.nn.functional.avg_pool2d(each, 2).numpy() for each in (batch.first, batch.second))
    known = torch.isfinite(batch.targets).numpy()
    assert known.mean() > 0.9
    errors = []
    for away in (0, 3):
        index, col, _ = np.nonzero(known)
        rows = np.clip(np.rint(batch.targets.numpy()[known]) + away, 0, 31).astype(int)
        errors.append(np.abs(first[index, :, batch.rows.numpy()[known], col] - second[index, :, rows, col]).mean())
    assert errors[0] < 0.03 < 2 * errors[0] < errors[1]
    one, same = (draw(np.random.default_rng(7), augmentation=Augmentation()) for _ in range(2))
    assert all(torch.equal(value, getattr(same, name)) for name, value in vars(one).items() if name != "targets")


def test_the_loss_is_least_where_the_true_row_is_alike():
    rows, targets = torch.full((1, 4, 2), 5), torch.tensor([7.0, torch.nan]).expand(1, 4, 2)
    batch = DescriptorBatch(torch.zeros(1, 3, 32, 8), torch.zeros(1, 3, 32, 8), rows, targets)
    other = 3.0 * torch.eye(16)[None, :, :, None].expand(-1, -1, -1, 4).clone()
    losses, right = [], []
    for row in (7, 8, 12):
        own = torch.zeros(1, 16, 16, 4)
        own[:, row, 5] = 3.0
        losses.append(float(descriptor_loss((own, other), batch)))
        right.append(descriptor_scores((own, other), batch)["right"])
    assert losses == sorted(losses)
    assert right == [1.0, 1.0, 0.0]
    assert losses[2] > losses[0] + 2.0
