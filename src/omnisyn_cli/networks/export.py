"""A trained network as one ONNX file, proven to say the same as torch."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
from jaxtyping import Float
from torch import Tensor, nn

from omnisyn_cli.networks.depth import DepthNetwork

__all__ = ["OPSET", "PARITY", "export_depth", "largest_difference"]

OPSET = 18

PARITY = 1e-4
"""Largest difference between torch and ONNX Runtime, relative to the largest value, that is accepted."""


class _DepthOutputs(nn.Module):
    """The network with the outputs that leave the program: inverse depth × baseline, and confidence."""

    def __init__(self, network: DepthNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, first: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
        prediction = self.network(first, second)
        return prediction.inverse_depth(), prediction.confidence()


def export_depth(network: DepthNetwork, path: Path) -> None:
    """Write ``network`` at its configured size, weights inside; the file is checked by ONNX.

    Inputs ``first`` and ``second``, ``(1, 3, height, width)`` in [0, 1] in the epipole frame; outputs ``inverse_depth``
    (× baseline) and ``confidence``, ``(1, 1, height, width)``. The size is fixed, as the volume's matrix is.
    """
    height, width = network.config.size
    image = torch.rand(1, 3, height, width)
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # the tracer's remarks on sizes, which are meant to be fixed
        torch.onnx.export(
            _DepthOutputs(network).eval(),
            (image, image),
            str(path),
            input_names=["first", "second"],
            output_names=["inverse_depth", "confidence"],
            opset_version=OPSET,
            external_data=False,
            dynamo=False,
        )
    onnx.checker.check_model(str(path), full_check=True)


def largest_difference(
    network: DepthNetwork, path: Path, pairs: Iterable[Float[np.ndarray, "2 3 height width"]]
) -> float:
    """Between torch and ONNX Runtime over all outputs of all pairs, relative to the largest value of each output."""
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    outputs, worst = _DepthOutputs(network).eval(), 0.0
    for pair in pairs:
        images = [image[None].astype(np.float32) for image in pair]
        with torch.no_grad():
            expected = [output.numpy() for output in outputs(*(torch.from_numpy(image) for image in images))]
        found = session.run(None, {"first": images[0], "second": images[1]})
        for one, other in zip(expected, found, strict=True):
            worst = max(worst, float(np.abs(one - other).max() / max(np.abs(one).max(), 1e-6)))
    return worst
