"""``omnisyn scenes``: procedural panoramas with exact depth and poses."""

import math
from collections.abc import Sequence
from pathlib import Path

import click

from omnisyn_cli.cli.lazy import PlainGroup
from omnisyn_cli.cli.options import quiet_option, threads_option
from omnisyn_cli.cli.parameters import FilePath, FiniteRange, Size, WholeRange
from omnisyn_cli.cli.progress import say_when_compiling
from omnisyn_cli.cli.scenes_render import render
from omnisyn_cli.cli.terminal import say

KINDS = ("street", "room", "home")
"""What :data:`omnisyn_cli.scenes.GENERATORS` make, written out because ``--help`` should not load them."""

TEXTURES = click.option(
    "--textures", type=FilePath(file_okay=False), metavar="FOLDER",
    help="Photographs to use as materials of walls, floors, fronts, pictures and objects.",
)  # fmt: skip
"""Of every command that makes scenes."""


@click.group(cls=PlainGroup)
def scenes() -> None:
    """Make procedural scenes with exact depth and poses."""


scenes.add_command(render)


SUITE_OPTIONS = {"out", "suite", "size", "threads", "overwrite", "quiet"}
"""Parameters that the standard set has not fixed."""


@scenes.command()
@click.argument("out", type=FilePath())
@click.option(
    "--suite", is_flag=True,
    help="Write the standard evaluation set: streets and rooms, 1, 2, 4 and 6 m apart, with three frames between.",
)  # fmt: skip
@click.option("--kind", type=click.Choice(KINDS), default="street", show_default=True, help="Kind of scene.")
@click.option(
    "--seed", type=WholeRange(0), default=0, show_default=True, help="Seed of the first scene; the next ones count up."
)
@click.option(
    "--count", type=WholeRange(1), default=1, show_default=True,
    help="Number of scenes; above 1 each gets a folder in OUT.",
)  # fmt: skip
@click.option("--frames", type=WholeRange(1), default=3, show_default=True, help="Panoramas on a straight line.")
@click.option("--size", type=Size(), default="1024x512", show_default=True, help="Size of the panoramas.")
@click.option(
    "--baseline", type=FiniteRange(0, min_open=True),
    help="Metres from the first panorama to the last.  [default: random]",
)  # fmt: skip
@click.option("--tilt", type=FiniteRange(0, 90), default=0.0, show_default=True, help="Camera tilt in degrees.")
@click.option("--vertical", is_flag=True, help="Put the cameras one above the other.")
@click.option(
    "--supersample", type=WholeRange(1, 8), default=3, show_default=True, help="Samples per pixel along each axis."
)
@click.option(
    "--name", "names", multiple=True, help="Image file of a frame, once per frame.  [default: 0000.png, 0001.png, ...]"
)
@click.option("--no-depth", is_flag=True, help="Write no depth files.")
@TEXTURES
@threads_option
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
@quiet_option
@click.pass_context
def make(
    context: click.Context, out: Path, suite: bool, kind: str, seed: int, count: int, frames: int,
    size: tuple[int, int], baseline: float | None, tilt: float, vertical: bool, supersample: int,
    names: tuple[str, ...], no_depth: bool, textures: Path | None, threads: int | None, overwrite: bool, quiet: bool,
) -> None:  # fmt: skip
    """Make scenes: panoramas, their depth (EXR, metres) and poses.json.

    A scene appears complete or not at all. Equal seeds make equal scenes, at any number of threads. --overwrite
    replaces only files of the same names; other files in a folder stay.

    With --suite every scene of the standard set gets a folder in OUT, which `omnisyn eval OUT` reads; only --size,
    --threads, --overwrite and --quiet apply.
    """
    from omnisyn_cli.errors import InputError
    from omnisyn_cli.evaluation.scene_files import files_of_scene, write_scene
    from omnisyn_cli.io import read_photographs
    from omnisyn_cli.io.outputs import make_folder, staged_folder
    from omnisyn_cli.scenes import generate_scene, pack_photos, sample_path

    context.with_resource(say_when_compiling(is_quiet=quiet))
    if suite:
        _check_suite_options(context)
        _make_suite(out, size, threads, overwrite=overwrite, quiet=quiet)
        return
    names = names or tuple(f"{frame:04d}.png" for frame in range(frames))
    files = files_of_scene(names, with_depth=not no_depth)
    _check_names(names, files, frames)
    folders = [out] if count == 1 else [out / f"{kind}_{number:04d}" for number in range(1, count + 1)]
    for folder in folders:
        _check_folder(folder, files, overwrite)
    photos = None if textures is None else pack_photos(read_photographs(textures))
    for number, folder in enumerate(folders, start=seed):
        scene = generate_scene(kind, number, photos)
        upright = 1.0 if vertical else 0.0
        try:
            path = sample_path(scene, number, frames, baseline=baseline, vertical=upright, tilt=math.radians(tilt))
        except ValueError as error:
            raise InputError(f"{kind} of seed {number}: {error}") from error
        make_folder(folder.parent, "scenes")
        with staged_folder(folder, overwrite=overwrite) as staged:
            write_scene(staged, scene, path, names, size, supersample, threads, with_depth=not no_depth)
        if not quiet:
            say(f"{folder}: {kind}, seed {number}, {frames} panorama{'s' * (frames > 1)}", err=True)


def _check_suite_options(context: click.Context) -> None:
    """Refuse options that the standard set has fixed."""
    from click.core import ParameterSource

    given = [
        option.opts[0]
        for option in context.command.params
        if option.name not in SUITE_OPTIONS and context.get_parameter_source(option.name) is ParameterSource.COMMANDLINE
    ]
    if given:
        options = ", ".join(given)
        raise click.UsageError(f"expected --suite without {options}: its scenes are fixed; leave one of them out")


def _make_suite(out: Path, size: tuple[int, int], threads: int | None, *, overwrite: bool, quiet: bool) -> None:
    """Every scene of the standard set in a folder of its own; each appears whole or not at all."""
    from omnisyn_cli.evaluation.scene_files import PANORAMA_NAMES, files_of_scene, write_suite_scene
    from omnisyn_cli.io.outputs import make_folder, staged_folder
    from omnisyn_cli.scenes.paths import suite_scenes

    walks = list(suite_scenes())
    for walk in walks:
        _check_folder(out / walk.name, files_of_scene(PANORAMA_NAMES), overwrite)
    make_folder(out, "scenes")
    for walk in walks:
        if walk.path:
            with staged_folder(out / walk.name, overwrite=overwrite) as staged:
                write_suite_scene(staged, walk, size, threads)
        if not quiet:
            missing = f"not made, the scene has no room for {walk.baseline:g} m"
            say(f"{out / walk.name}: {f'{len(walk.path)} panoramas' if walk.path else missing}", err=True)


def _check_names(names: Sequence[str], files: Sequence[str], frames: int) -> None:
    from omnisyn_cli.errors import OutputPathError
    from omnisyn_cli.io.encode import image_suffix

    if len(names) != frames:
        raise click.UsageError(f"expected --name once for each of {frames} frames, got it {len(names)} times")
    if len({Path(name).stem for name in names}) != frames or any(Path(name).name != name for name in names):
        raise OutputPathError(f"{', '.join(names)}: expected different file names without folders; change --name")
    if len(set(files)) != len(files):
        raise OutputPathError(f"{', '.join(names)}: expected no image named as the depth of another; change --name")
    for name in names:
        image_suffix(Path(name))


def _check_folder(folder: Path, files: Sequence[str], overwrite: bool) -> None:
    """Refuse a folder that the files could not be put into, or that has one of them unless ``overwrite``."""
    from omnisyn_cli.io import check_output
    from omnisyn_cli.io.outputs import check_name, check_staged_folder

    check_name(folder)
    check_staged_folder(next(path for path in (folder, *folder.parents) if path.exists()))
    if folder.is_dir():
        for file in files:
            check_output(folder / file, overwrite)
