import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from test_loop import equal
from training_samples import TINY, ball_scene, make_pool

from omnisyn_cli.errors import InputError
from omnisyn_cli.fusion import input_channels as channel
from omnisyn_cli.fusion.blend_rule import BlendRule, LayerArrays
from omnisyn_cli.fusion.fill import HoleFiller
from omnisyn_cli.fusion.input_channels import fusion_input_channels
from omnisyn_cli.fusion.layer_pair import LayerPair, LayerPairShader
from omnisyn_cli.fusion.residual import downsampled_pair
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.networks.fusion import FUSION_VARIANTS, FusionConfig, build_fusion
from omnisyn_cli.networks.paper import PAPER_VARIANTS, PaperPrediction
from omnisyn_cli.render.mesh import build_mesh
from omnisyn_cli.render.quad_blocks import CUT_EDGES
from omnisyn_cli.runtime.models import read_manifest
from omnisyn_cli.training import joint
from omnisyn_cli.training.checkpoint import compact, load_checkpoint, load_network, part_of, publish, save_checkpoint
from omnisyn_cli.training.data import list_scene_files, save_samples
from omnisyn_cli.training.loop import Trainer, train
from omnisyn_cli.training.losses import network_inputs
from omnisyn_cli.training.pairs import Triples, draw_pairs, swap_cameras
from omnisyn_cli.training.tasks import TrainConfig
from omnisyn_cli.types import Layer

PAINTING = FusionConfig("tiny", channels=8, widths=(8, 12, 16), is_direct=True)
JOINT = joint.JointConfig(TINY, PAINTING)
SIZE = (64, 128)


@pytest.fixture
def config(tmp_path):
    pool = str(make_pool(tmp_path / "pool"))
    return TrainConfig(
        pool, pool, size=SIZE, batch=1, warmup_steps=2, validate_every=4, save_every=2, validation_pairs=2
    )


def random_view(seed, position):
    """A rendering with holes, unreliable pixels, surfaces at any distance and some of them at infinity."""
    rng = np.random.default_rng(seed)
    colour, rho = rng.random((*SIZE, 4), np.float32), rng.random(SIZE, np.float32) ** 2
    rho[rng.random(SIZE) < 0.1] = 0.0
    hole = np.kron(rng.random((8, 16)) < 0.3, np.ones((8, 8), bool))
    colour[..., 3] = 0.01 + 0.99 * colour[..., 3]
    colour[hole], rho[hole] = 0.0, -1.0
    return Layer.from_arrays(rho, colour, Pose(np.eye(3), np.array(position, float)))


def as_seen(view):
    colour, offset = torch.from_numpy(view.colour), torch.from_numpy(view.target_from_source.position)
    return LayerArrays(colour[..., :3], colour[..., 3], torch.from_numpy(view.inverse_depth), offset.to(colour))


@pytest.mark.parametrize("t", [0.4, 0.93])
def test_planes_are_those_of_the_program(t):
    """Of tensors as of arrays, weights, confidence, filled holes and all."""
    first, second = random_view(1, (0.0, 0.0, t)), random_view(2, (0.0, 0.0, t - 1.0))
    rule = BlendRule.at(t)
    own, other = downsampled_pair(LayerPair(first, second), SIZE, LayerPairShader(SIZE, 1))

    def fill(image, weight):
        HoleFiller(SIZE, 1)(image, weight)
        return image

    expected = fusion_input_channels(own, other, rule, 1.0, fill)
    found = fusion_input_channels(as_seen(first), as_seen(second), rule, 1.0, joint.filled).numpy()
    names = (
        "FIRST_RGB", "SECOND_RGB", "FUSED_RGB", "BLEND_WEIGHTS", "SQRT_INVERSE_DEPTHS", "LOG_WEIGHT_RATIO", "DEPTH_GAP",
        "SEEN_MASKS", "RELEVANCE", "PATH_POSITION", "LATITUDE",
    )  # fmt: skip
    for name in names:
        which = slice(getattr(channel, name), getattr(channel, name) + 2)
        np.testing.assert_allclose(found[which], expected[which], atol=3e-3, err_msg=name)


def test_true_depth_shows_the_view_between(tmp_path):
    """Whichever end a way is walked from, mirrored or not: both renderings are the true picture."""
    pool = list_scene_files(make_pool(tmp_path, scenes=3))
    drawn = draw_pairs(Triples, pool, np.random.default_rng(0), 8, SIZE)
    second = swap_cameras(drawn.sqrt_inv_depths[1])
    rho = torch.stack([drawn.sqrt_inv_depths[0], second]).squeeze(2).square()
    textures = torch.stack([drawn.first_texture, drawn.second_texture])
    channels = joint.channels_between(rho, torch.ones_like(rho), textures, drawn.position)
    assert drawn.position.unique().numel() > 1
    for begin in (channel.FIRST_RGB, channel.SECOND_RGB, channel.FUSED_RGB):
        shown = channels[:, begin : begin + 3]
        error, moved = ((shown - x).abs().mean(dim=(1, 2, 3)) for x in (drawn.middle, drawn.middle.roll(4, -1)))
        assert (error < 0.02).all()
        assert (error < 0.4 * moved).all()


def test_the_gradient_of_the_loss_is_that_of_finite_differences(tmp_path):
    """Of the joint loss of a smooth scene without cuts, to the inverse depth of both panoramas, in any direction."""
    rng = np.random.default_rng(0)
    drawn = draw_pairs(Triples, list_scene_files(make_pool(tmp_path, scenes=1)), rng, 1, SIZE)
    drawn = replace(drawn, **{name: value.double() for name, value in vars(drawn).items()})
    own = torch.stack([drawn.sqrt_inv_depths[0], swap_cameras(drawn.sqrt_inv_depths[1])]).squeeze(2).square()
    rho = (1.05 * own).requires_grad_()
    for surface in rho.detach().numpy():
        assert not (build_mesh(surface[0]).quads & CUT_EDGES).any()
    torch.manual_seed(0)
    network = build_fusion(PAINTING).double()
    torch.nn.init.normal_(network.head.weight, std=0.02)
    textures = torch.stack([drawn.first_texture, drawn.second_texture])

    def loss(rho):
        channels = joint.channels_between(rho, torch.ones_like(rho), textures, drawn.position)
        stacked = torch.cat([rho[0], swap_cameras(rho[1])]).unsqueeze(1)
        prediction = joint.PairPrediction(PaperPrediction(stacked, stacked), rho, torch.ones_like(rho))
        return joint.joint_loss(
            joint.JointAnswer(prediction, channels, network(network_inputs(network.config, channels))), drawn
        )

    (gradient,) = torch.autograd.grad(loss(rho), rho)
    waves = torch.linspace(0, 2 * np.pi, SIZE[1] + 1, dtype=torch.float64)[:-1]
    shapes = [torch.ones(SIZE), torch.sin(waves).expand(SIZE), torch.cos(3 * waves).expand(SIZE), torch.randn(SIZE)]
    for view in range(2):
        for shape in shapes:
            direction = torch.zeros_like(own)
            direction[view, 0] = shape * own[view, 0]
            step = 1e-5
            with torch.no_grad():
                above, below = (loss(rho + s * direction) for s in (step, -step))
            expected = float(above - below) / (2 * step)
            assert float((gradient * direction).sum()) == pytest.approx(expected, rel=0.03, abs=3e-4)


def test_the_picture_alone_teaches_depth(tmp_path):
    """From a surface that is too far everywhere, the gradient of the picture's error leads to the true one."""
    drawn = draw_pairs(Triples, list_scene_files(make_pool(tmp_path, scenes=1)), np.random.default_rng(3), 1, SIZE)
    own = torch.stack([drawn.sqrt_inv_depths[0], swap_cameras(drawn.sqrt_inv_depths[1])]).squeeze(2).square()
    textures = torch.stack([drawn.first_texture, drawn.second_texture])
    scale = torch.tensor(0.9, requires_grad=True)
    optimizer = torch.optim.Adam([scale], lr=5e-3)
    for _ in range(60):
        channels = joint.channels_between(scale * own, torch.ones_like(own), textures, drawn.position)
        optimizer.zero_grad()
        (channels[:, channel.FUSED_RGB : channel.FUSED_RGB + 3] - drawn.middle).square().mean().backward()
        optimizer.step()
    assert scale.item() == pytest.approx(1.0, abs=0.03)


def test_both_networks_are_taught_by_both_losses(tmp_path):
    """The error of the picture alone reaches the weights of the depth network."""
    network = joint.JointNetwork(JOINT)
    drawn = draw_pairs(Triples, list_scene_files(make_pool(tmp_path)), np.random.default_rng(0), 1, SIZE)
    answer = joint.joint_answer(network, drawn)
    (answer.picture - drawn.middle).abs().mean().backward()
    for part in (network.depth, network.fusion):
        total = sum(float(p.grad.abs().sum()) for p in part.parameters() if p.grad is not None)
        assert np.isfinite(total)
        assert total > 0


def test_both_panoramas_are_estimated_in_one_frame():
    """Exchanging the cameras exchanges the answers."""
    torch.manual_seed(0)
    network = joint.JointNetwork(JOINT).eval()
    first, second = torch.rand(2, 1, 3, *SIZE)
    with torch.no_grad():
        there = network(first, second).inverse_depth
        back = network(swap_cameras(second), swap_cameras(first)).inverse_depth
    np.testing.assert_allclose(swap_cameras(back.flip(0)), there, atol=1e-5)


def test_a_stopped_run_goes_on_bit_for_bit(tmp_path, config):
    train(JOINT, config, tmp_path / "whole", steps=4)
    train(JOINT, config, tmp_path / "stopped", steps=2)
    train(JOINT, config, tmp_path / "stopped", steps=4)
    whole, stopped = (load_checkpoint(tmp_path / name / "checkpoint.pt") for name in ("whole", "stopped"))
    assert (whole["kind"], whole["step"]) == ("joint", 4)
    assert equal(whole, stopped)
    row = json.loads((tmp_path / "whole" / "log.jsonl").read_text().splitlines()[0])
    assert {"imae", "delta_25", "ws_psnr", "gain"} <= row.keys()
    assert (tmp_path / "whole" / "pictures" / "00000004.png").exists()
    assert load_network(tmp_path / "whole" / "checkpoint.pt")[0].config == JOINT


def test_both_networks_leave_as_files_of_their_own_and_can_begin_another_run(tmp_path, config):
    path = tmp_path / "run" / "checkpoint.pt"
    trainer = train(JOINT, config, tmp_path / "run", steps=1)
    published = publish(path, tmp_path / "models")
    assert [(entry.name, entry.role, entry.size) for entry, _ in published] == [
        ("depth-tiny", "depth", SIZE),
        ("fusion-tiny", "fusion", SIZE),
    ]
    assert all(difference < 1e-4 for _, difference in published)
    assert read_manifest(tmp_path / "models").keys() == {"depth-tiny", "fusion-tiny"}
    assert sum(entry.parameters for entry, _ in published) == sum(p.numel() for p in trainer.network.parameters())
    named = publish(path, tmp_path / "models", name="mine", pool=tmp_path / "pool")
    assert [entry.name for entry, _ in named] == ["mine-depth", "mine-fusion"]
    part = part_of(path, ("fusion",))
    assert equal(
        dict(part.state_dict()), {k.removeprefix("fusion."): v for k, v in trainer.average.items() if k[0] == "f"}
    )
    with pytest.raises(InputError, match=r"expected a completion network in .*got paper and fusion"):
        part_of(path, ("completion",))


def test_a_run_begins_with_the_checkpoints_it_is_given(tmp_path, monkeypatch, config, omnisyn):
    monkeypatch.setitem(PAPER_VARIANTS, "tiny", TINY)
    monkeypatch.setitem(FUSION_VARIANTS, "tiny", PAINTING)
    depth = train(TINY, config, tmp_path / "depth", steps=1)
    save_checkpoint(tmp_path / "small.pt", compact(depth.state()))
    words = ("--pool", config.pool, "--validation-pool", config.validation_pool, "--height", 64, "--rate", 0.0)
    words = ("--fusion", "tiny", "--steps", 1, *words)
    omnisyn.made("train", "joint", tmp_path / "run", *words, "--depth", tmp_path / "small.pt")
    begun = tmp_path / "run" / "checkpoint.pt"
    held = part_of(begun, ("paper",)).state_dict()
    for name, value in depth.average.items():
        torch.testing.assert_close(held[name], value, rtol=2e-3, atol=1e-4)
    omnisyn.made("train", "joint", tmp_path / "two", *words, "--depth", begun)
    assert equal(part_of(tmp_path / "two" / "checkpoint.pt", ("paper",)).state_dict(), held)


def test_what_cannot_begin_a_run_is_refused(tmp_path, config, omnisyn):
    words = ("train", "joint", tmp_path / "run", "--pool", config.pool, "--validation-pool", config.validation_pool)
    assert "expected a checkpoint or one of paper" in omnisyn.misused(*words, "--depth", "slow")
    assert "expected a network that paints" in omnisyn.misused(*words, "--fusion", "residual")
    assert "multiple of 64 for the joint network" in omnisyn.misused(*words, "--height", 100)
    train(TINY, config, tmp_path / "depth", steps=1)
    omnisyn.refused(*words, "--fusion", tmp_path / "depth" / "checkpoint.pt")
    with pytest.raises(ValueError, match="network has"):
        Trainer(JOINT, config).begin_with({"depth.none": torch.zeros(1)})


def test_pools_of_pairs_are_refused(tmp_path):
    save_samples(tmp_path / "00000000.npz", [ball_scene(along=(0.0, 1.0))])
    with pytest.raises(InputError, match="at least 3 views, got 2"):
        draw_pairs(Triples, list_scene_files(tmp_path), np.random.default_rng(0), 1, SIZE)


def test_triples_depend_on_the_seed_alone_and_light_is_the_same_for_all_views(tmp_path):
    from omnisyn_cli.training.data import Augmentation

    pool = list_scene_files(make_pool(tmp_path))
    plain = draw_pairs(Triples, pool, np.random.default_rng(5), 4, SIZE)
    one, same = (draw_pairs(Triples, pool, np.random.default_rng(5), 4, SIZE, Augmentation()) for _ in range(2))
    assert all(torch.equal(value, getattr(same, name)) for name, value in vars(one).items())
    assert torch.equal(plain.first, plain.first_texture)
    assert not torch.equal(one.first, one.first_texture)
    assert (one.position > 0).all()
    assert (one.position < 1).all()


@pytest.mark.slow
def test_one_pair_can_be_learned_by_heart(tmp_path):
    """Less than two minutes of one core: depth and picture of one scene, from random weights."""
    pool = str(make_pool(tmp_path / "pool", scenes=1))
    stage = TrainConfig(pool, pool, size=SIZE, batch=1, rate=3e-3, ema=0.9, validate_every=40, validation_pairs=4)
    rows = []
    train(JOINT, stage, tmp_path / "run", steps=320, report=rows.append)
    assert rows[-1]["delta_10"] > 0.85
    assert rows[-1]["ws_psnr"] > rows[0]["ws_psnr"] + 3
    assert rows[-1]["loss"] < 0.5 * rows[0]["loss"]
