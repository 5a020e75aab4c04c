"""No room left, and nobody who listens: one clear line, and what was there before is still there."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from stability_samples import visible_files

from cli.cli_samples import Omnisyn
from omnisyn_cli.errors import WriteError
from process_limits import file_size_limit
from synthesis_samples import posed, write_hall

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no file size limits there")


def test_scenes_need_room(tmp_path: Path, omnisyn: Omnisyn) -> None:
    make = ("scenes", "make", tmp_path / "out", "--size", "64x32", "--frames", 2, "--threads", 1, "-q")
    omnisyn.made(*make)
    before = visible_files(tmp_path)
    with file_size_limit(300):
        assert "check free space" in omnisyn.refused(*make, "--overwrite", "--seed", 1, code=1)
    assert visible_files(tmp_path) == before


def test_an_evaluation_needs_room(tmp_path: Path, omnisyn: Omnisyn) -> None:
    scene = tmp_path / "scenes" / "a"
    scene.mkdir(parents=True)
    write_hall(scene, [posed((0, 0, 0.5 - 0.25 * at)) for at in range(5)], (32, 64))
    run = ("eval", tmp_path / "scenes", "--report", tmp_path / "report", "--methods", "crossfade", "--threads", 1, "-q")
    with file_size_limit(200):
        failed = omnisyn.ended(1, *run)
    assert (failed.out, failed.err.count("\n")) == ("", 1)
    assert "check free space" in failed.err
    omnisyn.made(*run)
    assert (tmp_path / "report" / "report.html").is_file()


def test_a_checkpoint_needs_room_and_the_former_one_stays(tmp_path: Path) -> None:
    import torch

    from omnisyn_cli.training.checkpoint import load_checkpoint, save_checkpoint

    path = tmp_path / "checkpoint.pt"
    state = {"kind": "depth", "network": {}, "training": {}, "step": 1, "average": {}}
    save_checkpoint(path, state)
    with file_size_limit(20_000), pytest.raises(WriteError, match="check free space") as caught:
        save_checkpoint(path, {**state, "step": 2, "weights": torch.zeros(100_000)})
    assert "\n" not in str(caught.value)
    assert load_checkpoint(path)["step"] == 1
    assert [file.name for file in tmp_path.iterdir()] == ["checkpoint.pt"]
