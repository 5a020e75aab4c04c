"""``omnisyn scenes``: procedural panoramas with exact depth and poses."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from omnisyn_cli.cli.interpolate import Size

if TYPE_CHECKING:
    from omnisyn_cli.geometry.pose import Pose
    from omnisyn_cli.scenes import Scene

__all__ = ["scenes"]

POSES_NAME = "poses.json"


@click.group()
def scenes() -> None:
    """Make procedural scenes with exact depth and poses."""


@scenes.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.option(
    "--kind", type=click.Choice(["street", "room"]), default="street", show_default=True, help="What to build."
)
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the first scene; the next ones count on."
)
@click.option(
    "--count", type=click.IntRange(1), default=1, show_default=True, help="Scenes; above 1 each gets a folder in OUT."
)
@click.option("--frames", type=click.IntRange(1), default=3, show_default=True, help="Panoramas on a straight line.")
@click.option("--size", type=Size(), default="1024x512", show_default=True, help="Of the panoramas.")
@click.option(
    "--baseline",
    type=click.FloatRange(0, min_open=True),
    help="Metres from the first to the last.  [default: by chance]",
)
@click.option(
    "--tilt",
    type=click.FloatRange(0, 90),
    default=0.0,
    show_default=True,
    help="Degrees by which cameras are held askew.",
)
@click.option("--vertical", is_flag=True, help="Put the cameras one above the other.")
@click.option(
    "--supersample", type=click.IntRange(1, 8), default=3, show_default=True, help="Samples per pixel along each axis."
)
@click.option(
    "--name", "names", multiple=True, help="Image file of a frame, once per frame.  [default: 0000.png, 0001.png, ...]"
)
@click.option("--no-depth", is_flag=True, help="Write no depth files.")
@click.option("--threads", type=click.IntRange(1), help="At most this many threads.  [default: one per core]")
@click.option("--overwrite", is_flag=True, help="Replace scenes that exist.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")
def make(
    out: Path,
    kind: str,
    seed: int,
    count: int,
    frames: int,
    size: tuple[int, int],
    baseline: float | None,
    tilt: float,
    vertical: bool,
    supersample: int,
    names: tuple[str, ...],
    no_depth: bool,
    threads: int | None,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Make scenes: panoramas, their depth (EXR, metres) and poses.json.

    A scene appears whole or not at all. Equal seeds make equal scenes, whatever the number of threads.
    """
    from omnisyn_cli.errors import InputError
    from omnisyn_cli.scenes import generate_scene, sample_path

    names = names or tuple(f"{frame:04d}.png" for frame in range(frames))
    _check_names(names, frames)
    folders = [out] if count == 1 else [out / f"{kind}_{number:04d}" for number in range(1, count + 1)]
    for folder in folders:
        _check_folder(folder, overwrite)
    for number, folder in enumerate(folders, start=seed):
        scene = generate_scene(kind, number)
        upright = 1.0 if vertical else 0.0
        try:
            path = sample_path(scene, number, frames, baseline=baseline, vertical=upright, tilt=math.radians(tilt))
        except ValueError as error:
            raise InputError(f"{kind} of seed {number}: {error}") from error
        with _complete_folder(folder) as unfinished:
            _write_scene(unfinished, scene, path, names, size, supersample, threads, with_depth=not no_depth)
        if not quiet:
            click.echo(f"{folder}: {kind}, seed {number}, {frames} panoramas", err=True)


def _write_scene(
    folder: Path,
    scene: Scene,
    path: Sequence[Pose],
    names: Sequence[str],
    size: tuple[int, int],
    supersample: int,
    threads: int | None,
    *,
    with_depth: bool,
) -> None:
    from omnisyn_cli.io import PosedPanorama, write_depth, write_image, write_poses
    from omnisyn_cli.scenes import render_panorama

    panoramas = {}
    for name, pose in zip(names, path, strict=True):
        image, depth = render_panorama(scene, pose, size, supersample=supersample, threads=threads)
        write_image(folder / name, image)
        depth_file = folder / f"{Path(name).stem}_depth.exr" if with_depth else None
        if depth_file is not None:
            write_depth(depth_file, depth)
        panoramas[name] = PosedPanorama(pose, depth=depth_file)
    write_poses(folder / POSES_NAME, panoramas)


def _check_names(names: Sequence[str], frames: int) -> None:
    from omnisyn_cli.errors import OutputPathError
    from omnisyn_cli.io.encode import image_suffix

    if len(names) != frames:
        raise click.UsageError(f"expected --name once for each of {frames} frames, got it {len(names)} times")
    if len({Path(name).stem for name in names}) != frames or any(Path(name).name != name for name in names):
        raise OutputPathError(f"{', '.join(names)}: expected different file names without folders; change --name")
    for name in names:
        image_suffix(Path(name))


def _check_folder(folder: Path, overwrite: bool) -> None:
    """Refuse to replace what exists; with ``overwrite`` still refuse what does not look like a scene."""
    from omnisyn_cli.errors import OutputPathError

    if not folder.exists() and not folder.is_symlink():
        return
    if not overwrite:
        raise OutputPathError(
            f"{folder}: expected a new folder, got one that exists; choose another name or --overwrite"
        )
    if folder.is_symlink() or not folder.is_dir() or (any(folder.iterdir()) and not (folder / POSES_NAME).is_file()):
        raise OutputPathError(
            f"{folder}: expected a scene to overwrite, got something without {POSES_NAME}; remove it yourself"
        )


@contextmanager
def _complete_folder(folder: Path) -> Iterator[Path]:
    """Give a hidden folder beside ``folder``; put it in place at the end, remove it after any failure."""
    from omnisyn_cli.errors import WriteError
    from omnisyn_cli.io.paths import temporary_name

    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        unfinished, replaced = temporary_name(folder.parent), temporary_name(folder.parent)
        unfinished.mkdir()
        try:
            yield unfinished
            if folder.exists():
                folder.rename(replaced)
            unfinished.rename(folder)
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
            shutil.rmtree(replaced, ignore_errors=True)
    except OSError as error:
        raise WriteError(
            f"{folder}: expected to write a scene, got '{error.strerror}'; free some space or choose another place"
        ) from error
