"""Networks on planes: what all share, then completion, fusion and SynSin."""

import math

import numpy as np
import onnx
import pytest
import torch
from plane_samples import COMPLETION, FUSION, PAINTING, awake, losses_of, predict, random_channels
from torch.nn import functional

from omnisyn_cli.fusion.warp_candidates import MIN_CANDIDATE_WEIGHT
from omnisyn_cli.networks import completion, fusion
from omnisyn_cli.networks.completion import FILLED_CHANNEL, CompletionNetwork, CompletionPrediction, SphereAttention
from omnisyn_cli.networks.export import OPSET, PARITY, export_network, largest_difference
from omnisyn_cli.networks.interface import RefinementUNet, RefinementUNetConfig
from omnisyn_cli.networks.layers import LEAK
from omnisyn_cli.networks.paper import upsample_linear
from omnisyn_cli.networks.synsin import (
    SYNSIN_VARIANTS,
    FeatureEncoder,
    MonocularNetwork,
    RefinementDecoder,
    SynSinConfig,
    SynSinNetwork,
    inverse_depth_of,
)

every_network = pytest.mark.parametrize(
    "config", [COMPLETION, FUSION, PAINTING], ids=["completion", "fusion", "painting"]
)


@every_network
def test_rolling_the_planes_rolls_the_answer(config):
    """Nothing knows where the seam is."""
    network, given = awake(config), random_channels(config.channels)
    straight, rolled = predict(network, given), predict(network, given.roll(24, -1))
    assert max(value.std() for value in straight.values()) > 1e-3
    for name, value in straight.items():
        torch.testing.assert_close(rolled[name], value.roll(24, -1), rtol=1e-3, atol=1e-4)


@every_network
def test_sizes_that_do_not_fit_are_refused(config):
    with pytest.raises(ValueError, match="multiples of 8"):
        awake(config)(random_channels(config.channels, 36, 72))


@every_network
def test_the_exported_network_says_the_same_at_every_size(tmp_path, config):
    network, path = awake(config), tmp_path / "tiny.onnx"
    export_network(network, path)
    sizes = ((16, 32), (32, 64), (64, 128), (24, 80), (80, 160))
    examples = [(random_channels(config.channels, *size, seed=size[0]).numpy(),) for size in sizes]
    assert largest_difference(network, path, examples) < PARITY
    model = onnx.load(path)
    assert [opset.version for opset in model.opset_import] == [OPSET]
    assert not any(node.op_type == "Pad" for node in model.graph.node)
    assert [entry.name for entry in model.graph.output] == list(network.ports.outputs)


def convolved(weights, name, x, stride=1):
    """A 3×3 or 1×1 convolution that wraps around the seam, from the names in a checkpoint alone."""
    kernel = weights[f"{name}.weight"]
    if kernel.shape[-1] == 3:
        x = functional.pad(functional.pad(x, (1, 1, 0, 0), mode="circular"), (0, 0, 1, 1))
    return functional.conv2d(x, kernel, weights[f"{name}.bias"], stride=stride)


def block(weights, name, x, stride=1):
    inner = functional.leaky_relu(convolved(weights, f"{name}.first", x, stride), LEAK)
    past = convolved(weights, f"{name}.shortcut", x, stride) if f"{name}.shortcut.weight" in weights else x
    return functional.leaky_relu(convolved(weights, f"{name}.second", inner) + past, LEAK)


def test_the_answers_are_those_of_the_plain_formula():
    """Written out once more over the names of the weights, which checkpoints depend on."""
    torch.manual_seed(0)
    network = RefinementUNet(RefinementUNetConfig("tiny", 5, (8, 12, 16), 6), 3)
    w, channels = dict(network.state_dict()), torch.rand(2, 5, 16, 32)
    with torch.no_grad():
        x0 = block(w, "stem", functional.pixel_unshuffle(channels, 2))
        x1 = block(w, "down.0", x0, 2)
        x = block(w, "middle", block(w, "down.1", x1, 2))
        for level, skip in ((1, x1), (0, x0)):
            larger = convolved(w, f"project.{level}", x).repeat_interleave(2, -1).repeat_interleave(2, -2)
            x = block(w, f"up.{level}", functional.leaky_relu(larger + skip, LEAK))
        x = functional.pixel_shuffle(convolved(w, "expand", x), 2) + convolved(w, "skip", channels)
        expected = convolved(w, "head", block(w, "fine", functional.leaky_relu(x, LEAK)))
        torch.testing.assert_close(network.predict(channels), expected, atol=1e-5, rtol=1e-5)


@pytest.fixture(scope="module")
def network():
    return awake(COMPLETION)


def test_a_fresh_network_nearly_leaves_the_filled_map_alone():
    torch.manual_seed(0)
    given = random_channels()
    with torch.no_grad():
        answer = CompletionNetwork(COMPLETION)(given)
    assert answer.sqrt_inv_depth().shape == (1, 1, 32, 64)
    assert (answer.sqrt_inv_depth() - given[:, FILLED_CHANNEL : FILLED_CHANNEL + 1]).abs().max() < 0.2


def test_the_answer_is_the_likelier_root_and_never_between_the_two(network):
    with torch.no_grad():
        answer = network(random_channels())
    sqrt_inv_depth, first = answer.sqrt_inv_depth(), answer.mode_logit > 0
    assert 0.02 < first.float().mean() < 0.98
    assert torch.equal(sqrt_inv_depth[first], answer.modes[:, :1][first])
    assert torch.equal(sqrt_inv_depth[~first], answer.modes[:, 1:][~first])
    assert torch.all(answer.inverse_depth() >= 0)


def test_every_place_sees_every_other_one(network):
    """What changes at one pixel reaches the other side of the sphere."""
    given = random_channels().requires_grad_()
    network(given).modes[0, 0, 4, 40].backward()
    assert torch.all(torch.isfinite(given.grad))
    assert given.grad[0, :, 28, 4].abs().max() > 0


def test_places_count_by_their_solid_angle():
    """Where nothing is asked for, the mean over the sphere is taken in."""
    layer = SphereAttention(4, heads=1)
    for linear in (layer.qkv, layer.position_bias):
        torch.nn.init.zeros_(linear.weight)
        torch.nn.init.zeros_(linear.bias)
    with torch.no_grad():
        layer.qkv.weight[8:] = torch.eye(4)  # values as they come
    height, width = 16, 32
    rows = torch.linspace(-1.0, 1.0, height)[:, None].expand(height, width)
    values = torch.stack([rows, rows.square(), rows.abs(), torch.ones_like(rows)])[None]
    seen = layer._attend(values.flatten(2).transpose(1, 2), completion._directions(values))
    area = torch.sin((torch.arange(height) + 0.5) / height * np.pi)[:, None].expand(height, width)
    expected = (values * area).sum((-1, -2)) / area.sum()
    torch.testing.assert_close(seen[0, 0], expected[0], rtol=1e-4, atol=1e-5)


def test_inverse_depth_is_never_negative_and_zero_is_reached():
    zero = torch.zeros((1, 1, 1, 1))
    answer = CompletionPrediction(torch.full((1, 2, 1, 1), -0.2), zero, zero)
    assert float(answer.sqrt_inv_depth()) < 0.0
    assert float(answer.inverse_depth()) == 0.0


def test_single_precision_is_enough(network):
    """float32 against float64, relative to the inverse depth."""
    given = random_channels()
    with torch.no_grad():
        single = network(given)
        double = CompletionNetwork(COMPLETION).double()
        double.load_state_dict(network.state_dict())
        exact = double.eval()(given.double())
    same_choice = (single.mode_logit > 0) == (exact.mode_logit > 0)
    assert same_choice.float().mean() > 0.999
    error = (single.inverse_depth().double() - exact.inverse_depth()).abs()[same_choice]
    assert np.quantile(error / exact.inverse_depth()[same_choice].clamp(min=1e-3), 0.999) < 1e-3


def parameters(network):
    return sum(parameter.numel() for parameter in network.parameters())


def test_the_network_of_the_paper_has_its_size():
    """22.8 million parameters: the channels of the authors' fusion UNet, 8 → 16 … 512, 1024, and back."""
    assert parameters(fusion.build_fusion(fusion.FUSION_VARIANTS["paper"])) == pytest.approx(22.8e6, rel=0.003)


def test_ours_is_small():
    assert 1.0e6 < parameters(fusion.build_fusion(fusion.FUSION_VARIANTS["residual"])) < 2.0e6


@pytest.mark.parametrize(("variant", "channels"), [("paper", (3,)), ("residual", (4,))])
def test_answers_have_the_size_of_the_pictures(variant, channels):
    config = fusion.FUSION_VARIANTS[variant]
    network = fusion.build_fusion(config)
    side = config.size_multiple
    assert side == {"paper": 64, "residual": 32}[variant]
    given = random_channels(config.channels, side, 2 * side)
    assert [answer.shape for answer in predict(network, given).values()] == [(1, n, side, 2 * side) for n in channels]


def test_a_fresh_network_corrects_nothing_that_is_looked_up():
    torch.manual_seed(0)
    (shares,) = predict(fusion.ResidualFusionUNet(FUSION), random_channels(52)).values()
    assert shares.max() < MIN_CANDIDATE_WEIGHT


def test_candidates_count_where_it_is_open_what_is_shown():
    """By hand: one surface around; two of nearly one depth; two, that matter by half; seen by one view; a hole."""
    given = torch.zeros(1, 52, 1, 5)
    given[0, fusion.SEEN_SLICE] = torch.tensor([[[1.0, 1.0, 1.0, 0.0, 0.0]], [[1.0, 1.0, 1.0, 1.0, 0.0]]])
    given[0, fusion.HYPOTHESIS_SLICE] = torch.tensor([[[1.0, 0.97, 0.5, 0.5, 0.0]], [[1.0, 1.0, 1.0, 1.0, 0.0]]])
    given[0, fusion.RELEVANCE_CHANNEL] = torch.tensor([1.0, 1.0, 0.5, 0.0, 1.0])
    apart = (1 - 0.97**2) / 0.06
    wanted = torch.tensor([0.0, 1 - math.exp(-(apart**2)), 0.5, 1.0, 1.0])
    torch.testing.assert_close(fusion.depth_ambiguity(given).flatten(), wanted, atol=1e-6, rtol=0)


def test_bilinear_enlargement_continues_around_the_seam():
    """The middle of three copies side by side, where no border is near."""
    x = torch.rand((1, 3, 6, 10), generator=torch.Generator().manual_seed(0))
    three = functional.interpolate(torch.cat([x, x, x], -1), scale_factor=2.0, mode="bilinear")
    torch.testing.assert_close(upsample_linear(x, 2), three[..., 20:40])


def test_shares_are_a_choice_beside_what_there_is():
    """With constant answers, in closed form."""
    network, given = fusion.ResidualFusionUNet(FUSION), random_channels(52) - 0.5
    torch.nn.init.zeros_(network.head.weight)
    with torch.no_grad():
        network.head.bias.copy_(torch.tensor([0.1, 0.2, 0.3, 0.4]))
    (shares,) = predict(network, given).values()
    weights = torch.exp(8.0 * torch.tensor([0.1, 0.2, 0.3, 0.4]) - 4.0)
    expected = (weights / (1.0 + weights.sum())).view(1, 4, 1, 1).expand(1, 4, 32, 64)
    torch.testing.assert_close(shares, fusion.depth_ambiguity(given) * expected)


def test_single_precision_is_enough_for_fusion():
    given, single = random_channels(52), awake(FUSION)
    double = fusion.ResidualFusionUNet(FUSION).double()
    double.load_state_dict(single.state_dict())
    for one, exact in zip(
        *(predict(*x).values() for x in ((single, given), (double.eval(), given.double()))), strict=True
    ):
        torch.testing.assert_close(one.double(), exact, rtol=1e-3, atol=1e-3)


def test_the_network_of_the_paper_begins_with_the_mean_of_both_renderings_and_learns():
    """A few steps towards the first one."""
    torch.manual_seed(0)
    network = fusion.DirectFusionUNet(PAINTING)
    given = random_channels(8)
    torch.testing.assert_close(network(given), 0.5 * (given[:, :3] + given[:, 3:6]))
    losses = losses_of(network, lambda: (network(given) - given[:, :3]).abs().mean())
    assert losses[-1] < 0.6 * losses[0]


SMALL_SYNSIN = SynSinConfig("tiny", (32, 64), features=6, depth_widths=(6, 8), decoder_widths=(6, 8, 8), fine=4)


@pytest.fixture
def synsin():
    torch.manual_seed(0)
    return SynSinNetwork(SMALL_SYNSIN).eval()


@pytest.mark.parametrize("part", ["depth", "encoder", "decoder"])
def test_no_network_knows_where_the_seam_is(synsin, part):
    """Turned by a multiple of the coarsest stride, every answer turns along."""
    channels = SMALL_SYNSIN.features + 1 if part == "decoder" else 3
    x, answer = torch.rand(1, channels, 32, 64), getattr(synsin, part)
    with torch.no_grad():
        torch.testing.assert_close(answer(x.roll(24, dims=-1)), answer(x).roll(24, dims=-1), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("part", ["depth", "encoder", "decoder"])
def test_every_network_knows_up_from_down(synsin, part):
    channels = SMALL_SYNSIN.features + 1 if part == "decoder" else 3
    x, answer = torch.full((1, channels, 32, 64), 0.5), getattr(synsin, part)
    with torch.no_grad():
        rows = answer(x)[0, -1, 8:24, 0]
    assert (rows - rows.flip(0)).abs().max() > 1e-6


def test_the_first_features_are_the_colours_and_a_picture_begins_as_one_of_points(synsin):
    image, points = torch.rand(2, 3, 32, 64), torch.rand(2, SMALL_SYNSIN.features + 1, 32, 64)
    points[:, -1] = 0.5 + 0.5 * points[:, -1]
    with torch.no_grad():
        features, picture = synsin.encoder(image), synsin.decoder(points)
    assert features.shape == (2, SMALL_SYNSIN.features, 32, 64)
    assert torch.equal(features[:, :3], image)
    assert (picture - points[:, :3] / points[:, -1:]).abs().mean() < 0.1


def test_inverse_depth_is_bounded_and_a_root_below_zero_is_infinitely_far(synsin):
    sqrt_inv_depths = torch.tensor([-1.0, 0.0, 0.5, 9.0])
    assert inverse_depth_of(sqrt_inv_depths, SMALL_SYNSIN).tolist() == [0.0, 0.0, 0.25, 4.0]
    with torch.no_grad():
        first = synsin.depth(torch.rand(1, 3, 32, 64))
    assert first.shape == (1, 1, 32, 64)
    assert (first - 0.4).abs().mean() < 0.1  # six metres, until it has learned better


def test_sizes_that_cannot_be_halved_often_enough_are_refused(synsin):
    for part, channels in ((synsin.depth, 3), (synsin.decoder, SMALL_SYNSIN.features + 1)):
        with pytest.raises(ValueError, match=r"multiples of 8, got 64×36"):
            part(torch.rand(1, channels, 36, 64))


def test_the_shipped_variant_is_small():
    config = SYNSIN_VARIANTS["small"]
    parts = [MonocularNetwork(config), FeatureEncoder(config), RefinementDecoder(config)]
    assert 4 * sum(parameter.numel() for part in parts for parameter in part.parameters()) < 12e6
