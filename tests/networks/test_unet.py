from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from torch.nn import functional

from omnisyn_cli.networks.export import export_fusion, export_refine
from omnisyn_cli.networks.layers import LEAK
from omnisyn_cli.networks.unet import CorrectingUNet, check_multiple
from omnisyn_cli.training.loop import load_network

MODELS = Path(__file__).parents[2] / "models"

EXPORTS = {"fusion-residual": export_fusion, "refine-balanced": export_refine}


@pytest.mark.parametrize("name", EXPORTS)
def test_shipped_checkpoints_say_what_the_shipped_models_say(tmp_path, name):
    """Loaded strictly, exported again, run by ONNX Runtime: the same answers as those of the file that is shipped."""
    network, _ = load_network(MODELS / "checkpoints" / f"{name}.pt")
    EXPORTS[name](network, tmp_path / "again.onnx")
    planes = np.random.default_rng(0).random((1, network.config.planes, 64, 128), dtype=np.float32)
    again, shipped = (
        onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"]).run(None, {"planes": planes})
        for path in (tmp_path / "again.onnx", MODELS / f"{name}.onnx")
    )
    assert any(np.abs(answer).max() > 0.1 for answer in shipped)
    for one, other in zip(again, shipped, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5)


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
    network = CorrectingUNet(5, (8, 12, 16), 6, 3)
    w, planes = dict(network.state_dict()), torch.rand(2, 5, 16, 32)
    with torch.no_grad():
        x0 = block(w, "stem", functional.pixel_unshuffle(planes, 2))
        x1 = block(w, "down.0", x0, 2)
        x = block(w, "middle", block(w, "down.1", x1, 2))
        for level, skip in ((1, x1), (0, x0)):
            larger = convolved(w, f"project.{level}", x).repeat_interleave(2, -1).repeat_interleave(2, -2)
            x = block(w, f"up.{level}", functional.leaky_relu(larger + skip, LEAK))
        x = functional.pixel_shuffle(convolved(w, "spread", x), 2) + convolved(w, "look", planes)
        expected = convolved(w, "answer", block(w, "fine", functional.leaky_relu(x, LEAK)))
        torch.testing.assert_close(network.answers(planes), expected, atol=1e-5, rtol=1e-5)


def test_sizes_that_cannot_be_halved_are_refused():
    check_multiple(torch.zeros(1, 1, 32, 64), 32)
    with pytest.raises(ValueError, match="multiples of 32"):
        check_multiple(torch.zeros(1, 1, 32, 48), 32)
