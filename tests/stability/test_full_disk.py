"""No room left, and nobody who listens: one clear line, and what was there before is still there."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from stability_samples import visible_files

from omnisyn_cli.cli import main
from omnisyn_cli.errors import WriteError
from synthesis_samples import posed, write_hall

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no file size limits there")


@contextmanager
def room_for(size: int) -> Iterator[None]:
    """No file can grow beyond ``size`` bytes: the system's answer is that of a full disk."""
    import resource

    former = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, former[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, former)


def failed(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line that a command says when it fails for want of room."""
    with pytest.raises(SystemExit) as left:
        main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    assert (left.value.code, out) == (1, "")
    assert err.count("\n") == 1
    return err


def test_scenes_need_room(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make = ("scenes", "make", tmp_path / "out", "--size", "64x32", "--frames", 2, "--threads", 1, "-q")
    with pytest.raises(SystemExit):
        main([*map(str, make)])
    before = visible_files(tmp_path)
    with room_for(300):
        assert "check free space" in failed(capsys, *make, "--overwrite", "--seed", 1)
    assert visible_files(tmp_path) == before
    assert len(list((tmp_path / "out").iterdir())) == len(before)


def test_an_evaluation_needs_room(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "scenes" / "a"
    scene.mkdir(parents=True)
    write_hall(scene, [posed((0, 0, 0.5 - 0.25 * at)) for at in range(5)], (32, 64))
    run = ("eval", tmp_path / "scenes", "--report", tmp_path / "report", "--methods", "crossfade", "--threads", 1, "-q")
    with room_for(200):
        assert "check free space" in failed(capsys, *run)
    with pytest.raises(SystemExit) as left:
        main([*map(str, run)])
    assert left.value.code == 0
    assert (tmp_path / "report" / "report.html").is_file()


def test_a_checkpoint_needs_room_and_the_former_one_stays(tmp_path: Path) -> None:
    import torch

    from omnisyn_cli.training.checkpoint import load_checkpoint, save_checkpoint

    path = tmp_path / "checkpoint.pt"
    state = {"kind": "depth", "network": {}, "training": {}, "step": 1, "average": {}}
    save_checkpoint(path, state)
    with room_for(20_000), pytest.raises(WriteError, match="check free space") as caught:
        save_checkpoint(path, {**state, "step": 2, "weights": torch.zeros(100_000)})
    assert "\n" not in str(caught.value)
    assert load_checkpoint(path)["step"] == 1
    assert [file.name for file in tmp_path.iterdir()] == ["checkpoint.pt"]
