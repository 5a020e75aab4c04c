import numpy as np
import onnx
import pytest
import torch

from depth_samples import TINY
from omnisyn_cli.networks.export import OPSET, PARITY, export_network, largest_difference
from omnisyn_cli.networks.paper import PaperNetwork


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    torch.manual_seed(0)
    network = PaperNetwork(TINY).eval()
    torch.nn.init.constant_(network.high_head[-1].second.bias, 0.5)
    path = tmp_path_factory.mktemp("models") / "tiny.onnx"
    export_network(network, path)
    return network, path


def test_onnx_runtime_says_what_torch_says(exported):
    network, path = exported
    pairs = np.random.default_rng(0).random((3, 2, 1, 3, 64, 128), dtype=np.float32)
    assert largest_difference(network, path, map(tuple, pairs)) < PARITY


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
