"""Options that say which part of the panoramas may be used."""

from __future__ import annotations

import click

from omnisyn_cli.cli.numbers import FiniteRange
from omnisyn_cli.cli.places import FilePath

__all__ = ["masks_option", "nadir_option"]

masks_option = click.option(
    "--mask", "masks", metavar="FILE", multiple=True, type=FilePath(),
    help="Image that is black where a panorama must not be used; once for each panorama, in their order.",
)  # fmt: skip

nadir_option = click.option(
    "--nadir", metavar="DEGREES", type=FiniteRange(0, 90, max_open=True), default=0.0,
    help="Do not use what is this close to straight down in the panoramas: tripod, roof of a car.",
)  # fmt: skip
