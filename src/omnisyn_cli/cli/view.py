"""``omnisyn view``: a page to walk through panoramas in a browser."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from omnisyn_cli.cli.help import SectionedCommand
from omnisyn_cli.cli.options import check_one_cut, device_option, named, output_options, surface_options, tour_options
from omnisyn_cli.cli.parameters import FilePath, WholeRange
from omnisyn_cli.cli.runner import run_job
from omnisyn_cli.cli.terminal import say
from omnisyn_cli.pipeline.config import FALLBACKS

if TYPE_CHECKING:
    from pathlib import Path

    from omnisyn_cli.interpolation.summary import TourSummary
    from omnisyn_cli.interpolation.viewer.run import ViewJob

LINUX_OPENER = "xdg-open"  # finds the browser, or, with many lines of its own, none
OPENER_SECONDS = 2.0  # after which it has found one: it may go on for as long as the browser does


@click.command(cls=SectionedCommand)
@tour_options
@click.option(
    "-o", "--output", type=FilePath(),
    help="Page (.html), or a folder with --folder.  [default: FOLDER.html or A-C.html, here]",
)  # fmt: skip
@click.option(
    "--texture", metavar="COLUMNS", type=WholeRange(16, 16384), default=4096,
    help="Maximum width of the photographs in the page.",
)  # fmt: skip
@click.option("--lossless", is_flag=True, help="Store photographs as PNG, several times as large as JPEG.")
@click.option(
    "--add", "new", metavar="NEW", multiple=True, type=FilePath(),
    help="Place this panorama into the tour: an entry more in its pose file. May be repeated. With --folder, files of "
    "other panoramas stay.",
)  # fmt: skip
@click.option("--folder", is_flag=True, help="Write a folder for a web server instead of one file of at most 32 MiB.")
@click.option("--serve", is_flag=True, help="Serve the folder to browsers on this machine until Ctrl-C.")
@click.option("--open", "is_opened", is_flag=True, help="Open the walk in the browser.")
@surface_options
@device_option("Where networks run; auto uses a GPU if ONNX Runtime has one.")
@click.option(
    "--fallback", type=click.Choice(list(FALLBACKS)), default="auto",
    help="For pairs of low confidence. auto: the worst are cross-faded; crossfade: all are; none: a warning; fail: "
    "exit code 3.",
)  # fmt: skip
@output_options
def view(
    *, as_json: bool, dry_run: bool, quiet: bool, texture: int, lossless: bool,
    folder: bool, serve: bool, is_opened: bool, new: tuple[Path, ...], **options: Any,
) -> None:  # fmt: skip
    """Make an interactive page to walk through, from panorama A to B, and on through C and more.

    \b
    omnisyn view a.jpg b.jpg --poses auto --baseline 1.4 --open
    omnisyn view a.jpg b.jpg c.jpg --poses auto -o walk.html --preset balanced
    omnisyn view tour/ --folder --serve --open
    omnisyn view tour/ --add tour/new.jpg --folder --overwrite

    FOLDER means the panoramas in its poses.json, in the order of that file. With --poses auto it means all pictures in
    it, in an order found from their matches.

    The page works offline from a double click. It shows what a video frame would show, from any place near the path.
    In it, R measures distances, and O shows the tour from outside. Poses, masks and depth work as in `interpolate`.

    Put `--` before names that begin with a dash.
    """  # noqa: D301 - click's \b is a backspace
    from omnisyn_cli.interpolation.viewer.run import ViewJob, plan_view

    check_one_cut(options)
    if serve and not folder:
        raise click.UsageError("expected --serve with --folder, got a single file, which needs no server")
    kinds: dict[str, Any] = {"texture": texture, "is_lossless": lossless, "is_folder": folder}

    def job_of() -> ViewJob:
        return ViewJob(**kinds, **named(options, lambda: "-walk" if folder else ".html"))

    job = job_of()
    if new:
        if dry_run:
            raise click.UsageError("expected --add without --dry-run, got both; leave one of them out")
        _place(job, new, is_quiet=quiet)
        if not options["images"][0].is_dir():
            options["images"] = (*options["images"], *new)
        job = job_of()
    made = run_job(job, plan_view, "viewer.run:run_view", _report, as_json=as_json, dry_run=dry_run, quiet=quiet)
    if made is None:
        return
    if serve:
        _serve(job.output, is_opened=is_opened, is_quiet=quiet)
    elif is_opened:
        _open(str((job.output / "index.html" if folder else job.output).absolute()))


def _place(job: ViewJob, new: tuple[Path, ...], *, is_quiet: bool) -> None:
    """Add panoramas to the pose file of a tour, after a look at whether the walk can be made."""
    from dataclasses import replace

    from omnisyn_cli.interpolation.job import POSES_FROM_PICTURES, picture_options
    from omnisyn_cli.interpolation.viewer.run import plan_view
    from omnisyn_cli.poses.addition import add_to_file
    from omnisyn_cli.poses.file import read_poses

    if job.poses == POSES_FROM_PICTURES or job.refine:
        raise click.UsageError("expected --add with a pose file that stays, got --poses auto or --refine; leave it out")
    plan_view(replace(job, masks=(), blur=()))
    poses = read_poses(job.poses, allow_outside=job.allow_outside)
    notes = add_to_file(job.images, new, poses, job.poses, picture_options(job))
    for note in () if is_quiet else notes:
        say(note, err=True)


def _report(summary: TourSummary) -> None:
    """Say what was written, in one line."""
    plan, seconds = summary.plan, summary.seconds["total"]
    what = f"a walk through {len(plan.entries)} panoramas, {summary.results['bytes'] / 1e6:.1f} MB"
    say(f"{plan.job.output}: {what}, in {seconds:.1f} s")


def _serve(folder: Path, *, is_opened: bool, is_quiet: bool) -> None:
    """Serve a folder until somebody ends it."""
    from omnisyn_cli.interpolation.viewer.serve import served

    with served(folder) as (address, server):
        if not is_quiet:
            say(f"{address} shows the walk on this machine; Ctrl-C ends it", err=True)
        if is_opened:
            _open(address)
        server.serve_forever()


def _open(address: str) -> None:
    """Show a file or an address in the browser, or say that there is none. What openers print is for their makers."""
    import shutil
    import subprocess

    opener = shutil.which(LINUX_OPENER)
    if opener is None:  # other systems have their own, which are quiet
        code = click.launch(address)
    else:
        process = subprocess.Popen(  # noqa: S603 - of the system
            [opener, address], start_new_session=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            code = process.wait(OPENER_SECONDS)
        except subprocess.TimeoutExpired:  # it is the browser now
            code = 0
    if code:
        say(f"note: expected a browser, got none; open {address} in one", err=True)
