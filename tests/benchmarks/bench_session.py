"""What ONNX Runtime's options are worth: ``python tests/benchmarks/bench_session.py [ROUNDS]``.

``models/completion-balanced.onnx`` on both evidence inputs of a pair of a generated room, 512×256 pixels each: levels
of graph optimisation, threads that sleep instead of spinning, memory that is not kept, both directions in one batch,
weights in NHWC order, and eight-bit convolutions calibrated on another pair. Computing time of the whole process (its
waiting threads included), all variants in turn, the best of the rounds counts; what the answers differ by is
the mean absolute difference of inverse depth × baseline, against ONNX Runtime's default.
"""

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnxruntime
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static
from onnxruntime.quantization.shape_inference import quant_pre_process

sys.path.insert(0, str(Path(__file__).parents[1]))

from confidence_samples import generated_views
from omnisyn_cli.runtime.models import find_model
from omnisyn_cli.stereo.matching_estimator import MatchingDepthEstimator, MatchingOptions
from omnisyn_cli.stereo.stereo_features import completion_channels

ROWS = 512
ROUNDS = 5
Run = Callable[[list[np.ndarray]], list[np.ndarray]]


def inputs(seed: int) -> list[np.ndarray]:
    """What the network is shown of a pair, one array for each direction."""
    views = generated_views("room", seed, 1.0, (256, 512))
    there, back = MatchingDepthEstimator(MatchingOptions(size=(ROWS, 2 * ROWS))).features(views[0], views[-1])
    return [completion_channels(a, b)[None].astype(np.float32) for a, b in ((there, back), (back, there))]


class Pairs(CalibrationDataReader):
    def __init__(self, given: list[np.ndarray]) -> None:
        self._left = list(given)

    def get_next(self) -> dict[str, np.ndarray] | None:
        return {"planes": self._left.pop()} if self._left else None


def session(path: Path, **changes: str | int) -> onnxruntime.InferenceSession:
    """A session with attributes of its options, or entries of its configuration, changed."""
    options = onnxruntime.SessionOptions()
    options.log_severity_level, options.inter_op_num_threads = 3, 1
    for name, value in changes.items():
        if "." in name:
            options.add_session_config_entry(name, str(value))
        else:
            setattr(options, name, value)
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def one_by_one(opened: onnxruntime.InferenceSession) -> Run:
    return lambda given: [opened.run(None, {"planes": planes})[0] for planes in given]


def together(opened: onnxruntime.InferenceSession) -> Run:
    return lambda given: list(opened.run(None, {"planes": np.concatenate(given)})[0][:, None])


def quantized(path: Path, folder: Path) -> Path:
    """The model with convolutions of 8 bits, calibrated on another pair."""
    prepared, small = folder / "prepared.onnx", folder / "int8.onnx"
    quant_pre_process(str(path), str(prepared), skip_symbolic_shape=True)
    quantize_static(
        str(prepared), str(small), Pairs(inputs(103)), quant_format=QuantFormat.QDQ, per_channel=True,
        activation_type=QuantType.QUInt8, weight_type=QuantType.QInt8, op_types_to_quantize=["Conv"],
    )  # fmt: skip
    return small


def variants(path: Path, folder: Path) -> dict[str, Run]:
    """By name, the default first; what this ONNX Runtime or this model cannot do is left out and said so."""
    levels = onnxruntime.GraphOptimizationLevel
    makers: dict[str, Callable[[], Run]] = {
        "default (all optimisations)": lambda: one_by_one(session(path)),
        "no optimisations": lambda: one_by_one(session(path, graph_optimization_level=levels.ORT_DISABLE_ALL)),
        "basic": lambda: one_by_one(session(path, graph_optimization_level=levels.ORT_ENABLE_BASIC)),
        "extended": lambda: one_by_one(session(path, graph_optimization_level=levels.ORT_ENABLE_EXTENDED)),
        "threads sleep": lambda: one_by_one(session(path, **{"session.intra_op.allow_spinning": 0})),
        "one thread": lambda: one_by_one(session(path, intra_op_num_threads=1)),
        "no memory arena": lambda: one_by_one(session(path, enable_cpu_mem_arena=False)),
        "subnormals are zero": lambda: one_by_one(session(path, **{"session.set_denormal_as_zero": 1})),
        "layout by MLAS (NHWC)": lambda: one_by_one(session(path, **{"mlas.enable_nhwc": 1})),
        "both directions in one batch": lambda: together(session(path)),
        "int8 convolutions": lambda: one_by_one(session(quantized(path, folder))),
    }
    found = {}
    for name, make in makers.items():
        try:
            found[name] = make()
        except Exception as error:  # noqa: BLE001 - whatever it is, the others can be measured
            print(f"{name}: not possible ({str(error).splitlines()[0][:100]})")
    return found


def measured(run: Run, given: list[np.ndarray]) -> tuple[float, float, list[np.ndarray]]:
    """Computing seconds, wall seconds and answers."""
    wall, computing = time.perf_counter(), time.process_time()
    answers = run(given)
    return time.process_time() - computing, time.perf_counter() - wall, answers


def main() -> None:
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else ROUNDS
    given = inputs(101)
    with tempfile.TemporaryDirectory() as folder:
        runs = variants(find_model("completion-balanced"), Path(folder))
        best = {name: (float("inf"), float("inf")) for name in runs}
        answers: dict[str, list[np.ndarray]] = {}
        for number in range(rounds + 1):
            for name, run in list(runs.items()):
                try:
                    computing, wall, answers[name] = measured(run, given)
                except Exception as error:  # noqa: BLE001 - a batch may be refused at its first run
                    print(f"{name}: not possible ({str(error).splitlines()[0][:100]})")
                    del runs[name]
                    continue
                if number:
                    best[name] = min(best[name][0], computing), min(best[name][1], wall)
    reference = next(iter(runs))
    print(f"{'':32}{'computing':>12}{'wall':>10}{'of default':>12}{'difference':>12}")
    for name in runs:
        gap = np.mean([np.abs(a - b).mean() for a, b in zip(answers[name], answers[reference], strict=True)])
        computing, wall = best[name]
        print(f"{name:32}{computing:10.3f} s{wall:8.3f} s{computing / best[reference][0]:12.2f}{gap:12.2g}")


if __name__ == "__main__":
    main()
