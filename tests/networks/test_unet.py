import onnx
import pytest
import torch
from plane_samples import COMPLETION, FUSION, PAINTING, awake, predict, random_channels
from torch.nn import functional

from omnisyn_cli.networks.export import OPSET, PARITY, export_network, largest_difference
from omnisyn_cli.networks.interface import check_multiple
from omnisyn_cli.networks.layers import LEAK
from omnisyn_cli.networks.unet import RefinementUNet, RefinementUNetConfig

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


def test_sizes_that_cannot_be_halved_are_refused():
    check_multiple(torch.zeros(1, 1, 32, 64), 32)
    with pytest.raises(ValueError, match="multiples of 32"):
        check_multiple(torch.zeros(1, 1, 32, 48), 32)
