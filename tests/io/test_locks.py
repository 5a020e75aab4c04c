"""What runs hold while they work, and what is known of it when they are killed."""

import multiprocessing
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cli.cli_samples import Omnisyn, folder_arguments, start_cli, write_pair
from omnisyn_cli.errors import OutputPathError
from omnisyn_cli.io import outputs
from omnisyn_cli.io.outputs import abandoned, check_empty_folder, claimed, staged_folder, temporary_name

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no such locks there")


def ended_process() -> int:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def left_by(monkeypatch: pytest.MonkeyPatch, process: int, folder: Path) -> Path:
    """A hidden file as a process makes it."""
    with monkeypatch.context() as patch:
        patch.setattr(os, "getpid", lambda: process)
        path = temporary_name(folder, ".mp4")
    path.write_bytes(b"half")
    return path


def test_a_place_is_held_once_under_any_of_its_names_and_let_go(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path)
    is_made = pytest.raises(OutputPathError, match="that another run is making")
    with claimed(tmp_path / "a.mp4"), claimed(tmp_path / "b.mp4"), is_made, claimed(tmp_path / "link" / "a.mp4"):
        pass
    with claimed(tmp_path / "a.mp4"):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["link"]


def hold(place: Path, held: "multiprocessing.synchronize.Event") -> None:
    with claimed(place):
        held.set()
        signal.pause()


def test_a_killed_process_holds_nothing(tmp_path: Path) -> None:
    context = multiprocessing.get_context("spawn")
    held = context.Event()
    process = context.Process(target=hold, args=(tmp_path / "a.mp4", held))
    process.start()
    assert held.wait(60)
    with pytest.raises(OutputPathError), claimed(tmp_path / "a.mp4"):
        pass
    process.kill()
    process.join()
    with claimed(tmp_path / "a.mp4"):
        pass


def test_only_what_ended_processes_of_this_machine_have_left_is_abandoned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = left_by(monkeypatch, ended_process(), tmp_path)
    left_by(monkeypatch, os.getpid(), tmp_path)
    for name in (".omnisyn-batch", ".omnisyn-x", "a.mp4"):
        (tmp_path / name).touch()
    with monkeypatch.context() as patch:
        patch.setattr(outputs, "MACHINE_DIGEST", "abcdef")
        left_by(monkeypatch, ended_process(), tmp_path)
    assert abandoned(tmp_path) == [gone]


def test_a_folder_in_which_a_run_was_killed_is_still_an_empty_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    left_by(monkeypatch, ended_process(), folder)
    check_empty_folder(folder, overwrite=False)
    left_by(monkeypatch, os.getpid(), folder)
    with pytest.raises(OutputPathError, match="expected a new or empty folder"):
        check_empty_folder(folder, overwrite=False)


def test_a_new_folder_appears_with_everything_in_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So a run that is killed on the way has left all of it or nothing."""
    seen = []
    original = Path.rename

    def renamed(source: Path, target: Path) -> Path:
        seen.append((sorted(path.name for path in source.iterdir()), target.exists()))
        return original(source, target)

    monkeypatch.setattr(Path, "rename", renamed)
    with staged_folder(tmp_path / "out") as staged:
        for name in ("a", "b"):
            (staged / name).touch()
    assert seen == [(["a", "b"], False)]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a", "b"]


def test_two_runs_with_one_output_and_leftovers_are_told_at_once(
    tmp_path: Path, omnisyn: Omnisyn, monkeypatch: pytest.MonkeyPatch
) -> None:
    images = write_pair(tmp_path)
    words = folder_arguments(tmp_path, images)
    with claimed(tmp_path / "out"):
        process = start_cli(*words, folder=tmp_path)
        assert b"that another run is making; wait for its end" in process.communicate(timeout=300)[1]
        assert process.returncode == 3
        assert omnisyn.made(*words, "--dry-run").code == 0
    gone = left_by(monkeypatch, ended_process(), tmp_path)
    assert f"remove them with: rm -r {gone}\n" in omnisyn.made(*words).err
    assert f"remove them with: rm -r {gone}\n" in omnisyn.ended(3, *words).err
    gone.unlink()
    (tmp_path / "pages").mkdir()
    left = left_by(monkeypatch, ended_process(), tmp_path / "pages")
    page = ("--view", tmp_path / "pages" / "walk.html")
    assert f"rm -r {left}\n" in omnisyn.made(*words, "--overwrite", *page).err
    assert "hidden files" not in omnisyn.made(*words, "--overwrite").err


def test_reports_and_pose_files_tell_of_leftovers_too(
    tmp_path: Path, omnisyn: Omnisyn, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = tmp_path / "scenes" / "s0"
    scene.mkdir(parents=True)
    write_pair(scene, ("a.png", "b.png", "c.png"), (32, 64))
    gone = left_by(monkeypatch, ended_process(), tmp_path)
    remedy = f"remove them with: rm -r {gone}\n"
    export = ("poses", "export", scene / "poses.json", "--format", "tum", "-o", tmp_path / "poses.txt")
    assert remedy in omnisyn.made(*export).err
    report = ("--report", tmp_path / "report", "--methods", "crossfade", "--no-pictures", "--threads", 1)
    assert remedy in omnisyn.made("eval", scene.parent, *report).err
    deep = tmp_path / "report" / "pictures" / "s0" / "truth"
    deep.mkdir(parents=True)
    remedy = f"{remedy.rstrip()} {left_by(monkeypatch, ended_process(), deep)}\n"
    assert remedy in omnisyn.made("eval", scene.parent, *report).err
