"""Layers without a seam, configurations, networks as files; and the network of guided depth."""

import numpy as np
import onnx
import pytest
import torch
from torch.nn import functional

from depth_samples import TINY
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import direction_to_angles, pixel_directions
from omnisyn_cli.geometry.sweep import sweep_directions
from omnisyn_cli.networks.efficientnet import CHANNELS, EfficientNetLite0
from omnisyn_cli.networks.export import OPSET, PARITY, export_network, largest_difference
from omnisyn_cli.networks.fusion import FUSION_VARIANTS
from omnisyn_cli.networks.guided_depth import (
    FEATURE_SHIFT,
    GUIDED_DEPTH_VARIANTS,
    GuidedDepthConfig,
    GuidedDepthNetwork,
    GuidedDepthPrediction,
    convex_upsample,
    correlate,
    correlate_gathered,
    feature_directions,
    sweep_grid,
)
from omnisyn_cli.networks.layers import ResidualBlock, WrappedConv, initialise, wrap_columns
from omnisyn_cli.networks.paper import PAPER_VARIANTS, PaperNetwork
from omnisyn_cli.networks.synsin import SYNSIN_VARIANTS


@pytest.fixture(autouse=True)
def _seeded():
    torch.manual_seed(0)


def test_wrapped_columns_are_those_of_numpy():
    x = torch.rand(2, 3, 4, 8)
    expected = np.pad(x.numpy(), ((0, 0), (0, 0), (0, 0), (2, 3)), mode="wrap")
    np.testing.assert_array_equal(wrap_columns(x, 2, 3).numpy(), expected)
    assert wrap_columns(x, 0, 0) is x


def test_a_convolution_does_not_know_where_the_seam_is():
    x = torch.rand(1, 3, 8, 16)
    block = ResidualBlock(3, 5)
    torch.testing.assert_close(block(x.roll(5, -1)), block(x).roll(5, -1))


def test_a_strided_convolution_commutes_with_rolls_by_its_stride():
    x, convolution = torch.rand(1, 3, 8, 16), WrappedConv(3, 5, (2, 2))
    assert convolution(x).shape == (1, 5, 4, 8)
    torch.testing.assert_close(convolution(x.roll(6, -1)), convolution(x).roll(3, -1))


def test_beyond_the_poles_a_convolution_sees_zeros():
    convolution = WrappedConv(1, 1)
    torch.nn.init.ones_(convolution.weight)
    torch.nn.init.zeros_(convolution.bias)
    rows = convolution(torch.ones(1, 1, 3, 8))[0, 0, :, 0]
    torch.testing.assert_close(rows, torch.tensor([6.0, 9.0, 6.0]))


def test_initialisation_keeps_the_size_of_signals():
    block = torch.nn.Sequential(*(ResidualBlock(32, 32) for _ in range(6)))
    initialise(block)
    expand = block(torch.randn(1, 32, 16, 32)).std()
    assert 0.3 < expand < 30


CONFIGURATIONS = [*PAPER_VARIANTS.values(), TINY, *FUSION_VARIANTS.values(), SYNSIN_VARIANTS["small"]]


@pytest.mark.parametrize("config", CONFIGURATIONS, ids=lambda config: config.name)
def test_configurations_survive_as_plain_values(config):
    """As a checkpoint has them, with lists for tuples; what it does not know is an error."""
    plain = {key: list(value) if isinstance(value, tuple) else value for key, value in config.as_dict().items()}
    assert type(config).from_dict(plain) == config
    with pytest.raises(TypeError, match="surprise"):
        type(config).from_dict({**plain, "surprise": 1})


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    torch.manual_seed(0)
    network = PaperNetwork(TINY).eval()
    torch.nn.init.constant_(network.high_head[-1].second.bias, 0.5)
    path = tmp_path_factory.mktemp("models") / "tiny.onnx"
    export_network(network, path)
    return network, path


def test_a_difference_is_noticed(exported):
    _, path = exported
    other = PaperNetwork(TINY).eval()
    pairs = np.random.default_rng(0).random((1, 2, 1, 3, 64, 128), dtype=np.float32)
    assert largest_difference(other, path, map(tuple, pairs)) > PARITY


def test_one_file_holds_everything_and_no_pad_wraps(exported):
    _, path = exported
    model = onnx.load(path)
    assert [path.name for path in path.parent.iterdir()] == ["tiny.onnx"]
    assert [opset.version for opset in model.opset_import] == [OPSET]
    modes = [a.s for node in model.graph.node if node.op_type == "Pad" for a in node.attribute if a.name == "mode"]
    assert b"wrap" not in modes
    assert [entry.name for entry in model.graph.input] == ["first", "second"]
    assert [entry.name for entry in model.graph.output] == ["inverse_depth", "confidence"]


def test_weights_that_are_halves_are_kept_as_halves_and_say_the_same(exported, tmp_path):
    network, whole = exported
    halved = PaperNetwork(TINY).eval()
    halved.load_state_dict({name: tensor.half().float() for name, tensor in network.state_dict().items()})
    export_network(halved, tmp_path / "half.onnx")
    kinds = [[one.data_type for one in onnx.load(file).graph.initializer] for file in (whole, tmp_path / "half.onnx")]
    assert [onnx.TensorProto.FLOAT16 in kind for kind in kinds] == [False, True]
    assert (tmp_path / "half.onnx").stat().st_size < whole.stat().st_size
    pairs = np.random.default_rng(0).random((2, 2, 1, 3, 64, 128), dtype=np.float32)
    assert largest_difference(halved, tmp_path / "half.onnx", map(tuple, pairs)) < PARITY


SMALL = GuidedDepthConfig("small", size=(64, 128), spheres=8, features=8, groups=2, widths=(8, 16, 16, 24, 24))


def inputs(batch=1, height=64, towards=(0.0, 0.1, -0.995)):
    direction = torch.tensor(towards).view(1, 3, 1, 1).expand(batch, 3, 1, 1)
    pictures = torch.rand(2, batch, 3, height, 2 * height)
    return pictures[0], pictures[1], direction


def awake(network):
    """With last layers that say something: they begin at zero."""
    for layer in (network.answer2, network.upsampling):
        torch.nn.init.normal_(layer.weight, std=0.1)
    return network.eval()


def test_the_encoder_does_not_know_where_the_seam_is():
    encoder, image = EfficientNetLite0().eval(), torch.rand(1, 3, 64, 128)
    with torch.no_grad():
        plain, rolled = encoder(image), encoder(image.roll(32, -1))
    assert [x.shape[1] for x in plain] == list(CHANNELS)
    for stride, one, other in zip((2, 4, 8, 16, 32), plain, rolled, strict=True):
        assert one.shape[-2:] == (64 // stride, 128 // stride)
        torch.testing.assert_close(one.roll(32 // stride, -1), other)


def test_the_features_at_a_quarter_lie_where_the_sweep_takes_them_to_be():
    """The centre of what a spot leaves behind, averaged over the places of the spot within a block."""
    encoder, offsets = EfficientNetLite0(), []
    for place in range(64, 68):
        x = torch.zeros(1, 1, 64, 128)
        x[..., 32, place] = 1.0
        for conv in (encoder.stem, encoder.blocks[1].depthwise):
            wide = functional.pad(wrap_columns(x, conv.before, conv.after), (0, 0, conv.before, conv.after))
            x = functional.conv2d(wide, torch.ones(1, 1, 3, 3), stride=2)
        columns = x.sum(dim=(0, 1, 2))
        offsets.append(float((columns * torch.arange(32)).sum() / columns.sum()) - ((place + 0.5) / 4 - 0.5))
    assert np.mean(offsets) == pytest.approx(-FEATURE_SHIFT, abs=0.02)


def test_the_sweep_is_that_of_the_geometry():
    towards = torch.tensor([[0.1, 0.2, -0.97]])
    towards = towards / towards.norm()
    sqrt_inv_depths = torch.tensor([0.0, 0.5, 1.7])
    directions = feature_directions((16, 32), 0.0, sqrt_inv_depths)
    np.testing.assert_allclose(directions.numpy(), pixel_directions(16, 32), atol=1e-6)
    azimuth, polar = sweep_grid(directions, towards, sqrt_inv_depths)
    motion = Pose(np.eye(3), -towards[0].double().numpy())
    for k, sqrt_inv_depth in enumerate(sqrt_inv_depths.tolist()):
        moved = sweep_directions(pixel_directions(16, 32), np.full((16, 32), sqrt_inv_depth**2), motion)
        expected_azimuth, expected_polar = direction_to_angles(moved)
        turn = (azimuth[0, k].numpy() * np.pi - expected_azimuth + np.pi) % (2 * np.pi) - np.pi
        assert np.abs(turn * np.sin(expected_polar)).max() < 1e-4
        np.testing.assert_allclose((polar[0, k].numpy() + 1) * np.pi / 2, expected_polar, atol=1e-4)


def test_costs_are_highest_at_the_true_sphere():
    """Random features on a sphere around the first camera: every pixel finds it."""
    network = GuidedDepthNetwork(GuidedDepthConfig("wide", spheres=21, features=16, groups=4))
    towards, sqrt_inv_depth = torch.tensor([[0.0, 0.0, -1.0]]), 0.8
    height, width = 32, 64
    waves = torch.randn(16, 3) * 6.0
    points = feature_directions((height, width), -0.125, waves)  # the sphere has radius 1/sqrt_inv_depth² baselines
    first = torch.sin(points @ waves.T).permute(2, 0, 1)[None]
    # what the other camera sees along d: the point at distance s with |s d + sqrt_inv_depth² t| = 1 radius
    other = feature_directions((height, width), -0.125, waves)
    along = (other @ towards[0]) * sqrt_inv_depth**2
    distance = -along + torch.sqrt(along**2 - sqrt_inv_depth**4 + 1.0)
    second = torch.sin((other * distance[..., None] + sqrt_inv_depth**2 * towards[0]) @ waves.T).permute(2, 0, 1)[None]
    costs, _ = network._costs(first, second, towards)
    best = costs.view(4, 21, height, width).mean(dim=0).argmax(dim=0)
    inner = best[4:-4]
    assert (inner == 8).float().mean() > 0.85  # 2.0 / 20 · 8; around the epipoles all spheres look alike


def test_the_answer_has_the_size_of_the_picture_and_confidence_is_a_probability():
    network = awake(GuidedDepthNetwork(SMALL))
    with torch.no_grad():
        answer = network(*inputs(2))
    assert answer.estimate.shape == answer.log_scale.shape == (2, 1, 64, 128)
    assert [x.shape[-1] for x in answer.coarse] == [32, 64]
    inverse_depth, confidence = answer.outputs()
    assert inverse_depth.min() >= 0.0
    assert inverse_depth.max() <= SMALL.max_sqrt_inv_depth**2
    assert 0.0 <= confidence.min() <= confidence.max() <= 1.0


def test_confidence_is_the_share_of_a_laplace_distribution_within_ten_percent():
    sqrt_inv_depth, scale = 0.8, 0.03
    answer = GuidedDepthPrediction(
        torch.full((1, 1, 1, 1), sqrt_inv_depth), torch.full((1, 1, 1, 1), np.log(scale)), ()
    )
    errors = np.random.default_rng(0).laplace(0.0, scale, 200_000)
    within = (sqrt_inv_depth + errors) ** 2 / sqrt_inv_depth**2
    share = np.mean((within < 1.1) & (within > 2 - 1.1))  # nearly symmetric
    assert float(answer.confidence()) == pytest.approx(share, abs=0.01)


def test_onnx_runtime_says_of_guided_depth_what_torch_says(tmp_path):
    network = awake(GuidedDepthNetwork(SMALL))
    export_network(network, tmp_path / "small.onnx")
    examples = [tuple(x.numpy() for x in inputs(towards=t)) for t in ((0.0, 0.1, -0.995), (0.6, 0.0, 0.8))]
    assert largest_difference(network, tmp_path / "small.onnx", examples) < PARITY


def test_the_shipped_size_has_few_parameters():
    network = GuidedDepthNetwork(GUIDED_DEPTH_VARIANTS["lite0"])
    assert sum(parameter.numel() for parameter in network.parameters()) < 6_000_000


def test_convex_upsampling_stays_within_the_neighbourhood_and_keeps_constants():
    x = torch.rand(2, 2, 4, 8)
    fine = convex_upsample(x, torch.randn(2, 36, 4, 8))
    repeated = torch.cat([x[:, :, :1], x, x[:, :, -1:]], dim=2)
    highest = functional.max_pool2d(wrap_columns(repeated, 1, 1), 3, 1)
    lowest = -functional.max_pool2d(-wrap_columns(repeated, 1, 1), 3, 1)
    for i in range(2):
        for j in range(2):
            assert torch.all(fine[:, :, i::2, j::2] <= highest + 1e-6)
            assert torch.all(fine[:, :, i::2, j::2] >= lowest - 1e-6)
    torch.testing.assert_close(
        convex_upsample(torch.full((1, 1, 4, 8), 0.3), torch.randn(1, 36, 4, 8)), torch.full((1, 1, 8, 16), 0.3)
    )


def test_features_that_are_gathered_correlate_as_those_that_are_sampled():
    """The second way is that of the exported file. Seam and poles are among the places."""
    first, second = torch.randn(2, 1, 4, 6, 16, 32)
    azimuth = torch.rand(1, 12, 16, 32) * 2.0 - 1.0
    polar = torch.rand(1, 12, 16, 32) * 2.0 - 1.0
    azimuth[0, 0], polar[0, 1], polar[0, 2] = 0.9999, 1.0, -1.0
    found = correlate_gathered(first, second, azimuth, polar)
    torch.testing.assert_close(found, correlate(first, second, azimuth, polar), atol=1e-4, rtol=0.0)
