"""Who does what next, and what happens when a worker dies: for any kind of job and any kind of worker.

An :class:`Executor` is a number of workers (:mod:`.local_executor`: processes of this machine, :mod:`.ray_executor`:
actors of a cluster). Each holds one work function, made once from a :class:`Work`, and is given one job at a time.
"""

import os
import platform
import traceback
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pkgutil import resolve_name
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


Report = tuple[int, Answer | str]
"""News of one worker: its answer, or how it died."""


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
                self._function = resolve_name(self._work.factory)(self._work.settings)
            return Answer(self._function(payload), None, None, self._name)
        except OmnisynError as error:
            message, trace = str(error), None
        except Exception as error:  # noqa: BLE001  whatever it is, the other jobs go on; the traceback is kept
            message, trace = f"{type(error).__name__}: {error}", traceback.format_exc()
        return Answer(None, " ".join(message.splitlines()), trace, self._name)


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
    waiting = deque(_groups(jobs))
    groups_of_workers: dict[int, deque[Job]] = {}
    running: dict[int, Job] = {}
    deaths: Counter[str] = Counter()
    if not waiting:
        return
    with executor:
        while waiting or running or any(groups_of_workers.values()):
            for worker in executor.ready():
                if not groups_of_workers.get(worker) and waiting:
                    groups_of_workers[worker] = waiting.popleft()
                if group := groups_of_workers.get(worker):
                    running[worker] = group.popleft()
                    executor.submit(worker, running[worker])
            for worker, answer in executor.wait():
                job = running.pop(worker)
                if isinstance(answer, Answer):
                    yield Outcome(job, answer, deaths[job.key] + 1)
                    continue
                deaths[job.key] += 1
                rest = groups_of_workers.pop(worker)
                is_lost = deaths[job.key] >= MAX_WORKER_DEATHS
                if not is_lost:
                    rest.appendleft(job)
                if rest:
                    waiting.appendleft(rest)
                if is_lost:
                    yield Outcome(job, _lost(answer), deaths[job.key])


def _groups(jobs: Iterable[Job]) -> list[deque[Job]]:
    """Jobs by group in the order given; the most expensive group first."""
    groups: dict[tuple[str, str], deque[Job]] = {}
    for job in jobs:
        groups.setdefault(("job", job.key) if job.group is None else ("group", job.group), deque()).append(job)
    return sorted(groups.values(), key=lambda group: -sum(job.cost for job in group))


def _lost(death: str) -> Answer:
    message = (
        f"expected a worker to survive this job, got {MAX_WORKER_DEATHS} that died of it ({death}); if memory ran "
        "out, take fewer workers or a smaller size"
    )
    return Answer(None, message, None, "")
