"""``omnisyn depth-table``: the paper's depth table, on scenes that no network was trained on."""

from pathlib import Path
from typing import Any

import click

from omnisyn_cli.cli.evaluate import print_records, print_table
from omnisyn_cli.cli.options import device_option, json_option, quiet_option, report_option, threads_option
from omnisyn_cli.cli.parameters import Size, WholeRange
from omnisyn_cli.cli.progress import counted_bar, working_folder
from omnisyn_cli.cli.terminal import say


@click.command("depth-table")
@report_option("results and table")
@click.option(
    "--scenes", type=WholeRange(2), default=200, show_default=True, help="Number of scenes, half of them streets."
)
@click.option(
    "--seed", type=WholeRange(0), default=20_000_000, show_default=True,
    help="Seed of the first scene, at least 10,000,000; smaller ones are for training.",
)  # fmt: skip
@click.option(
    "--methods", metavar="all|LIST", default="all", show_default=True,
    help="Names separated by commas; network:FILE.onnx is a stereo network in a file.",
)  # fmt: skip
@click.option("--size", type=Size(), default="1024x512", show_default=True, help="Size of the panoramas.")
@device_option("Where networks run.")
@threads_option
@json_option("all results")
@quiet_option
def depth_table(report: Path | None, as_json: bool, quiet: bool, **options: Any) -> int:
    """Compare estimated with true depth on generated streets and rooms.

    \b
    omnisyn depth-table --scenes 20
    omnisyn depth-table --report depth/ --methods matching,omnisyn-balanced,network:my-models/depth-paper.onnx

    Every scene has two panoramas one metre apart. Both are scored where the true depth is between 1 m and 50 m.
    Networks that are not installed are listed with the reason.
    """  # noqa: D301 - click's \b is a backspace
    with working_folder(report, "depth-table", is_quiet=quiet) as folder:
        from omnisyn_cli.evaluation.depth_benchmark import (
            DepthTableJob,
            depth_sources,
            depth_tables,
            run_depth_table,
            write_depth_tables,
        )

        job = DepthTableJob(folder, **options)
        total = job.scenes * len(depth_sources(job.methods))
        with counted_bar("scenes", total, lambda _, made: f"{made.scene} {made.method}", is_quiet=quiet) as on_unit:
            records = run_depth_table(job, on_unit)
        path = write_depth_tables(folder, records)
    if as_json:
        print_records(records)
    elif not quiet:
        for table in depth_tables(records):
            print_table(table, table.title)
        if report is not None:
            say(f"{path}: {len(records)} results")
    return int(any(record.status == "failed" for record in records))
