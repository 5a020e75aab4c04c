"""``omnisyn depth-table``: the paper's depth table, on scenes that no network was trained on."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from omnisyn_cli.cli.compiling import say_when_compiling
from omnisyn_cli.cli.evaluate import print_table
from omnisyn_cli.cli.interpolate import Size
from omnisyn_cli.cli.numbers import WholeRange
from omnisyn_cli.cli.places import FilePath

if TYPE_CHECKING:
    from omnisyn_cli.evaluation.records import UnitRecord

__all__ = ["depth_table"]


@click.command(
    "depth-table", epilog="Exit codes: 0 done, 1 a method broke, 2 wrong usage, 3 unusable input, 130 interrupted."
)
@click.option(
    "--report", metavar="DIR", type=FilePath(),
    help="Keep results and table here; a run that was interrupted goes on from them.",
)  # fmt: skip
@click.option("--scenes", type=WholeRange(2), default=200, show_default=True, help="How many, half of them streets.")
@click.option(
    "--seed", type=WholeRange(0), default=20_000_000, show_default=True,
    help="Of the first scene; 10,000,000 at least, smaller ones are for training.",
)  # fmt: skip
@click.option(
    "--methods", metavar="all|LIST", default="all", show_default=True,
    help="Names separated by commas; network:FILE.onnx is a stereo network in a file.",
)  # fmt: skip
@click.option("--size", type=Size(), default="1024x512", show_default=True, help="Of the panoramas.")
@click.option(
    "--device", type=click.Choice(["auto", "cpu", "cuda"]), default="auto", show_default=True, help="For networks."
)
@click.option("--threads", type=WholeRange(1), help="At most this many threads.  [default: one per core]")
@click.option("--json", "as_json", is_flag=True, help="Print all results as JSON on stdout.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")
def depth_table(report: Path | None, as_json: bool, quiet: bool, **options: Any) -> int:
    """Compare estimated depth with the truth, on streets and rooms that the program makes.

    \b
    omnisyn depth-table --scenes 20
    omnisyn depth-table --report depth/ --methods matching,omnisyn-balanced,network:my-models/depth-paper.onnx

    Two panoramas a metre apart in every scene; both are scored where the true depth is between 1 m and 50 m. Networks
    that are not installed are listed with the reason.
    """  # noqa: D301 - click's \b is a backspace
    import tempfile

    from omnisyn_cli.evaluation.depth_table import (
        DepthTableJob,
        depth_tables,
        run_depth_table,
        write_depth_tables,
    )

    with ExitStack() as stack:
        stack.enter_context(say_when_compiling(is_quiet=quiet))
        folder = report or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="omnisyn-depth-table-")))
        with _progress(is_shown=not quiet and sys.stderr.isatty()) as on_unit:
            records = run_depth_table(DepthTableJob(folder, **options), on_unit)
        path = write_depth_tables(folder, records)
    if as_json:
        _print_json(records)
    elif not quiet:
        for table in depth_tables(records):
            print_table(table, table.title)
        if report is not None:
            click.echo(f"{path}: {len(records)} results")
    return int(any(record.status == "failed" for record in records))


def _print_json(records: Sequence[UnitRecord]) -> None:
    import json

    from omnisyn_cli import __version__

    values = {"version": __version__, "units": [record.to_json() for record in records]}
    click.echo(json.dumps(values, indent=2, ensure_ascii=False, allow_nan=False))


@contextmanager
def _progress(*, is_shown: bool) -> Iterator[Callable[[int, UnitRecord], None] | None]:
    """How far it is, on stderr; nothing where stderr is no terminal."""
    if not is_shown:
        yield None
        return
    from rich.console import Console
    from rich.status import Status

    with Status("scenes", console=Console(stderr=True)) as status:
        yield lambda done, record: status.update(f"{done} results, {record.scene} {record.method}")
