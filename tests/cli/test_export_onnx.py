"""``omnisyn export-onnx``: with nothing it lists, with a checkpoint it writes beside it, and never over a model."""

from dataclasses import asdict
from pathlib import Path

import pytest
import torch

from cli.cli_samples import Omnisyn
from omnisyn_cli.runtime.models import read_manifest
from omnisyn_cli.training.checkpoint import save_checkpoint
from omnisyn_cli.training.tasks import TASKS


def write_checkpoint(path: Path, kind: str = "fusion", variant: str = "residual", step: int = 1200) -> None:
    """One of a run, whose network has random weights."""
    task = TASKS[kind]
    config = task.variants[variant]
    torch.manual_seed(0)
    network = task.build(config)
    state = {"kind": kind, "network": asdict(config), "training": {"size": (64, 128)}, "step": step}
    save_checkpoint(path, {**state, "average": network.state_dict()})


def test_without_a_checkpoint_those_are_listed_that_there_are(
    tmp_path: Path, omnisyn: Omnisyn, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In runs below this folder and in folders of checkpoints; what is no checkpoint is passed over."""
    monkeypatch.chdir(tmp_path)
    empty = omnisyn.quiet("export-onnx")
    assert empty.out.startswith("no checkpoints here\n")
    for kind, task in TASKS.items():
        assert f"    {kind}: {', '.join(task.variants)}" in empty.out
    write_checkpoint(tmp_path / "runs" / "one" / "checkpoint.pt")
    write_checkpoint(tmp_path / "models" / "checkpoints" / "kept.pt", step=7)
    (tmp_path / "photo.pt").write_bytes(b"no checkpoint")
    found = omnisyn.made("export-onnx")
    assert found.out.splitlines()[:3] == [
        "`omnisyn export-onnx PATH` writes one of these:",
        f"    {Path('models/checkpoints/kept.pt')}: fusion residual, 7 steps",
        f"    {Path('runs/one/checkpoint.pt')}: fusion residual, 1,200 steps",
    ]


def test_a_model_comes_to_lie_beside_its_checkpoint_and_over_no_other_one(tmp_path: Path, omnisyn: Omnisyn) -> None:
    write_checkpoint(tmp_path / "run" / "checkpoint.pt")
    model = tmp_path / "run" / "fusion-residual.onnx"
    words = ("export-onnx", tmp_path / "run" / "checkpoint.pt")
    assert omnisyn.made(*words).out.startswith(f"{model}: ")
    assert list(read_manifest(tmp_path / "run")) == ["fusion-residual"]
    model.write_bytes(b"mine")
    assert omnisyn.refused(*words).startswith(f"omnisyn: {model}: expected a new file, got one that exists")
    assert model.read_bytes() == b"mine"
    omnisyn.made(*words, "--overwrite")
    assert model.read_bytes() != b"mine"
