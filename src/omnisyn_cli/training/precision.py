"""Where a network is trained, and in how many bits: single precision on a processor, bfloat16 where a GPU has it."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass

import torch

from omnisyn_cli.errors import InputError

__all__ = ["DEVICES", "Precision", "choose_precision"]

DEVICES = ("auto", "cpu", "cuda")


@dataclass(frozen=True)
class Precision:
    """A device and its arithmetic.

    Attributes:
        device: that weights, batches and averages are on.
        is_half: whether convolutions and products are computed in bfloat16; weights and losses never are.
    """

    device: torch.device
    is_half: bool = False

    def autocast(self) -> AbstractContextManager[object]:
        """To compute a loss in."""
        return torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=self.is_half)


def choose_precision(device: str = "auto") -> Precision:
    """What to train with.

    bfloat16 has the range of single precision, so no loss needs scaling; on a processor it gains nothing.

    Args:
        device: one of :data:`DEVICES`; ``auto`` is CUDA where there is a GPU.

    Raises:
        InputError: an unknown device, or CUDA was asked for and there is none.
    """
    if device not in DEVICES:
        raise InputError(f"expected a device of {', '.join(DEVICES)}, got {device!r}")
    has_cuda = torch.cuda.is_available()
    if device == "cuda" and not has_cuda:
        raise InputError("expected a CUDA GPU and a torch that can use it, got none; use --device cpu")
    if device == "cpu" or not has_cuda:
        return Precision(torch.device("cpu"))
    return Precision(torch.device("cuda"), is_half=torch.cuda.is_bf16_supported())
