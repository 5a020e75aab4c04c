import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.nn import functional
from training_samples import ball_walk, make_walks

from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.grouping import BASELINE_BINS, baseline_bin
from omnisyn_cli.geometry.pose import rotation_from_heading
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.networks.guided_depth import GuidedDepthPrediction, feature_directions
from omnisyn_cli.training.data import Augmentation, list_scene_files, load_walk, save_samples
from omnisyn_cli.training.guided_depth import GuidedBatch, draw_guided, guided_loss, guided_scores, with_cap
from omnisyn_cli.training.walks import WalkConfig, draw_pose_error, facing_the_other, make_walk


def warped(batch, factor):
    """The second picture as the first would see it if √(inverse depth) was wrong by a factor."""
    height, width = batch.sqrt_inv_depth.shape[-2:]
    directions = feature_directions((height, width), 0.0, batch.first)
    moved = directions - (batch.sqrt_inv_depth * factor).square().squeeze(1)[..., None] * batch.towards.view(
        -1, 1, 1, 3
    )
    azimuth = torch.atan2(moved[..., 0], -moved[..., 2]) / math.pi
    polar = torch.atan2(torch.hypot(moved[..., 0], moved[..., 2]), moved[..., 1]) * 2 / math.pi - 1
    return functional.grid_sample(
        batch.second, torch.stack([azimuth, polar], -1), padding_mode="border", align_corners=False
    )


@pytest.mark.parametrize("augmentation", [None, Augmentation(0, 0, 0, 0, 0, 0)], ids=["exact", "held by hand"])
def test_what_is_drawn_is_a_pair_its_geometry_and_its_truth(tmp_path, augmentation):
    """The second picture, warped by the true depth, is the first one; by others it is not."""
    pool = list_scene_files(make_walks(tmp_path, 4))
    batch = draw_guided(pool, np.random.default_rng(0), 8, (64, 128), 2.0, augmentation)
    errors = {factor: float((warped(batch, factor) - batch.first).abs().mean()) for factor in (0.9, 1.0, 1.1)}
    assert errors[1.0] < (0.006 if augmentation is None else 0.02)
    assert errors[1.0] < 0.5 * min(errors[0.9], errors[1.1])
    torch.testing.assert_close(batch.towards.norm(dim=1), torch.ones(8, 1, 1))
    assert (batch.towards[:, 2] < -0.9).all()  # the other camera is ahead, up to the slope


def test_a_batch_depends_on_the_random_numbers_alone_and_smaller_ones_are_means(tmp_path):
    pool = list_scene_files(make_walks(tmp_path, 2))
    one, same = (draw_guided(pool, np.random.default_rng(7), 2, (32, 64), 2.0, Augmentation()) for _ in range(2))
    for name, value in vars(one).items():
        assert torch.equal(value, getattr(same, name)), name
    assert one.first.shape == (2, 3, 32, 64)
    with pytest.raises(InputError, match="multiple of 48"):
        draw_guided(pool, np.random.default_rng(0), 1, (48, 96), 2.0)


def test_narrow_and_wide_pairs_are_drawn_equally_often(tmp_path):
    along = [(0, 0, 0), (0.2, 0, 0), (0.3, 0, 0), (0.4, 0, 0), (1.8, 0, 0)]
    save_samples(tmp_path / "0.npz", [ball_walk(positions=along, radius=2.5)])
    drawn = draw_guided(list_scene_files(tmp_path), np.random.default_rng(0), 300, (64, 128), 2.0)
    bins = [baseline_bin(float(ratio)) for ratio in drawn.ratio]
    shares = {name: bins.count(name) / 300 for name in BASELINE_BINS if name in bins}
    assert all(share == pytest.approx(1 / len(shares), abs=0.1) for share in shares.values())
    assert len(shares) >= 2


@pytest.mark.parametrize("heading", [0.0, 0.7, 2.9, -3.1, -1.6])
def test_turning_towards_the_other_camera_moves_pictures_and_direction_alike(heading):
    """What lies in the direction of the other camera is ahead afterwards; the direction is exact, not whole columns."""
    towards = rotation_from_heading(heading) @ np.array([0.0, 0.3, -1.0]) / math.hypot(1.0, 0.3)
    directions = pixel_directions(64, 128)
    images = np.stack([directions, directions]).astype(np.float32)
    turned, ahead = facing_the_other(images, towards)
    assert abs(math.atan2(ahead[0], -ahead[2])) <= math.pi / 128 + 1e-9
    expected = (pixel_directions(64, 128) @ ahead).reshape(64, 128)
    np.testing.assert_allclose(turned[0] @ towards, expected, atol=1e-6)


def prediction(sqrt_inv_depth, log_scale=-3.0):
    thin = [sqrt_inv_depth[..., s // 2 :: s, s // 2 :: s].clone() for s in (4, 2)]
    return GuidedDepthPrediction(sqrt_inv_depth.clone(), torch.full_like(sqrt_inv_depth, log_scale), tuple(thin))


def batch_of(sqrt_inv_depth, ratio=0.4, is_mesh=True):
    empty, count = torch.zeros(len(sqrt_inv_depth), 6, 1, 1), len(sqrt_inv_depth)
    return GuidedBatch(*[empty] * 3, sqrt_inv_depth, torch.full((count,), ratio), torch.tensor([is_mesh]))


def test_the_truth_costs_nothing_but_its_doubt():
    sqrt_inv_depth = torch.rand(1, 1, 32, 64) + 0.1
    doubt = 0.02 * -3.0
    assert float(guided_loss(prediction(sqrt_inv_depth), batch_of(sqrt_inv_depth))) == pytest.approx(doubt, abs=1e-6)
    assert float(guided_loss(prediction(sqrt_inv_depth + 0.1), batch_of(sqrt_inv_depth))) > 0.1
    below_zero, sky = torch.full((1, 1, 32, 64), -0.2), torch.zeros(1, 1, 32, 64)
    assert float(guided_loss(prediction(below_zero), batch_of(sky))) == pytest.approx(doubt, abs=1e-6)


def test_caps_are_at_the_nadir_of_both_pictures_of_a_quarter_of_the_pairs():
    black, rng = np.zeros((2, 64, 128, 3), np.float32), np.random.default_rng(0)
    is_capped = np.array([with_cap(black.copy(), rng).any(axis=-1).all(axis=(0, 2)) for _ in range(400)])
    assert 0.2 < is_capped[:, -1].mean() < 0.3
    assert not is_capped[:, : 64 - round(64 * 26 / 180) - 1].any()


def test_two_fifths_of_the_poses_are_wrong_by_some_milliradians():
    rng = np.random.default_rng(3)
    drawn = [draw_pose_error(rng) for _ in range(2000)]
    wrong = [(np.arccos((np.trace(turn) - 1) / 2), offset) for turn, offset in drawn if offset.any()]
    assert len(wrong) / len(drawn) == pytest.approx(0.4, abs=0.03)
    assert all((turn == np.eye(3)).all() for turn, offset in drawn if not offset.any())
    angles, offsets = map(np.array, zip(*wrong, strict=True))
    assert np.sqrt((angles**2).mean() / 3) == pytest.approx(0.003, rel=0.1)
    assert offsets.std() == pytest.approx(0.008, rel=0.1)


def test_nothing_is_taught_where_the_truth_is_not_known_and_gradients_are_finite():
    sqrt_inv_depth = torch.rand(1, 1, 32, 64) + 0.1
    holes = torch.where(torch.rand_like(sqrt_inv_depth) < 0.3, torch.tensor(math.nan), sqrt_inv_depth)
    estimate = sqrt_inv_depth.clone().requires_grad_()
    guess = GuidedDepthPrediction(estimate, torch.zeros_like(sqrt_inv_depth), prediction(sqrt_inv_depth).coarse)
    guided_loss(replace(guess, estimate=estimate + 0.1), batch_of(holes)).backward()
    assert torch.isfinite(estimate.grad).all()
    assert (estimate.grad[holes.isnan()] == 0).all()
    assert estimate.grad[~holes.isnan()].abs().max() > 0


def test_the_laplace_scale_learns_from_errors_that_it_cannot_change():
    sqrt_inv_depth = torch.full((1, 1, 32, 64), 0.5)
    scale = torch.full_like(sqrt_inv_depth, -1.0).requires_grad_()
    for offset, sign in ((0.01, 1.0), (2.0, -1.0)):
        guess = GuidedDepthPrediction(sqrt_inv_depth + offset, scale, prediction(sqrt_inv_depth).coarse)
        (gradient,) = torch.autograd.grad(guided_loss(guess, batch_of(sqrt_inv_depth)), scale)
        assert torch.equal(gradient.sign(), torch.full_like(gradient, sign))  # too wide, then too narrow


def test_figures_belong_to_the_bin_of_the_pair():
    sqrt_inv_depth = torch.full((1, 1, 32, 64), 0.5)
    scores = guided_scores(prediction(sqrt_inv_depth * 1.1), batch_of(sqrt_inv_depth, ratio=0.7, is_mesh=False))
    assert scores["error"] == pytest.approx(0.05, rel=1e-4)
    assert scores["delta_25"] == 1.0  # 1.1² < 1.25
    assert scores["delta_5"] == 0.0
    assert scores["error_wide"] == scores["error"]
    assert all(math.isnan(scores[f"error_{group}"]) for group in ("narrow", "medium", "mesh"))


def test_a_walk_of_a_procedural_scene_reads_back_and_is_the_same_again(tmp_path):
    config = WalkConfig(size=(32, 64), views=3, kinds=("room",), supersample=1)
    walk = make_walk(3, config)
    save_samples(tmp_path / "3.npz", [walk])
    read, again = load_walk(tmp_path / "3.npz"), make_walk(3, config)
    np.testing.assert_array_equal(read.images, again.images)
    np.testing.assert_allclose(read.inverse_depth, again.inverse_depth, rtol=1e-3)
    assert walk.images.shape == (3, 32, 64, 3)
    assert not walk.is_mesh
    steps = np.diff(walk.positions, axis=0)
    assert np.linalg.norm(np.cross(*steps)) < 1e-5  # on a line


def test_kinds_and_meshes_are_checked_before_anything_is_made():
    with pytest.raises(InputError, match="expected kinds"):
        WalkConfig(kinds=("castle",)).check()
    with pytest.raises(InputError, match="--meshes"):
        WalkConfig(kinds=("mesh",)).check()
