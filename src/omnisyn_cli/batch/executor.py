"""Who does what next, and what happens when a worker dies: for any kind of job and any kind of worker.

An :class:`Executor` is a number of workers (:class:`LocalExecutor`: processes of this machine, :class:`RayExecutor`:
actors of a cluster). Each holds one work function, made once from a :class:`Work`, and is given one job at a time.
"""

import logging
import multiprocessing
import os
import platform
import signal
import threading
import traceback
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable
from contextlib import AbstractContextManager, chdir, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, Protocol, Self

from omnisyn_cli.compute.processes import environment, safe_path, spawn_context
from omnisyn_cli.errors import InputError, OmnisynError

MAX_WORKER_DEATHS = 2  # a job during which so many workers died is not tried again
SHUTDOWN_TIMEOUT_SECONDS = 10  # that a worker has to finish after its connection is closed; then it is killed
# Environment variables by which numerical libraries take their number of threads, when they are loaded.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Work:
    """What workers do."""

    # ``package.module:function``; called once per worker with ``settings``, it returns the work function, which takes
    # the payload of a job and returns a value, both picklable
    factory: str
    settings: tuple[Any, ...] = ()  # for the factory; picklable


@dataclass(frozen=True)
class Job:
    """One piece of work."""

    key: str  # unique among the jobs of a run
    payload: Any  # what the work function is called with
    cost: float = 1.0  # how long it will take, in any unit
    # jobs of one group go to one worker one after another, as long as it lives, so that it can use again what it has in
    # memory; None is a group of its own
    group: str | None = None


@dataclass(frozen=True)
class Answer:
    """What a worker says about a job."""

    value: Any  # of the work function; None after an error
    error: str | None  # one line, None if there was none
    trace: str | None  # the traceback of an unexpected error
    worker: str  # ``host:pid``


@dataclass(frozen=True)
class Outcome:
    """How a job ended; ``attempts`` is 1 unless workers died."""

    job: Job
    answer: Answer
    attempts: int


Report = tuple[int, Answer | str]  # News of one worker: its answer, or how it died.


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
                self._function = resolve_name(self._work.factory)(*self._work.settings)
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
    """Do all jobs, expensive groups first, as they end; dead workers are replaced, a job that kills two fails."""
    groups: dict[tuple[str, str], deque[Job]] = {}
    for job in jobs:
        groups.setdefault(("job", job.key) if job.group is None else ("group", job.group), deque()).append(job)
    waiting = deque(sorted(groups.values(), key=lambda group: -sum(job.cost for job in group)))
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
                    message = (
                        f"expected a worker to survive this job, got {MAX_WORKER_DEATHS} that died of it ({answer}); "
                        "if memory ran out, take fewer workers or a smaller size"
                    )
                    yield Outcome(job, Answer(None, message, None, ""), deaths[job.key])


class LocalExecutor(Executor):
    """Workers that are processes of this machine; each is started when its first job is given.

    Spawned, they inherit neither threads nor locks, and end with this process. ``threads`` are those of their
    libraries.
    """

    def __init__(self, work: Work, workers: int, threads: int) -> None:
        self._work, self._size, self._threads = work, workers, threads
        self._workers: dict[int, tuple[SpawnProcess, Connection]] = {}
        self._busy: set[int] = set()

    def __exit__(self, kind: type[BaseException] | None, *about: object) -> None:
        for process, connection in self._workers.values():
            connection.close()
            if kind is not None:
                process.kill()
        for process, _ in self._workers.values():
            process.join(SHUTDOWN_TIMEOUT_SECONDS)
            if process.is_alive():
                process.kill()
                process.join()
        self._workers.clear()

    def ready(self) -> list[int]:
        """Those without a job."""
        return [worker for worker in range(self._size) if worker not in self._busy]

    def submit(self, worker: int, job: Job) -> None:
        """Start a job; a process that died while it had nothing to do is replaced."""
        if worker not in self._workers or not self._workers[worker][0].is_alive():
            self._workers[worker] = self._spawn()
        self._busy.add(worker)
        with suppress(BrokenPipeError):  # it died just now, which wait() will report
            self._workers[worker][1].send(job)

    def wait(self) -> list[Report]:
        """Reports of all that have ended a job, or died, by now; waits for the first."""
        connections = {self._workers[worker][1]: worker for worker in self._busy}
        return [self._report(connections[ended]) for ended in wait(list(connections)) if isinstance(ended, Connection)]

    def _report(self, worker: int) -> Report:
        process, connection = self._workers[worker]
        self._busy.discard(worker)
        try:
            return worker, connection.recv()
        except (EOFError, OSError):
            process.join()
            connection.close()
            del self._workers[worker]
            code = process.exitcode
            return worker, f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"

    def _spawn(self) -> tuple[SpawnProcess, Connection]:
        context = spawn_context()
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs, self._work), daemon=True)
        with environment({name: os.environ.get(name, str(self._threads)) for name in THREAD_VARIABLES}):
            process.start()
        theirs.close()
        return process, ours


def _serve(connection: Connection, work: Work) -> None:
    """Work through jobs until the connection closes."""
    end_with_parent()
    worker = Worker(work)
    with suppress(EOFError, OSError):
        while True:
            connection.send(worker.perform(connection.recv().payload))


def end_with_parent() -> None:
    """End this process as soon as the one that started it ends, which alone heeds Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes of a terminal: the first one decides
    parent = multiprocessing.parent_process()

    def exit_with_parent() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=exit_with_parent, daemon=True).start()


class RayExecutor:
    """Workers that are actors of a Ray cluster, whose nodes must have this package installed.

    Ray places them, gives each ``threads`` processors and ``gpus``, or a share of one, and starts them again where
    there is room when their process or their node dies; a job that was lost that way goes to whichever actor is ready
    first. By default as many as the cluster has room for now. Its address is ``auto``, ``ray://host:10001``; None is
    RAY_ADDRESS, else a cluster that is started on this machine.
    """

    def __init__(
        self, work: Work, workers: int | None, threads: int, gpus: float = 0.0, address: str | None = None
    ) -> None:
        self._ray = _ray()
        self._work, self._size, self._threads, self._gpus, self._address = work, workers, threads, gpus, address
        self._actors: list[Any] = []
        self._starting: dict[Any, int] = {}
        self._running: dict[Any, int] = {}
        self._idle: set[int] = set()

    def __enter__(self) -> Self:
        home = Path(__file__).parents[2]  # Ray lets workers import from the current directory of this process
        try:
            with safe_path(), chdir(home):
                self._ray.init(address=self._address, log_to_driver=False, logging_level=logging.ERROR)
        except Exception as error:  # Ray raises errors of many kinds, some without a base of their own
            where = self._address or "RAY_ADDRESS"
            raise InputError(
                f"expected a Ray cluster at {where}, got '{_first_line(error)}'; check --ray-address"
            ) from error
        actor = self._ray.remote(Worker).options(
            num_cpus=self._threads, num_gpus=self._gpus, max_restarts=-1, max_task_retries=0
        )
        for worker in range(self._size or self._room()):
            self._actors.append(actor.remote(self._work))
            self._expect(worker)
        return self

    def __exit__(self, *_: object) -> None:
        for actor in self._actors:
            self._ray.kill(actor)
        self._actors.clear()
        self._ray.shutdown()

    def ready(self) -> list[int]:
        """Actors that live and have nothing to do."""
        return sorted(self._idle)

    def submit(self, worker: int, job: Job) -> None:
        """Start a job."""
        self._idle.discard(worker)
        self._running[self._actors[worker].perform.remote(job.payload)] = worker

    def wait(self) -> list[Report]:
        """The first that happens: an actor has started, ended a job, or died."""
        (reference,), _ = self._ray.wait([*self._running, *self._starting], num_returns=1)
        if reference in self._running:
            return [self._report(reference)]
        try:
            self._ray.get(reference)
        except self._ray.exceptions.RayError as error:
            raise OmnisynError(
                f"expected Ray to start a worker, got '{_first_line(error)}'; check that omnisyn-cli is installed on "
                "every node"
            ) from error
        self._idle.add(self._starting.pop(reference))
        return []

    def _report(self, reference: Any) -> Report:
        worker = self._running.pop(reference)
        try:
            answer = self._ray.get(reference)
        except self._ray.exceptions.RayError as error:
            self._expect(worker)
            return worker, _first_line(error)
        self._idle.add(worker)
        return worker, answer

    def _expect(self, worker: int) -> None:
        """Have Ray tell when an actor lives (again)."""
        reference = self._actors[worker].ready.options(max_task_retries=-1).remote()
        self._starting[reference] = worker

    def _room(self) -> int:
        resources = self._ray.cluster_resources()
        rooms = [resources.get("CPU", 0) / self._threads]
        if self._gpus:
            rooms.append(resources.get("GPU", 0) / self._gpus)
        room = int(min(rooms))
        if room < 1:
            raise InputError(
                f"expected a cluster with {self._threads} processors and {self._gpus:g} GPUs for one worker, got "
                f"{resources.get('CPU', 0):g} and {resources.get('GPU', 0):g}; ask for less or name --workers to wait"
            )
        return room


def _ray() -> Any:
    try:
        import ray
        import ray.exceptions
    except ImportError as error:
        raise InputError(
            'expected Ray for --engine ray, got none; install it: pip install "omnisyn-cli[ray]"'
        ) from error
    return ray


def _first_line(error: BaseException) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
