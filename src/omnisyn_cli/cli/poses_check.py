"""``omnisyn poses check``, ``refine`` and ``estimate``: poses and what the pictures say about them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from omnisyn_cli.cli.masks import masks_option, nadir_option
from omnisyn_cli.cli.numbers import FiniteRange, WholeRange
from omnisyn_cli.cli.places import FilePath

if TYPE_CHECKING:
    from omnisyn_cli.posing import PictureOptions

__all__ = ["check", "estimate", "refine"]


images = click.argument("images", metavar="A B [C ...]", nargs=-1, required=True, type=FilePath())
poses_option = click.option(
    "--poses", required=True, type=FilePath(), help="JSON file with the poses of the panoramas."
)
output_option = click.option("-o", "--output", required=True, type=FilePath(), help="Pose file to write.")
overwrite_option = click.option("--overwrite", is_flag=True, help="Replace the output if it exists.")
threads_option = click.option("--threads", type=WholeRange(1), help="At most this many.  [default: one per core]")
aspect_option = click.option("--allow-aspect", is_flag=True, help="Accept panoramas that are not 2:1.")
outside_option = click.option(
    "--allow-outside", is_flag=True, help="Accept depth and masks outside of the pose file's folder."
)
quiet_option = click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")


@click.command(epilog="Exit codes: 0 the poses fit or nearly fit (or cannot be judged), 3 they do not.")
@images
@poses_option
@masks_option
@nadir_option
@threads_option
@aspect_option
@outside_option
@click.option("--json", "as_json", is_flag=True, help="Print the measurements as JSON.")
def check(images: tuple[Path, ...], poses: Path, allow_outside: bool, as_json: bool, **options: Any) -> None:
    """Do the poses fit the pictures, and if not, what was done wrong?

    Points that neighbouring panoramas have in common are compared with the poses. The distance between two panoramas
    cannot be checked.
    """
    import json

    from omnisyn_cli.io import read_poses
    from omnisyn_cli.posing import check_poses
    from omnisyn_cli.registration.words import diagnosis_sentences, diagnosis_values

    does_fit, values = True, []
    pose_file = read_poses(poses, allow_outside=allow_outside)
    for pair in check_poses(images, pose_file, _picture_options(**options)):
        does_fit &= pair.diagnosis.verdict not in ("mistake", "contradiction")
        values.append({"first": str(pair.first), "second": str(pair.second), **diagnosis_values(pair.diagnosis)})
        if not as_json:
            verdict, *details = diagnosis_sentences(pair.diagnosis)
            click.echo("\n  ".join([f"{pair.first.name} and {pair.second.name}: {verdict}", *details]))
    if as_json:
        click.echo(json.dumps(values, indent=2, ensure_ascii=False))
    if not does_fit:
        click.get_current_context().exit(3)


@click.command()
@images
@poses_option
@output_option
@overwrite_option
@masks_option
@nadir_option
@threads_option
@aspect_option
@outside_option
@quiet_option
def refine(
    images: tuple[Path, ...], poses: Path, output: Path, overwrite: bool, allow_outside: bool, quiet: bool,
    **options: Any,
) -> None:  # fmt: skip
    """Correct rotations and directions of poses that nearly fit.

    The first panorama and the distances between neighbours stay as they are. What cannot be improved is written as it
    was given; every pair's correction is printed.
    """
    from omnisyn_cli.io import check_output, read_poses, write_poses
    from omnisyn_cli.io.paths import check_kept
    from omnisyn_cli.io.poses import check_companions_named
    from omnisyn_cli.posing import refine_poses

    pose_file = read_poses(poses, allow_outside=allow_outside)
    check_output(output, overwrite)
    check_kept([output], (poses, *images))
    check_companions_named(output, pose_file.panoramas, allow_outside=allow_outside)
    refined = refine_poses(images, pose_file, _picture_options(**options))
    write_poses(output, refined.panoramas, allow_outside=allow_outside)
    _report(refined.notes, f"{output}: {refined.changed} of {len(images) - 1} pairs refined", quiet)


@click.command()
@images
@click.option(
    "--baseline", "baselines", metavar="METRES", multiple=True, required=True,
    type=FiniteRange(0, min_open=True), help="Distance of neighbours: once for all pairs, or once for each.",
)  # fmt: skip
@output_option
@overwrite_option
@masks_option
@nadir_option
@threads_option
@aspect_option
@quiet_option
def estimate(
    images: tuple[Path, ...], baselines: tuple[float, ...], output: Path, overwrite: bool, quiet: bool, **options: Any
) -> None:
    """Find the poses of panoramas in the pictures alone.

    The first panorama is put at the origin and taken for level, looking along −z. Pictures do not tell distances: say
    how far neighbours are apart.
    """
    from omnisyn_cli.io import check_output, write_poses
    from omnisyn_cli.io.paths import check_kept
    from omnisyn_cli.posing import estimate_poses

    check_output(output, overwrite)
    check_kept([output], images)
    found = estimate_poses(images, baselines, _picture_options(**options))
    write_poses(output, found.panoramas)
    _report(found.notes, f"{output}: {len(found.panoramas)} poses", quiet)


def _picture_options(nadir: float, **options: Any) -> PictureOptions:
    from omnisyn_cli.posing import PictureOptions

    return PictureOptions(nadir=math.radians(nadir), **options)


def _report(notes: Sequence[str], last: str, quiet: bool) -> None:
    if not quiet:
        for note in notes:
            click.echo(note, err=True)
        click.echo(last, err=True)
