"""Who does what next, and what happens when a worker dies: for any kind of job and any kind of worker.

An :class:`Executor` is a number of workers (:mod:`.local_executor`: processes of this machine, :mod:`.ray_executor`:
actors of a cluster). Each holds one work function, made once from a :class:`Work`, and is given one job at a time.
"""

import importlib
import os
import platform
import traceback
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol

from omnisyn_cli.errors import OmnisynError

MAX_WORKER_DEATHS = 2
"""A job during which so many workers died is not tried again."""


@dataclass(frozen=True)
class Work:
    """What workers do.

    Attributes:
        factory: ``package.module:function``; called once per worker with ``settings``, it returns the work function,
            which takes the payload of a job and returns a value, both picklable.
        settings: for the factory; picklable.
    """

    factory: str
    settings: Any = None


@dataclass(frozen=True)
class Job:
    """One piece of work.

    Attributes:
        key: unique among the jobs of a run.
        payload: what the work function is called with.
        cost: how long it will take, in any unit.
        group: jobs of one group go to one worker one after another, as long as it lives, so that it can use again what
            it has in memory; None is a group of its own.
    """

    key: str
    payload: Any
    cost: float = 1.0
    group: str | None = None


@dataclass(frozen=True)
class Answer:
    """What a worker says about a job.

    Attributes:
        value: of the work function; None after an error.
        error: one line, None if there was none.
        trace: the traceback of an unexpected error.
        worker: ``host:pid``.
    """

    value: Any
    error: str | None
    trace: str | None
    worker: str


@dataclass(frozen=True)
class Outcome:
    """How a job ended; ``attempts`` is 1 unless workers died."""

    job: Job
    answer: Answer
    attempts: int


@dataclass(frozen=True)
class Report:
    """News of one worker: its answer, or how it died."""

    worker: int
    answer: Answer | None
    death: str = ""


class Worker:
    """The inside of a worker: answers instead of exceptions. The work function is made at the first job."""

    def __init__(self, work: Work) -> None:
        self._work = work
        self._function: Callable[[Any], Any] | None = None
        self._name = f"{platform.node()}:{os.getpid()}"

    def ready(self) -> None:
        """Returns as soon as the worker lives."""

    def perform(self, payload: Any) -> Answer:
        """The value for a payload, or the error that it ended with; only signals get through."""
        try:
            if self._function is None:
                module, _, name = self._work.factory.partition(":")
                self._function = getattr(importlib.import_module(module), name)(self._work.settings)
            return Answer(self._function(payload), None, None, self._name)
        except OmnisynError as error:
            return Answer(None, " ".join(str(error).splitlines()), None, self._name)
        except Exception as error:  # noqa: BLE001  whatever it is, the other jobs go on; the traceback is kept
            message = f"{type(error).__name__}: {error}"
            return Answer(None, " ".join(message.splitlines()), traceback.format_exc(), self._name)


class Executor(AbstractContextManager["Executor"], Protocol):
    """Workers, numbered from 0; a context manager that leaves no process behind, after an error at once."""

    def ready(self) -> list[int]:
        """Workers that can be given a job."""

    def submit(self, worker: int, job: Job) -> None:
        """Start a job on a worker that is ready."""

    def wait(self) -> list[Report]:
        """Wait until something happens; there may be no report in it, only a worker that has become ready."""


def run_jobs(jobs: Iterable[Job], executor: Executor) -> Generator[Outcome, None, None]:
    """Do all jobs, the most expensive groups first; outcomes in the order in which jobs end.

    An error of a job and the death of a worker stop nothing: a dead worker is replaced, its job is tried once more, and
    fails when that kills its worker again.
    """
    queue = _JobQueue(jobs)
    if not queue.is_open():
        return
    with executor:
        while queue.is_open():
            for worker in executor.ready():
                if (job := queue.next_for(worker)) is not None:
                    executor.submit(worker, job)
            for report in executor.wait():
                if (outcome := queue.finish_report(report)) is not None:
                    yield outcome


class _JobQueue:
    """What waits, and who works on what."""

    def __init__(self, jobs: Iterable[Job]) -> None:
        self._waiting: deque[deque[Job]] = deque(deque(group) for group in _groups(jobs))
        self._groups_of_workers: dict[int, deque[Job]] = {}
        self._running: dict[int, Job] = {}
        self._deaths: Counter[str] = Counter()

    def is_open(self) -> bool:
        """Whether anything waits or runs."""
        return bool(self._waiting or self._running or any(self._groups_of_workers.values()))

    def next_for(self, worker: int) -> Job | None:
        """The next job of the worker's group, or of the next group."""
        if not self._groups_of_workers.get(worker):
            if not self._waiting:
                return None
            self._groups_of_workers[worker] = self._waiting.popleft()
        job = self._running[worker] = self._groups_of_workers[worker].popleft()
        return job

    def finish_report(self, report: Report) -> Outcome | None:
        """The outcome of the job that a report is about; None if it has to be tried again."""
        job = self._running.pop(report.worker)
        if report.answer is not None:
            return Outcome(job, report.answer, self._deaths[job.key] + 1)
        self._deaths[job.key] += 1
        rest = self._groups_of_workers.pop(report.worker)
        is_lost = self._deaths[job.key] >= MAX_WORKER_DEATHS
        if not is_lost:
            rest.appendleft(job)
        if rest:
            self._waiting.appendleft(rest)
        return Outcome(job, _lost(report.death), self._deaths[job.key]) if is_lost else None


def _groups(jobs: Iterable[Job]) -> Sequence[list[Job]]:
    """Jobs by group in the order given; the most expensive group first."""
    groups: dict[tuple[str, str], list[Job]] = {}
    for job in jobs:
        groups.setdefault(("job", job.key) if job.group is None else ("group", job.group), []).append(job)
    return sorted(groups.values(), key=lambda group: -sum(job.cost for job in group))


def _lost(death: str) -> Answer:
    message = (
        f"expected a worker to survive this job, got {MAX_WORKER_DEATHS} that died of it ({death}); if memory ran "
        "out, take fewer workers or a smaller size"
    )
    return Answer(None, message, None, "")
