from unittest.mock import Mock

import numpy as np
import pytest
import torch

from omnisyn_cli.errors import InputError
from omnisyn_cli.networks.completion import (
    CONSISTENT_CHANNEL,
    FILLED_CHANNEL,
    SKY_CHANNEL,
    CompletionConfig,
    CompletionPrediction,
)
from omnisyn_cli.runtime.models import read_manifest
from omnisyn_cli.stereo.stereo_features import COMPLETION_CHANNEL_COUNT
from omnisyn_cli.training import losses
from omnisyn_cli.training.checkpoint import load_network, publish
from omnisyn_cli.training.completion import FeatureBatch, draw_completion, make_feature_scene
from omnisyn_cli.training.data import list_scene_files, load_samples
from omnisyn_cli.training.loop import train
from omnisyn_cli.training.losses import completion_loss, completion_scores
from omnisyn_cli.training.scene_makers import SceneConfig
from omnisyn_cli.training.tasks import TrainConfig

TINY = CompletionConfig(
    "tiny", channels=COMPLETION_CHANNEL_COUNT, widths=(8, 12, 16), fine=6, heads=2, attention_layers=1
)
SIZE = (32, 64)


@pytest.fixture(scope="module")
def pool(tmp_path_factory):
    folder = tmp_path_factory.mktemp("evidence")
    paths = [make_feature_scene(folder, seed, SceneConfig(size=SIZE)) for seed in range(4)]
    return [path for path in paths if path is not None]


def test_the_pairs_of_a_scene_hold_true_depth_beside_the_evidence(pool):
    """What both directions agree on is far nearer to the truth there than to that half a turn away."""
    own, elsewhere = [], []
    for path in pool:
        for pair in load_samples(path, FeatureBatch):
            assert pair.channels.shape == (COMPLETION_CHANNEL_COUNT, *SIZE)
            assert pair.sqrt_inv_depth.shape == (1, *SIZE)
            assert pair.baseline > 0.05
            assert np.isfinite(pair.channels).all()
            left_right_consistent = (pair.channels[5] > 0) & (pair.channels[6] == 0)
            for truth, errors in (
                (pair.sqrt_inv_depth, own),
                (np.roll(pair.sqrt_inv_depth, SIZE[0], axis=2), elsewhere),
            ):
                errors.extend(np.abs(pair.channels[3] - truth[0])[left_right_consistent])
        assert load_samples(path, FeatureBatch, 2)[0].baseline == load_samples(path, FeatureBatch)[2].baseline
    assert np.mean(own) < 0.7 * np.mean(elsewhere), (np.mean(own), np.mean(elsewhere))


@pytest.mark.parametrize("augment", [False, True])
@pytest.mark.parametrize("size", [SIZE, (SIZE[0] // 2, SIZE[1] // 2)])
def test_a_pair_is_the_same_for_the_same_seed_and_moves_planes_with_the_truth(pool, size, augment):
    one, same = (draw_completion(pool[:1], np.random.default_rng(3), 1, size, augment=augment) for _ in range(2))
    assert torch.equal(one.channels, same.channels)
    assert one.channels.shape == (2, COMPLETION_CHANNEL_COUNT, *size)
    assert one.sqrt_inv_depth.shape == (2, 1, *size)
    colours = sorted(float(pair.channels[:3].mean()) for path in pool for pair in load_samples(path, FeatureBatch))
    drawn = [min(abs(float(channels[:3].mean()) - colour) for colour in colours) for channels in one.channels]
    assert (max(drawn) > 1e-3) == augment
    stored = [
        (part, nearest)
        for path in pool
        for pair in load_samples(path, FeatureBatch)
        for part, nearest in (halves(pair) if size != SIZE else [(pair.channels[3], pair.sqrt_inv_depth[0])])
    ]
    for channels, sqrt_inv_depth in zip(one.channels.numpy(), one.sqrt_inv_depth.numpy(), strict=True):
        shown = [
            (np.roll(part[:, ::flip], turn, axis=1), np.roll(nearest[:, ::flip], turn, axis=1))
            for part, nearest in stored
            for flip in (1, -1)
            for turn in range(size[1])
        ]
        assert any(
            np.array_equal(channels[3], part) and np.array_equal(sqrt_inv_depth[0], nearest) for part, nearest in shown
        )


def halves(pair):
    """Every second pixel of the filled roots, and of the true ones, in four ways."""
    return [
        (pair.channels[3, row::2, col::2], pair.sqrt_inv_depth[0, row::2, col::2]) for row in (0, 1) for col in (0, 1)
    ]


def test_evidence_of_another_size_is_refused(pool):
    with pytest.raises(InputError, match=r"expected evidence of 64 or 128 rows in .*, got 32; choose another --height"):
        draw_completion(pool[:1], np.random.default_rng(0), 1, (64, 128), augment=False)


def test_a_network_is_trained_and_published(tmp_path, pool):
    folder = str(pool[0].parent)
    config = TrainConfig(folder, folder, size=SIZE, batch=4, rate=4e-3, validate_every=40, validation_pairs=4, ema=0.8)
    rows = []
    train(TINY, config, tmp_path / "run", steps=80, report=rows.append)
    assert rows[-1]["loss"] < rows[0]["loss"]
    network, state = load_network(tmp_path / "run" / "checkpoint.pt")
    assert (state["kind"], state["step"], network.config) == ("completion", 80, TINY)
    ((entry, difference),) = publish(tmp_path / "run" / "checkpoint.pt", tmp_path / "models", pool=pool[0].parent)
    assert difference < 1e-4
    assert (entry.role, entry.size) == ("completion", SIZE)
    assert read_manifest(tmp_path / "models") == {"completion-tiny": entry}


@pytest.fixture
def checkpoint(tmp_path, pool):
    folder = str(pool[0].parent)
    train(TINY, TrainConfig(folder, folder, size=SIZE, batch=1), tmp_path / "run", steps=1)
    return tmp_path / "run" / "checkpoint.pt"


def test_names_that_are_paths_are_refused_and_nothing_half_made_stays(tmp_path, checkpoint, monkeypatch):
    models = tmp_path / "models"
    with pytest.raises(InputError, match=r"name without folders, got 'a/b'; choose another \(--name\)"):
        publish(checkpoint, models, name="a/b")

    monkeypatch.setattr("omnisyn_cli.training.checkpoint.largest_difference", Mock(side_effect=KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        publish(checkpoint, models)
    assert list(models.iterdir()) == []


def test_a_compact_checkpoint_replaces_others_on_request_and_never_the_whole_one(tmp_path, checkpoint, omnisyn):
    small, words = tmp_path / "small.pt", ("train", "compact", checkpoint, "-o")
    small.write_bytes(b"mine")
    omnisyn.refused(*words, small)
    omnisyn.refused(*words, checkpoint, "--overwrite")
    omnisyn.made(*words, small, "--overwrite")
    assert small.stat().st_size > len(b"mine")


def test_scenes_for_another_network_are_refused(tmp_path, pool):
    folder = str(pool[0].parent)
    with pytest.raises(InputError, match="made by `omnisyn train fusion-pool`"):
        list_scene_files(pool[0].parent, "fusion-pool")
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "00000000.npz").write_bytes(b"PK")
    for validation in (tmp_path, tmp_path / "broken"):
        with pytest.raises(InputError, match="expected a"):
            train(TINY, TrainConfig(folder, str(validation), size=SIZE, batch=1), tmp_path / "run", steps=1)
    assert not (tmp_path / "run" / "checkpoint.pt").exists()


def disc_before_a_wall(size=(64, 128)):
    """Inverse depth: a disc of 8 pixels at 1 before a wall at a tenth, across the seam; how far silhouettes are."""
    row, col = np.mgrid[: size[0], : size[1]]
    away = np.hypot(row - size[0] // 2, (col + size[1] // 2) % size[1] - size[1] // 2) - 8.0
    return np.where(away < 0, 1.0, 0.1).astype(np.float32), np.abs(away)


def sure(batch):
    return torch.maximum(batch.channels[:, CONSISTENT_CHANNEL], batch.channels[:, SKY_CHANNEL])[:, None]


def matched():
    """A disc before a wall, half of which is matched, with a filled map that is off."""
    root = torch.from_numpy(np.sqrt(disc_before_a_wall()[0])).float()[None, None]
    channels = torch.zeros(1, COMPLETION_CHANNEL_COUNT, *root.shape[-2:])
    channels[:, CONSISTENT_CHANNEL, :, ::2] = 1.0
    channels[:, FILLED_CHANNEL] = root[0] + 0.1
    return FeatureBatch(channels, root, torch.ones(1))


def test_the_loss_is_least_at_the_truth_and_has_finite_gradients():
    batch = matched()
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
    batch = matched()
    certain = torch.full_like(batch.sqrt_inv_depth, 30.0)
    prediction = CompletionPrediction(batch.sqrt_inv_depth.repeat(1, 2, 1, 1), certain, certain)
    scores = completion_scores(prediction, batch.channels, batch.sqrt_inv_depth)
    assert (scores["within_5"], scores["within_25"]) == (pytest.approx(1.0), pytest.approx(1.0))
    assert scores["error"] == pytest.approx(0.0, abs=1e-6)
    assert scores["error_filled"] > 0
    assert scores["confidence_error"] == pytest.approx(0.0, abs=1e-6)


def test_the_command_refuses_other_heights(tmp_path, pool, omnisyn):
    words = ("train", "completion", tmp_path / "run", "--pool", pool[0].parent, "--validation-pool", pool[0].parent)
    assert "multiple of 32" in omnisyn.misused(*words, "--height", 80)
