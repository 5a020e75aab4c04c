"""SynSin's samples, losses and runs, on a scene in closed form."""

import dataclasses

import numpy as np
import pytest
import torch
from training_samples import ball_walk, make_pool

from omnisyn_cli.evaluation.metrics import ws_psnr
from omnisyn_cli.networks.synsin import SynSinConfig
from omnisyn_cli.training.checkpoint import load_checkpoint
from omnisyn_cli.training.data import list_scene_files
from omnisyn_cli.training.loop import train
from omnisyn_cli.training.synsin import ViewSample, draw_views, splat_torch, view_sample
from omnisyn_cli.training.tasks import TrainConfig

TINY = SynSinConfig("tiny", (32, 64), features=6, depth_widths=(6, 8), decoder_widths=(6, 8, 8), fine=4)


@pytest.fixture
def config(tmp_path):
    pool = str(make_pool(tmp_path / "pool"))
    return TrainConfig(
        pool, pool, size=(32, 64), batch=2, warmup_steps=2, validate_every=4, save_every=2, validation_pairs=2
    )


def seen_from_target(sample: ViewSample) -> torch.Tensor:
    """The points of a sample with their true depth, as the target sees them; colours and opacity."""
    depths = list(sample.sqrt_inv_depths[:, 0].square())
    return splat_torch(list(sample.images), depths, sample.target_from_sources, (64, 128), radius=1.5)


@pytest.mark.parametrize("last", [(0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (0.6, 0.3, -0.8)], ids=["level", "lift", "slope"])
@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_the_points_of_a_sample_are_where_its_truth_shows_them(last, heading):
    """With the true depth; a mirrored axis, a swapped sign or a forgotten turn would move them aside."""
    positions = np.outer((0.0, 0.4, 1.0), last)
    sample = view_sample(ball_walk(3, (128, 256), positions=positions), 1, (0, 2), (64, 128), heading=heading)
    truth = sample.truth.permute(1, 2, 0).numpy()
    shown = seen_from_target(sample)
    right = ws_psnr((shown[:3] / shown[3:]).permute(1, 2, 0).numpy(), truth)
    reversed_way = tuple(dataclasses.replace(pose, position=-pose.position) for pose in sample.target_from_sources)
    wrong = seen_from_target(dataclasses.replace(sample, target_from_sources=reversed_way))
    assert right > 26
    assert right > ws_psnr((wrong[:3] / wrong[3:]).permute(1, 2, 0).numpy(), truth) + 3


def test_samples_drawn_at_random_stay_consistent_when_mirrored_and_turned(tmp_path):
    pool = list_scene_files(make_pool(tmp_path, size=(128, 256)))
    samples = draw_views(pool, np.random.default_rng(0), 12, (64, 128))
    assert [len(sample.images) for sample in samples] == [1, 2] * 6
    for sample in samples:
        shown = seen_from_target(sample)
        assert (shown[:3] / shown[3:] - sample.truth).abs().mean() < 0.05


def test_a_run_logs_figures_and_shows_pictures(tmp_path, config):
    rows = []
    train(TINY, config, tmp_path / "run", steps=4, report=rows.append)
    assert {"ws_psnr_one_view", "ws_psnr_two_views", "imae", "delta_25"} < rows[0].keys()
    assert 3 < rows[0]["ws_psnr_two_views"] < 60
    assert (tmp_path / "run" / "pictures" / "00000004.png").is_file()


def test_the_command_trains_and_refuses_sizes_that_do_not_fit(tmp_path, config, omnisyn):
    words = ("train", "synsin", tmp_path / "run", "--pool", config.pool, "--validation-pool", config.pool, "--height")
    assert "multiple of 32" in omnisyn.misused(*words, 40)
    omnisyn.made(*words, 32, "--steps", 1, "--threads", 1)
    assert load_checkpoint(tmp_path / "run" / "checkpoint.pt")["training"]["size"] == (32, 64)


def test_scenes_of_two_views_can_be_learned_from_and_judged_by(tmp_path):
    pool = str(make_pool(tmp_path / "pool", along=(0.0, 1.0)))
    two = TrainConfig(pool, pool, size=(32, 64), batch=2, validate_every=1, validation_pairs=2)
    rows = []
    train(TINY, two, tmp_path / "run", steps=1, report=rows.append)
    assert rows[0]["ws_psnr_one_view"] == pytest.approx(rows[0]["ws_psnr_two_views"])
