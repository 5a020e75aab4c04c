"""The first run after an installation: another process compiles what is drawn with, and nothing depends on it."""

import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from interpolation_samples import CHAIN, job_of
from omnisyn_cli.interpolation import rehearsal
from omnisyn_cli.interpolation.plan import TourPlan, plan_interpolation, plan_tour
from omnisyn_cli.interpolation.rehearsal import Rehearsal, rehearsed
from synthesis_samples import write_hall

WITHOUT_GUARD = """
import sys
from numba.core import event
from omnisyn_cli.cli import main

class Compiled(event.Listener):
    def on_start(self, event):
        if event.data:
            print("here:", event.data["dispatcher"].py_func.__name__, file=sys.stderr)

    def on_end(self, event):
        pass

with event.install_listener("numba:compile", Compiled()):
    main(sys.argv[1:])
"""


@pytest.fixture
def plan(tmp_path: Path) -> TourPlan:
    """Of a video for which depth has to be found."""
    images = write_hall(tmp_path, CHAIN[:2], (64, 128), with_depth=False)
    return plan_interpolation(job_of(tmp_path, images, output=tmp_path / "a.mp4", threads=2))


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[Rehearsal]:
    """What another process would have been asked for, after an installation on a machine with two cores."""
    asked: list[Rehearsal] = []
    monkeypatch.setattr(rehearsal, "_started", asked.append)
    monkeypatch.setattr(rehearsal, "is_on_disk", lambda kernel: False)
    monkeypatch.setattr(rehearsal, "are_kernels_kept", lambda: True)
    monkeypatch.setattr(rehearsal, "available_threads", lambda: 2)
    return asked


def test_what_is_rehearsed_is_the_recipe_on_a_processor_and_the_types_of_the_job(
    plan: TourPlan, started: list[Rehearsal], tmp_path: Path
) -> None:
    with rehearsed(plan):
        pass
    (asked,) = started
    assert asked == Rehearsal(replace(plan.recipe, device="cpu"), plan.size, has_samples=True, is_rounded=True)
    assert Rehearsal.from_json(asked.to_json()) == asked
    deep = Rehearsal.of(plan_interpolation(replace(plan.job, output=tmp_path / "frames", codec="exr")))
    assert not deep.is_rounded
    surfaces = Rehearsal.of(plan_tour(plan.job))
    assert (surfaces.size, Rehearsal.from_json(surfaces.to_json())) == (None, surfaces)


@pytest.mark.parametrize(
    "why", ["all on disk", "no place", "one core", "one thread", "known depth", "points", "a network alone"]
)
def test_nobody_is_asked_where_that_would_not_help(
    plan: TourPlan, started: list[Rehearsal], why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if why == "all on disk":
        monkeypatch.setattr(rehearsal, "is_on_disk", lambda kernel: True)
    elif why == "no place":
        monkeypatch.setattr(rehearsal, "are_kernels_kept", lambda: False)
    elif why == "one core":
        monkeypatch.setattr(rehearsal, "available_threads", lambda: 1)
    elif why == "one thread":
        plan = replace(plan, job=replace(plan.job, threads=1))
    elif why == "points":
        plan = replace(plan, recipe=replace(plan.recipe, renderer="points"))
    else:
        kind = "file" if why == "known depth" else "network"
        plan = replace(plan, recipe=replace(plan.recipe, depth=replace(plan.recipe.depth, kind=kind)))
    with rehearsed(plan):
        pass
    assert started == []


@pytest.mark.parametrize("program", ["", "no such interpreter", "false", "cat"])
def test_without_a_second_process_everything_goes_on(
    plan: TourPlan, program: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """None that could be started, one that ends at once, one that says something else."""
    monkeypatch.setattr(rehearsal, "_is_worth_while", lambda plan: True)
    monkeypatch.setattr(sys, "executable", program)
    begin = time.monotonic()
    with rehearsed(plan):
        pass
    assert time.monotonic() - begin < 30


def rehearsing(folder: Path) -> subprocess.Popen[bytes]:
    """A second process with nothing on disk."""
    here = str(Path(rehearsal.__file__).parents[2])
    return subprocess.Popen(
        [sys.executable, "-m", "omnisyn_cli.interpolation.rehearsal"], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": here, "NUMBA_CACHE_DIR": str(folder / "kernels")},
    )  # fmt: skip


def test_the_second_process_ends_with_the_first(plan: TourPlan, tmp_path: Path) -> None:
    """However that ends: what it reads from is closed then."""
    with rehearsing(tmp_path) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(Rehearsal.of(plan).to_json().encode() + b"\n")
        process.stdin.flush()
        assert process.stdout.readline().startswith(b"+omnisyn_cli.")  # it is at work, for a long time
        process.stdin.close()
        assert process.wait(timeout=60) == 1


@pytest.mark.slow
@pytest.mark.skipif(rehearsal.available_threads() < 2, reason="nobody would be asked")
def test_the_first_run_leaves_what_is_drawn_with_to_another_process(tmp_path: Path) -> None:
    """From a script without a guard; the video is that of a run which found everything on disk."""
    images = write_hall(tmp_path, CHAIN[:2], (64, 128), with_depth=False)
    here = str(Path(rehearsal.__file__).parents[2])
    environment = {**os.environ, "PYTHONPATH": here, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    (tmp_path / "script.py").write_text(WITHOUT_GUARD)
    command = [sys.executable, tmp_path / "script.py", "interpolate", *images, "--frames", "3"]
    first, second = (
        subprocess.run([*command, "-o", tmp_path / name], capture_output=True, text=True, env=environment, check=True)
        for name in ("first.mp4", "second.mp4")
    )
    here_compiled = {line.split()[1] for line in first.stderr.splitlines() if line.startswith("here:")}
    assert "_aggregate" in here_compiled
    drawing = {"find_block_boxes", "rasterize_blocks", "shade_rows", "blend_band", "_push_rows"}
    assert not here_compiled & (drawing | {"mark_edges", "list_spots", "rasterize_spots", "shade_spots", "blend_spots"})
    assert "here:" not in second.stderr
    assert (tmp_path / "first.mp4").read_bytes() == (tmp_path / "second.mp4").read_bytes()
