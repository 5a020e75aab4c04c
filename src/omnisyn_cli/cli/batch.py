"""``omnisyn batch``: every pair of a manifest, on this machine or on a Ray cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from omnisyn_cli.cli.failures import EXIT_CODES_LINE, EXIT_FAILURE
from omnisyn_cli.cli.options import json_option, quiet_option
from omnisyn_cli.cli.parameters import FilePath, FiniteRange, WholeRange
from omnisyn_cli.cli.progress import drawn_bars, is_watched, leftover_notes
from omnisyn_cli.cli.terminal import print_json, printable, say
from omnisyn_cli.errors import InputError

if TYPE_CHECKING:
    from omnisyn_cli.batch.batch_runner import BatchReport, Progress

MAX_SHOWN_JOBS = 20  # failures in the table at the end; all of them are in results.jsonl and in --json


class _BatchCommand(click.Command):
    """A command whose first argument ``plan`` is another command."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        """That of ``plan`` if it is named."""
        if args[:1] == [plan.name]:
            return plan.make_context(f"{info_name} {plan.name}", args[1:], parent, **extra)
        return super().make_context(info_name, args, parent, **extra)


@click.command(cls=_BatchCommand)
@click.argument("manifest", type=FilePath())
@click.option(
    "-o", "--output", required=True, metavar="FOLDER", type=FilePath(), help="Folder of all outputs and records."
)
@click.option(
    "--engine", type=click.Choice(["local", "ray"]), default="local",
    help="Processes on this machine, or actors on a Ray cluster.",
)  # fmt: skip
@click.option(
    "--workers", type=WholeRange(1), help="Number of workers.  [default: one per core; as many as Ray has room for]"
)
@click.option(
    "--threads", type=WholeRange(1), help="Threads per worker.  [default: the cores divided by the workers; 1 with Ray]"
)
@click.option(
    "--ray-address", metavar="ADDRESS", help="Address of the cluster, such as auto.  [default: what Ray finds]"
)
@click.option("--gpus", type=FiniteRange(0), default=0.0, help="GPUs per Ray worker, or a share of one.")
@click.option("--retry-failed", is_flag=True, help="Repeat jobs that failed in an earlier run.")
@click.option("--overwrite", is_flag=True, help="Replace files in FOLDER that no batch wrote.")
@click.option("--record-host", is_flag=True, help="Write the name of the machine into results.jsonl.")
@json_option("the report")
@quiet_option
@click.pass_context
def batch(context: click.Context, /, manifest: Path, output: Path, as_json: bool, quiet: bool, **options: Any) -> None:
    """Make all videos of MANIFEST, a JSONL or CSV file with one job per line.

    \b
    omnisyn batch plan tour/ -o jobs.jsonl --set frames=30
    omnisyn batch jobs.jsonl -o out/
    omnisyn batch jobs.jsonl -o out/ --engine ray --ray-address auto

    A line has an id, inputs and poses (or a scene folder), and any option of interpolate. FOLDER/results.jsonl records
    every job. Started again, the command does only what is missing or has changed. `omnisyn batch plan` writes a
    manifest.
    """  # noqa: D301 - click's \b is a backspace
    from omnisyn_cli.batch.batch_runner import BatchOptions, run_batch
    from omnisyn_cli.batch.manifest import read_manifest

    checked = read_manifest(manifest)
    for problem in checked.problems:
        say(f"{manifest}: {' '.join(problem.splitlines())}", err=True)
    if checked.problems:
        raise InputError(
            f"{manifest}: expected lines without problems, got {len(checked.problems)} (see above); mend them, nothing "
            "was started"
        )
    with _progress(is_quiet=quiet) as on_progress:
        report = run_batch(checked, output, BatchOptions(**options), on_progress)
    _print_report(report, output, as_json=as_json, quiet=quiet)
    if report.failed:
        context.exit(EXIT_FAILURE)


@click.command("plan", epilog=EXIT_CODES_LINE)
@click.argument("source", metavar="FOLDER|POSES", type=FilePath())
@click.option("-o", "--output", required=True, type=FilePath(), help="Manifest to write (.jsonl).")
@click.option(
    "--max-baseline", type=FiniteRange(0, min_open=True), default=10.0, help="Largest distance of neighbours in metres."
)
@click.option(
    "--neighbours", type=WholeRange(1), default=2, help="Number of nearest panoramas that each is paired with."
)
@click.option("--one-way", is_flag=True, help="Plan one direction only.")
@click.option(
    "--share", type=WholeRange(1), default=8,
    help="Consecutive pairs that one worker does, so that it decodes shared panoramas once.",
)  # fmt: skip
@click.option("--set", "settings", metavar="NAME=VALUE", multiple=True, help="Option of every job; may be repeated.")
@click.option("--overwrite", is_flag=True, help="Replace the manifest if it exists.")
@quiet_option
def plan(
    source: Path, output: Path, one_way: bool, settings: tuple[str, ...], overwrite: bool, quiet: bool, **options: Any
) -> None:
    """Write a manifest of all neighbours in a tour: a pose file, a folder with poses.json, or a folder of such folders.

    Both directions of a pair are adjacent, so its depth is estimated once. --share says how many pairs one worker does
    in a row.
    """
    from omnisyn_cli.batch.pairing import TourOptions, plan_tours, write_manifest

    if output.suffix != ".jsonl":
        raise InputError(f"{output}: expected a name that ends in .jsonl, got {output.suffix or 'no ending'}; add it")
    chosen = TourOptions(both_directions=not one_way, options=dict(map(_setting, settings)), **options)
    lines = plan_tours(source, chosen)
    write_manifest(output, lines, overwrite=overwrite)
    if not quiet:
        say(f"{output}: {len(lines)} jobs")


def _setting(text: str) -> tuple[str, Any]:
    """Name and value; numbers, true and false are what they are in JSON."""
    import json

    name, equals, value = text.partition("=")
    if not equals:
        raise click.BadParameter(f"expected NAME=VALUE such as frames=30, got {text!r}", param_hint="--set")
    try:
        return name, json.loads(value)
    except ValueError:
        return name, value


def _print_report(report: BatchReport, folder: Path, *, as_json: bool, quiet: bool) -> None:
    if as_json:
        print_json(report.describe())
    elif not quiet:
        total = len(report.done) + len(report.kept) + len(report.failed)
        say(
            f"{folder}: {total} jobs, {len(report.done)} done in {report.seconds:.1f} s, {len(report.kept)} done "
            f"before, {len(report.failed)} failed"
        )
        for version in report.describe()["kept_from_versions"]:
            say(f"note: some were done by version {version}; remove their outputs to have them again", err=True)
    if not quiet:
        for folder_left in report.leftovers:
            say(f"note: a run that was killed had left {folder_left}, which is removed", err=True)
        for note in leftover_notes(folder):
            say(f"note: {note}", err=True)
    if report.failed:
        _print_failures(report)


def _print_failures(report: BatchReport) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("job", "attempts", "error", title=f"{len(report.failed)} failed")
    for record in report.failed[:MAX_SHOWN_JOBS]:
        table.add_row(*(printable(str(record.get(key, ""))) for key in ("id", "attempts", "error")))
    if len(report.failed) > MAX_SHOWN_JOBS:
        table.add_row("…", "", f"{len(report.failed) - MAX_SHOWN_JOBS} more in results.jsonl")
    Console(stderr=True, markup=False).print(table)


@contextmanager
def _progress(*, is_quiet: bool) -> Iterator[Callable[[Progress], None] | None]:
    """A bar over all jobs with the time left on stderr; a line for each job where stderr is no terminal."""

    def in_words(now: Progress) -> str:
        return f"{now.done + now.failed}/{now.jobs} jobs" + (f", {now.failed} failed" if now.failed else "")

    if not is_watched(is_quiet=is_quiet):
        yield None if is_quiet else (lambda now: say(in_words(now), err=True))
        return
    from rich import progress

    times = (progress.TimeElapsedColumn(), progress.TimeRemainingColumn())
    with drawn_bars(*times, speed_estimate_period=3600) as bar:
        task = bar.add_task("jobs", total=None)

        def show(now: Progress) -> None:
            bar.update(task, total=now.cost, completed=now.cost_done, description=in_words(now))

        yield show
