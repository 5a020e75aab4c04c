"""Workers that are processes of this machine.

Each is started afresh (spawn), so that none inherits threads or locks, and ends by itself when this process is gone.
"""

import multiprocessing
import os
import signal
import threading
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Self

from omnisyn_cli.batch.executor import Job, Report, Work, Worker
from omnisyn_cli.compute.processes import spawn_context

SHUTDOWN_TIMEOUT_SECONDS = 10
"""That a worker has to finish after its connection is closed; then it is killed."""

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables by which numerical libraries take their number of threads."""


class LocalExecutor:
    """An :class:`~omnisyn_cli.batch.executor.Executor` of processes; each is started when its first job is given.

    Args:
        work: what to do.
        workers: how many.
        threads: of each worker's libraries.
    """

    def __init__(self, work: Work, workers: int, threads: int) -> None:
        self._work, self._size, self._threads = work, workers, threads
        self._workers: dict[int, tuple[SpawnProcess, Connection]] = {}
        self._busy: set[int] = set()

    def __enter__(self) -> Self:
        return self

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
        process = context.Process(target=_serve, args=(theirs, self._work, self._threads), daemon=True)
        process.start()
        theirs.close()
        return process, ours


def _serve(connection: Connection, work: Work, threads: int) -> None:
    """Work through jobs until the connection closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes of a terminal: the first one decides
    for name in THREAD_VARIABLES:  # libraries read them when they are loaded, which they are not yet
        os.environ.setdefault(name, str(threads))
    end_with_parent()
    worker = Worker(work)
    with suppress(EOFError, OSError):
        while True:
            connection.send(worker.perform(connection.recv().payload))


def end_with_parent() -> None:
    """End this process as soon as the one that started it ends."""
    parent = multiprocessing.parent_process()

    def exit_with_parent() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=exit_with_parent, daemon=True).start()
