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
from omnisyn_cli.networks.fusion import FusionNetwork, PaintingNetwork
from omnisyn_cli.networks.paper import PaperNetwork
from omnisyn_cli.networks.refine import RefineNetwork
from omnisyn_cli.networks.synsin import FeatureEncoder, MonocularNetwork, RefinementDecoder, inverse_depth_of

__all__ = ["OPSET", "PARITY", "export_depth", "export_fusion", "export_refine", "export_synsin", "largest_difference"]

OPSET = 18

OUTPUTS = ("inverse_depth", "confidence")

PARITY = 1e-4
"""Largest difference between torch and ONNX Runtime, relative to the largest value, that is accepted."""


SynSinPart = MonocularNetwork | FeatureEncoder | RefinementDecoder

Network = DepthNetwork | PaperNetwork | RefineNetwork | FusionNetwork | PaintingNetwork | SynSinPart


class _DepthOutputs(nn.Module):
    """A depth network with the outputs that leave the program: inverse depth × baseline, and confidence."""

    def __init__(self, network: DepthNetwork | PaperNetwork | RefineNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, *inputs: Tensor) -> tuple[Tensor, Tensor]:
        prediction = self.network(*inputs)
        return prediction.inverse_depth(), prediction.confidence()


def export_depth(network: DepthNetwork | PaperNetwork, path: Path) -> None:
    """Write ``network`` at its configured size, weights inside; the file is checked by ONNX.

    Inputs ``first`` and ``second``, ``(1, 3, height, width)`` in [0, 1] in the frame that the metadata ``frame`` names;
    outputs ``inverse_depth`` (× baseline) and ``confidence``, ``(1, 1, height, width)``. The size is fixed, as the
    sweep is.
    """
    height, width = network.config.size
    image = torch.rand(1, 3, height, width)
    _export(network, (image, image), path, ["first", "second"])
    model = onnx.load(str(path))
    onnx.helper.set_model_props(model, {"frame": network.frame})
    onnx.save(model, str(path))


def export_refine(network: RefineNetwork, path: Path) -> None:
    """Write ``network``, weights inside; the file is checked by ONNX.

    Input ``planes``, ``(1, planes, height, width)``; outputs as :func:`export_depth`. Height and width are free,
    multiples of ``network.config.size_multiple``.
    """
    side = 2 * network.config.size_multiple
    planes = torch.rand(1, network.config.planes, side, 2 * side)
    axes = {name: {2: "height", 3: "width"} for name in ("planes", *OUTPUTS)}
    _export(network, (planes,), path, ["planes"], axes)


class _FusionOutputs(nn.Module):
    """A fusion network with plain outputs: shift and colour, or the colours that it paints."""

    def __init__(self, network: FusionNetwork | PaintingNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, planes: Tensor) -> tuple[Tensor, ...]:
        answer = self.network(planes)
        return (answer,) if isinstance(answer, Tensor) else (answer.shift, answer.colour)


def export_fusion(network: FusionNetwork | PaintingNetwork, path: Path) -> None:
    """Write ``network``, weights inside; the file is checked by ONNX.

    Input ``planes``, ``(1, planes, height, width)``; outputs ``shift`` ``(1, 1, height, width)`` and ``colour``
    ``(1, 3, height, width)``, of a network that paints ``colour`` alone. Height and width are free, multiples of
    ``network.config.size_multiple``.
    """
    side = 2 * network.config.size_multiple
    planes = torch.rand(1, network.config.planes, side, 2 * side)
    outputs = ("colour",) if network.config.paints else ("shift", "colour")
    axes = {name: {2: "height", 3: "width"} for name in ("planes", *outputs)}
    _export(network, (planes,), path, ["planes"], axes, outputs)


class _SynSinOutput(nn.Module):
    """One of SynSin's networks with its only output; roots of inverse depth leave the program squared."""

    def __init__(self, network: SynSinPart) -> None:
        super().__init__()
        self.network = network

    def forward(self, x: Tensor) -> tuple[Tensor]:
        answer = self.network(x)
        is_depth = isinstance(self.network, MonocularNetwork)
        return (inverse_depth_of(answer, self.network.config) if is_depth else answer,)


SYNSIN_NAMES = {
    MonocularNetwork: ("image", "inverse_depth"),
    FeatureEncoder: ("image", "features"),
    RefinementDecoder: ("points", "colour"),
}
"""Input and output of its files."""


def export_synsin(network: SynSinPart, path: Path) -> None:
    """Write one of SynSin's networks at its configured size, weights inside; the file is checked by ONNX.

    ``image`` ``(1, 3, height, width)`` in [0, 1], upright, becomes ``inverse_depth`` ``(1, 1, height, width)`` in 1/m,
    or ``features``; ``points``, blended features and their opacity, become ``colour`` ``(1, 3, height, width)``. The
    metadata ``radius`` and ``points`` say how wide points are, in rows, and how many a pixel is made of.
    """
    config, (taken, given) = network.config, SYNSIN_NAMES[type(network)]
    channels = config.features + 1 if taken == "points" else 3
    _export(network, (torch.rand(1, channels, *config.size),), path, [taken], outputs=(given,))
    model = onnx.load(str(path))
    onnx.helper.set_model_props(model, {"radius": repr(config.radius), "points": str(config.points)})
    onnx.save(model, str(path))


def _with_outputs(network: Network) -> nn.Module:
    """A network with the outputs that leave the program."""
    if isinstance(network, FusionNetwork | PaintingNetwork):
        return _FusionOutputs(network).eval()
    if isinstance(network, MonocularNetwork | FeatureEncoder | RefinementDecoder):
        return _SynSinOutput(network).eval()
    return _DepthOutputs(network).eval()


def _export(
    network: Network,
    example: tuple[Tensor, ...],
    path: Path,
    inputs: list[str],
    dynamic_axes: dict[str, dict[int, str]] | None = None,
    outputs: tuple[str, ...] = OUTPUTS,
) -> None:
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # the tracer's remarks on sizes, which are meant to be fixed
        torch.onnx.export(
            _with_outputs(network),
            example,
            str(path),
            input_names=inputs,
            output_names=list(outputs),
            dynamic_axes=dynamic_axes,
            opset_version=OPSET,
            external_data=False,
            do_constant_folding=not isinstance(network, PaperNetwork),  # its sweep would be written out, and twice
            dynamo=False,
        )
    onnx.checker.check_model(str(path), full_check=True)


def largest_difference(network: Network, path: Path, examples: Iterable[tuple[Float32[np.ndarray, ...], ...]]) -> float:
    """Between torch and ONNX Runtime over all outputs of all examples, relative to the largest value of each output.

    Args:
        network: that was exported.
        path: of the file.
        examples: the inputs of one run each, as the network takes them.
    """
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    names = [entry.name for entry in session.get_inputs()]
    outputs, worst = _with_outputs(network), 0.0
    for example in examples:
        with torch.no_grad():
            expected = [output.numpy() for output in outputs(*(torch.from_numpy(array) for array in example))]
        found = session.run(None, dict(zip(names, example, strict=True)))
        for one, other in zip(expected, found, strict=True):
            worst = max(worst, float(np.abs(one - other).max() / max(np.abs(one).max(), 1e-6)))
    return worst
