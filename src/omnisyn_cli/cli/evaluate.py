"""``omnisyn eval`` and ``bench``: methods compared with true frames and depth, and what settings cost and are worth."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from omnisyn_cli.cli.options import device_option, json_option, quiet_option, report_option, threads_option
from omnisyn_cli.cli.parameters import FilePath, Size, WholeRange
from omnisyn_cli.cli.progress import counted_bar, leftover_notes, working_folder
from omnisyn_cli.cli.terminal import print_json, printable, say

if TYPE_CHECKING:
    from omnisyn_cli.evaluation.results import UnitRecord
    from omnisyn_cli.evaluation.tables import Table

# Keys of :data:`omnisyn_cli.evaluation.datasets.FORMATS`, written out because ``--help`` should not load them.
LAYOUTS = ("auto", "omnisyn", "carla", "m3d", "zind")
TABLE_COLUMNS = 160  # characters of a table that no terminal limits

layout_option = click.option(
    "--format", "layout", type=click.Choice(LAYOUTS), default="auto", show_default=False,
    help="Layout of the data, see omnisyn eval.",
)  # fmt: skip


def _list_methods(context: click.Context, _: click.Parameter, is_asked: bool) -> None:
    if not is_asked:
        return
    from omnisyn_cli.evaluation.methods import METHODS

    width = max(map(len, METHODS))
    for method in METHODS.values():
        say(f"{method.name:{width}}  {method.description}")
    context.exit()


@click.command("eval")
@click.argument("dataset", metavar="DATASET_DIR", type=FilePath())
@report_option("results, pictures and the report")
@click.option(
    "--methods", metavar="usual|all|LIST", default="usual",
    help="Names separated by commas, see --list-methods. A name may have parameters: matching:cut=0.02. usual: "
    "crossfade, matching, the presets from fast to balanced, and the true depth if known; between photographs what "
    "interpolate does, and its parts.",
)  # fmt: skip
@click.option(
    "--list-methods", is_flag=True, is_eager=True, expose_value=False, callback=_list_methods, help="List all methods."
)
@click.option(
    "--format", "layout", type=click.Choice(LAYOUTS), default="auto",
    help="Layout of the data: this program's, the authors' CARLA, Habitat renders (PanoGRF), or ZInD tours.",
)  # fmt: skip
@click.option(
    "--pairs", metavar="0:4,1:3|every:N|FILE",
    help="Input frames by index in every scene. every:4 takes 0:4, 4:8 and so on; around takes the neighbours of each "
    "frame. A text file has one pair per line: "
    "scene, first, second.  [default: the first and the last]",
)  # fmt: skip
@click.option(
    "--leave-out", is_flag=True,
    help="DATASET_DIR has photographs of tours: each is left out once and compared with the frame made of its "
    "neighbours. Poses come from poses.json, else they are estimated.",
)  # fmt: skip
@click.option("--size", type=Size(), help="Compare frames of this size.  [default: of the true frames]")
@click.option("--allow-outside", is_flag=True, help="Accept depth and masks outside the folder of poses.json.")
@click.option("--no-pictures", is_flag=True, help="Save no frames, error maps and depth maps.")
@device_option("What makes frames and runs networks; everything else runs on the processor.")
@threads_option
@json_option("all results")
@quiet_option
def eval_(report: Path | None, no_pictures: bool, as_json: bool, quiet: bool, **options: Any) -> int:
    """Compare methods on scenes with true frames between two panoramas.

    \b
    omnisyn eval scenes/
    omnisyn eval scenes/ --report report/ --methods all
    omnisyn eval scenes/ --methods matching,crossfade,oracle-depth --size 512x256
    omnisyn eval Town06/ --format carla --pairs every:5 --report report/
    omnisyn eval walks/ --pairs every:2 --methods omnisyn-balanced,omnisyn-balanced:neighbours=2
    omnisyn eval photographs/ --leave-out --report report/

    A data set is a folder of scene folders. The first and the last panorama of a scene are the inputs, and those
    between are the truth. Depth is compared where the truth is known. The report also gives errors by kind of pixel
    (both views agree, they disagree, one view only, hole, beside silhouettes), depth confidence, changes between
    frames, flying pixels and shards. A pair without true frames has one frame half way, judged by shards alone.
    """  # noqa: D301 - click's \b is a backspace
    import shlex

    from omnisyn_cli import __version__
    from omnisyn_cli.evaluation.engine import EvaluationJob, evaluate, plan_evaluation
    from omnisyn_cli.evaluation.visualization import PICTURES_FOLDER

    with working_folder(report, is_quiet=quiet) as folder:
        command = shlex.join(["omnisyn", *sys.argv[1:]])
        job = EvaluationJob(report=folder, pictures=report is not None and not no_pictures, command=command, **options)
        if job.leave_out and not quiet:
            say("note: poses of tours without poses.json are estimated first: some 10 s a scene", err=True)
        plan = plan_evaluation(job)
        if not quiet:
            left = leftover_notes(report, pictures=report / PICTURES_FOLDER) if report else ()
            kept = f"are kept in {report} as they come; started again, the command goes on from there"
            if report is None:
                kept = "are printed at the end and kept nowhere; --report DIR keeps them as they come, with pictures"
            for note in (f"results {kept}", *left):
                say(f"note: {note}", err=True)
        with counted_bar(
            "depth and frames", plan.units, lambda _, record: f"{record.scene} {record.method}", is_quiet=quiet
        ) as on_unit:
            records = evaluate(plan, on_unit, has_report=report is not None)
    if as_json:
        about = {"dataset": str(job.dataset), "report": None if report is None else str(report)}
        print_json({"version": __version__, **about, "units": [record.to_json() for record in records]})
    elif not quiet:
        _print_table(records)
        if report is not None:
            say(f"{report / 'report.html'}: {len(records)} results")
    return int(any(record.status == "failed" for record in records))


def _print_table(records: Sequence[UnitRecord]) -> None:
    """The means per method, what tours are worth, what is known without true frames, and why others have none."""
    from omnisyn_cli.evaluation.tables import ARTEFACTS, mean_table, method_table, tour_table

    tables = [(mean_table(records), None), (tour_table(records), "In tours, against pairs alone")]
    if any("ws_psnr" not in frame.scores for record in records for frame in record.frames):
        tables.append((method_table(records, ARTEFACTS), "Some pairs have no true frames"))
    for table, title in tables:
        if table.rows:
            print_table(table, title)
    for record in records:
        if record.status == "failed" or not record.method:
            name = " ".join(part for part in (record.scene, record.method) if part)
            say(f"{name}: {record.status}: {record.reason}")


def print_table(shown: Table, title: str | None = None) -> None:
    """Print a table of figures, below it the rows that have a reason instead."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    from omnisyn_cli.evaluation.tables import ERROR_NOTE, format_cell

    table = Table(title=title, box=box.SIMPLE, title_justify="left")
    table.add_column(shown.corner, no_wrap=True)
    for column in shown.columns:
        table.add_column(column.title, justify="right")
    for row in shown.rows:
        cells = [format_cell(cell, column.digits) for cell, column in zip(row.cells, shown.columns, strict=False)]
        table.add_row(printable(f"{row.name} (upper bound)" if row.is_bound else row.name), *cells)
    if any(row.cells for row in shown.rows):
        Console(width=None if sys.stdout.isatty() else TABLE_COLUMNS, markup=False).print(table)
    if any(not math.isnan(cell.error) for row in shown.rows for cell in row.cells):
        say(ERROR_NOTE.partition(". ")[0])
    for row in shown.rows:
        if not row.cells:
            say(f"{row.name}: {row.reason}")


QUICK_SIZE = (256, 512)  # height and width of frames and scenes that ``--quick`` stands for


class ListOf(click.ParamType):  # type: ignore[type-arg]
    """Values of a type, separated by commas."""

    def __init__(self, of: click.ParamType) -> None:  # type: ignore[type-arg]
        self._of = of
        self.name = f"{of.name},..."

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[Any, ...]:
        """All of them, each once."""
        if isinstance(value, tuple):
            return value
        return tuple(dict.fromkeys(self._of.convert(part.strip(), param, ctx) for part in str(value).split(",")))


@click.command()
@click.argument("dataset", metavar="[DATASET_DIR]", required=False, type=FilePath())
@report_option("results, page and diagram")
@click.option(
    "--methods", metavar="NAME,...",
    help="Methods of omnisyn eval, such as omnisyn-fast,omnisyn-balanced:rows=512.  [default: cross-fade, optical "
    "flow, matching, the presets, and balanced with one change at a time]",
)  # fmt: skip
@click.option(
    "--sizes", metavar="WxH,...", type=ListOf(Size()), default="1024x512,2048x1024,4096x2048",
    help="Frame sizes; from the second on, only the presets are measured.",
)  # fmt: skip
@click.option(
    "--threads", metavar="N,...", type=ListOf(WholeRange(1)), default=(),
    help="At most this many.  [default: one per core]",
)  # fmt: skip
@click.option("--frames", type=WholeRange(1), default=6, help="Timed frames per clip.")
@click.option(
    "--scene-size", metavar="WxH", type=Size(), default="1024x512",
    help="Size of the generated scenes, if no data set is given.",
)  # fmt: skip
@click.option("--quick", is_flag=True, help="Frames and scenes of 512x256 only, for a quick look.")
@layout_option
@click.option("--pairs", metavar="0:4|every:N|FILE", help="Input frames, see omnisyn eval.")
@device_option("What makes frames and runs networks.")
@click.option("--store", metavar="FILE", type=FilePath(), help="Write the table that interpolate --budget uses.")
@json_option("all figures")
@quiet_option
def bench(
    dataset: Path | None, report: Path | None, scene_size: tuple[int, int], quick: bool, store: Path | None,
    as_json: bool, quiet: bool, **options: Any,
) -> int:  # fmt: skip
    """Measure the cost and gain of settings.

    \b
    omnisyn bench --quick
    omnisyn bench --report bench/ --store pareto.json
    omnisyn bench scenes/ --methods omnisyn-balanced,omnisyn-balanced:rows=512 --sizes 1024x512 --threads 1,2

    Every combination of method, size and threads makes one clip per pair of panoramas, in its own process. Accuracy
    needs true frames between. Without a data set the command makes twelve scenes: streets, rooms and homes, 1 to 6
    metres long. Seconds are summed over all cores and include the encoder.
    """  # noqa: D301 - click's \b is a backspace
    from omnisyn_cli import __version__
    from omnisyn_cli.evaluation.bench_settings import BenchJob, machine_in_words, make_scenes, plan_bench, run_bench
    from omnisyn_cli.evaluation.report import bench_tables, write_bench_report
    from omnisyn_cli.interpolation.planning.figures import write_table
    from omnisyn_cli.io import check_output

    if quick:
        scene_size, options["sizes"] = QUICK_SIZE, (QUICK_SIZE,)
    if store is not None:
        check_output(store, overwrite=True)
    with working_folder(report, is_quiet=quiet) as folder:
        if dataset is None:
            dataset = folder / f"scenes-{scene_size[1]}x{scene_size[0]}"
            make_scenes(dataset, scene_size)
        wanted = {name: value for name, value in options.items() if value is not None or name != "methods"}
        runs, name = plan_bench(BenchJob(dataset, **wanted)), lambda _, figures: figures.setting.name
        with counted_bar("settings", len(runs), name, is_quiet=quiet) as on_setting:
            measured = run_bench(folder, runs, on_setting)
        write_bench_report(folder, measured)
    if store is not None:
        write_table(store, machine_in_words(), measured)
    if as_json:
        settings = [asdict(figures) for figures in measured]
        print_json({"version": __version__, "machine": machine_in_words(), "settings": settings})
    elif not quiet:
        for table in bench_tables(measured):
            print_table(table, table.title)
    return int(any(figures.status == "failed" for figures in measured))
