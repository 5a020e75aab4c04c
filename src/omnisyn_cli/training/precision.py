"""Where a network is trained, and in how many bits: bfloat16 where the machine multiplies in it, else single."""

from contextlib import AbstractContextManager
from dataclasses import dataclass

import torch

from omnisyn_cli.errors import InputError
from omnisyn_cli.pipeline.config import DEVICES

# Questions to :mod:`torch.cpu`, not all of which every version of torch knows: whether there are instructions that
# multiply in bfloat16. Without them torch imitates it, three times slower than single precision.
BF16_INSTRUCTIONS = ("_is_avx512_bf16_supported", "_is_amx_tile_supported")


@dataclass(frozen=True)
class Precision:
    """A device and its arithmetic."""

    device: torch.device  # that weights, batches and averages are on
    is_half: bool = False  # whether convolutions and products are computed in bfloat16; weights and losses never are

    def __str__(self) -> str:
        """As said to users."""
        return f"{self.device}, {'bfloat16' if self.is_half else 'single precision'}"

    def autocast(self) -> AbstractContextManager[object]:
        """To compute a loss in."""
        return torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=self.is_half)


def choose_precision(device: str = "auto") -> Precision:
    """``auto``: CUDA, else bfloat16 if the processor has it. InputError: unknown, or CUDA without a GPU."""
    if device not in DEVICES:
        raise InputError(f"expected a device of {', '.join(DEVICES)}, got {device!r}")
    has_cuda = torch.cuda.is_available()
    if device == "cuda" and not has_cuda:
        raise InputError("expected a CUDA GPU and a torch that can use it, got none; use --device cpu")
    if device != "cpu" and has_cuda:
        return Precision(torch.device("cuda"), is_half=torch.cuda.is_bf16_supported())
    multiplies = device == "auto" and any(getattr(torch.cpu, question, bool)() for question in BF16_INSTRUCTIONS)
    return Precision(torch.device("cpu"), is_half=multiplies)
