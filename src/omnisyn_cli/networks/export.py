"""A trained network as one ONNX file, proven to say the same as torch."""

import warnings
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
from jaxtyping import Float32
from torch import Tensor, nn

from omnisyn_cli.networks.interface import Network

OPSET = 18  # Of ONNX; ONNX Runtime reads it since 1.14
PARITY = 1e-4  # Largest difference between torch and ONNX Runtime, relative to the largest value, that is accepted
MIN_HALVED_WEIGHTS = 1024  # Size of a tensor below which the cast costs more bytes than halves save


class _Outputs(nn.Module):
    """A network with the outputs that leave the program."""

    def __init__(self, network: Network) -> None:
        super().__init__()
        self.network = network

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        return self.network.outputs(*inputs)


def export_network(network: Network, path: Path) -> None:
    """Write ``network`` with the inputs and outputs of ``network.ports``, weights inside; ONNX checks the file."""
    ports = network.ports
    side = 2 * network.config.size_multiple
    size = ports.size or (side, 2 * side)
    free = {name: {2: "height", 3: "width"} for name in (*ports.inputs, *ports.outputs)}
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # the tracer's remarks on sizes, which are meant to be fixed
        torch.onnx.export(
            _Outputs(network).eval(), tuple(torch.rand(1, *shape) for shape in ports.input_shapes(size).values()),
            str(path), input_names=list(ports.inputs), output_names=list(ports.outputs),
            dynamic_axes=None if ports.size else free, opset_version=OPSET, external_data=False,
            do_constant_folding=ports.is_folded, dynamo=False,
        )  # fmt: skip
    model = onnx.load(str(path))
    onnx.helper.set_model_props(model, dict(ports.notes))
    _halve(model.graph)
    onnx.save(model, str(path))
    onnx.checker.check_model(str(path), full_check=True)


def _halve(graph: onnx.GraphProto) -> None:
    """Keep weights in half precision where nothing is lost (of compact checkpoints); they are cast back on use."""
    casts = []
    for weights in graph.initializer:
        if weights.data_type != onnx.TensorProto.FLOAT:
            continue
        values, name = onnx.numpy_helper.to_array(weights), weights.name
        with np.errstate(over="ignore"):
            halves = values.astype(np.float16)
        if values.size < MIN_HALVED_WEIGHTS or not np.array_equal(halves, values):
            continue
        weights.CopyFrom(onnx.numpy_helper.from_array(halves, f"{name}_half"))
        casts.append(onnx.helper.make_node("Cast", [f"{name}_half"], [name], to=onnx.TensorProto.FLOAT))
    nodes = [*casts, *graph.node]
    del graph.node[:]
    graph.node.extend(nodes)


def read_weights(path: Path) -> dict[str, Tensor]:
    """An exported network's weights by module name; linear layers come transposed, equal tensors are kept once."""
    graph = onnx.load(str(path)).graph
    arrays = {each.name.removesuffix("_half"): onnx.numpy_helper.to_array(each) for each in graph.initializer}
    for node in graph.node:
        if node.op_type == "Identity" and node.input[0] in arrays:
            arrays[node.output[0]] = arrays[node.input[0]]
        elif node.op_type == "MatMul" and node.input[1] in arrays:
            arrays[f"{_module_name(node.name)}.weight"] = arrays[node.input[1]].T
    return {name.removeprefix("network."): torch.tensor(array).float() for name, array in arrays.items()}


def _module_name(node: str) -> str:
    """``network.mlp.0`` of ``/network/mlp/mlp.0/MatMul``."""
    names: list[str] = []
    for name in node.strip("/").split("/")[:-1]:
        if names and name.startswith(f"{names[-1]}."):
            names.pop()
        names.append(name)
    return ".".join(names)


def largest_difference(
    network: Network, path: Path, examples: Iterable[tuple[Float32[np.ndarray, "..."], ...]]
) -> float:
    """Of torch and ONNX Runtime over all examples (inputs of a run), relative to the largest value of each output."""
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    names, worst = list(network.ports.inputs), 0.0
    for example in examples:
        with torch.no_grad():
            expected = [output.numpy() for output in network.outputs(*(torch.from_numpy(array) for array in example))]
        found = session.run(None, dict(zip(names, example, strict=True)))
        for one, other in zip(expected, found, strict=True):
            worst = max(worst, float(np.abs(one - other).max() / max(np.abs(one).max(), 1e-6)))
    return worst
