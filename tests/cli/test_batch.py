"""``omnisyn batch``: killed workers and a killed command cost time, nothing else."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from cli.cli_samples import Omnisyn, listing, start_cli, write_pair
from interpolation_samples import edit_poses

NAMES = ("a.png", "b.png", "c.png", "d.png")
SIZE = (128, 256)
SECONDS = 600


def write_batch(folder: Path, **options: Any) -> Path:
    """Six jobs between four panoramas, and how they are done."""
    write_pair(folder, NAMES, SIZE)
    pairs = [(a, b) for a in NAMES for b in NAMES if a < b]
    lines = [
        {"id": f"{a[0]}{b[0]}", "inputs": [a, b], "poses": "poses.json", "encoder_preset": "ultrafast", **options}
        for a, b in pairs
    ]
    (folder / "jobs.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    return folder / "jobs.jsonl"


def finished(folder: Path) -> list[str]:
    """Jobs that have a whole line in the records."""
    path = folder / "results.jsonl"
    lines = path.read_text().split("\n")[:-1] if path.exists() else []
    return [json.loads(line)["id"] for line in lines]


def wait_for(folder: Path, count: int, process: subprocess.Popen[bytes]) -> None:
    end = time.monotonic() + SECONDS
    while len(finished(folder)) < count:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.02)


def workers_of(process: subprocess.Popen[bytes]) -> list[int]:
    """Processes that do jobs, the oldest first."""
    tasks = Path(f"/proc/{process.pid}/task").iterdir()
    children = [int(child) for task in tasks for child in (task / "children").read_text().split()]
    return sorted(pid for pid in children if b"spawn_main" in command_of(pid))


def command_of(pid: int) -> bytes:
    """Empty of a process that has ended in the meantime."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def videos(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.glob("*.mp4")}


def leave(process: subprocess.Popen[bytes]) -> tuple[int, str]:
    out, err = process.communicate(timeout=SECONDS)
    return process.returncode, (out + err).decode()


@pytest.mark.skipif(sys.platform != "linux", reason="finds and kills processes of Linux")
def test_whatever_is_killed_the_videos_are_those_of_an_undisturbed_run(tmp_path: Path) -> None:
    """One worker killed, the command killed, started again, two more workers killed: each job has one record."""
    jobs = write_batch(tmp_path, frames=24)
    arguments = ["batch", jobs, "--workers", 2, "--threads", 1, "-o"]
    calm, wild = tmp_path / "calm", tmp_path / "wild"
    assert leave(start_cli(*arguments, calm, folder=tmp_path))[0] == 0
    first = start_cli(*arguments, wild, folder=tmp_path)
    wait_for(wild, 1, first)
    os.kill(workers_of(first)[0], signal.SIGKILL)
    wait_for(wild, 2, first)
    orphans = workers_of(first)
    first.kill()
    first.communicate()
    done = finished(wild)
    assert len(done) < 6, "it was too fast to be killed in the middle"
    second = start_cli(*arguments, wild, folder=tmp_path)
    for count in (1, 2):
        wait_for(wild, len(done) + count, second)
        os.kill(workers_of(second)[0], signal.SIGKILL)
    code, words = leave(second)
    assert code == 0, words
    assert f"{len(done)} done before, 0 failed" in words
    assert sorted(finished(wild)) == sorted(finished(calm)), "a job was done twice or not at all"
    assert videos(wild) == videos(calm)
    assert len(videos(wild)) == 6
    assert not [name for name in listing(wild) if name.startswith(".")]
    assert not [pid for pid in orphans if Path(f"/proc/{pid}").exists()]


def test_failures_are_shown_and_are_exit_code_1(tmp_path: Path, omnisyn: Omnisyn) -> None:
    write_pair(tmp_path)
    (tmp_path / "bad.png").write_bytes((tmp_path / "a.png").read_bytes()[:300])
    edit_poses(tmp_path, lambda panoramas: panoramas.update({"bad.png": panoramas["a.png"]}))
    common = {"poses": "poses.json", "frames": 3, "encoder_preset": "ultrafast"}
    lines = [
        {"id": "good", "inputs": ["a.png", "b.png"], **common},
        {"id": "worse", "inputs": ["bad.png", "b.png"], **common},
    ]
    (tmp_path / "jobs.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    arguments = ["batch", tmp_path / "jobs.jsonl", "-o", tmp_path / "out", "--workers", 1, "--threads", 1]
    result = omnisyn.ended(1, *arguments)
    assert "2 jobs, 1 done" in result.out
    assert result.err.startswith("0/2 jobs\n")
    assert "\n2/2 jobs, 1 failed\n" in result.err
    assert "worse" in result.err
    report = json.loads(omnisyn.ended(1, *arguments, "--json").out)
    assert (report["done"], report["kept"], report["failed"]) == (0, 1, 1)
    assert "bad.png" in report["failures"][0]["error"]
    assert (tmp_path / "out" / "good.mp4").exists()


def test_problems_of_a_manifest_are_listed_and_nothing_starts(tmp_path: Path, omnisyn: Omnisyn) -> None:
    write_pair(tmp_path)
    (tmp_path / "jobs.jsonl").write_text('{"id": "a"}\nno\n')
    listed = omnisyn.ended(3, "batch", tmp_path / "jobs.jsonl", "-o", tmp_path / "out").err
    assert "jobs.jsonl: line 1: " in listed
    assert "jobs.jsonl: line 2: " in listed
    assert not (tmp_path / "out").exists()


def test_a_tour_is_planned(tmp_path: Path, omnisyn: Omnisyn) -> None:
    write_pair(tmp_path, NAMES)
    arguments = ["batch", "plan", tmp_path, "-o", tmp_path / "jobs.jsonl", "--max-baseline", 1.5, "--set", "fps=25"]
    assert "6 jobs" in omnisyn.quiet(*arguments, "--set", "ease=smooth").out
    lines = [json.loads(line) for line in (tmp_path / "jobs.jsonl").read_text().splitlines()]
    assert {(line["fps"], line["ease"]) for line in lines} == {(25, "smooth")}
    assert omnisyn(*arguments).code == 3, "it exists"
    assert omnisyn(*arguments, "--set", "fps").code == 2
    assert omnisyn(*arguments[:4], tmp_path / "jobs.txt").code == 3


@pytest.mark.parametrize("more", [["--gpus", "1"], ["--ray-address", "auto"]])
def test_what_only_ray_has_is_refused_without_it(tmp_path: Path, omnisyn: Omnisyn, more: list[str]) -> None:
    assert "engine ray" in omnisyn.refused("batch", write_batch(tmp_path), "-o", tmp_path / "out", *more)


def test_help_of_both(omnisyn: Omnisyn) -> None:
    assert "MANIFEST" in omnisyn("batch", "--help").out
    assert "FOLDER|POSES" in omnisyn("batch", "plan", "--help").out
    assert omnisyn("batch").code == 2
