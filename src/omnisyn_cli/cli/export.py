"""``omnisyn export``: panoramas with their depth as files for other programs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from omnisyn_cli.cli.help import SectionedCommand
from omnisyn_cli.cli.options import check_one_cut, device_option, named, output_options, surface_options, tour_options
from omnisyn_cli.cli.parameters import FilePath, FiniteRange, WholeRange
from omnisyn_cli.cli.runner import run_job
from omnisyn_cli.cli.terminal import say

if TYPE_CHECKING:
    from omnisyn_cli.interpolation.export.formats import ExportSummary

VIEWERS = ("pannellum", "photo-sphere-viewer", "marzipano", "krpano")  # those of sites
# Those of :data:`omnisyn_cli.interpolation.export.formats.FORMATS`, written out as ``--help`` should not load them.
FORMATS = ("glb", "ply", "splats", "colmap", "nerfstudio", *VIEWERS)


@click.command(cls=SectionedCommand)
@tour_options
@click.option(
    "-o", "--output", type=FilePath(),
    help="File (.glb, .ply), or folder for all other formats.  [default: FOLDER or A-C with the format's ending, here]",
)  # fmt: skip
@click.option(
    "--format", type=click.Choice(FORMATS),
    help="glb: a textured mesh, for Blender and model-viewer. ply: points. splats: flat discs as Gaussian splats, for "
    "SuperSplat. colmap: two models with depth, of panoramas and of six faces. nerfstudio: transforms.json with depth. "
    "pannellum, photo-sphere-viewer, marzipano, krpano: a site with links for that viewer. "
    " [default: by the output's ending, else glb]",
)  # fmt: skip
@click.option(
    "--texture", metavar="COLUMNS", type=WholeRange(16), default=4096,
    help="Maximum width of the textures in a GLB, and of panoramas in a site.",
)  # fmt: skip
@click.option(
    "--stride", type=WholeRange(1),
    help="Distance of points or discs in pixels of the depth.  [default: 1; 4 in data sets]",
)  # fmt: skip
@click.option(
    "--sky/--no-sky", default=None, help="Put the sky on the dome.  [default: sky for glb and splats, else no-sky]"
)
@click.option(
    "--dome", metavar="METRES", type=FiniteRange(0, min_open=True), default=200.0,
    help="Radius of the sphere around each panorama that holds everything farther away.",
)  # fmt: skip
@click.option(
    "--clips", is_flag=True,
    help="With pannellum and marzipano: make short videos along the links, which the page shows instead of fading.",
)  # fmt: skip
@surface_options
@device_option("Where networks run; auto uses a GPU if ONNX Runtime has one.")
@output_options
def export(
    *, as_json: bool, dry_run: bool, quiet: bool, clips: bool,
    format: str | None, texture: int, stride: int | None, sky: bool | None, dome: float, **options: Any,  # noqa: A002
) -> None:  # fmt: skip
    """Write panoramas A, B and more, with their depth, for other programs.

    \b
    omnisyn export a.jpg b.jpg --poses auto --baseline 1.4
    omnisyn export tour/ --format splats --stride 2
    omnisyn export a.jpg b.jpg c.jpg --poses auto -o dataset/ --format colmap
    omnisyn export tour/ --format pannellum -o site/

    FOLDER means the panoramas in its poses.json, in the order of that file. With --poses auto it means all pictures in
    it, in an order found from their matches.

    Poses, masks and depth work as in `omnisyn interpolate`. All formats are in metres and have the origin of the poses.
    The up axis differs; see docs/export.md. Sites for viewers are described in docs/tours.md.

    Put `--` before names that begin with a dash.
    """  # noqa: D301 - click's \b is a backspace
    from omnisyn_cli.interpolation.export.formats import ExportJob, default_ending, plan_export

    check_one_cut(options)
    given = named(options, lambda: default_ending(format))
    job = ExportJob(format=format, texture=texture, stride=stride, sky=sky, dome=dome, clips=clips, **given)
    run_job(job, plan_export, "export.run:run_export", _report, as_json=as_json, dry_run=dry_run, quiet=quiet)


def _report(summary: ExportSummary) -> None:
    """Say what was written, in one line."""
    plan, made, form = summary.plan, summary.results, summary.plan.format
    what = f"{made['points']:,} {'discs' if form == 'splats' else 'points'}"
    if made["triangles"]:
        what = f"{made['triangles']:,} triangles"
    elif form in VIEWERS:
        what = f"{made['links']:,} link{'s' * (made['links'] != 1)}"
    say(f"{plan.job.output}: {what} of {len(plan.entries)} panoramas in {summary.seconds['total']:.1f} s")
