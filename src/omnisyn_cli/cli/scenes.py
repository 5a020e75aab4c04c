"""``omnisyn scenes``: panoramas with exact depth and poses, procedural ones and those of textured meshes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from omnisyn_cli.cli.help import PlainGroup
from omnisyn_cli.cli.options import quiet_option, threads_option
from omnisyn_cli.cli.parameters import FILE, FOLDER, FilePath, FiniteRange, Size, WholeRange
from omnisyn_cli.cli.progress import say_when_compiling
from omnisyn_cli.cli.terminal import say

if TYPE_CHECKING:
    from omnisyn_cli.geometry.pose import Pose
    from omnisyn_cli.scenes.mesh.render import MeshScene

# What :data:`omnisyn_cli.scenes.GENERATORS` make, written out because ``--help`` should not load them.
KINDS = ("street", "room", "home")
# Of every command that makes scenes.
TEXTURES = click.option(
    "--textures", type=FOLDER, metavar="FOLDER",
    help="Photographs to use as materials of walls, floors, fronts, pictures and objects.",
)  # fmt: skip

MEDIUM_TEXTURE = 0.5  # Share of the area without texture from which on a line says so


@click.group(cls=PlainGroup)
def scenes() -> None:
    """Make procedural scenes with exact depth and poses."""


# Parameters that the standard set has not fixed.
SUITE_OPTIONS = {"out", "suite", "size", "threads", "overwrite", "quiet"}


@scenes.command()
@click.argument("out", type=FilePath())
@click.option(
    "--suite", is_flag=True,
    help="Write the standard evaluation set: streets and rooms, 1, 2, 4 and 6 m apart, with three frames between.",
)  # fmt: skip
@click.option("--kind", type=click.Choice(KINDS), default="street", help="Kind of scene.")
@click.option("--seed", type=WholeRange(0), default=0, help="Seed of the first scene; the next ones count up.")
@click.option("--count", type=WholeRange(1), default=1, help="Number of scenes; above 1 each gets a folder in OUT.")
@click.option("--frames", type=WholeRange(1), default=3, help="Panoramas on a straight line.")
@click.option("--size", type=Size(), default="1024x512", help="Size of the panoramas.")
@click.option(
    "--baseline", type=FiniteRange(0, min_open=True),
    help="Metres from the first panorama to the last.  [default: random]",
)  # fmt: skip
@click.option("--tilt", type=FiniteRange(0, 90), default=0.0, help="Camera tilt in degrees.")
@click.option("--vertical", is_flag=True, help="Put the cameras one above the other.")
@click.option("--supersample", type=WholeRange(1, 8), default=3, help="Samples per pixel along each axis.")
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
        try:
            path = sample_path(
                scene, number, frames, baseline=baseline, vertical=float(vertical), tilt=math.radians(tilt)
            )
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
    from omnisyn_cli.evaluation.scene_files import PANORAMA_NAMES, SUPERSAMPLE, files_of_scene, write_scene
    from omnisyn_cli.io.outputs import make_folder, staged_folder
    from omnisyn_cli.scenes import generate_scene
    from omnisyn_cli.scenes.paths import suite_scenes

    walks = list(suite_scenes())
    for walk in walks:
        _check_folder(out / walk.name, files_of_scene(PANORAMA_NAMES), overwrite)
    make_folder(out, "scenes")
    for walk in walks:
        if walk.path:
            with staged_folder(out / walk.name, overwrite=overwrite) as staged:
                scene = generate_scene(walk.kind, walk.seed)
                write_scene(staged, scene, walk.path, PANORAMA_NAMES, size, SUPERSAMPLE, threads)
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


@scenes.command()
@click.argument("meshes", nargs=-1, required=True, type=FILE)
@click.option("-o", "--output", required=True, type=FOLDER, help="Folder to write.")
@click.option("--count", type=WholeRange(1), default=1, help="Walks through each mesh.")
@click.option("--frames", type=WholeRange(1), default=3, help="Panoramas on a straight line.")
@click.option("--poses", type=FILE, help="Pose file of the cameras, in the mesh's frame, y up.")
@click.option("--size", type=Size(), default="1024x512", help="Size of the panoramas.")
@click.option("--scale", type=FiniteRange(0, min_open=True), default=1.0, help="Metres per unit.")
@click.option("--z-up", is_flag=True, help="The z axis of the files is up, instead of y.")
@click.option("--unlit", is_flag=True, help="Show textures without lighting, as for scans.")
@click.option("--textures", type=FOLDER, help="Photographs for surfaces without texture.")
@click.option("--light-rays", type=WholeRange(4, 1024), default=64, help="Light rays per pixel.")
@click.option("--supersample", type=WholeRange(1, 8), default=2, help="Samples per pixel along each axis.")
@click.option("--seed", type=WholeRange(0), default=0, help="Seed of walks and lighting.")
@click.option("--pool", is_flag=True, help="Write training scenes (.npz) for `omnisyn train recipe` instead.")
@click.option("--no-depth", is_flag=True, help="Write no depth files.")
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
@quiet_option
def render(
    meshes: tuple[Path, ...], output: Path, count: int, frames: int, poses: Path | None, size: tuple[int, int],
    scale: float, z_up: bool, unlit: bool, textures: Path | None, light_rays: int, supersample: int, seed: int,
    pool: bool, no_depth: bool, overwrite: bool, quiet: bool,
) -> None:  # fmt: skip
    """Render walks through textured MESHES (glTF, OBJ, PLY).

    The output is that of `scenes make`: panoramas, their depth (EXR, metres) and poses.json.

    Cameras stand at eye height in free space, on straight lines that the program finds, or at --poses. Light comes from
    light maps if there are any, else from the sky, lamps and other surfaces. Several walks get a folder each.

    Needs `pip install "omnisyn-cli[scenes]"`.
    """
    from functools import partial

    from omnisyn_cli.evaluation.scene_files import files_of_scene, write_renderings
    from omnisyn_cli.io import read_photographs
    from omnisyn_cli.io.outputs import check_output, make_folder, staged_folder
    from omnisyn_cli.scenes.mesh.render import render_mesh

    if pool and (poses is not None or frames < 2):
        raise click.UsageError("expected --pool with at least 2 --frames and without --poses; leave one out")
    if poses is not None and count > 1:
        raise click.UsageError("expected --poses without --count, as they are the same cameras; leave one out")
    photos = [] if textures is None else read_photographs(textures)
    several = len(meshes) * count > 1
    for number, path in enumerate(meshes):
        mesh = _mesh(path, scale, photos, seed, z_up=z_up, unlit=unlit, quiet=quiet)
        for walk in range(count):
            name = f"{path.stem if path.stem != 'scene' else path.parent.name}_{number:02d}_{walk:04d}"
            scene, line = _walk(mesh, path, (seed, number, walk), frames, poses, light_rays)
            if pool:
                from omnisyn_cli.training.data import save_samples
                from omnisyn_cli.training.walks import mesh_walk

                target = output / f"{name}.npz"
                make_folder(output, "a pool")
                check_output(target, overwrite)
                save_samples(target, [mesh_walk(scene, list(line.values()), size, supersample)])
            else:
                target = output / name if several else output
                _check_folder(target, files_of_scene(line, with_depth=not no_depth), overwrite)
                make_folder(target.parent, "scenes")
                draw = partial(render_mesh, scene, size=size, supersample=supersample)
                with staged_folder(target, overwrite=overwrite) as staged:
                    write_renderings(staged, draw, line, with_depth=not no_depth)
            if not quiet:
                say(f"{target}: {len(line)} panorama{'s' * (len(line) > 1)}", err=True)


def _mesh(path: Path, scale: float, photos: list[Any], seed: int, *, z_up: bool, unlit: bool, quiet: bool) -> Any:
    """The mesh, as it is rendered; InputError unless there is something to see on it."""
    from dataclasses import replace

    import numpy as np

    from omnisyn_cli.errors import InputError
    from omnisyn_cli.io.meshes import read_mesh
    from omnisyn_cli.scenes.mesh.texturing import papered_mesh, untextured_share

    mesh = read_mesh(path, scale, z_up=z_up)
    plain = untextured_share(mesh)
    if plain == 1.0 and not photos:
        raise InputError(f"expected textures or vertex colours in {path}, found none; give photographs (--textures)")
    if plain > MEDIUM_TEXTURE and not photos and not quiet:
        say(f"{path}: {plain:.0%} of the area has no texture; --textures would paper it", err=True)
    if photos:
        mesh = papered_mesh(mesh, np.random.default_rng([32, seed]), photos)
    if unlit:
        mesh = replace(mesh, materials=tuple(replace(material, is_lit=True) for material in mesh.materials))
    return mesh


def _walk(
    mesh: Any, path: Path, seeds: tuple[int, ...], frames: int, poses: Path | None, light_rays: int
) -> tuple[MeshScene, dict[str, Pose]]:
    """The lit scene, and a pose for each image."""
    import numpy as np

    from omnisyn_cli.errors import InputError
    from omnisyn_cli.poses.file import read_poses
    from omnisyn_cli.scenes.mesh.raycast import MeshCaster, find_walk
    from omnisyn_cli.scenes.mesh.render import lit_scene

    caster, rng = MeshCaster(mesh), np.random.default_rng([31, *seeds])
    if poses is not None:
        line = {name: panorama.pose for name, panorama in read_poses(poses).panoramas.items()}
    else:
        found = find_walk(caster, rng, frames)
        if found is None:
            raise InputError(
                f"expected a floor in {path} with free space at eye height and something around it, found none; "
                "check --scale and --z-up, or give cameras (--poses)"
            )
        line = {f"{frame:04d}.png": pose for frame, pose in enumerate(found)}
    return lit_scene(caster, rng, next(iter(line.values())), light_rays), line
