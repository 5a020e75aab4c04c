"""``omnisyn poses export``: a pose file as another program wants it."""

from __future__ import annotations

from pathlib import Path

import click

from omnisyn_cli.cli.interpolate import Size
from omnisyn_cli.cli.places import FilePath

__all__ = ["export"]

FORMATS = ("colmap", "nerfstudio", "tum")
""":data:`omnisyn_cli.io.pose_formats.EXPORT_FORMATS`, written out because ``--help`` should not load them."""


@click.command()
@click.argument("poses", metavar="POSES", type=FilePath())
@click.option("-o", "--output", required=True, type=FilePath(), help="File to write; for colmap a folder.")
@click.option("--format", "format_name", type=click.Choice(FORMATS), required=True)
@click.option("--images", type=FilePath(), help="Folder of the panoramas.  [default: that of POSES]")
@click.option("--size", type=Size(), help="Of all panoramas.  [default: read from their files]")
@click.option(
    "--allow-outside", is_flag=True, help="Accept depth and masks outside of POSES' folder (none is exported)."
)
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")
def export(
    poses: Path,
    output: Path,
    format_name: str,
    images: Path | None,
    size: tuple[int, int] | None,
    allow_outside: bool,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Write poses.json as another program wants it.

    \b
    colmap      cameras.txt, images.txt, points3D.txt in a folder; EQUIRECTANGULAR cameras
    nerfstudio  transforms.json; EQUIRECTANGULAR cameras, z up
    tum         a trajectory in OpenCV axes; names in comments
    """  # noqa: D301 - click's \b is a backspace
    from omnisyn_cli.io import read_poses
    from omnisyn_cli.io.paths import check_kept
    from omnisyn_cli.io.pose_formats import export_poses

    check_kept([output], [poses])
    pose_file = read_poses(poses, allow_outside=allow_outside)
    notes = export_poses(pose_file, output, format_name, images=images, size=size, overwrite=overwrite)
    if not quiet:
        for note in notes:
            click.echo(note, err=True)
        click.echo(f"{output}: {len(pose_file.panoramas)} panoramas for {format_name}", err=True)
