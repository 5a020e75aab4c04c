"""``omnisyn bench``: what settings cost in time and memory, and what they are worth."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from omnisyn_cli.cli.evaluate import LAYOUTS, print_table
from omnisyn_cli.cli.options import device_option, json_option, quiet_option, report_option
from omnisyn_cli.cli.parameters import FilePath, Size, WholeRange
from omnisyn_cli.cli.progress import counted_bar, working_folder
from omnisyn_cli.cli.terminal import print_json

QUICK_SIZE = (256, 512)
"""Height and width of frames and scenes that ``--quick`` stands for."""


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
    show_default=True, help="Frame sizes; from the second on, only the presets are measured.",
)  # fmt: skip
@click.option(
    "--threads",
    metavar="N,...",
    type=ListOf(WholeRange(1)),
    default=(),
    help="At most this many.  [default: one per core]",
)
@click.option("--frames", type=WholeRange(1), default=6, show_default=True, help="Timed frames per clip.")
@click.option(
    "--scene-size", metavar="WxH", type=Size(), default="1024x512", show_default=True,
    help="Size of the generated scenes, if no data set is given.",
)  # fmt: skip
@click.option("--quick", is_flag=True, help="Frames and scenes of 512x256 only, for a quick look.")
@click.option(
    "--format", "layout", type=click.Choice(LAYOUTS), default="auto", help="Layout of the data, see omnisyn eval."
)
@click.option("--pairs", metavar="0:4|every:N|FILE", help="Input frames, see omnisyn eval.")
@device_option("Where networks run.")
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
    with working_folder(report, "bench", is_quiet=quiet) as folder:
        if dataset is None:
            dataset = folder / f"scenes-{scene_size[1]}x{scene_size[0]}"
            make_scenes(dataset, scene_size)
        wanted = {name: value for name, value in options.items() if value is not None or name != "methods"}
        runs, name = plan_bench(BenchJob(dataset, **wanted)), lambda _, figures: figures.setting.name
        with counted_bar("settings", len(runs), name, is_quiet=quiet, has_lines=True) as on_setting:
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
