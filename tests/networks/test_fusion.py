import math

import pytest
import torch
from plane_samples import FUSION, PAINTING, awake, predict, random_channels
from torch.nn import functional

from omnisyn_cli.fusion.warp_candidates import MIN_CANDIDATE_WEIGHT
from omnisyn_cli.networks.fusion import (
    FUSION_VARIANTS,
    HYPOTHESIS_SLICE,
    RELEVANCE_CHANNEL,
    SEEN_SLICE,
    DirectFusionUNet,
    FusionConfig,
    ResidualFusionUNet,
    build_fusion,
    depth_ambiguity,
)
from omnisyn_cli.networks.paper import upsample_linear


def parameters(network):
    return sum(parameter.numel() for parameter in network.parameters())


def test_the_network_of_the_paper_has_its_size():
    """22.8 million parameters: the channels of the authors' fusion UNet, 8 → 16 … 512, 1024, and back."""
    assert parameters(build_fusion(FUSION_VARIANTS["paper"])) == pytest.approx(22.8e6, rel=0.003)


def test_ours_is_small():
    assert 1.0e6 < parameters(build_fusion(FUSION_VARIANTS["residual"])) < 2.0e6


@pytest.mark.parametrize(("variant", "channels"), [("paper", (3,)), ("residual", (4,))])
def test_answers_have_the_size_of_the_pictures(variant, channels):
    config = FUSION_VARIANTS[variant]
    network = build_fusion(config)
    side = config.size_multiple
    assert side == {"paper": 64, "residual": 32}[variant]
    given = random_channels(config.channels, side, 2 * side)
    assert [answer.shape for answer in predict(network, given).values()] == [(1, n, side, 2 * side) for n in channels]


def test_a_fresh_network_corrects_nothing_that_is_looked_up():
    torch.manual_seed(0)
    (shares,) = predict(ResidualFusionUNet(FUSION), random_channels(52)).values()
    assert shares.max() < MIN_CANDIDATE_WEIGHT


def test_candidates_count_where_it_is_open_what_is_shown():
    """By hand: one surface around; two of nearly one depth; two, that matter by half; seen by one view; a hole."""
    given = torch.zeros(1, 52, 1, 5)
    given[0, SEEN_SLICE] = torch.tensor([[[1.0, 1.0, 1.0, 0.0, 0.0]], [[1.0, 1.0, 1.0, 1.0, 0.0]]])
    given[0, HYPOTHESIS_SLICE] = torch.tensor([[[1.0, 0.97, 0.5, 0.5, 0.0]], [[1.0, 1.0, 1.0, 1.0, 0.0]]])
    given[0, RELEVANCE_CHANNEL] = torch.tensor([1.0, 1.0, 0.5, 0.0, 1.0])
    apart = (1 - 0.97**2) / 0.06
    wanted = torch.tensor([0.0, 1 - math.exp(-(apart**2)), 0.5, 1.0, 1.0])
    torch.testing.assert_close(depth_ambiguity(given).flatten(), wanted, atol=1e-6, rtol=0)


def test_bilinear_enlargement_continues_around_the_seam():
    """The middle of three copies side by side, where no border is near."""
    x = torch.rand((1, 3, 6, 10), generator=torch.Generator().manual_seed(0))
    three = functional.interpolate(torch.cat([x, x, x], -1), scale_factor=2.0, mode="bilinear")
    torch.testing.assert_close(upsample_linear(x, 2), three[..., 20:40])


def test_shares_are_a_choice_beside_what_there_is():
    """With constant answers, in closed form."""
    network, given = ResidualFusionUNet(FUSION), random_channels(52) - 0.5
    torch.nn.init.zeros_(network.head.weight)
    with torch.no_grad():
        network.head.bias.copy_(torch.tensor([0.1, 0.2, 0.3, 0.4]))
    (shares,) = predict(network, given).values()
    weights = torch.exp(8.0 * torch.tensor([0.1, 0.2, 0.3, 0.4]) - 4.0)
    expected = (weights / (1.0 + weights.sum())).view(1, 4, 1, 1).expand(1, 4, 32, 64)
    torch.testing.assert_close(shares, depth_ambiguity(given) * expected)


def test_single_precision_is_enough():
    given, single = random_channels(52), awake(FUSION)
    double = ResidualFusionUNet(FUSION).double()
    double.load_state_dict(single.state_dict())
    for one, exact in zip(
        *(predict(*x).values() for x in ((single, given), (double.eval(), given.double()))), strict=True
    ):
        torch.testing.assert_close(one.double(), exact, rtol=1e-3, atol=1e-3)


def test_configurations_survive_as_plain_values():
    for config in (*FUSION_VARIANTS.values(), FUSION):
        plain = {key: list(value) if isinstance(value, tuple) else value for key, value in config.as_dict().items()}
        assert FusionConfig.from_dict(plain) == config
    with pytest.raises(TypeError, match="depth"):
        FusionConfig.from_dict({**FUSION.as_dict(), "depth": 3})


def test_the_network_of_the_paper_begins_with_the_mean_of_both_renderings_and_learns():
    """A few steps towards the first one."""
    torch.manual_seed(0)
    network = DirectFusionUNet(PAINTING)
    given = random_channels(8)
    torch.testing.assert_close(network(given), 0.5 * (given[:, :3] + given[:, 3:6]))
    target = given[:, :3]
    optimizer = torch.optim.Adam(network.parameters(), lr=3e-3)
    losses = []
    for _ in range(30):
        loss = (network(given) - target).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.6 * losses[0]
