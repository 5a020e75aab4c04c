import numpy as np
import pytest
from training_samples import make_pool, make_walks

from omnisyn_cli.geometry.pose import Pose, rotation_from_rotation_vector
from omnisyn_cli.geometry.sampling import sample_bilinear, sample_nearest
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.geometry.sweep import sweep_directions
from omnisyn_cli.training.data import list_scene_files
from omnisyn_cli.training.pairs import draw_pairs, turned_depth

AHEAD = Pose(np.eye(3), np.array([0.0, 0.0, 1.0]))  # second from first camera: a baseline straight ahead


@pytest.mark.parametrize("make", [make_pool, make_walks], ids=["level", "sloped"])
@pytest.mark.parametrize("size", [(64, 128), (64, 64), (32, 64)])
def test_every_pair_is_photoconsistent_straight_ahead(tmp_path, size, make):
    """Whichever end a pair is read from, mirrored or not: the root leads to the same colour in the second image.

    Its camera stands a baseline ahead.
    """
    batch = draw_pairs(list_scene_files(make(tmp_path)), np.random.default_rng(0), 12, size)
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
