"""A trained network as one ONNX file, proven to say the same as torch."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
from jaxtyping import Float32
from torch import Tensor, nn

from omnisyn_cli.networks.depth import DepthNetwork
from omnisyn_cli.networks.refine import RefineNetwork

__all__ = ["OPSET", "PARITY", "export_depth", "export_refine", "largest_difference"]

OPSET = 18

OUTPUTS = ("inverse_depth", "confidence")

PARITY = 1e-4
"""Largest difference between torch and ONNX Runtime, relative to the largest value, that is accepted."""


class _DepthOutputs(nn.Module):
    """A depth network with the outputs that leave the program: inverse depth × baseline, and confidence."""

    def __init__(self, network: DepthNetwork | RefineNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, *inputs: Tensor) -> tuple[Tensor, Tensor]:
        prediction = self.network(*inputs)
        return prediction.inverse_depth(), prediction.confidence()


def export_depth(network: DepthNetwork, path: Path) -> None:
    """Write ``network`` at its configured size, weights inside; the file is checked by ONNX.

    Inputs ``first`` and ``second``, ``(1, 3, height, width)`` in [0, 1] in the epipole frame; outputs ``inverse_depth``
    (× baseline) and ``confidence``, ``(1, 1, height, width)``. The size is fixed, as the volume's matrix is.
    """
    height, width = network.config.size
    image = torch.rand(1, 3, height, width)
    _export(network, (image, image), path, ["first", "second"])


def export_refine(network: RefineNetwork, path: Path) -> None:
    """Write ``network``, weights inside; the file is checked by ONNX.

    Input ``planes``, ``(1, planes, height, width)``; outputs as :func:`export_depth`. Height and width are free,
    multiples of ``network.config.size_multiple``.
    """
    side = 2 * network.config.size_multiple
    planes = torch.rand(1, network.config.planes, side, 2 * side)
    axes = {name: {2: "height", 3: "width"} for name in ("planes", *OUTPUTS)}
    _export(network, (planes,), path, ["planes"], axes)


def _export(
    network: DepthNetwork | RefineNetwork,
    example: tuple[Tensor, ...],
    path: Path,
    inputs: list[str],
    dynamic_axes: dict[str, dict[int, str]] | None = None,
) -> None:
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # the tracer's remarks on sizes, which are meant to be fixed
        torch.onnx.export(
            _DepthOutputs(network).eval(),
            example,
            str(path),
            input_names=inputs,
            output_names=list(OUTPUTS),
            dynamic_axes=dynamic_axes,
            opset_version=OPSET,
            external_data=False,
            dynamo=False,
        )
    onnx.checker.check_model(str(path), full_check=True)


def largest_difference(
    network: DepthNetwork | RefineNetwork, path: Path, examples: Iterable[tuple[Float32[np.ndarray, ...], ...]]
) -> float:
    """Between torch and ONNX Runtime over all outputs of all examples, relative to the largest value of each output.

    Args:
        network: that was exported.
        path: of the file.
        examples: the inputs of one run each, as the network takes them.
    """
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    names = [entry.name for entry in session.get_inputs()]
    outputs, worst = _DepthOutputs(network).eval(), 0.0
    for example in examples:
        with torch.no_grad():
            expected = [output.numpy() for output in outputs(*(torch.from_numpy(array) for array in example))]
        found = session.run(None, dict(zip(names, example, strict=True)))
        for one, other in zip(expected, found, strict=True):
            worst = max(worst, float(np.abs(one - other).max() / max(np.abs(one).max(), 1e-6)))
    return worst
