"""A device that is not there is refused; on one that is there, nothing is ever mixed with what is on the processor."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import torch
from array_api_compat import torch as torch_arrays
from gpu_samples import BRIGHTER, POSES, rough
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.fx.experimental.symbolic_shapes import ShapeEnv
from torch.utils._python_dispatch import _disable_current_modes

from omnisyn_cli.errors import InputError, OmnisynError
from omnisyn_cli.fusion import ghosts
from omnisyn_cli.synthesis.device import pair as frames
from omnisyn_cli.synthesis.device.device import open_device
from omnisyn_cli.synthesis.device.pair import GpuFrames
from omnisyn_cli.synthesis.device.raster import GpuRasterizer, _Boxes
from omnisyn_cli.types import DepthEstimate

SIZE = (32, 64)

ELSEWHERE = torch.device("meta")
"""Inside of :class:`FakeTensorMode` a device like any other, whose tensors have shapes and no numbers."""


def test_cuda_that_is_not_there_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(
        InputError, match=r"expected CUDA, got a PyTorch \(.*\) that sees none; install .* --device cpu"
    ):
        GpuFrames(SIZE)


def test_devices_have_names() -> None:
    assert open_device("cpu") == torch.device("cpu")
    with pytest.raises(InputError, match="expected a device of cuda, cpu, got 'auto'"):
        open_device("auto")


def test_a_device_that_is_full_is_said_in_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB.")

    made, depth = GpuFrames(SIZE, "cpu"), DepthEstimate(rough(16, 32), np.ones((16, 32), np.float32))
    surface = made.surface(np.zeros((*SIZE, 3), np.float32), None, depth)
    monkeypatch.setattr(made.rasterizer, "_draw", full)
    monkeypatch.setattr(frames, "quads_of", full)
    with pytest.raises(OmnisynError, match="expected enough memory on the GPU, got none left; try a smaller --size"):
        made.pair(surface, surface, BRIGHTER).frame(POSES["any"], POSES["up"], 0.4, np.zeros((*SIZE, 3), np.uint8))
    with pytest.raises(OmnisynError, match="expected enough memory on the GPU"):
        made.surface(np.zeros((*SIZE, 3), np.float32), None, depth)


def some_candidates(self: GpuRasterizer, boxes: _Boxes, is_seen: torch.Tensor) -> Iterator[tuple[torch.Tensor, ...]]:
    """As many as is known beforehand, because how many there are is a number."""
    ends = torch.where(is_seen, boxes.rows * boxes.cols, 0).cumsum(0)
    quad = torch.searchsorted(ends, torch.arange(50, device=self.device), right=True)
    yield quad, boxes.row[quad], boxes.col[quad]


@pytest.fixture
def elsewhere(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Tensors without numbers, on the processor or elsewhere; operations on both at once raise an error."""
    mode, real = FakeTensorMode(shape_env=ShapeEnv()), torch.from_numpy

    def from_numpy(array: np.ndarray) -> torch.Tensor:
        with _disable_current_modes():
            tensor = real(np.ascontiguousarray(array))
        return mode.from_tensor(tensor, static_shapes=True)

    def as_tensor(array: np.ndarray, dtype: Any = None, device: Any = "cpu") -> torch.Tensor:
        tensor = from_numpy(array)
        return tensor.to(device, dtype or tensor.dtype)

    answers = iter([True, False])  # something is a ghost; its region does not grow

    def is_any(mask: torch.Tensor) -> bool:
        assert mask.device == ELSEWHERE
        return next(answers)

    def sums(labels: torch.Tensor, votes: torch.Tensor) -> torch.Tensor:
        return votes.new_zeros(SIZE[0] * SIZE[1]).scatter_add(0, labels, votes)

    replacements: list[tuple[Any, str, Callable[..., Any]]] = [
        (torch, "from_numpy", from_numpy), (torch, "as_tensor", as_tensor), (torch_arrays, "asarray", as_tensor),
        (torch_arrays, "bincount", sums), (ghosts, "is_any", is_any),
        (GpuRasterizer, "_candidates", some_candidates), (frames, "open_device", lambda _: ELSEWHERE),
    ]  # fmt: skip
    for owner, name, replacement in replacements:
        monkeypatch.setattr(owner, name, replacement)
    with mode:
        yield


@pytest.mark.usefixtures("elsewhere")
def test_everything_from_surfaces_to_samples_is_done_on_the_device() -> None:
    """With masks, cuts, caps, other exposures, ghosts and holes; the frame is the only thing that is copied."""
    made, rng = GpuFrames(SIZE), np.random.default_rng(1)
    image, mask, rho = rng.random((*SIZE, 3), np.float32), rng.random(SIZE) > 0.1, rough(16, 32)
    depth = DepthEstimate(rho, np.ones_like(rho))
    pair = made.pair(made.surface(image, mask, depth), made.surface(np.uint8(image * 255), None, depth), BRIGHTER)
    pair.frame(POSES["any"], POSES["up"], 0.4, np.zeros((*SIZE, 3), np.uint8))
    tensors = [pair._nearest, pair.surfaces[0].quads.corner, pair.surfaces[1].texture.texels, made.rays(slice(0, 2))]
    assert {tensor.device for tensor in tensors} == {ELSEWHERE}


@pytest.mark.usefixtures("elsewhere")
def test_a_mixture_would_be_noticed() -> None:
    with pytest.raises(RuntimeError, match="same device"):
        GpuFrames(SIZE).rays(slice(0, 2)) + torch.ones(3)
