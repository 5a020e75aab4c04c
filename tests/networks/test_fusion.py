import onnx
import pytest
import torch
from torch.nn import functional

from omnisyn_cli.networks.export import OPSET, PARITY, export_fusion, largest_difference
from omnisyn_cli.networks.fusion import (
    FUSION_VARIANTS,
    GREATEST_SHIFT,
    FusionConfig,
    FusionNetwork,
    PaintingNetwork,
    build_fusion,
    upsample_bilinear,
)

TINY = FusionConfig("tiny", planes=20, widths=(8, 12, 16), fine=6)
TINY_PAPER = FusionConfig("tiny paper", planes=8, widths=(8, 12, 16, 24), paints=True)


def made(config):
    torch.manual_seed(0)
    network = build_fusion(config).eval()
    torch.nn.init.normal_(network.answer.weight, std=0.3)
    return network


def planes(count, height=32, width=64, seed=0):
    return torch.rand((1, count, height, width), generator=torch.Generator().manual_seed(seed))


def answers(network, given):
    with torch.no_grad():
        answer = network(given)
    return (answer,) if isinstance(answer, torch.Tensor) else (answer.shift, answer.colour)


def parameters(network):
    return sum(parameter.numel() for parameter in network.parameters())


def test_the_network_of_the_paper_has_its_size():
    """22.8 million parameters: the channels of the authors' fusion UNet, 8 → 16 … 512, 1024, and back."""
    assert parameters(build_fusion(FUSION_VARIANTS["paper"])) == pytest.approx(22.8e6, rel=0.003)


def test_ours_is_small():
    assert 0.3e6 < parameters(build_fusion(FUSION_VARIANTS["residual"])) < 1.0e6


@pytest.mark.parametrize(("variant", "channels"), [("paper", (3,)), ("residual", (1, 3))])
def test_answers_have_the_size_of_the_pictures(variant, channels):
    config = FUSION_VARIANTS[variant]
    network = build_fusion(config)
    side = config.size_multiple
    assert side == {"paper": 64, "residual": 32}[variant]
    given = planes(config.planes, side, 2 * side)
    assert [answer.shape for answer in answers(network, given)] == [(1, n, side, 2 * side) for n in channels]


def test_a_fresh_network_corrects_nothing():
    torch.manual_seed(0)
    assert all((answer == 0).all() for answer in answers(FusionNetwork(TINY), planes(20)))


@pytest.mark.parametrize("config", [TINY, TINY_PAPER, FUSION_VARIANTS["paper"]], ids=lambda config: config.name)
def test_rolling_the_input_rolls_the_answer(config):
    """Nothing knows where the seam is: bilinear enlargement and convolutions go across it."""
    network = made(config)
    multiple = config.size_multiple
    given = planes(config.planes, multiple, 4 * multiple)
    for straight, rolled in zip(answers(network, given), answers(network, given.roll(multiple, -1)), strict=True):
        assert straight.std() > 1e-3
        torch.testing.assert_close(rolled, straight.roll(multiple, -1), rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("config", [TINY, TINY_PAPER], ids=lambda config: config.name)
def test_sizes_that_do_not_fit_are_refused(config):
    with pytest.raises(ValueError, match="multiples of 8"):
        build_fusion(config)(planes(config.planes, 36, 72))


def test_bilinear_enlargement_continues_around_the_seam():
    """The middle of three copies side by side, where no border is near."""
    x = planes(3, 6, 10)
    three = functional.interpolate(torch.cat([x, x, x], -1), scale_factor=2.0, mode="bilinear")
    torch.testing.assert_close(upsample_bilinear(x), three[..., 20:40])


def test_a_shift_is_bounded():
    network = made(TINY)
    torch.nn.init.constant_(network.answer.bias, 1000.0)
    assert answers(network, planes(20))[0].abs().max() <= GREATEST_SHIFT


def test_weights_can_be_made_less_decided_and_one_view_be_preferred():
    """With constant answers: log-ratio · exp(stretch) + preference, in closed form."""
    network, given = FusionNetwork(TINY), planes(20) - 0.5
    torch.nn.init.zeros_(network.answer.weight)
    with torch.no_grad():
        network.answer.bias.copy_(torch.tensor([-0.05, 0.03, 0.1, 0.2, 0.3]))
    shift, colour = answers(network, given)
    log_ratio = 8.0 * given[:, 13:14]
    wanted = log_ratio * torch.exp(torch.tensor(-0.4)) + 0.24 - log_ratio
    torch.testing.assert_close(shift, 8.0 * torch.tanh(wanted / 8.0))
    torch.testing.assert_close(colour, torch.tensor([0.1, 0.2, 0.3]).view(1, 3, 1, 1).expand(1, 3, 32, 64))


@pytest.mark.parametrize("config", [TINY, TINY_PAPER], ids=lambda config: config.name)
def test_the_exported_network_says_the_same_at_every_size(tmp_path, config):
    network, path = made(config), tmp_path / "tiny.onnx"
    export_fusion(network, path)
    sizes = ((16, 32), (32, 64), (64, 128), (24, 80))
    examples = [(planes(config.planes, h, w, h).numpy(),) for h, w in sizes]
    assert largest_difference(network, path, examples) < PARITY
    model = onnx.load(path)
    assert [opset.version for opset in model.opset_import] == [OPSET]
    assert not any(node.op_type == "Pad" for node in model.graph.node)
    assert [entry.name for entry in model.graph.output] == (["colour"] if config.paints else ["shift", "colour"])


def test_single_precision_is_enough():
    given, single = planes(20), made(TINY)
    double = FusionNetwork(TINY).double()
    double.load_state_dict(single.state_dict())
    for one, exact in zip(answers(single, given), answers(double.eval(), given.double()), strict=True):
        torch.testing.assert_close(one.double(), exact, rtol=1e-3, atol=1e-3)


def test_configurations_survive_as_plain_values():
    for config in (*FUSION_VARIANTS.values(), TINY):
        plain = {key: list(value) if isinstance(value, tuple) else value for key, value in config.as_dict().items()}
        assert FusionConfig.from_dict(plain) == config
    with pytest.raises(TypeError, match="depth"):
        FusionConfig.from_dict({**TINY.as_dict(), "depth": 3})


def test_the_network_of_the_paper_learns():
    """A few steps towards the mean of both renderings."""
    torch.manual_seed(0)
    network = PaintingNetwork(TINY_PAPER)
    given = planes(8)
    target = 0.5 * (given[:, :3] + given[:, 3:6])
    optimizer = torch.optim.Adam(network.parameters(), lr=3e-3)
    losses = []
    for _ in range(30):
        loss = (network(given) - target).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.6 * losses[0]
