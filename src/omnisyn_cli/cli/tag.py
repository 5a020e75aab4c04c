"""``omnisyn tag``: 360° metadata for videos and pictures that have lost it."""

from pathlib import Path
from typing import Any

import click

from omnisyn_cli.cli.info import show_described
from omnisyn_cli.cli.options import json_option, part_options, quiet_option
from omnisyn_cli.cli.parameters import FilePath
from omnisyn_cli.cli.terminal import say


@click.command()
@click.argument("files", metavar="VIDEO|PICTURE...", nargs=-1, required=True, type=FilePath())
@click.option(
    "-o", "--output", type=FilePath(), help="File to write, or a folder.  [default: NAME-360.mp4 beside NAME.mp4]"
)
@click.option("--in-place", is_flag=True, help="Replace the files themselves, each when its copy is complete.")
@click.option(
    "--stereo", type=click.Choice(["mono", "top-bottom", "left-right"]), default="mono",
    help="How a video holds both eyes, if it does.",
)  # fmt: skip
@part_options
@click.option("--allow-aspect", is_flag=True, help="Accept files that are not 2:1 for each eye.")
@click.option("--check", is_flag=True, help="Say what is in the files and what players make of them; write nothing.")
@click.option("--overwrite", is_flag=True, help="Replace the output if it exists.")
@json_option("with --check what is said")
@quiet_option
@click.pass_context
def tag(
    context: click.Context, /, *, files: tuple[Path, ...], output: Path | None, in_place: bool, stereo: str,
    allow_aspect: bool, check: bool, overwrite: bool, as_json: bool, quiet: bool, **part: Any,
) -> None:  # fmt: skip
    """Write 360° metadata into videos and pictures that lost it when they were cut or edited.

    \b
    omnisyn tag edited.mp4
    omnisyn tag --check edited.mp4 retouched.jpg
    omnisyn tag retouched.jpg --in-place
    omnisyn tag both-eyes.mp4 --stereo top-bottom -o headset.mp4

    MP4 and MOV get spherical metadata of both versions, JPEG gets GPano tags. Nothing is encoded again: picture and
    sound stay as they are, to the byte.
    """  # noqa: D301 - click's \b is a backspace
    from omnisyn_cli.io.placement import Reading
    from omnisyn_cli.io.tagging import check_taggable, described_tags, write_tags

    if check:
        show_described(context, files, described_tags, as_json=as_json)
        return
    reading = Reading(**part)
    targets = list(files) if in_place else _targets(files, output, overwrite)
    for file in files:
        check_taggable(file, stereo, reading, allow_aspect=allow_aspect)
    for file, target in zip(files, targets, strict=True):
        write_tags(file, target, stereo, reading)
        if not quiet:
            say(f"{target}: tagged as 360°{'' if stereo == 'mono' else f', {stereo}'}")


def _targets(files: tuple[Path, ...], output: Path | None, overwrite: bool) -> list[Path]:
    """Where every file goes. OutputPathError: there is something, or it is one place for several."""
    from omnisyn_cli.errors import OutputPathError
    from omnisyn_cli.io.outputs import check_kept, check_output

    targets = [file.with_name(f"{file.stem}-360{file.suffix}") for file in files]
    if output is not None:
        targets = [output / file.name for file in files] if output.is_dir() else [output] * len(files)
    if len({*targets}) < len(targets):
        raise OutputPathError(f"{output}: expected a folder for files of different names; tag them one by one")
    check_kept(targets, files)
    for target in targets:
        check_output(target, overwrite)
    return targets
