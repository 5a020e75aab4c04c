"""Where tensors live, by the names that users know."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from omnisyn_cli.errors import InputError, OmnisynError

__all__ = ["open_device"]


def open_device(name: str) -> torch.device:
    """``cuda``, or ``cpu`` for tests and comparisons.

    Raises InputError: an unknown name, or CUDA where torch sees none.
    """
    if name not in ("cuda", "cpu"):
        raise InputError(f"expected a device of cuda, cpu, got {name!r}")
    if name == "cuda" and not torch.cuda.is_available():
        raise InputError(
            f"expected CUDA, got a PyTorch ({torch.__version__}) that sees none; install its CUDA build and a driver, "
            "or use --device cpu"
        )
    return torch.device(name)


@contextmanager
def report_out_of_memory() -> Iterator[None]:
    """Say in a line that the device has no memory left for what happens inside.

    Raises OmnisynError: there is none left.
    """
    try:
        yield
    except torch.OutOfMemoryError as error:
        raise OmnisynError(
            "expected enough memory on the GPU, got none left; try a smaller --size or --device cpu"
        ) from error
