"""ONNX Runtime sessions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from omnisyn_cli.errors import InputError

__all__ = ["DEVICES", "open_session"]

DEVICES = ("auto", "cpu", "cuda")

PROVIDERS = {"cpu": "CPUExecutionProvider", "cuda": "CUDAExecutionProvider"}


def open_session(path: Path, *, device: str = "auto", threads: int | None = None) -> Any:
    """A session of the model at ``path``.

    Args:
        path: of the ONNX file.
        device: ``auto`` takes CUDA if this ONNX Runtime has it.
        threads: cap on the processor threads of one operation; None = all.

    Raises:
        InputError: unknown or absent device, or a file that ONNX Runtime cannot load.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    options.inter_op_num_threads = 1
    if threads is not None:
        options.intra_op_num_threads = threads
    providers = _providers(device, onnxruntime.get_available_providers())
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=providers)
    except Exception as error:
        raise InputError(f"expected an ONNX model in {path}, ONNX Runtime says: {error}") from error


def _providers(device: str, available: list[str]) -> list[str]:
    if device not in DEVICES:
        raise InputError(f"expected a device of {', '.join(DEVICES)}, got {device!r}")
    has_cuda = PROVIDERS["cuda"] in available
    if device == "cuda" and not has_cuda:
        raise InputError("expected CUDA, got an ONNX Runtime without it; install onnxruntime-gpu or use --device cpu")
    return [PROVIDERS["cuda"], PROVIDERS["cpu"]] if has_cuda and device != "cpu" else [PROVIDERS["cpu"]]
