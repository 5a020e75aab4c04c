"""The shipped completion network in half precision, with weights of bfloat16, and quantised to 8 bits, against float32.

What counts is what becomes of the video: WS-PSNR of the middle frame of a room with known truth.
"""

import copy
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import onnx
import pytest
from onnx import TensorProto, numpy_helper

from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.runtime.image_networks import CompletionSession
from omnisyn_cli.runtime.models import find_model, models_folder
from omnisyn_cli.runtime.session import open_session
from omnisyn_cli.scenes import generate_scene, render_panorama, sample_path
from omnisyn_cli.stereo.matching_estimator import MatchingDepthEstimator, MatchingOptions
from omnisyn_cli.stereo.refined_estimator import RefinedDepthEstimator
from omnisyn_cli.stereo.stereo_features import StereoFeatures, completion_channels
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import View
from synthesis_samples import ws_psnr

MODEL = "completion-balanced"
SIZE = (128, 256)
pytestmark = pytest.mark.skipif(
    not (models_folder() / f"{MODEL}.onnx").is_file(), reason=f"the model {MODEL} is not in this checkout"
)


@dataclass(frozen=True)
class Room:
    """Two views of a room, what matching makes of them, and the true picture half way."""

    views: tuple[View, View]
    features: tuple[StereoFeatures, StereoFeatures]
    truth: np.ndarray
    middle: Pose


@pytest.fixture(scope="module")
def room() -> Room:
    scene = generate_scene("room", 101)
    path = sample_path(scene, 101, 3)
    seen = [render_panorama(scene, pose, SIZE, supersample=2, threads=1)[0] for pose in path]
    first, second = (View(np.asarray(seen[at], np.float32), path[at]) for at in (0, 2))
    matching = MatchingDepthEstimator(MatchingOptions(size=(2 * SIZE[0], 2 * SIZE[1])), 1)
    return Room((first, second), matching.features(first, second), np.asarray(seen[1]), path[1])


def planes(room: Room) -> list[np.ndarray]:
    there, back = room.features
    return [completion_channels(there, back), completion_channels(back, there)]


def quality(room: Room, path: Path) -> tuple[np.ndarray, float]:
    """Inverse depth × baseline of the first panorama, and WS-PSNR of the middle frame, by a model file."""
    refinement = CompletionSession(open_session(path, device="cpu", threads=1))
    matching = SimpleNamespace(threads=None, features=lambda *_: room.features)  # its answer is known
    estimator = RefinedDepthEstimator(matching, refinement, 0)
    waypoint = Waypoint(0, 0.5, room.middle)
    pair = SurfaceMethod(estimator, SynthesisOptions(SIZE, threads=1)).prepare(0, room.views)
    picture = pair.frame(waypoint).image
    return refinement(planes(room)[0])[0], ws_psnr(picture, room.truth)


def in_single(source: Path) -> onnx.ModelProto:
    """The model with its weights in float32: shipped files hold halves, which are cast when they are opened."""
    model = copy.deepcopy(onnx.load(source))
    casts = {node.input[0]: node for node in model.graph.node if node.op_type == "Cast"}
    for tensor in model.graph.initializer:
        if tensor.data_type == TensorProto.FLOAT16:
            cast = casts[tensor.name]
            weights = numpy_helper.to_array(tensor).astype(np.float32)
            tensor.CopyFrom(numpy_helper.from_array(weights, cast.output[0]))
            model.graph.node.remove(cast)
    return model


def half(source: Path, target: Path, room: Room) -> None:
    """Weights and arithmetic in float16, inputs and outputs in float32."""
    from onnxruntime.transformers.float16 import convert_float_to_float16

    onnx.save(convert_float_to_float16(in_single(source), keep_io_types=True), target)


def brain_float(source: Path, target: Path, room: Room) -> None:
    """Weights rounded to bfloat16, arithmetic in float32: ONNX Runtime's processor kernels know no other."""
    model = in_single(source)
    for tensor in model.graph.initializer:
        if tensor.data_type == TensorProto.FLOAT:
            bits = numpy_helper.to_array(tensor).view(np.uint32).astype(np.uint64)
            rounded = ((bits + 0x7FFF + ((bits >> 16) & 1)) & 0xFFFF0000).astype(np.uint32)
            tensor.CopyFrom(numpy_helper.from_array(rounded.view(np.float32), tensor.name))
    onnx.save(model, target)


def integers(source: Path, target: Path, room: Room) -> None:
    """Weights and activations of convolutions in 8 bits, ranges measured on the room itself."""
    from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static

    class Reader(CalibrationDataReader):  # type: ignore[misc]
        def __init__(self) -> None:
            self._rest: Iterator[dict[str, np.ndarray]] = iter({"planes": p[None]} for p in planes(room))

        def get_next(self) -> dict[str, np.ndarray] | None:
            return next(self._rest, None)

    quantize_static(
        in_single(source), target, Reader(), quant_format=QuantFormat.QDQ, per_channel=True,
        weight_type=QuantType.QInt8, activation_type=QuantType.QUInt8, op_types_to_quantize=["Conv"],
    )  # fmt: skip


# How to make each, and what it may cost: median relative error of inverse depth, decibels of the picture.
FORMS = {"fp16": (half, 0.003, 0.1), "bf16": (brain_float, 0.003, 0.1), "int8": (integers, 0.02, 0.3)}


@pytest.mark.parametrize("form", FORMS)
def test_other_number_formats_cost_no_more_than_documented(form, room, tmp_path, record_property) -> None:
    source, target = find_model(MODEL), tmp_path / f"{form}.onnx"
    make, most_relative, most_decibels = FORMS[form]
    make(source, target, room)
    depth, decibels = quality(room, source)
    other_depth, other_decibels = quality(room, target)
    relative = float(np.median(np.abs(other_depth - depth) / np.maximum(depth, 1e-3)))
    size = target.stat().st_size
    figures = {"form": form, "relative": relative, "fp32": decibels, "other": other_decibels, "bytes": size}
    record_property("figures", json.dumps(figures))
    print(figures)
    assert relative < most_relative
    assert other_decibels > decibels - most_decibels
