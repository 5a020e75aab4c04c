"""ONNX Runtime sessions."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.errors import InputError
from omnisyn_cli.runtime.models import find_model

DEVICES = ("auto", "cpu", "cuda")  # where users can ask for networks to run
DepthAnswer = tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]
MAX_COMPLAINT_CHARS = 300  # characters of what ONNX Runtime says that are passed on
PROVIDERS = {"cpu": "CPUExecutionProvider", "cuda": "CUDAExecutionProvider"}  # ONNX Runtime's names of them


def open_session(path: Path, *, device: str = "auto", threads: int | None = None, keeps_memory: bool = True) -> Any:
    """A session of the ONNX file at ``path``, with at most so many processor threads for one operation; None = all.

    ``auto`` takes CUDA if this ONNX Runtime has it. A session that gives its memory back after a run is a little
    slower. InputError: unknown or absent device, or a file that ONNX Runtime cannot load.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # who waits sleeps: a quarter less work
    options.enable_cpu_mem_arena = options.enable_mem_pattern = keeps_memory
    if threads is not None:
        options.intra_op_num_threads = threads
    chosen = providers(device)
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=chosen)
    except Exception as error:
        raise InputError(
            f"expected an ONNX model in {path}, ONNX Runtime says: {_short(error)}; name another file"
        ) from error


def open_model(name: str, *, device: str = "auto", threads: int | None = None, keeps_memory: bool = True) -> Any:
    """:func:`open_session` of a model of the manifest, by its name, or of an ONNX file; InputError: also not found."""
    return open_session(find_model(name), device=device, threads=threads, keeps_memory=keeps_memory)


def run_depth_network(session: Any, inputs: Mapping[str, np.ndarray], size: tuple[int, int]) -> DepthAnswer:
    """Inverse depth × baseline, finite and >= 0, and confidence in [0, 1]; InputError: as :func:`run_network`."""
    inverse_depth, confidence = (answer[0, 0] for answer in run_network(session, inputs, [(1, 1, *size)] * 2))
    if not (inverse_depth >= 0).all():
        raise InputError("expected a model whose inverse depths are not negative, got others; name another (--model)")
    return inverse_depth, np.clip(confidence, 0.0, 1.0)


def run_network(
    session: Any, inputs: Mapping[str, np.ndarray], shapes: Sequence[tuple[int, ...]] | None = None
) -> list[Float32[np.ndarray, "..."]]:
    """All outputs, finite and of these shapes (None: any). InputError: it refuses the inputs, or answers otherwise."""
    try:
        answers = session.run(None, dict(inputs))
    except Exception as error:
        height, width = (shapes[0] if shapes else next(iter(inputs.values())).shape)[-2:]
        raise InputError(
            f"expected a model that works on {width}×{height} pixels, ONNX Runtime says: {_short(error)}; "
            "name another (--model)"
        ) from error
    found = [np.shape(answer) for answer in answers]
    if shapes is not None and found != list(shapes):
        raise InputError(f"expected a model with outputs of {list(shapes)}, got {found}; name another (--model)")
    arrays = [np.asarray(answer, np.float32) for answer in answers]
    if not all(np.isfinite(array).all() for array in arrays):
        raise InputError("expected a model whose answers are finite, got others; name another (--model)")
    return arrays


def _short(error: Exception) -> str:
    return " ".join(f"{error!s:.{MAX_COMPLAINT_CHARS}}".split())


def providers(device: str) -> list[str]:
    """ONNX Runtime's names of what runs networks on a device, the first choice first. InputError: unknown or absent."""
    import onnxruntime

    if device not in DEVICES:
        raise InputError(f"expected a device of {', '.join(DEVICES)}, got {device!r}")
    has_cuda = PROVIDERS["cuda"] in onnxruntime.get_available_providers()
    if device == "cuda" and not has_cuda:
        raise InputError("expected CUDA, got an ONNX Runtime without it; install onnxruntime-gpu or use --device cpu")
    return [PROVIDERS["cuda"], PROVIDERS["cpu"]] if has_cuda and device != "cpu" else [PROVIDERS["cpu"]]
