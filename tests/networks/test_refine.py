import math

import numpy as np
import pytest
import torch

from omnisyn_cli.networks.export import OPSET, PARITY, export_refine, largest_difference
from omnisyn_cli.networks.refine import FILLED_PLANE, LEAST_SCALE, RefineConfig, RefineNetwork, RefinePrediction

TINY = RefineConfig("tiny", planes=19, widths=(8, 12, 16), fine=6)


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(0)
    network = RefineNetwork(TINY).eval()
    torch.nn.init.normal_(network.answer.weight, std=0.3)
    return network


def planes(height=32, width=64, seed=0):
    return torch.rand((1, 19, height, width), generator=torch.Generator().manual_seed(seed))


def test_a_fresh_network_nearly_leaves_matching_alone():
    torch.manual_seed(0)
    given = planes()
    with torch.no_grad():
        answer = RefineNetwork(TINY)(given)
    assert answer.root().shape == (1, 1, 32, 64)
    assert (answer.root() - given[:, FILLED_PLANE : FILLED_PLANE + 1]).abs().max() < 0.5


def test_rolling_the_planes_rolls_the_answer(network):
    given = planes()
    with torch.no_grad():
        straight, rolled = network(given), network(given.roll(24, -1))
    torch.testing.assert_close(rolled.roots, straight.roots.roll(24, -1), rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(rolled.confidence_logit, straight.confidence_logit.roll(24, -1), rtol=1e-4, atol=1e-5)


def test_sizes_that_do_not_fit_are_refused(network):
    with pytest.raises(ValueError, match="multiples of 8"):
        network(planes(36, 72))


def test_the_mode_of_the_denser_distribution_is_taken():
    """Against the densities themselves, over a grid of shares and scales."""
    share, first, second = (x.reshape(1, 1, 1, -1) for x in torch.meshgrid(
        torch.linspace(0.05, 0.95, 7), torch.linspace(0.01, 0.2, 6), torch.linspace(0.01, 0.2, 5), indexing="ij"
    ))  # fmt: skip
    roots = torch.cat([torch.full_like(share, 0.3), torch.full_like(share, 0.9)], dim=1)
    scales = torch.cat([first, second], dim=1)
    answer = RefinePrediction(roots, scales.log(), (share / (1 - share)).log(), torch.zeros_like(share))
    dense = torch.where(share / (2 * first) >= (1 - share) / (2 * second), 0.3, 0.9)
    assert (answer.root() == dense).float().mean() > 0.98  # rounding decides between equals
    torch.testing.assert_close(answer.inverse_depth(), answer.root() ** 2)


def test_inverse_depth_is_never_negative_and_zero_is_reached():
    roots = torch.tensor([-0.2, 0.5]).reshape(1, 2, 1, 1)
    zero = torch.zeros((1, 1, 1, 1))
    answer = RefinePrediction(roots, torch.full((1, 2, 1, 1), math.log(LEAST_SCALE)), zero + 5.0, zero)
    assert float(answer.inverse_depth()) == 0.0


def test_the_exported_network_says_the_same_at_every_size(tmp_path, network):
    import onnx

    path = tmp_path / "tiny.onnx"
    export_refine(network, path)
    examples = [(planes(h, w, h).numpy(),) for h, w in ((16, 32), (32, 64), (64, 128), (24, 80))]
    assert largest_difference(network, path, examples) < PARITY
    model = onnx.load(path)
    assert [opset.version for opset in model.opset_import] == [OPSET]
    assert not any(node.op_type == "Pad" for node in model.graph.node)


def test_single_precision_is_enough(network):
    """float32 against float64, relative to the inverse depth."""
    given = planes()
    with torch.no_grad():
        single = network(given)
        double = RefineNetwork(TINY).double()
        double.load_state_dict(network.state_dict())
        exact = double.eval()(given.double())
    same_mode = (single.root() - exact.root()).abs() < 0.01
    assert same_mode.float().mean() > 0.999
    error = (single.inverse_depth().double() - exact.inverse_depth()).abs()[same_mode]
    assert np.quantile(error / exact.inverse_depth()[same_mode].clamp(min=1e-3), 0.999) < 1e-3
