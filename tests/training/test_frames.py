import numpy as np
import pytest
import torch
from training_samples import make_pool

from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.geometry.sampling import sample_bilinear, sample_nearest
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.geometry.sweep import epipole_frame, forward_frame, sweep_directions
from omnisyn_cli.training.data import Batch, draw_batch, list_scene_files
from omnisyn_cli.training.triples import EPIPOLE_FROM_FORWARD, forward_batch

AHEAD = Pose(np.eye(3), np.array([0.0, 0.0, 1.0]))  # second from first camera: a baseline straight ahead


def test_the_rotation_between_both_frames_is_the_same_for_every_pair():
    rng = np.random.default_rng(0)
    for _ in range(10):
        one, two = (Pose(rotation_from_rotation_vector(rng.normal(size=3)), rng.normal(size=3)) for _ in range(2))
        epipole, forward = epipole_frame(one, two)[0], forward_frame(one, two)[0]
        np.testing.assert_allclose(epipole.rotation.T @ forward.rotation, EPIPOLE_FROM_FORWARD, atol=1e-9)


@pytest.mark.parametrize("size", [(64, 128), (64, 64), (32, 64)])
def test_every_turned_pair_is_photoconsistent_straight_ahead(tmp_path, size):
    """The root leads to the same colour in the second image, whose camera stands a baseline ahead."""
    drawn = draw_batch(list_scene_files(make_pool(tmp_path)), np.random.default_rng(0), 8, (size[0], 2 * size[0]))
    batch = forward_batch(drawn, size)
    assert batch.first.shape == batch.second.shape == (8, 3, *size)
    assert batch.sqrt_inv_depth.shape == (8, 1, *size)
    assert torch.equal(batch.baseline, drawn.baseline)
    for first, second, sqrt_inv_depth in zip(batch.first, batch.second, batch.sqrt_inv_depth, strict=True):
        moved = sweep_directions(pixel_directions(*size), sqrt_inv_depth[0].double().numpy() ** 2, AHEAD)
        seen = sample_bilinear(second.permute(1, 2, 0).double().numpy(), moved)
        difference = np.abs(seen - first.permute(1, 2, 0).numpy()).mean()
        assert difference < 0.02 + 0.02 * (size[0] < 64)
        assert difference < 0.5 * (second - first).abs().mean().item()


def test_at_edges_nothing_is_invented_and_what_is_unknown_stays_unknown():
    sqrt_inv_depth = torch.full((1, 1, 32, 64), 0.2)
    sqrt_inv_depth[..., :16, :], sqrt_inv_depth[..., 20:24, 8:16] = 0.8, torch.nan
    batch = forward_batch(
        Batch(torch.rand(1, 3, 32, 64), torch.rand(1, 3, 32, 64), sqrt_inv_depth, torch.ones(1)), (32, 64)
    )
    found = batch.sqrt_inv_depth[torch.isfinite(batch.sqrt_inv_depth)]
    near = [torch.isclose(found, torch.tensor(value), rtol=0.06) for value in (0.2, 0.8)]
    assert torch.all(near[0] | near[1])
    directions = pixel_directions(32, 64) @ EPIPOLE_FROM_FORWARD.T
    expected = sample_nearest(torch.isnan(sqrt_inv_depth)[0, 0].float().numpy(), directions) > 0
    assert (torch.isnan(batch.sqrt_inv_depth)[0, 0].numpy() == expected).mean() > 0.995
