from dataclasses import replace

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from training_samples import ball_scene, make_pool

from omnisyn_cli.cli.train import train
from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.networks.completion import (
    CONSISTENT_CHANNEL,
    FILLED_CHANNEL,
    SKY_CHANNEL,
    CompletionConfig,
    CompletionPrediction,
)
from omnisyn_cli.training import completion, losses
from omnisyn_cli.training.completion import completion_pair, draw_completion
from omnisyn_cli.training.data import Augmentation, list_scene_files
from omnisyn_cli.training.loop import TrainConfig, Trainer
from omnisyn_cli.training.losses import completion_loss, completion_scores
from omnisyn_cli.training.publish import publish

TINY = CompletionConfig("tiny", channels=19, widths=(8, 12, 16), fine=6, heads=2, attention_layers=1)
SIZE = (32, 64)
TOWARDS_PLANE, UP_PLANE = 16, 17
USABLE_PLANE = 7


def pair(seed, size=SIZE, scene=0, **options):
    return completion_pair(ball_scene(scene, **options), np.random.default_rng(seed), size, Augmentation())


def sure(batch):
    return torch.maximum(batch.channels[:, CONSISTENT_CHANNEL], batch.channels[:, SKY_CHANNEL])[:, None]


@pytest.mark.parametrize("seed", range(6))
def test_views_are_upright_and_look_at_each_other(seed):
    """Two of three planes of directions are orthogonal axes of the camera; those of the two views are opposite."""
    batch = pair(seed)
    towards, up = (batch.channels[:, plane].numpy().astype(float) for plane in (TOWARDS_PLANE, UP_PLANE))
    directions = pixel_directions(*SIZE).reshape(-1, 3)
    for plane in (*towards, *up):
        axis, *_ = np.linalg.lstsq(directions, plane.ravel(), rcond=None)
        np.testing.assert_allclose(directions @ axis, plane.ravel(), atol=1e-5)
        assert np.linalg.norm(axis) == pytest.approx(1.0, abs=1e-4)
    np.testing.assert_allclose(towards[0], -towards[1], atol=1e-5)
    assert np.unravel_index(up[0].argmax(), SIZE)[0] < SIZE[0] // 4


def test_roots_are_those_of_the_scene_in_the_turned_frame():
    """In closed form: every point lies on the wall of the ball, so both views see points at one distance from it."""
    rng = np.random.default_rng(3)
    scene = ball_scene(0, size=(128, 256))
    batch = completion_pair(scene, rng, SIZE)
    depth = (batch.baseline[:, None, None] / batch.sqrt_inv_depth[:, 0].square()).numpy().astype(float)
    points = pixel_directions(*SIZE)[None] * depth[..., None]
    for view in points:
        system = np.column_stack([2.0 * view.reshape(-1, 3), np.ones(view[..., 0].size)])
        answer, *_ = np.linalg.lstsq(system, (view.reshape(-1, 3) ** 2).sum(-1), rcond=None)
        assert np.sqrt(answer[3] + answer[:3] @ answer[:3]) == pytest.approx(2.0, abs=0.02)


def test_equal_random_numbers_make_equal_batches(tmp_path):
    pool = list_scene_files(make_pool(tmp_path))
    first, again, other = (
        draw_completion(pool, np.random.default_rng(seed), 1, SIZE, Augmentation()) for seed in (1, 1, 2)
    )
    assert torch.equal(first.channels, again.channels)
    assert torch.equal(first.sqrt_inv_depth, again.sqrt_inv_depth)
    assert not torch.equal(first.channels, other.channels)


def test_what_is_sure_is_nearly_right_and_the_rest_is_not():
    """Over many draws: some of the sphere is left open, and what is sure is wrong in few places only."""
    open_share, wrong = [], []
    for seed in range(12):
        batch = pair(seed, size=(64, 128), scene=seed)
        known = sure(batch) > 0
        error = (
            batch.channels[:, FILLED_CHANNEL : FILLED_CHANNEL + 1] - batch.sqrt_inv_depth
        ).abs() / batch.sqrt_inv_depth.clamp(min=0.05)
        open_share.append(1.0 - known.float().mean())
        wrong.append((error[known] > 0.1).float().mean())
    assert 0.03 < np.mean(open_share) < 0.5
    assert 0.0 < np.mean(wrong) < 0.1


def disc_before_a_wall(size=(64, 128)):
    """Inverse depth: a disc of 8 pixels at 1 before a wall at a tenth, across the seam; how far silhouettes are."""
    row, col = np.mgrid[: size[0], : size[1]]
    away = np.hypot(row - size[0] // 2, (col + size[1] // 2) % size[1] - size[1] // 2) - 8.0
    return np.where(away < 0, 1.0, 0.1).astype(np.float32), np.abs(away)


def test_silhouettes_are_blunted_as_windows_do_it_and_nothing_else_is():
    """Pixels beside a silhouette get the value of its other side, and some of them pass for sure, others for open."""
    truth, away = disc_before_a_wall()
    nothing = np.zeros(truth.shape, np.bool_)
    grown, lost, sure_there = 0, 0, []
    for seed in range(20):
        left_right_consistent, matched = completion._fatten_silhouettes(
            truth, nothing, truth, np.random.default_rng(seed)
        )
        changed = np.abs(matched - truth) > 0.3
        assert away[changed].max(initial=0.0) < 8.0
        np.testing.assert_array_equal(matched[~changed & (away > 8.0)], truth[~changed & (away > 8.0)])
        assert not left_right_consistent[away > 8.0].any()
        grown, lost = grown + (changed & (truth < 0.5)).sum(), lost + (changed & (truth > 0.5)).sum()
        np.testing.assert_allclose(matched[changed & (truth < 0.5)], 1.0, rtol=0.2)
        sure_there.append(left_right_consistent[changed].mean() if changed.any() else 0.5)
    assert grown > lost
    assert 0.2 < np.mean(sure_there) < 0.9


def test_nothing_that_a_mask_hides_passes_for_agreed():
    """Whatever is blunted or mistaken afterwards."""
    masked = 0
    for seed in range(20):
        channels = pair(seed, size=(64, 128)).channels
        hidden = channels[:, USABLE_PLANE] == 0
        masked += int(hidden.sum())
        assert torch.all(channels[:, CONSISTENT_CHANNEL][hidden] == 0)
    assert masked > 0


def test_points_are_seen_by_the_other_camera_unless_something_stands_before_them():
    """A wall all around, first in full view of the other camera, then behind a screen that hides half of it."""
    size = (64, 128)
    directions, towards = pixel_directions(*size), np.array([1.0, 0.0, 0.0])
    everywhere, image = np.ones(size, np.bool_), np.zeros((*size, 3), np.float32)
    view = completion._UprightView(image, np.full(size, 1 / 6.0, np.float32), towards, everywhere)
    along = directions @ towards  # the other camera's depth of the wall, seen along its own rays
    wall = 1.0 / (np.sqrt(along**2 + 35.0) - along)
    other = completion._UprightView(image, wall.astype(np.float32), -towards, everywhere)
    assert completion._is_visible_to_other(view, other, directions).all()
    behind = directions[..., 2] > 0
    screened = replace(other, inverse_depth=np.where(behind, 2.0, wall).astype(np.float32))
    seen = completion._is_visible_to_other(view, screened, directions)
    assert not seen[directions[..., 2] > 0.05].any()
    assert seen[directions[..., 2] < -0.05].all()


def test_where_the_truth_is_not_known_nothing_is_sure_or_taught():
    """Holes of a scan: pools of one's own data have them."""
    scene = ball_scene(0, size=(64, 128))
    scene.inverse_depth[:, 20:40, 30:90] = np.nan
    batch = completion_pair(scene, np.random.default_rng(0), SIZE, Augmentation())
    unknown = torch.isnan(batch.sqrt_inv_depth)
    assert 0.05 < unknown.float().mean() < 0.5
    assert torch.all(torch.isfinite(batch.channels))
    assert torch.all(sure(batch)[unknown] == 0)
    prediction = CompletionPrediction(torch.zeros(2, 2, *SIZE), torch.zeros(2, 1, *SIZE), torch.zeros(2, 1, *SIZE))
    scores = completion_scores(
        prediction, batch.channels[:, FILLED_CHANNEL : FILLED_CHANNEL + 1], batch.sqrt_inv_depth, sure(batch)
    )
    assert all(np.isfinite(value) for value in scores.values())


def test_the_loss_is_least_at_the_truth_and_has_finite_gradients():
    batch = pair(0)
    known = sure(batch)

    def loss_of(sqrt_inv_depths):
        prediction = CompletionPrediction(
            sqrt_inv_depths, torch.zeros_like(batch.sqrt_inv_depth), torch.zeros_like(batch.sqrt_inv_depth)
        )
        return completion_loss(prediction, batch.sqrt_inv_depth, known)

    right = batch.sqrt_inv_depth.repeat(1, 2, 1, 1)
    for offset in (-0.05, 0.02, 0.3):
        assert loss_of(right + offset) > loss_of(right)
    sqrt_inv_depths = (right + 0.1 * torch.randn_like(right)).requires_grad_()
    loss_of(sqrt_inv_depths).backward()
    assert torch.all(torch.isfinite(sqrt_inv_depths.grad))
    unknown = batch.sqrt_inv_depth.clone()
    unknown[..., :10] = torch.nan
    prediction = CompletionPrediction(
        right, torch.zeros_like(batch.sqrt_inv_depth), torch.zeros_like(batch.sqrt_inv_depth)
    )
    assert torch.isfinite(completion_loss(prediction, unknown, known))


def test_what_is_sure_counts_more_beside_silhouettes():
    """Where matching is sure of everything, the same error costs more beside a silhouette, but for what edges cost."""
    truth, away = disc_before_a_wall()
    sqrt_inv_depth = torch.from_numpy(np.sqrt(truth))[None, None]
    known = torch.ones_like(sqrt_inv_depth)

    def loss_with(wrong):
        sqrt_inv_depths = torch.where(torch.from_numpy(wrong), sqrt_inv_depth + 0.05, sqrt_inv_depth).repeat(1, 2, 1, 1)
        sure_of = torch.full_like(sqrt_inv_depth, 30.0)
        return float(
            completion_loss(
                CompletionPrediction(sqrt_inv_depths, sure_of, torch.zeros_like(sqrt_inv_depth)), sqrt_inv_depth, known
            )
        )

    right = loss_with(np.zeros(truth.shape, np.bool_))
    ring, wide = (away < 2.0), (away > 6.0) & (away < 8.0) & (truth < 0.5)
    beside, elsewhere = ((loss_with(each) - right) / each.sum() for each in (ring, wide))
    assert beside > 1.5 * elsewhere
    rolled, there = (losses._silhouette_mask(x) for x in (sqrt_inv_depth.roll(50, -1), sqrt_inv_depth))
    assert torch.equal(rolled, there.roll(50, -1))


def test_scores_are_perfect_at_the_truth_and_tell_the_filled_map_apart():
    batch = pair(1)
    certain = torch.full_like(batch.sqrt_inv_depth, 30.0)
    prediction = CompletionPrediction(batch.sqrt_inv_depth.repeat(1, 2, 1, 1), certain, certain)
    filled = batch.channels[:, FILLED_CHANNEL : FILLED_CHANNEL + 1]
    scores = completion_scores(prediction, filled, batch.sqrt_inv_depth, sure(batch))
    assert (scores["within_5"], scores["within_25"]) == (pytest.approx(1.0), pytest.approx(1.0))
    assert scores["error"] == pytest.approx(0.0, abs=1e-6)
    assert scores["error_filled"] > 0
    assert scores["confidence_error"] == pytest.approx(0.0, abs=1e-6)


def test_views_that_are_too_small_are_refused():
    with pytest.raises(InputError, match="at least 128 rows, got 64"):
        pair(0, size=(128, 256))


def test_batches_drawn_ahead_are_those_of_their_step(tmp_path):
    """A run that goes on draws what it would have drawn, and learns the same, bit for bit."""
    folder = make_pool(tmp_path)
    pool = list_scene_files(folder)
    config = TrainConfig(str(folder), str(folder), size=SIZE, batch=1)
    through, stopped = Trainer(TINY, config), Trainer(TINY, config)
    losses = [through.advance(pool) for _ in range(4)]
    again = [stopped.advance(pool) for _ in range(2)]
    resumed = Trainer(TINY, config)
    resumed.restore(stopped.state())
    again += [resumed.advance(pool) for _ in range(2)]
    assert losses == again
    for one, other in zip(through.network.parameters(), resumed.network.parameters(), strict=True):
        assert torch.equal(one, other)


def test_the_command_trains_judges_and_publishes(tmp_path):
    folder = make_pool(tmp_path / "pool")
    arguments = ["completion", tmp_path / "run", "--pool", folder, "--validation-pool", folder, "--height", 64]
    result = CliRunner().invoke(train, [str(x) for x in (*arguments, "--batch", 1, "--steps", 2)])
    assert result.exit_code == 0, result.output
    [(entry, difference)] = publish(tmp_path / "run" / "checkpoint.pt", tmp_path / "models", pool=folder)
    assert (entry.name, entry.role) == ("completion-balanced", "completion")
    assert difference < 1e-4
    wrong = CliRunner().invoke(train, [str(x) for x in (*arguments[:-1], 80)])
    assert "multiple of 32" in wrong.output
