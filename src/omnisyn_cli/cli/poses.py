"""``omnisyn poses``: where panoramas were taken, from and for other programs, and what the pictures say about it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from omnisyn_cli.cli.failures import EXIT_FAILURE
from omnisyn_cli.cli.help import PlainGroup
from omnisyn_cli.cli.options import json_option, outside_option, picture_options, quiet_option
from omnisyn_cli.cli.parameters import FilePath, FiniteRange, Size
from omnisyn_cli.cli.progress import leftover_notes
from omnisyn_cli.cli.terminal import print_json, say

if TYPE_CHECKING:
    from omnisyn_cli.poses.estimation import PictureOptions
    from omnisyn_cli.poses.formats.files import Origin

# ``auto`` and :data:`omnisyn_cli.poses.formats.IMPORT_FORMATS`, written out: ``--help`` does not load them.
IMPORT_FORMATS = (
    "auto", "exif", "table", "xyz", "colmap", "metashape", "opensfm", "nerfstudio", "tum", "kitti", "habitat", "zind",
    "authors",
)  # fmt: skip
# Those of :mod:`omnisyn_cli.poses.formats.writers`, written out likewise.
EXPORT_FORMATS = ("colmap", "nerfstudio", "tum", "gpano")
CAMERA_AXES = ("opengl", "opencv", "flu")
# What a user may call up: an axis of the positions, or what the cameras hold upright.
UP_AXES = ("y", "-y", "z", "-z", "cameras")
ROLL_DIRECTIONS = ("counter-clockwise", "clockwise")

images = click.argument("images", metavar="A B [C ...]", nargs=-1, required=True, type=FilePath())
poses_option = click.option(
    "--poses", type=FilePath(),
    help="JSON file with the poses of the panoramas.  [default: poses.json beside the pictures]",
)  # fmt: skip
output_option = click.option("-o", "--output", required=True, type=FilePath(), help="Pose file to write.")
overwrite_option = click.option("--overwrite", is_flag=True, help="Replace the output if it exists.")


class Place(click.ParamType):  # type: ignore[type-arg]
    """``LATITUDE,LONGITUDE[,ALTITUDE]`` as three numbers."""

    name = "place"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> Origin:
        """Degrees and metres; altitude 0 if none is given."""
        try:
            numbers = [float(part) for part in str(value).split(",")]
        except ValueError:
            numbers = []
        is_complete = len(numbers) in (2, 3) and all(math.isfinite(number) for number in numbers)
        if not is_complete or abs(numbers[0]) > 90 or abs(numbers[1]) > 180:
            self.fail(f"expected LATITUDE,LONGITUDE[,ALTITUDE] in degrees and metres, got '{value}'", param, ctx)
        return numbers[0], numbers[1], numbers[2] if len(numbers) == 3 else 0.0


@click.group(cls=PlainGroup)
def poses() -> None:
    """Import, export, check, refine and estimate poses."""


@poses.command("import")
@click.argument("sources", metavar="SOURCE...", nargs=-1, required=True, type=FilePath())
@click.option("-o", "--output", required=True, type=FilePath(), help="The pose file to write.")
@click.option("--format", "format_name", type=click.Choice(IMPORT_FORMATS), default="auto")
@click.option("--images", type=FilePath(), help="Folder of the panoramas.  [default: where SOURCE says]")
@click.option(
    "--copy-images", is_flag=True, help="Copy panoramas (and depth) beside the pose file, under unique names."
)
@click.option(
    "--origin", type=Place(), metavar="LAT,LON[,ALT]", help="Origin of a georeferenced world.  [default: first]"
)
@click.option(
    "--up", type=click.Choice(UP_AXES), help="Axis of SOURCE's world that points up.  [default: the format's]"
)
@click.option(
    "--camera-axes", "camera", type=click.Choice(CAMERA_AXES), help="Axes of SOURCE's cameras.  [default: the format's]"
)
@click.option(
    "--roll", type=click.Choice(ROLL_DIRECTIONS),
    help="How a positive roll of images or a table rotates the horizon.  [default: counter-clockwise, as in GPano]",
)  # fmt: skip
@click.option("--floor", help="Floor of a ZInD tour, e.g. floor_01.  [default: the only one]")
@click.option(
    "--time-tolerance", type=FiniteRange(0), default=0.02,
    help="Largest difference in seconds between the time stamps of poses and images.",
)  # fmt: skip
@click.option("--allow-outside", is_flag=True, help="Accept images outside the folder of SOURCE.")
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
@quiet_option
def import_(
    sources: tuple[Path, ...], output: Path, format_name: str, copy_images: bool, overwrite: bool, quiet: bool,
    **options: Any,
) -> None:  # fmt: skip
    """Convert poses of cameras and other programs to poses.json.

    \b
    exif        images with GPS and GPano tags, or their folder
    table       CSV or JSON with image, lat, lng, heading, pitch, roll
    xyz         CSV or JSON with image, x, y, z in metres, and heading or qw, qx, qy, qz (NavVis: pano-poses.csv)
    colmap      model with EQUIRECTANGULAR or SPHERE cameras, or the rigs of panorama_sfm.py
    metashape   cameras of spherical sensors, exported as XML
    opensfm     reconstruction.json with spherical cameras
    nerfstudio  transforms.json with EQUIRECTANGULAR cameras
    tum, kitti  trajectories
    habitat     NN/{rgb.png,rot.txt,tran.txt} as PanoGRF and PanSplat use them
    zind        zind_data.json of the Zillow Indoor Dataset
    authors     rotations.npy and translations.npy of the OmniSyn authors

    Every assumption is printed on stderr, one line each.
    """  # noqa: D301 - click's \b is a backspace
    from omnisyn_cli.io.outputs import check_kept, check_output
    from omnisyn_cli.poses.formats import import_poses
    from omnisyn_cli.poses.formats.files import ImportOptions
    from omnisyn_cli.poses.formats.writers import write_imported

    check_kept([output], sources)
    check_output(output, overwrite)
    name, imported = import_poses(sources, format_name, ImportOptions(**options))
    notes = write_imported(output, imported, copy_images=copy_images, overwrite=overwrite)
    _report([*imported.notes, *notes, f"{output}: {len(imported.views)} panoramas from {name}"], output, quiet)


@poses.command()
@click.argument("poses", metavar="POSES", type=FilePath())
@click.option("-o", "--output", required=True, type=FilePath(), help="File to write; for colmap and gpano a folder.")
@click.option("--format", "format_name", type=click.Choice(EXPORT_FORMATS), required=True)
@click.option("--images", type=FilePath(), help="Folder of the panoramas.  [default: that of POSES]")
@click.option("--size", type=Size(), help="Size of all panoramas.  [default: read from their files]")
@click.option(
    "--allow-outside", is_flag=True, help="Accept depth and masks outside the folder of POSES (none is exported)."
)
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
@quiet_option
def export(poses: Path, output: Path, format_name: str, allow_outside: bool, quiet: bool, **options: Any) -> None:
    """Convert poses.json for another program.

    \b
    colmap      cameras.txt, images.txt, points3D.txt in a folder; EQUIRECTANGULAR cameras
    nerfstudio  transforms.json; EQUIRECTANGULAR cameras, z up
    tum         a trajectory in OpenCV axes; names in comments
    gpano       copies of the JPEGs, with heading, pitch and roll as GPano tags
    """  # noqa: D301 - click's \b is a backspace
    from omnisyn_cli.io.outputs import check_kept
    from omnisyn_cli.poses.file import read_poses
    from omnisyn_cli.poses.formats.writers import export_poses

    check_kept([output], [poses])
    pose_file = read_poses(poses, allow_outside=allow_outside)
    notes = export_poses(pose_file, output, format_name, **options)
    _report([*notes, f"{output}: {len(pose_file.panoramas)} panoramas for {format_name}"], output, quiet)


@poses.command()
@images
@poses_option
@picture_options
@outside_option
@json_option("the measurements")
def check(images: tuple[Path, ...], poses: Path | None, allow_outside: bool, as_json: bool, **options: Any) -> None:
    """Check whether poses fit the pictures, and name the mistake if not.

    The command matches points of neighbouring panoramas and compares them with the poses. It cannot check distances,
    but prints the camera heights that follow from them.
    """
    from omnisyn_cli.poses.estimation import check_poses
    from omnisyn_cli.poses.file import read_poses
    from omnisyn_cli.poses.registration.diagnosis import camera_height_sentence, diagnosis_sentences, diagnosis_values

    does_fit, values = True, []
    pose_file = read_poses(poses or _poses_beside(images), allow_outside=allow_outside)
    for pair in check_poses(images, pose_file, _picture_options(**options)):
        does_fit &= pair.diagnosis.verdict not in ("mistake", "contradiction")
        height = pair.camera_height()
        named = {"first": str(pair.first), "second": str(pair.second)}
        values.append({**named, **diagnosis_values(pair.diagnosis), "camera_height": height})
        if not as_json:
            verdict, *details = diagnosis_sentences(pair.diagnosis)
            details += [] if height is None else [camera_height_sentence(height)]
            say(f"{pair.first.name} and {pair.second.name}: {verdict}")
            for detail in details:
                say(f"  {detail}")
    if as_json:
        print_json(values)
    if not does_fit:
        click.get_current_context().exit(EXIT_FAILURE)


@poses.command()
@images
@poses_option
@output_option
@overwrite_option
@picture_options
@outside_option
@quiet_option
def refine(
    images: tuple[Path, ...], poses: Path | None, output: Path, overwrite: bool, allow_outside: bool, quiet: bool,
    **options: Any,
) -> None:  # fmt: skip
    """Correct rotations and directions of poses that nearly fit.

    The first pose and the distances between neighbours stay. Poses that cannot be improved stay too. The correction of
    every pair is printed.
    """
    from omnisyn_cli.io.outputs import check_kept, check_output
    from omnisyn_cli.poses.estimation import refine_poses
    from omnisyn_cli.poses.file import check_companions_named, read_poses, write_poses

    poses = poses or _poses_beside(images)
    pose_file = read_poses(poses, allow_outside=allow_outside)
    check_output(output, overwrite)
    check_kept([output], (poses, *images))
    check_companions_named(output, pose_file.panoramas, allow_outside=allow_outside)
    refined = refine_poses(images, pose_file, _picture_options(**options))
    links, is_metric = pose_file.links, pose_file.is_metric
    write_poses(output, refined.panoramas, allow_outside=allow_outside, links=links, is_metric=is_metric)
    _report([*refined.notes, f"{output}: {refined.changed} of {len(images) - 1} pairs refined"], output, quiet)


@poses.command()
@images
@click.option(
    "--baseline", "baselines", metavar="METRES", multiple=True, type=FiniteRange(0, min_open=True),
    help="Distance between neighbours: once for their mean, or once per pair.",
)  # fmt: skip
@click.option(
    "--camera-height", metavar="METRES", type=FiniteRange(0, min_open=True),
    help="Height of the cameras above the floor, instead of --baseline.",
)  # fmt: skip
@click.option(
    "--add", "new", metavar="NEW", multiple=True, type=FilePath(),
    help="Place this panorama among A, B and so on, whose poses stay as they are; may be repeated. Needs --poses, no "
    "distance.",
)  # fmt: skip
@poses_option
@click.option("--require-all", is_flag=True, help="Fail if a panorama cannot be placed, instead of leaving it out.")
@output_option
@overwrite_option
@picture_options
@quiet_option
def estimate(
    images: tuple[Path, ...], baselines: tuple[float, ...], camera_height: float | None, require_all: bool,
    new: tuple[Path, ...], poses: Path | None, output: Path, overwrite: bool, quiet: bool, **options: Any,
) -> None:  # fmt: skip
    """Estimate the poses of panoramas from the pictures alone.

    The first panorama is at the origin and looks towards −z. Vertical edges level the world. Pictures carry no scale,
    so give the distance between neighbours, or the height of the cameras.

    \b
    omnisyn poses estimate a.jpg b.jpg c.jpg --camera-height 1.6 -o poses.json
    omnisyn poses estimate a.jpg b.jpg c.jpg --add d.jpg -o poses.json --overwrite
    """  # noqa: D301 - click's \b is a backspace
    if (given := bool(baselines) + (camera_height is not None) + bool(new)) != 1:
        problem = "more than one; leave out the others" if given else "none; give one"
        raise click.UsageError(f"expected one of --baseline, --camera-height and --add, got {problem}")
    if poses is not None and not new:
        raise click.UsageError("expected --poses with --add only, got it alone; name new panoramas (--add NEW)")
    from omnisyn_cli.io.outputs import check_kept, check_output
    from omnisyn_cli.poses.addition import add_to_file
    from omnisyn_cli.poses.estimation import estimate_poses
    from omnisyn_cli.poses.file import read_poses, write_poses

    check_output(output, overwrite)
    check_kept([output], (*images, *new))
    pictures = _picture_options(**options)
    if new:
        known = read_poses(poses or _poses_beside(images), allow_outside=True)  # of its files only names are written
        notes = add_to_file(images, new, known, output, pictures)
    else:
        found = estimate_poses(images, baselines, pictures, camera_height=camera_height, must_place_all=require_all)
        write_poses(output, found.panoramas, links=found.links)
        notes = (*found.notes, f"{output}: {len(found.panoramas)} of {len(images)} poses")
    _report(notes, output, quiet)


def _poses_beside(images: Sequence[Path]) -> Path:
    """The pose file beside the first panorama; InputError: there is none."""
    from omnisyn_cli.errors import InputError
    from omnisyn_cli.poses.file import POSES_NAME

    beside = images[0].parent / POSES_NAME
    if not beside.is_file():
        raise InputError(
            f"expected --poses, or a {POSES_NAME} beside {images[0]}, got neither; name the pose file (--poses FILE), "
            "or have poses found (omnisyn poses estimate)"
        )
    return beside


def _picture_options(
    nadir: float, upper_half: bool, hfov: float | None, vfov: float | None, horizon: float, **options: Any
) -> PictureOptions:
    from omnisyn_cli.io.placement import Reading
    from omnisyn_cli.poses.estimation import PictureOptions

    return PictureOptions(nadir=nadir, reading=Reading(upper_half, hfov, vfov, horizon), **options)


def _report(notes: Sequence[str], output: Path, quiet: bool) -> None:
    """Say on stderr what there is to say, one line each, and what killed runs have left beside the output."""
    left = (f"note: {note}" for note in leftover_notes(output))
    for note in () if quiet else (*left, *notes):
        say(note, err=True)
