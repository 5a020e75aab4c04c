"""Workers that are actors of a Ray cluster.

Ray places them, gives them their share of processors and GPUs, and starts them again where there is room when their
process or their node dies. A job that was lost that way goes to whichever actor is ready first.
"""

import logging
from contextlib import chdir
from pathlib import Path
from typing import Any, Self

from omnisyn_cli.batch.executor import Job, Report, Work, Worker
from omnisyn_cli.compute.processes import safe_path
from omnisyn_cli.errors import InputError, OmnisynError


class RayExecutor:
    """An :class:`~omnisyn_cli.batch.executor.Executor` of Ray actors; the nodes must have this package installed.

    By default as many as the cluster has room for now, each with ``threads`` processors and ``gpus``, or a share of
    one. Its address is ``auto``, ``ray://host:10001``; None is RAY_ADDRESS, else a cluster that is started on this
    machine.
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
        _connect(self._ray, self._address)
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


def _connect(ray: Any, address: str | None) -> None:
    home = Path(__file__).parents[2]  # Ray lets workers import from the current directory of this process
    try:
        with safe_path(), chdir(home):
            ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    except Exception as error:  # Ray raises errors of many kinds, some without a base of their own
        raise InputError(
            f"expected a Ray cluster at {address or 'RAY_ADDRESS'}, got '{_first_line(error)}'; check --ray-address"
        ) from error


def _first_line(error: BaseException) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
