"""``--device cuda`` from the command to the files, made here with the processor as the device."""

import re
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from gpu_samples import pair_along, share_within_a_level

from interpolation_samples import CHAIN, job_of
from omnisyn_cli.cli import main
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.interpolation.plan import plan_interpolation, with_preset
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.io import read_panorama
from omnisyn_cli.pipeline.methods import METHODS
from omnisyn_cli.synthesis.device import pair
from omnisyn_cli.synthesis.device.pair import GpuFrames
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import synthesize
from omnisyn_cli.synthesis.trajectory import Waypoint, plan_path
from omnisyn_cli.types import KnownDepth
from synthesis_samples import hall_view, posed, write_hall

SIZE = (64, 128)


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[GpuFrames]:
    """What is opened where a GPU is asked for."""
    made: list[GpuFrames] = []

    def opening(size: tuple[int, int]) -> GpuFrames:
        made.append(GpuFrames(size, "cpu"))
        return made[-1]

    monkeypatch.setattr(pair, "GpuFrames", opening)
    return made


@pytest.mark.parametrize("changes", [{}, {"codec": "exr"}], ids=["8 bits", "numbers"])
def test_files_agree_with_those_of_the_processor(
    tmp_path: Path, opened: list[GpuFrames], changes: dict[str, object]
) -> None:
    """A chain of three, photographs among the frames; the surfaces of the second pair are not those of the first."""
    images = write_hall(tmp_path, CHAIN)
    written = {}
    for device in ("cpu", "cuda"):
        job = job_of(tmp_path, images, frames=9, device=device, output=tmp_path / device, **changes)
        summary = run_interpolation(plan_interpolation(job))
        written[device] = [read_panorama(path) for path in sorted((tmp_path / device).iterdir())]
        assert len(summary.made.triangles) == 2
    assert len(opened) == 1
    for found, expected in zip(written["cuda"], written["cpu"], strict=True):
        assert share_within_a_level(found.image, expected.image) >= 0.99
    for index in (0, 4, 8):
        np.testing.assert_array_equal(written["cuda"][index].image, written["cpu"][index].image)


def test_only_cuda_by_name_and_what_a_gpu_does_open_one(tmp_path: Path, opened: list[GpuFrames]) -> None:
    images = write_hall(tmp_path, CHAIN[:2], (16, 32))
    others = (
        {"device": "auto"}, {"device": "cpu"}, {"renderer": "two-pass"},
        {"fallback": "crossfade"}, {"save_confidence": tmp_path / "confidence"},
    )  # fmt: skip
    for number, changes in enumerate(others):
        job = job_of(tmp_path, images, output=tmp_path / f"out{number}", **{"device": "cuda", **changes})
        run_interpolation(plan_interpolation(job))
    assert opened == []


@pytest.mark.parametrize(
    ("changes", "noted"),
    [
        ({}, None),
        ({"adaptive": True}, r"every triangle is drawn, --adaptive changes nothing"),
        ({"renderer": "two-pass"}, r"on the processor: .*; this job has the renderer two-pass$"),
        ({"fusion": "network"}, r"on the processor: .*; this job has the fusion network$"),
        ({"fallback": "crossfade", "renderer": "two-pass"}, r"has the renderer two-pass, cross-fades \(.*\)$"),
        ({"save_confidence": Path("map")}, r"has confidence maps \(--save-confidence\)$"),
    ],
)
def test_the_plan_says_what_the_gpu_does_not_do(tmp_path: Path, changes: dict[str, object], noted: str | None) -> None:
    images = write_hall(tmp_path, CHAIN[:2], (16, 32))
    if "save_confidence" in changes:
        changes = {"save_confidence": tmp_path / "map"}
    plan = plan_interpolation(job_of(tmp_path, images, device="cuda", **changes))
    assert plan.config.is_on_gpu == (noted is None or "adaptive" in noted)
    if noted is None:
        assert plan.notes == ()
    else:
        (note,) = plan.notes
        assert re.search(noted, note)
    without = plan_interpolation(job_of(tmp_path, images, **changes))
    assert not without.config.is_on_gpu
    assert without.notes == ()


def test_notes_follow_the_preset(tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN[:2], (16, 32), with_depth=False)
    plan = plan_interpolation(job_of(tmp_path, images, device="cuda", preset="paper"))
    assert not plan.config.is_on_gpu
    assert len(plan.notes) == 1
    faster = with_preset(plan, "fast")
    assert faster.config.is_on_gpu
    assert faster.notes == ()
    assert with_preset(faster, "paper").notes == plan.notes


def test_a_gpu_fuses_by_rules_where_only_the_preset_has_a_network(tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN[:2], (16, 32), with_depth=False)
    plan, asked, elsewhere = (
        plan_interpolation(job_of(tmp_path, images, device="cuda", preset="balanced", **changes))
        for changes in ({}, {"fusion": "network"}, {"save_confidence": tmp_path / "map"})
    )
    assert (plan.config.is_on_gpu, plan.config.fusion) == (True, "geometric")
    assert re.search(r"fuses by rules; --fusion network .* as preset balanced does$", plan.notes[0])
    assert (asked.config.is_on_gpu, asked.config.fusion) == (False, "network")
    assert (elsewhere.config.is_on_gpu, elsewhere.config.fusion) == (False, "network")


def test_other_methods_have_nothing_to_do_with_it(tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN[:2], (16, 32), with_depth=False)
    for method in (name for name, each in METHODS.items() if each.is_offered and not each.draws_surfaces):
        assert not plan_interpolation(job_of(tmp_path, images, device="cuda", method=method)).config.is_on_gpu


@pytest.mark.parametrize("more", [[], ["--dry-run"], ["--dry-run", "--renderer", "two-pass", "--depth", "refined"]])
def test_cuda_that_is_not_there_is_code_3_and_one_line(
    tmp_path: Path, more: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: ["CPUExecutionProvider"])
    images = write_hall(tmp_path, CHAIN[:2], (16, 32))
    arguments = [*map(str, images), "--poses", str(tmp_path / "poses.json"), "-o", str(tmp_path / "out")]
    with pytest.raises(SystemExit) as ended:
        main(["interpolate", *arguments, "--device", "cuda", "--frames", "3", *more])
    assert ended.value.code == 3
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_samples_go_into_the_memory_that_is_given() -> None:
    """One frame looks the same as the one before: it is copied, into memory of its own."""
    views = [hall_view(posed((0.0, 0.0, z)), SIZE) for z in (0.5, -0.5)]
    path = [Waypoint(0, t, posed((0.0, 0.0, 0.5 - t))) for t in (0.3, 0.3001, 0.6)]
    ring = [np.zeros((*SIZE, 3), np.uint8) for _ in path]
    method = SurfaceMethod(KnownDepth(), SynthesisOptions(SIZE, threads=1), device=GpuFrames(SIZE, "cpu"))
    images = [frame.image for frame in synthesize(views, path, method, iter(ring).__next__)]
    assert [image is memory for image, memory in zip(images, ring, strict=True)] == [True] * 3
    np.testing.assert_array_equal(images[0], images[1])
    assert (images[1] != images[2]).mean() > 0.1


def test_masked_photographs_are_painted_over_first() -> None:
    """What lies beneath a mask shows nowhere, on the device as on the processor."""
    first, second = pair_along("room", (0.0, 0.3, -0.5), SIZE)
    mask = np.ones(SIZE, bool)
    mask[40:] = False
    image = np.where(mask[..., None], first.image, np.float32([1.0, 0.0, 1.0]))
    views = [type(first)(image, first.pose, mask, first.known_depth), second]
    path = plan_path([first.pose, second.pose], 3)
    frames: dict[str, list[np.ndarray]] = {}
    for name, device in (("cpu", None), ("gpu", GpuFrames(SIZE, "cpu"))):
        fuser = GeometricFuser(SIZE, threads=1, edges=False)
        method = SurfaceMethod(KnownDepth(), SynthesisOptions(SIZE, threads=1), fuser, device=device)
        frames[name] = [frame.image.copy() for frame in synthesize(views, path, method)]
        assert (method.prepare(0, views).prepared.on_device is None) == (device is None)
    for found, expected in zip(frames["gpu"], frames["cpu"], strict=True):
        assert share_within_a_level(found, expected) >= 0.995
