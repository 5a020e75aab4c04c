"""``omnisyn poses import``: a pose file from what another program, or a camera, wrote."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from omnisyn_cli.cli.numbers import FiniteRange
from omnisyn_cli.cli.places import FilePath

if TYPE_CHECKING:
    from omnisyn_cli.io.pose_formats import Origin

    PlaceType = click.ParamType[Origin]
else:
    PlaceType = click.ParamType  # older releases of click have no generic one

__all__ = ["import_"]

FORMATS = ("auto", "exif", "table", "colmap", "opensfm", "nerfstudio", "tum", "kitti", "habitat", "zind", "authors")
"""``auto`` and :data:`omnisyn_cli.io.pose_formats.IMPORT_FORMATS`, written out: ``--help`` does not load them."""

CAMERA_AXES = ("opengl", "opencv", "flu")

UP = ("y", "-y", "z", "-z", "cameras")


class Place(PlaceType):
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


@click.command("import")
@click.argument("sources", metavar="SOURCE...", nargs=-1, required=True, type=FilePath())
@click.option("-o", "--output", required=True, type=FilePath(), help="The pose file to write.")
@click.option("--format", "format_name", type=click.Choice(FORMATS), default="auto", show_default=True)
@click.option("--images", type=FilePath(), help="Folder of the panoramas.  [default: where SOURCE says]")
@click.option(
    "--copy-images", is_flag=True, help="Copy panoramas (and depth) beside the pose file, under unique names."
)
@click.option("--origin", type=Place(), metavar="LAT,LON[,ALT]", help="Origin of a world on earth.  [default: first]")
@click.option("--up", type=click.Choice(UP), help="Axis of SOURCE's world that points up.  [default: the format's]")
@click.option(
    "--camera-axes", type=click.Choice(CAMERA_AXES), help="Axes of SOURCE's cameras.  [default: the format's]"
)
@click.option("--floor", help="Floor of a ZInD tour, e.g. floor_01.  [default: the only one]")
@click.option(
    "--time-tolerance",
    type=FiniteRange(0),
    default=0.02,
    show_default=True,
    help="Seconds by which time stamps of a trajectory and of its images may differ.",
)
@click.option("--allow-outside", is_flag=True, help="Accept images outside of SOURCE's folder.")
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")
def import_(
    sources: tuple[Path, ...],
    output: Path,
    format_name: str,
    images: Path | None,
    copy_images: bool,
    origin: Origin | None,
    up: str | None,
    camera_axes: str | None,
    floor: str | None,
    time_tolerance: float,
    allow_outside: bool,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Make poses.json from what another program, or a camera, wrote.

    \b
    exif        images with GPS and GPano tags, or their folder
    table       CSV or JSON with image, lat, lng, heading, pitch, roll
    colmap      text model with EQUIRECTANGULAR cameras
    opensfm     reconstruction.json with spherical cameras
    nerfstudio  transforms.json with EQUIRECTANGULAR cameras
    tum, kitti  trajectories
    habitat     NN/{rgb.png,rot.txt,tran.txt} as PanoGRF and PanSplat use them
    zind        zind_data.json of the Zillow Indoor Dataset
    authors     rotations.npy and translations.npy of the OmniSyn authors

    What had to be assumed is said on stderr, one line each.
    """  # noqa: D301 - click's \b is a backspace
    from omnisyn_cli.io import check_output
    from omnisyn_cli.io.paths import check_kept
    from omnisyn_cli.io.pose_formats import ImportOptions, import_poses, write_imported

    check_kept([output], sources)
    check_output(output, overwrite)
    options = ImportOptions(images, origin, up, camera_axes, floor, time_tolerance, allow_outside)
    name, imported = import_poses(sources, format_name, options)
    notes = write_imported(output, imported, copy_images=copy_images, overwrite=overwrite)
    if not quiet:
        for note in (*imported.notes, *notes):
            click.echo(note, err=True)
        click.echo(f"{output}: {len(imported.views)} panoramas from {name}", err=True)
