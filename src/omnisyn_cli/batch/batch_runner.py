"""A batch from its manifest to its records: what ``omnisyn batch`` does, as a library.

:func:`run_batch` compares the manifest with what former runs left behind and does what is missing.
"""

import os
import re
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from omnisyn_cli import __version__
from omnisyn_cli.batch import folder as folders
from omnisyn_cli.batch.executor import Executor, Job, LocalExecutor, Outcome, RayExecutor, Work, run_jobs
from omnisyn_cli.batch.manifest import RECORDS, BatchJob, Manifest
from omnisyn_cli.batch.provenance import files_of, has_same_sources, job_sources
from omnisyn_cli.compute.threads import available_threads
from omnisyn_cli.errors import InputError, OmnisynError
from omnisyn_cli.interpolation.plan import SECONDS_PER_PAIR
from omnisyn_cli.io import read_header
from omnisyn_cli.io.outputs import TEMPORARY_PREFIX

INTERPOLATOR = "omnisyn_cli.batch.interpolations:Interpolator"  # what workers make their work function with
# Finding the depth of a pair of 2048×1024 takes as long as making so many frames; see docs/batch.md.
DEPTH_COST_FRAMES = 12.0


@dataclass(frozen=True)
class BatchOptions:
    """How a batch is done; none of it changes a result but for ``threads`` (encoders work differently with more)."""

    engine: Literal["local", "ray"] = "local"  # ``local`` (processes of this machine) or ``ray``
    workers: int | None = None  # how many; None is one per core or, with Ray, what the cluster has room for
    # of each worker; None divides the cores of this machine among the workers and is 1 with Ray
    threads: int | None = None
    gpus: float = 0.0  # GPUs, or a share of one, for each worker; only with Ray
    ray_address: str | None = None  # of the cluster; None is what Ray takes by default
    retry_failed: bool = False  # try jobs again that failed in a former run
    overwrite: bool = False  # replace files that no batch has written
    record_host: bool = False  # write the name of the machine into the record of each job


@dataclass(frozen=True)
class Progress:
    """How far a batch is; costs are in the unit of :attr:`~omnisyn_cli.batch.executor.Job.cost`."""

    done: int
    failed: int
    jobs: int
    cost_done: float
    cost: float


@dataclass
class BatchReport:
    """What became of the jobs of a manifest."""

    # jobs that this run has done: of their records only what is told at the end
    done: list[dict[str, Any]] = field(default_factory=list)
    kept: list[dict[str, Any]] = field(default_factory=list)  # jobs that were done already
    failed: list[dict[str, Any]] = field(default_factory=list)  # jobs that failed, now or before
    seconds: float = 0.0  # wall time of this run
    # hidden folders of runs that were killed, which this run has removed
    leftovers: list[Path] = field(default_factory=list)

    def describe(self) -> dict[str, Any]:
        """The report as plain values, for JSON; records of jobs that went well are in the file of records."""
        versions = sorted({str(record.get("version", "unknown")) for record in self.kept} - {__version__})
        return {
            "done": len(self.done), "kept": len(self.kept), "failed": len(self.failed),
            "seconds": round(self.seconds, 3), "job_seconds": round(sum(record["seconds"] for record in self.done), 3),
            "kept_from_versions": versions,
            "failures": [{key: record.get(key) for key in ("id", "error", "attempts")} for record in self.failed],
        }  # fmt: skip


def run_batch(
    manifest: Manifest, folder: Path, options: BatchOptions, on_progress: Callable[[Progress], None] | None = None
) -> BatchReport:
    """Do what is missing or has changed, and nothing else; ``on_progress`` is called first and after each job.

    Outputs and ``results.jsonl`` go into ``folder``, which is made if its parent exists. InputError: the manifest has
    problems, or the workers cannot be had; OutputPathError: outputs would replace what is not theirs, or another batch
    is at work in the folder; WriteError: the disk is full.
    """
    begin = time.perf_counter()
    if manifest.problems:
        raise InputError(f"{manifest.path}: expected lines without problems, got {len(manifest.problems)}; mend them")
    if options.engine != "ray" and (options.gpus or options.ray_address):
        raise InputError("expected a share of GPUs or a Ray address only with the engine ray, got local; name it")
    places = [place for job in manifest.jobs for place in job.places]
    inputs = {path for job in manifest.jobs for path in files_of(job)} | {manifest.path}
    folders.prepare_folder(folder, places, inputs, overwrite=options.overwrite)
    report = BatchReport()
    with folders.Records(folder / RECORDS) as records, folders.open_staging_dir(folder) as staging:
        report.leftovers = folders.remove_leftovers(folder, staging)
        todo = [job for job in manifest.jobs if _is_open(job, folder, records, report, options.retry_failed)]
        jobs = [Job(job.id, job, _cost(job), job.group) for job in todo]
        tell = on_progress or (lambda _: None)
        tell(progress := Progress(0, 0, len(jobs), 0.0, sum(job.cost for job in jobs)))
        executor = make_executor((folder.absolute(), staging), options, len(jobs))
        with closing(run_jobs(jobs, executor)) as outcomes:
            for outcome in outcomes:
                record = _record(outcome, folder, is_host_named=options.record_host)
                records.append(record)
                is_failed = record["status"] == "failed"
                (report.failed if is_failed else report.done).append(_short(record))
                counts = {"done": progress.done + (not is_failed), "failed": progress.failed + is_failed}
                tell(progress := replace(progress, **counts, cost_done=progress.cost_done + outcome.job.cost))
    report.seconds = time.perf_counter() - begin
    return report


def make_executor(place: tuple[Path, str], options: BatchOptions, jobs: int) -> Executor:
    """At most one worker per job; ``place`` is the folder, and the hidden one in it. InputError: Ray is missing."""
    if options.engine == "ray":
        threads = options.threads or 1
        work = Work(INTERPOLATOR, (*place, threads))
        return RayExecutor(work, options.workers, threads, options.gpus, options.ray_address)
    cores = available_threads()
    workers = options.workers or cores
    threads = options.threads or max(1, cores // workers)
    return LocalExecutor(Work(INTERPOLATOR, (*place, threads)), max(1, min(workers, jobs)), threads)


def _is_open(job: BatchJob, folder: Path, records: folders.Records, report: BatchReport, retry_failed: bool) -> bool:
    """Whether a job is to be done; if not, its former record goes into the report."""
    record = records.last(job.id)
    if record is None or not has_same_sources(job, record.get("sources")):
        return True
    if record.get("status") == "failed":
        if not retry_failed:
            report.failed.append(_short(record))
        return retry_failed
    if not folders.is_unchanged(folder, job.places, record.get("outputs", {})):
        return True
    report.kept.append(_short(record))
    return False


def _record(outcome: Outcome, folder: Path, *, is_host_named: bool) -> dict[str, Any]:
    """The line for ``results.jsonl``; files that a worker sent are written here."""
    job, answer = outcome.job.payload, outcome.answer
    value, error = dict(answer.value or {}), answer.error
    files = value.pop("files", None)
    if files is not None:
        folders.write_outputs(files, folder, job.places)
    about = {"id": job.id, "status": "done" if error is None else "failed", "version": __version__,
             "finished": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
             "worker": answer.worker if is_host_named else answer.worker.rpartition(":")[2],
             "attempts": outcome.attempts}  # fmt: skip
    if error is not None:
        value = {"error": error} if answer.trace is None else {"error": error, "traceback": answer.trace}
    sources = {} if error is None else {"sources": job_sources(job)}
    return {**about, **_without_folders(value, folder, job.folder), **sources}


def _without_folders(value: Any, output: Path, inputs: Path) -> Any:
    """Values in which text names what is made relative to ``output``, and everything else relative to ``inputs``."""
    if isinstance(value, dict):
        return {key: _without_folders(item, output, inputs) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_folders(item, output, inputs) for item in value]
    if not isinstance(value, str):
        return value
    hidden = rf"{re.escape(TEMPORARY_PREFIX)}[0-9a-f-]+"
    attempt = rf"{hidden}{re.escape(folders.STAGING_SUFFIX)}[/\\](?:{hidden}[/\\])?"
    made, given = (re.escape(f"{folder}{os.sep}") for folder in (output.absolute(), inputs))
    return re.sub(f"(?:{made}(?:{attempt})?|{given})", "", value)


def _short(record: dict[str, Any]) -> dict[str, Any]:
    return {key: record[key] for key in ("id", "version", "seconds", "attempts", "error") if key in record}


def _cost(job: BatchJob) -> float:
    """Pixels to be made, with those that take as long as depth: enough to tell long jobs from short ones."""
    pairs = len(job.images) - 1
    options = job.options
    seconds = options.get("duration", SECONDS_PER_PAIR * pairs)
    frames = options.get("frames") or seconds * options.get("fps", 30.0)
    width = job.size[1] if job.size else _width(job.images[0])
    return float(width * width / 2 * frames + DEPTH_COST_FRAMES * pairs * 1024 * 2048)


@lru_cache(maxsize=65536)
def _width(image: Path) -> int:
    try:
        return read_header(image).width
    except OmnisynError:
        return 1  # such a job will not take long
