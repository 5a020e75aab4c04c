"""Frames on a GPU: kernels show what the processor shows; a run without a GPU, or with a failing one, goes on."""

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from omnisyn_cli.errors import InputError
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.interpolation import configs
from omnisyn_cli.pipeline.config import RunConfig
from omnisyn_cli.synthesis import device
from omnisyn_cli.synthesis.device import frames
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import synthesize
from omnisyn_cli.synthesis.trajectory import plan_path
from omnisyn_cli.types import KnownDepth
from synthesis_samples import SIZE, hall_view, posed

HERE = Path(__file__).parent
CASES = (
    "plain", "room", "exposure", "ghosts", "holes", "faded masks", "edges", "adaptive", "confidence", "cross-fade",
    "flat", "network", "one place", "numbers",
)  # fmt: skip


def run(script: str, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, HERE / script], env={**os.environ, **environment}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def simulated() -> dict[str, dict[str, float]]:
    """What ``simulated_gpu.py`` found; the simulator has to be chosen before numba is imported."""
    found = json.loads(run("simulated_gpu.py", NUMBA_ENABLE_CUDASIM="1").splitlines()[-1])
    assert set(found) == set(CASES)
    return found


@pytest.mark.parametrize("case", CASES)
def test_kernels_show_what_the_processor_shows(simulated: dict[str, dict[str, float]], case: str) -> None:
    """A thousandth of the pixels may differ by more than 1/255; what is tested changes more of them by far."""
    assert simulated[case]["beyond"] <= 0.001
    assert simulated[case]["changed"] > 0.005


def test_maps_of_confidence_agree(simulated: dict[str, dict[str, float]]) -> None:
    assert simulated["confidence"]["confidence"] < 0.002


@pytest.mark.skipif(find_spec("numba_cuda") is None, reason="numba-cuda is not installed")
def test_every_kernel_compiles_for_a_gpu() -> None:
    """To PTX, which needs no GPU; colours and the tests of rays have no float64, setups of quads may."""
    lines = [line.split() for line in run("compiled_gpu.py").splitlines()]
    assert {name for name, _ in lines} == {
        "clear", "draw", "draw_listed", "shade_grid", "blend", "pull", "fill", "mark_edges", "supersample",
        "mix_candidates",
    }  # fmt: skip
    assert {name for name, doubles in lines if int(doubles)} == {"draw", "draw_listed"}


@pytest.fixture
def without_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device, "find_spec", lambda name: None)


@pytest.mark.usefixtures("without_gpu")
def test_without_a_gpu_the_processor_makes_frames_unless_cuda_is_asked_for() -> None:
    assert not device.has_device("cpu")
    assert not device.has_device("auto")
    with pytest.raises(InputError, match=r"got no numba-cuda; install 'omnisyn-cli\[cuda\]', or use --device cpu"):
        device.has_device("cuda")


def test_what_runs_on_the_processor_all_the_same_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(configs, "has_device", lambda name: True)
    monkeypatch.setattr(configs, "providers", lambda name: ["CPUExecutionProvider"])
    painting = RunConfig(fusion="painting", device="cuda")
    network = RunConfig(fusion="network", device="cuda")
    assert "networks run on the processor" in configs.check_device(network, makes_frames=True)[0]
    assert "frames are made on the processor" in configs.check_device(painting, makes_frames=True)[0]
    assert configs.check_device(RunConfig(device="auto", fusion="painting"), makes_frames=True) == ()


@pytest.mark.usefixtures("without_gpu")
def test_nothing_is_refused_for_a_gpu_that_no_frame_needs() -> None:
    assert configs.check_device(RunConfig(device="cuda")) == ()  # no frames and no network
    with pytest.raises(InputError, match="expected a GPU for the frames"):
        configs.check_device(RunConfig(device="cuda"), makes_frames=True)


def test_the_processor_goes_on_when_a_gpu_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    views = [hall_view(posed((0.0, 0.0, z))) for z in (0.0, 1.0)]
    path = plan_path([view.pose for view in views], 6)[1:-1]
    options, fuser = SynthesisOptions(SIZE, threads=1), GeometricFuser(SIZE, threads=1)
    failing = frames.DeviceFrames(options, fuser)

    def fail(*arguments: object) -> None:
        raise MemoryError("none left\nat address 0")

    monkeypatch.setattr(frames, "upload_view", fail)
    found, expected = (
        [
            frame.image.copy()
            for frame in synthesize(views, path, SurfaceMethod(KnownDepth(), options, fuser, device=used))
        ]
        for used in (failing, None)
    )
    np.testing.assert_array_equal(found, expected)
    assert failing.failure == "MemoryError: none left"
