"""Compiles the kernels of frames on a GPU to PTX, without a GPU; prints the name and float64 instructions of each."""

import re
from types import SimpleNamespace
from typing import Any

import numba.cuda.dispatcher
import numpy as np
from numba import cuda, typeof
from simulated_gpu import between, pair_along, shares

from omnisyn_cli.fusion import residual
from omnisyn_cli.synthesis.device import frames
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.types import KnownDepth

SIZE = (64, 128)
compiled: list[Any] = []


def compile_kernel(kernel: Any, count: int | None, stream: Any, *arguments: Any) -> None:
    """In place of a launch."""
    if kernel in compiled:
        return
    compiled.append(kernel)
    types, is_fast = tuple(map(typeof, arguments)), kernel.targetoptions.get("fastmath", False)
    ptx, _ = cuda.compile_ptx(kernel.py_func, types, cc=(8, 0), fastmath=is_fast)
    doubles = re.findall(r"^\s+(?:@!?%p\d+ )?(?!ld|st|mov)[a-z0-9.]+\.f64", ptx, re.MULTILINE)
    print(kernel.py_func.__name__, len(doubles))


def main() -> None:
    numba.cuda.dispatcher.get_current_device = lambda: SimpleNamespace(compute_capability=(8, 0))
    residual.needs_no_network = lambda channels: False
    frames.allocate, frames.upload = np.zeros, lambda array, *where: np.array(array)
    frames.launch, frames.download = compile_kernel, lambda *arguments: None
    stream = SimpleNamespace(synchronize=lambda: None)
    frames.cuda = SimpleNamespace(stream=lambda: stream, pinned_array=np.zeros)
    views = pair_along("room", (0.0, 0.9, 0.05), SIZE)
    options, fuser = (
        SynthesisOptions(SIZE, threads=1, confidence=True),
        residual.ResidualFuser(SIZE, shares, 96, threads=1),
    )
    device = frames.DeviceFrames(options, fuser)
    pair = SurfaceMethod(KnownDepth(), options, fuser, device=device).prepare(0, views)
    pair.frame(between(views, 0.4), lambda: np.empty((*SIZE, 3), np.uint8))
    assert device.failure is None, device.failure


if __name__ == "__main__":
    main()
