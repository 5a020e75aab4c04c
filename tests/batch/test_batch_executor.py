"""Every job ends exactly once, whatever happens to workers; what a worker remembers is what it would find."""

import os
import random
import weakref
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from batch_samples import CAN_KILL, InlineExecutor, write_row
from hypothesis import given
from hypothesis import strategies as st

from omnisyn_cli.batch.executor import MAX_WORKER_DEATHS, Answer, Job, LocalExecutor, Outcome, Report, Work, run_jobs
from omnisyn_cli.batch.interpolations import MAX_CACHED_PANORAMAS, DepthCache, PanoramaCache
from omnisyn_cli.fusion.photometry import darken_to_match, rough_exposure_curve
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.io import read_panorama, write_image
from omnisyn_cli.types import DepthEstimate, View

TRICKS = "batch_samples:make_tricks"


class MortalExecutor:
    """Workers in name only: each time one is asked for an answer it may die instead."""

    def __init__(self, size: int, mortality: float, seed: int) -> None:
        self.given: list[tuple[int, str]] = []
        self._size, self._mortality, self._random = size, mortality, random.Random(seed)  # noqa: S311
        self._busy: dict[int, Job] = {}

    def __enter__(self) -> "MortalExecutor":
        return self

    def __exit__(self, *_: object) -> None:
        assert not self._busy

    def ready(self) -> list[int]:
        return [worker for worker in range(self._size) if worker not in self._busy]

    def submit(self, worker: int, job: Job) -> None:
        assert worker not in self._busy
        self._busy[worker] = job
        self.given.append((worker, job.key))

    def wait(self) -> list[Report]:
        assert self._busy, "waits for nobody"
        worker = self._random.choice(sorted(self._busy))
        job = self._busy.pop(worker)
        if self._random.random() < self._mortality:
            return [(worker, "signal 9")]
        return [(worker, Answer(job.payload, None, None, str(worker)))]


jobs_of_any_kind = st.lists(
    st.tuples(st.floats(0, 100), st.none() | st.sampled_from("abc")), max_size=12
).map(lambda all_: [Job(str(k), k, cost, group) for k, (cost, group) in enumerate(all_)])  # fmt: skip


@given(jobs=jobs_of_any_kind, size=st.integers(1, 4), mortality=st.sampled_from([0.0, 0.3, 1.0]), seed=st.integers())
def test_every_job_has_one_outcome_however_many_workers_die(jobs, size, mortality, seed):
    executor = MortalExecutor(size, mortality, seed)
    outcomes = list(run_jobs(jobs, executor))
    assert sorted(o.job.key for o in outcomes) == sorted(job.key for job in jobs)
    tries = Counter(key for _, key in executor.given)
    for outcome in outcomes:
        assert outcome.attempts == tries[outcome.job.key] <= MAX_WORKER_DEATHS
        if outcome.answer.error is None:
            assert outcome.answer.value == outcome.job.payload
        else:
            assert outcome.attempts == MAX_WORKER_DEATHS
            assert "signal 9" in outcome.answer.error


@given(jobs=jobs_of_any_kind, size=st.integers(1, 4), seed=st.integers())
def test_groups_stay_with_one_worker_in_their_order(jobs, size, seed):
    executor = MortalExecutor(size, 0.0, seed)
    list(run_jobs(jobs, executor))
    for name in "abc":
        of_group = [(worker, key) for worker, key in executor.given if jobs[int(key)].group == name]
        assert len({worker for worker, _ in of_group}) <= 1
        assert [key for _, key in of_group] == [job.key for job in jobs if job.group == name]


@given(jobs=jobs_of_any_kind)
def test_the_most_expensive_group_begins_first(jobs):
    executor = MortalExecutor(1, 0.0, 0)
    list(run_jobs(jobs, executor))
    sums: dict[str, float] = {}
    for job in jobs:
        sums[job.group or job.key] = sums.get(job.group or job.key, 0) + job.cost
    begun = [sums[jobs[int(key)].group or key] for _, key in executor.given]
    assert begun == sorted(begun, reverse=True)


def run_tricks(folder: Path, *tricks: tuple[str, Any], workers: int = 2) -> dict[str, Outcome]:
    jobs = [Job(str(number), trick, float(-number)) for number, trick in enumerate(tricks)]
    executor = LocalExecutor(Work(TRICKS, (str(folder),)), workers, 1)
    return {outcome.job.key: outcome for outcome in run_jobs(jobs, executor)}


def test_an_error_is_an_answer_and_bugs_keep_their_traceback(tmp_path):
    done = run_tricks(tmp_path, ("refuse", "worse"), ("stumble", "over"), ("echo", 1), workers=1)
    assert (done["0"].answer.error, done["0"].answer.trace) == ("expected better, got worse", None)
    assert done["1"].answer.error == "ZeroDivisionError: over"
    assert "raise ZeroDivisionError(value)" in (done["1"].answer.trace or "")
    assert done["2"].answer.error is None
    assert done["2"].answer.value[1] == ["worse", "over", 1], "one worker, made once, did it all"


@pytest.mark.skipif(not CAN_KILL, reason="needs /proc")
def test_numerical_libraries_are_told_their_threads_before_a_worker_loads_them(tmp_path, monkeypatch):
    """What the user says of one of them is left."""
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    monkeypatch.setenv("MKL_NUM_THREADS", "3")
    found = run_tricks(tmp_path, ("environment", 0), workers=1)["0"].answer.value
    assert {b"OPENBLAS_NUM_THREADS=1", b"MKL_NUM_THREADS=3"} <= set(found)
    assert "OPENBLAS_NUM_THREADS" not in os.environ


@pytest.mark.skipif(not CAN_KILL, reason="needs SIGKILL")
def test_a_dead_worker_is_replaced_and_its_job_done_again_but_not_for_ever(tmp_path):
    done = run_tricks(tmp_path, ("die", 0), ("die once", 1), ("echo", 2), ("echo", 3))
    error = done["0"].answer.error
    assert error is not None
    assert "signal 9" in error
    assert {key: (outcome.attempts, outcome.answer.error) for key, outcome in done.items()} == {
        "0": (2, error), "1": (2, None), "2": (1, None), "3": (1, None)
    }  # fmt: skip


def test_a_work_function_that_cannot_be_made_is_every_jobs_error():
    outcomes = list(run_jobs([Job("a", 1), Job("b", 2)], InlineExecutor(Work("no_such_module:f"))))
    assert [o.answer.error for o in outcomes] == ["ModuleNotFoundError: No module named 'no_such_module'"] * 2


def test_no_job_needs_no_worker():
    class NoExecutor(MortalExecutor):
        def __enter__(self) -> "MortalExecutor":
            raise AssertionError

    assert list(run_jobs([], NoExecutor(1, 0.0, 0))) == []


@pytest.mark.skipif(not CAN_KILL, reason="looks at processes of Linux")
def test_whoever_stops_listening_leaves_no_process_behind(tmp_path):
    executor = LocalExecutor(Work(TRICKS, (str(tmp_path),)), 2, 1)
    outcomes = run_jobs([Job("0", ("echo", 0)), Job("1", ("sleep", 600)), Job("2", ("sleep", 600))], executor)
    pid = next(outcomes).answer.value[0]
    outcomes.close()
    assert not Path(f"/proc/{pid}").exists()


class Counting:
    """An estimator that says in its estimates which views it was asked about, and in which order."""

    def __init__(self) -> None:
        self.calls: list[tuple[float, float]] = []

    def __call__(self, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        self.calls.append((first.pose.position[0], second.pose.position[0]))
        return estimate(first), estimate(second)


def estimate(view: View) -> DepthEstimate:
    value = np.full((1, 1), view.image.sum() + 100 * view.pose.position[0])
    return DepthEstimate(value, np.ones((1, 1)))


def view(x: float, image: np.ndarray | None = None, mask: np.ndarray | None = None) -> View:
    return View(np.full((2, 4, 3), x) if image is None else image, Pose(np.eye(3), np.array([x, 0.0, 0.0])), mask)


def values(depths: tuple[DepthEstimate, DepthEstimate]) -> list[float]:
    return [float(depth.inverse_depth[0, 0]) for depth in depths]


def test_depth_of_both_directions_is_found_once_and_in_one_order():
    inner, a, b = Counting(), view(1.0), view(2.0)
    memory = DepthCache(inner)
    expected = [float(estimate(one).inverse_depth[0, 0]) for one in (a, b)]
    for _ in range(2):
        assert values(memory(b, a)) == expected[::-1]
        assert values(memory(a, b)) == expected
    assert inner.calls == [(1.0, 2.0)]
    assert memory.misses == 1


def test_another_picture_pose_or_mask_is_another_pair():
    inner, a, b = Counting(), view(1.0), view(2.0)
    memory = DepthCache(inner)
    mask = np.ones((2, 4), bool)
    others = [view(2.5, b.image), view(2.0, b.image + 0.1), view(2.0, b.image, mask), view(2.0, b.image, ~mask)]
    for other in (b, *others):
        assert values(memory(a, other)) == [float(estimate(one).inverse_depth[0, 0]) for one in (a, other)]
    assert memory.misses == len(inner.calls) == 5
    memory(a, view(2.0, b.image, np.zeros((2, 4), bool)))
    assert memory.misses == 5, "an equal mask is the same mask"
    memory(a, view(2.0, b.image.copy(), ~mask))
    assert memory.misses == 5, "an equal picture is the same picture"


def test_pictures_that_were_darkened_to_one_exposure_are_known_again_in_either_direction():
    """They are made anew for each job."""
    bright = np.random.default_rng(0).uniform(0.2, 0.8, (64, 128, 3)).astype(np.float32)
    memory, a, b = DepthCache(Counting()), view(1.0, bright), view(2.0, np.float32(0.7) * bright[:, ::-1])
    for pair in ((a, b), (b, a), (a, b)):
        darkened = darken_to_match(*pair, rough_exposure_curve(*pair))
        assert not any(one is other for one, other in zip(darkened, pair, strict=True) if other is a)
        memory(*darkened)
    assert memory.misses == 1


def test_depth_keeps_no_picture_alive():
    memory, image = DepthCache(Counting()), np.full((2, 4, 3), 2.0)
    memory(view(1.0), view(2.0, image))
    picture = weakref.ref(image)
    del image
    assert picture() is None


def test_a_panorama_is_decoded_once_until_its_file_changes(tmp_path):
    write_row(tmp_path, 2)
    memory, path = PanoramaCache(), tmp_path / "p0.png"
    first = memory(path)
    assert memory(path).original is first.original
    np.testing.assert_array_equal(first.image, read_panorama(path).image)
    memory(tmp_path / "p1.png")
    assert memory.misses == 2
    write_image(path, np.zeros((16, 32, 3), np.uint8))
    os.utime(path, ns=(1, 1))
    assert not memory(path).image.any()
    assert memory.misses == 3


def test_panoramas_are_remembered_as_the_samples_of_their_files(tmp_path):
    """And are the same numbers when they are made of these again."""
    write_row(tmp_path, 1)
    memory, path = PanoramaCache(), tmp_path / "p0.png"
    numbers = weakref.ref(memory(path).image)
    assert numbers() is None
    np.testing.assert_array_equal(memory(path).image, read_panorama(path).image)
    assert memory.misses == 1


def test_only_a_few_panoramas_are_remembered(tmp_path):
    write_row(tmp_path, MAX_CACHED_PANORAMAS + 1)
    memory = PanoramaCache()
    for index in range(MAX_CACHED_PANORAMAS + 1):
        memory(tmp_path / f"p{index}.png")
    assert len(memory._known) == MAX_CACHED_PANORAMAS
    memory(tmp_path / "p1.png")
    assert memory.misses == MAX_CACHED_PANORAMAS + 1
    memory(tmp_path / "p0.png")
    assert memory.misses == MAX_CACHED_PANORAMAS + 2
