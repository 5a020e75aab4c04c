import numpy as np
import pytest
import torch
from plane_samples import COMPLETION, awake, random_channels

from omnisyn_cli.networks import completion
from omnisyn_cli.networks.completion import FILLED_CHANNEL, CompletionNetwork, CompletionPrediction, SphereAttention


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
