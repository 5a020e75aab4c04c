from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.nn import functional
from training_samples import make_walks

from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.metrics import ws_psnr
from omnisyn_cli.fusion import input_channels as channel
from omnisyn_cli.fusion.blend_rule import BlendRule
from omnisyn_cli.fusion.input_channels import INPUT_CHANNELS
from omnisyn_cli.fusion.layer_pair import LayerPair, LayerPairShader
from omnisyn_cli.fusion.residual import InputBuilder, ResidualFuser
from omnisyn_cli.fusion.warp_candidates import CANDIDATE_CHANNELS, CANDIDATE_RGB, CANDIDATE_SCALE, HYPOTHESIS_DEPTHS
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.networks import fusion as networks
from omnisyn_cli.networks.fusion import FusionConfig, build_fusion
from omnisyn_cli.render.shade import Reprojector, Shader
from omnisyn_cli.render.texture import make_texture
from omnisyn_cli.runtime.models import read_manifest
from omnisyn_cli.training.checkpoint import load_network, publish
from omnisyn_cli.training.data import load_samples, load_walk, save_samples, stacked
from omnisyn_cli.training.fusion_scenes import (
    WINDOW_DIVISOR,
    FusionBatch,
    FusionSceneConfig,
    draw_fusion,
    make_fusion_scene,
    swap_views,
    window_columns,
)
from omnisyn_cli.training.loop import train
from omnisyn_cli.training.losses import fuse_with, fusion_loss, fusion_scores, mix_candidates
from omnisyn_cli.training.tasks import TrainConfig
from omnisyn_cli.types import Layer

TINY = FusionConfig("tiny", channels=INPUT_CHANNELS + CANDIDATE_CHANNELS, widths=(8, 12, 16), fine=6)
TINY_PAPER = FusionConfig("tiny-paper", channels=8, widths=(8, 12, 16), is_direct=True)
SIZE = (32, 64)


@pytest.fixture(scope="module")
def pool(tmp_path_factory):
    """Two scenes of two places each, matched at a small size."""
    folder = tmp_path_factory.mktemp("fusion")
    config = FusionSceneConfig(size=SIZE, views_between=2, matched_share=1.0, rows=2 * SIZE[0])
    paths = [make_fusion_scene(folder, seed, config) for seed in (0, 1)]
    return [path for path in paths if path is not None]


def rendering(seed, offset):
    """Blocks of what a panorama shows, wrong about most of it, that are the network's pixels."""
    rng = np.random.default_rng(seed)
    colour, rho = rng.random((*SIZE, 4), np.float32), rng.random(SIZE, np.float32) * 0.5
    hole = np.kron(rng.random((8, 16)) < 0.3, np.ones((4, 4), bool))
    colour[hole], rho[hole] = 0.0, -1.0
    colour, rho = (x.repeat(CANDIDATE_SCALE, 0).repeat(CANDIDATE_SCALE, 1) for x in (colour, rho))
    pose, texture = Pose(np.eye(3), np.array(offset, float)), make_texture(rng.random((16, 32, 3), np.float32))
    panorama = Reprojector(lambda: texture, rng.random((16, 32)), Shader(rho.shape, 1))
    return replace(Layer.from_arrays(rho, colour, pose), source_sampler=panorama.sampler(pose))


def test_the_network_learns_on_the_picture_that_the_program_makes():
    """But for candidates, which are read at the size of the frame."""
    shares = np.zeros((4, *SIZE), np.float32)
    views, pictures = (rendering(1, (0.1, 0, 0.5)), rendering(2, (0, 0.2, -0.5))), []

    def network(channels):
        pictures.append(channels)
        return shares

    fuser = ResidualFuser(views[0].inverse_depth.shape, network, threads=1, rows=SIZE[0])
    for share, most in ((0.0, 0.01), (0.2, 0.03)):
        shares[:] = np.float32(share)
        picture = fuser(*views, 0.4).reshape(SIZE[0], CANDIDATE_SCALE, SIZE[1], CANDIDATE_SCALE, 3).mean(axis=(1, 3))
        batch = torch.from_numpy(pictures[-1])[None]
        chosen = torch.cat(
            [batch[:, channel.FUSED_RGB : channel.FUSED_RGB + 3], batch[:, CANDIDATE_RGB:HYPOTHESIS_DEPTHS]], dim=1
        )
        expected = mix_candidates(chosen, torch.from_numpy(shares)[None])[0].permute(1, 2, 0).numpy()
        hole = pictures[-1][channel.SEEN_MASKS : channel.SEEN_MASKS + 2].sum(axis=0) == 0
        difference = np.abs(picture - np.maximum(expected, 0))
        assert np.median(difference[~hole]) < 0.1 * most, share
        assert np.quantile(difference[~hole], 0.99) < most, share
        # holes are filled from what is around them, which the program corrects first
        assert difference[hole].max() < 0.3
        assert hole.any()


def test_the_network_knows_where_the_weights_are():
    """Networks and fusion do not know each other, so the place of the plane is written down twice."""
    assert slice(channel.SEEN_MASKS, channel.SEEN_MASKS + 2) == networks.SEEN_SLICE
    assert networks.RELEVANCE_CHANNEL == channel.RELEVANCE
    assert slice(HYPOTHESIS_DEPTHS, HYPOTHESIS_DEPTHS + 2) == networks.HYPOTHESIS_SLICE
    assert networks.FUSION_VARIANTS["residual"].channels == INPUT_CHANNELS + CANDIDATE_CHANNELS


def test_exchanging_the_views_exchanges_the_planes():
    first, second = rendering(1, (0.1, 0, 0.5)), rendering(2, (0, 0.2, -0.5))
    make = InputBuilder(SIZE, LayerPairShader(first.inverse_depth.shape, 1))
    source_samplers = first.source_sampler, second.source_sampler
    there = make(LayerPair(first, second), BlendRule.at(0.3), source_samplers)[0]
    back = make(LayerPair(second, first), BlendRule.at(0.7), source_samplers[::-1])[0]
    np.testing.assert_allclose(swap_views(there), back, atol=1e-4)
    np.testing.assert_array_equal(swap_views(swap_views(there)), there)


def test_samples_hold_what_the_program_sees_and_the_truth(pool):
    assert pool
    for path in pool:
        samples = load_samples(path, FusionBatch)
        assert len(samples) == 2
        for sample in samples:
            assert sample.channels.shape == (INPUT_CHANNELS + CANDIDATE_CHANNELS, *SIZE)
            assert sample.truth.shape == (3, 2 * SIZE[0], 2 * SIZE[1])
            assert sample.pictures.shape == (15, 2 * SIZE[0], 2 * SIZE[1])
            assert 0.1 <= (sample.channels[channel.PATH_POSITION].mean() + 1) / 2 <= 0.9
            assert np.isfinite(sample.channels).all()
            fused, roll = sample.pictures[:3], SIZE[1]
            assert np.abs(fused - sample.truth).mean() < 0.5 * np.abs(np.roll(fused, roll, -1) - sample.truth).mean()
            decibels = ws_psnr(*(x.transpose(1, 2, 0) for x in (fused, sample.truth)))
            assert -10 * np.log10(float(sample.fused_error)) == pytest.approx(decibels, abs=0.01)
            small = sample.pictures.reshape(15, SIZE[0], 2, SIZE[1], 2).mean(axis=(2, 4))
            held = [*range(channel.FUSED_RGB, channel.FUSED_RGB + 3), *range(CANDIDATE_RGB, HYPOTHESIS_DEPTHS)]
            assert np.median(np.abs(small - sample.channels[held])) < 0.02, "pictures are what the planes show, finer"
        np.testing.assert_array_equal(load_samples(path, FusionBatch, 3)[0].truth, samples[1].truth)


def test_a_place_is_seen_at_both_sizes_that_presets_look_at(tmp_path):
    size = (128, 256)
    config = FusionSceneConfig(size=size, views_between=1, matched_share=1.0, rows=size[0])
    samples = load_samples(make_fusion_scene(tmp_path, 1, config), FusionBatch)
    small, large = ([s for s in samples if s.channels.shape[1:] == each] for each in ((64, 128), size))
    assert len(small) == len(large) == 1
    for sample in small:
        assert sample.pictures.shape == (15, 256, 512)
        assert any(np.array_equal(one.truth, sample.truth) for one in large)


def test_networks_that_paint_frames_see_one_size(tmp_path, monkeypatch):
    monkeypatch.setattr("omnisyn_cli.training.fusion_scenes.MIN_HALVED_ROWS", 64)
    config = FusionSceneConfig(size=(64, 128), views_between=1, preset="paper", matched_share=0.0, known_share=0.0)
    (sample,) = load_samples(make_fusion_scene(tmp_path, 1, config), FusionBatch)
    assert sample.channels.shape[1:] == (64, 128)


def test_walks_are_shown_with_their_own_views_as_the_truth(tmp_path):
    """The wall of a ball that both ends see: its views between are like the fusion, and are the walk's."""
    positions = ((0, 0, 0), (0.1, 0, 0.2), (0.3, 0, 0.6), (0.4, 0, 0.8))
    make_walks(tmp_path / "walks", 2, size=(128, 256), positions=positions)
    walks = tuple(sorted((tmp_path / "walks").iterdir()))
    config = FusionSceneConfig(size=SIZE, matched_share=1.0, rows=2 * SIZE[0], walks=walks)
    samples = load_samples(make_fusion_scene(tmp_path, 3, config), FusionBatch)
    walk = load_walk(walks[1])
    shares = sorted((float(s.channels[channel.PATH_POSITION].mean() + 1) / 2, k) for k, s in enumerate(samples))
    assert [share for share, _ in shares] == pytest.approx([0.25, 0.75], abs=0.01)
    for image, (_, k) in zip(walk.images[1:3], shares, strict=True):
        seen = image.reshape(2 * SIZE[0], 2, 2 * SIZE[1], 2, 3).mean(axis=(1, 3)).transpose(2, 0, 1) / 255
        np.testing.assert_allclose(samples[k].truth, seen, atol=2e-3)
        assert np.abs(samples[k].pictures[:3] - seen).mean() < 0.01


def test_walks_of_another_size_are_refused(tmp_path):
    walks = tuple(make_walks(tmp_path / "walks", 1).iterdir())
    with pytest.raises(InputError, match="expected pictures of 256×128, got 128×64"):
        make_fusion_scene(tmp_path, 0, FusionSceneConfig(size=SIZE, walks=walks))


def test_scenes_of_several_sizes_share_a_pool(pool, tmp_path):
    """Steps are of one size each; a network of some rows is shown pictures of different ones."""
    small = load_samples(pool[0], FusionBatch)[0]
    coarse = replace(small, pictures=small.pictures[:, ::2, ::2], truth=small.truth[:, ::2, ::2])
    save_samples(tmp_path / "coarse.npz", [coarse])
    rows = {
        draw_fusion([*pool, tmp_path / "coarse.npz"], np.random.default_rng(k), 3).truth.shape[-2] for k in range(9)
    }
    assert rows == {SIZE[0], 2 * SIZE[0]}


def test_a_scene_is_the_same_for_the_same_seed(pool, tmp_path):
    config = FusionSceneConfig(size=SIZE, views_between=2, matched_share=1.0, rows=2 * SIZE[0])
    again = make_fusion_scene(tmp_path, int(pool[0].stem), config)
    for one, other in zip(load_samples(pool[0], FusionBatch), load_samples(again, FusionBatch), strict=True):
        np.testing.assert_array_equal(one.channels, other.channels)


def test_a_batch_is_the_same_for_the_same_seed_and_variations_keep_the_geometric_picture(pool):
    """Recoloured, mirrored, turned and exchanged planes still hold the blend of their own renderings."""
    one, same = (draw_fusion(pool, np.random.default_rng(3), 6) for _ in range(2))
    assert torch.equal(one.channels, same.channels)
    assert torch.equal(one.truth, same.truth)
    seen = one.channels[:, channel.SEEN_MASKS : channel.SEEN_MASKS + 2]
    share = torch.sigmoid(
        channel.MAX_LOG_RATIO * one.channels[:, channel.LOG_WEIGHT_RATIO : channel.LOG_WEIGHT_RATIO + 1]
    )
    first, second = (one.channels[:, k : k + 3] for k in (channel.FIRST_RGB, channel.SECOND_RGB))
    blend = share * first + (1 - share) * second
    both = (seen.prod(dim=1, keepdim=True) > 0) & ((share - 0.5).abs() < 0.499)
    difference = (blend - one.channels[:, channel.FUSED_RGB : channel.FUSED_RGB + 3]).abs()
    assert difference[both.expand_as(blend)].max() < 0.01
    fused = one.channels[:, channel.FUSED_RGB : channel.FUSED_RGB + 3]
    assert fused.shape == (6, 3, SIZE[0], SIZE[1] // WINDOW_DIVISOR)
    chosen = one.channels[
        :, [*range(channel.FUSED_RGB, channel.FUSED_RGB + 3), *range(CANDIDATE_RGB, HYPOTHESIS_DEPTHS)]
    ]
    assert (functional.avg_pool2d(one.pictures, 2) - chosen).abs().median() < 0.02
    own, others = (
        (one.pictures[:, :3] - one.truth).abs().mean(),
        (one.pictures[:, :3] - one.truth.roll(1, 0)).abs().mean(),
    )
    assert own < 0.7 * others


def test_windows_lie_where_the_views_contradict_each_other():
    """All that matters being in one column, almost all windows hold it; where nothing does, they lie anywhere."""
    relevance = np.zeros(SIZE, np.float32)
    relevance[10:20, 2] = 1.0
    rng = np.random.default_rng(0)
    begins = np.array([window_columns(relevance, rng)[0] for _ in range(200)])
    assert ((2 - begins) % SIZE[1] < SIZE[1] // WINDOW_DIVISOR).mean() > 0.95
    assert len(np.unique([window_columns(np.zeros(SIZE, np.float32), rng)[0] for _ in range(200)])) > 50


def test_the_loss_is_least_for_the_truth_and_counts_half_by_solid_angle():
    truth = torch.rand((1, 3, *SIZE), generator=torch.Generator().manual_seed(0))
    assert float(fusion_loss(truth, truth)) == 0.0
    at_pole, at_equator = truth.clone(), truth.clone()
    at_pole[..., 0, :] += 0.1
    at_equator[..., 16, :] += 0.1
    ratio = float(fusion_loss(at_equator, truth) / fusion_loss(at_pole, truth))
    sines = np.sin((np.arange(32) + 0.5) / 32 * np.pi)
    by_half = 0.5 + 0.5 * sines / sines.mean()
    assert ratio == pytest.approx(by_half[16] / by_half[0], rel=1e-3)
    for fused_error in (0.01, 0.001):
        wanted = 0.5 * 0.25 + 0.02 / (fused_error + 1e-4) * 0.25**2
        assert float(fusion_loss(truth + 0.25, truth, torch.tensor([fused_error]))) == pytest.approx(wanted, rel=1e-4)
    assert fusion_loss(truth + 0.25, truth) == fusion_loss(truth + 0.25, truth, torch.tensor([5e-3]))


def test_scores_are_those_of_the_metrics():
    channels = torch.rand((1, INPUT_CHANNELS + CANDIDATE_CHANNELS, *SIZE), generator=torch.Generator().manual_seed(0))
    channels[:, channel.SEEN_MASKS : channel.SEEN_MASKS + 2] = (
        channels[:, channel.SEEN_MASKS : channel.SEEN_MASKS + 2] > 0.5
    ).float()
    truth, geometric = torch.rand((2, 1, 3, *SIZE), generator=torch.Generator().manual_seed(1))
    picture = 0.9 * truth + 0.05
    finer = [image.repeat_interleave(2, -1).repeat_interleave(2, -2) for image in (truth, geometric)]
    scores = fusion_scores(picture, channels, *finer)
    arrays = [x[0].permute(1, 2, 0).numpy() for x in (picture, truth, geometric)]
    assert scores["ws_psnr"] == pytest.approx(ws_psnr(arrays[0], arrays[1]), abs=1e-3)
    assert scores["gain"] == pytest.approx(scores["ws_psnr"] - ws_psnr(arrays[2], arrays[1]), abs=1e-3)
    hole = channels[0, channel.SEEN_MASKS : channel.SEEN_MASKS + 2].sum(dim=0).numpy() == 0
    error = [np.abs(image - arrays[1])[hole].mean() for image in (arrays[0], arrays[2])]
    assert scores["hole_error"] == pytest.approx(error[0], rel=1e-4)
    assert scores["hole_gain"] == pytest.approx(error[1] - error[0], rel=1e-4)


def test_a_fresh_network_scores_nearly_as_the_geometric_fusion(pool):
    stored = stacked(load_samples(pool[0], FusionBatch, 0))
    torch.manual_seed(0)
    with torch.no_grad():
        picture = fuse_with(build_fusion(TINY), stored.channels, stored.pictures)
        scores = fusion_scores(picture, stored.channels, stored.truth, stored.pictures[:, :3])
    assert abs(scores["gain"]) < 0.3


@pytest.mark.parametrize("config", [TINY, TINY_PAPER], ids=lambda config: config.name)
def test_a_network_is_trained_and_published(tmp_path, pool, config):
    folder = str(pool[0].parent)
    stage = TrainConfig(
        folder, folder, size=SIZE, batch=4, rate=1.5e-3, warmup_steps=5, validate_every=20, validation_pairs=4, ema=0.8
    )
    rows = []
    train(config, stage, tmp_path / "run", steps=60, report=rows.append)
    assert rows[-1]["ws_psnr"] > rows[0]["ws_psnr"]
    if config is TINY:
        assert rows[-1]["gain"] > 0
    network, state = load_network(tmp_path / "run" / "checkpoint.pt")
    assert (state["kind"], state["step"], network.config) == ("fusion", 60, config)
    ((entry, difference),) = publish(tmp_path / "run" / "checkpoint.pt", tmp_path / "models", pool=pool[0].parent)
    assert difference < 1e-4
    assert (entry.role, entry.size) == ("fusion", SIZE)
    assert read_manifest(tmp_path / "models") == {f"fusion-{config.name}": entry}


def test_scenes_are_made_with_the_depth_and_the_renderer_of_a_preset(pool, tmp_path):
    """The paper's leaves more open than matching does: its surfaces end where depth steps by two metres."""
    config = FusionSceneConfig(size=SIZE, views_between=2, preset="paper", matched_share=0.0, known_share=0.0)
    made = make_fusion_scene(tmp_path, int(pool[0].stem), config)
    for one, other in zip(load_samples(pool[0], FusionBatch), load_samples(made, FusionBatch), strict=True):
        np.testing.assert_array_equal(one.truth, other.truth)
        assert np.abs(one.channels - other.channels)[channel.SQRT_INVERSE_DEPTHS].mean() > 0.01
