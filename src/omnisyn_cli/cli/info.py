"""``omnisyn info``: what the program sees in a file, before anything is done with it."""

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import click

from omnisyn_cli.cli.failures import EXIT_INPUT
from omnisyn_cli.cli.options import preset_option, reading_options, scale_options
from omnisyn_cli.cli.parameters import FilePath, WholeRange
from omnisyn_cli.cli.progress import leftover_notes, shown_stages
from omnisyn_cli.cli.terminal import print_json, say


@click.command()
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=FilePath())
@click.option("--max-pixels", type=WholeRange(1), help="Decode no image with more pixels.  [default: 268435456]")
@click.option("--allow-outside", is_flag=True, help="Accept depth and masks outside the folder of the pose file.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON list instead of text.")
@click.option(
    "--report", metavar="FILE.html", type=FilePath(),
    help="Also write a page about the pairs of panoramas: matches that agree and disagree with the poses, epipoles, "
    "depth and confidence. Without a pose file, poses are found in the pictures.",
)  # fmt: skip
@preset_option
@scale_options
@reading_options
@click.option("--overwrite", is_flag=True, help="Replace the report if it exists.")
@click.pass_context
def info(
    context: click.Context, /, files: tuple[Path, ...], max_pixels: int | None, allow_outside: bool, as_json: bool,
    report: Path | None, **options: Any,
) -> None:  # fmt: skip
    """Show what the program reads in panoramas, depth files, pose files and videos.

    \b
    omnisyn info a.jpg b.jpg poses.json
    omnisyn info a.jpg b.jpg --report report.html

    An unusable file does not stop the others; the exit code is then 3.
    """  # noqa: D301 - click's \b is a backspace
    from omnisyn_cli.interpolation.describe import describe_file
    from omnisyn_cli.io import MAX_PIXELS
    from omnisyn_cli.io.placement import Reading

    reading = Reading(**{name: options[name] for name in ("upper_half", "hfov", "vfov", "horizon")})
    limits: dict[str, Any] = {"max_pixels": max_pixels or MAX_PIXELS, "allow_outside": allow_outside}
    describe = partial(describe_file, reading=reading, **limits)
    descriptions = show_described(context, files, describe, as_json=as_json)
    if report is not None:
        _report(descriptions, report, **limits, **options)


def show_described(
    context: click.Context, files: Iterable[Path], describe: Callable[[Path], dict[str, Any]], *, as_json: bool
) -> list[dict[str, Any]]:
    """Print what is said of every file; the command ends where one cannot be used."""
    descriptions = [_description(path, describe) for path in files]
    if as_json:
        print_json(descriptions)
    else:
        for description in descriptions:
            _show(description)
    if not all(description["ok"] for description in descriptions):
        context.exit(EXIT_INPUT)
    return descriptions


def _report(descriptions: list[dict[str, Any]], report: Path, **options: Any) -> None:
    """Write the page about the panoramas among the files."""
    from omnisyn_cli.compute.stopwatch import while_timing
    from omnisyn_cli.interpolation.job import POSES_FROM_PICTURES, TourJob
    from omnisyn_cli.interpolation.pair_report import write_pair_report

    named = {
        kind: tuple(Path(each["file"]) for each in descriptions if each["kind"] == kind)
        for kind in ("panorama", "poses")
    }
    if len(named["poses"]) > 1:
        raise click.UsageError(f"expected one pose file with --report, got {len(named['poses'])}; name one")
    poses = (*named["poses"], POSES_FROM_PICTURES)[0]
    with shown_stages(is_quiet=False) as stages, while_timing(stages.time):
        for note in leftover_notes(report):
            stages.note(f"note: {note}")
        if poses == POSES_FROM_PICTURES:
            stages.show("poses")
        plan = write_pair_report(TourJob(named["panorama"], poses, report, **options))
        for note in plan.notes:
            stages.note(f"note: {note}")
    say(f"{report}: a page about {len(plan.entries)} panoramas", err=True)


def _description(path: Path, describe: Callable[[Path], dict[str, Any]]) -> dict[str, Any]:
    from omnisyn_cli.errors import OmnisynError

    try:
        description = describe(path)
    except OmnisynError as error:
        return {"file": str(path), "ok": False, "error": str(error)}
    return {"file": str(path), "ok": description.get("usable", True), **description}


def _show(description: dict[str, Any]) -> None:
    if "error" in description:
        say(f"error: {description['error']}", err=True)
        return
    say(f"{description['file']}: {description['kind']}")
    for key, value in description.items():
        if key not in ("file", "ok", "kind"):
            for line in _lines(key, value):
                say(f"  {line}")


def _lines(key: str, value: Any) -> Iterator[str]:
    """One line for a value, one for each of a list of tables or sentences."""
    label = key.replace("_", " ")
    if isinstance(value, list) and value and (isinstance(value[0], dict) or " " in str(value[0])):
        yield f"{label}:"
        for row in value:
            yield f"  {_text(row)}"
    else:
        yield f"{label}: {_text(value)}"


def _text(value: Any) -> str:
    if value is None or value == [] or value == {}:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value + 0.0:.6g}"  # no sign before zero
    if isinstance(value, list):
        return ", ".join(_text(item) for item in value)
    if isinstance(value, dict):
        return ", ".join(f"{key.replace('_', ' ')} {_text(item)}" for key, item in value.items() if item is not None)
    return str(value)
